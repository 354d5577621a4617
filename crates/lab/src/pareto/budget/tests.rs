//! Choices by hand.

use super::super::cost::tests::runs;
use super::*;

fn calibration() -> Calibration {
    let settings = [("voxel=0.06,k=25", 0.7), ("voxel=0.24,k=1", 0.6)];
    let settings = settings.map(|(s, f_miou)| Calibrated { setting: s.to_owned(), f_miou });
    Calibration {
        version: "0.1.0".to_owned(),
        machine: Machine::default(),
        fingerprint: "m".to_owned(),
        weights_hash: "w".to_owned(),
        f32_flop_s: 1e11,
        reference: "voxel=0.06,k=25".to_owned(),
        scenes: "synthetic:6:1022".to_owned(),
        width: 96,
        classes: 41,
        settings: settings.to_vec(),
        model: CostModel::fit(&runs()),
    }
}

fn size(setting: &str) -> Size {
    let fine = setting.ends_with("25");
    let (cell, k) = if fine { (3, 25) } else { (40, 1) };
    Size { gaussians: 120_000, voxels: 120_000 / cell, classes: 41, width: 96, k }
}

/// By hand: the fine setting takes 1.3 s, the coarse one 0.2 s.
fn choose(ask: Ask, slower: f64) -> Result<Choice, BudgetError> {
    calibration().choose("segment", &ask, &mut size, slower, 0.0)
}

#[test]
fn the_best_that_fits_is_chosen() {
    let within = |seconds| Ask { seconds: Some(seconds), ..Ask::default() };
    assert_eq!(choose(within(3.0), 1.0).unwrap().setting, "voxel=0.06,k=25");
    let coarse = choose(within(0.5), 1.0).unwrap();
    assert_eq!(coarse.setting, "voxel=0.24,k=1");
    assert!(coarse.seconds < 0.5 && (coarse.share - 6.0 / 7.0).abs() < 1e-9, "{coarse:?}");
    // A machine four times as slow.
    assert_eq!(choose(within(3.0), 4.0).unwrap().setting, "voxel=0.24,k=1");
    let error = choose(within(0.01), 1.0).unwrap_err().to_string();
    assert!(error.contains("the cheapest, voxel=0.24,k=1, takes about"), "{error}");
}

#[test]
fn quality_and_memory_are_kept_too() {
    let good = Ask { min_quality: Some(0.95), ..Ask::default() };
    assert_eq!(choose(good, 1.0).unwrap().setting, "voxel=0.06,k=25");
    let any = Ask { min_quality: Some(0.5), ..Ask::default() };
    assert_eq!(choose(any, 1.0).unwrap().setting, "voxel=0.24,k=1");
    let both = Ask { seconds: Some(0.5), ..good };
    let error = choose(both, 1.0).unwrap_err().to_string();
    assert!(error.contains("voxel=0.06") && error.contains("good enough"), "{error}");
    let error = choose(Ask { min_quality: Some(1.01), ..Ask::default() }, 1.0).unwrap_err();
    assert!(matches!(error, BudgetError::Quality { .. }), "{error}");
    // 50 MB and 12 MB of Gaussians; 40 or 3 MB of voxels.
    let memory =
        |mb: u64| Ask { seconds: Some(9.0), max_memory: Some(mb * 1_000_000), ..Ask::default() };
    assert_eq!(choose(memory(80), 1.0).unwrap().setting, "voxel=0.24,k=1");
    assert_eq!(choose(memory(200), 1.0).unwrap().setting, "voxel=0.06,k=25");
    assert!(matches!(choose(memory(10), 1.0).unwrap_err(), BudgetError::Memory { .. }));
}

#[test]
fn the_reserve_is_for_what_is_still_to_do() {
    // 1.24 s of work after 1.5 s that have passed: 1.5 + 1.1 · 1.24 = 2.86 s, not 1.1 · 2.74 = 3.01.
    let after = |seconds| {
        let ask = Ask { seconds: Some(seconds), ..Ask::default() };
        let choice = calibration().choose("segment", &ask, &mut size, 1.0, 1.5).unwrap();
        (choice.setting, choice.seconds)
    };
    let (setting, seconds) = after(2.95);
    assert_eq!(setting, "voxel=0.06,k=25");
    assert!((seconds - 2.74).abs() < 0.01, "{seconds}");
    assert_eq!(after(2.8).0, "voxel=0.24,k=1");
}

#[test]
fn a_front_returns_from_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("front.json");
    std::fs::write(&path, serde_json::to_string(&calibration()).unwrap()).unwrap();
    let back = Calibration::read(&path).unwrap();
    assert_eq!(back.settings, calibration().settings);
    std::fs::write(&path, "{}").unwrap();
    assert!(Calibration::read(&path).unwrap_err().to_string().contains("front.json"));
    let shipped = Calibration::shipped().unwrap();
    assert_eq!(shipped.weights_hash, scenesplat::embedded::sha256());
    assert!(shipped.settings.len() >= 4);
}

#[test]
fn a_slow_machine_makes_only_what_is_still_to_do_longer() {
    // 1.24 s of work after 1.5 s that have passed, four times as slow: 1.5 + 4 · 1.24 = 6.46 s.
    let ask = Ask { seconds: Some(100.0), ..Ask::default() };
    let choice = calibration().choose("segment", &ask, &mut size, 4.0, 1.5).unwrap();
    assert_eq!(choice.setting, "voxel=0.06,k=25");
    assert!((choice.seconds - 6.46).abs() < 0.05, "{}", choice.seconds);
}

#[test]
fn the_margin_is_the_larger_of_error_and_reserve() {
    // 1.24 s of work with half more in reserve are 1.86 s; with a fifth more they would be 1.49 s.
    for (error, reserve) in [(0.5, 0.2), (0.2, 0.5)] {
        let mut calibration = calibration();
        (calibration.model.error, calibration.model.reserve) = (error, reserve);
        let within = |seconds| {
            let ask = Ask { seconds: Some(seconds), ..Ask::default() };
            calibration.choose("segment", &ask, &mut size, 1.0, 0.0).unwrap().setting
        };
        assert_eq!(within(1.95), "voxel=0.06,k=25", "{error} {reserve}");
        assert_eq!(within(1.7), "voxel=0.24,k=1", "{error} {reserve}");
    }
}

/// Settings of 2, 4, 4 and 9 s, and one that the model does not know.
fn four() -> Calibration {
    let by = |values: [f64; 4]| {
        ["a", "b", "c", "d"].map(str::to_owned).into_iter().zip(values.map(|v| vec![v])).collect()
    };
    let settings = [("a", 0.2), ("b", 0.3), ("c", 0.35), ("d", 0.4), ("e", 0.9)];
    Calibration {
        settings: settings.map(|(s, f_miou)| Calibrated { setting: s.to_owned(), f_miou }).to_vec(),
        reference: "d".to_owned(),
        model: CostModel {
            start: 1.0,
            network: by([1.0, 3.0, 3.0, 8.0]),
            results: [("segment".to_owned(), vec![0.0])].into(),
            peak: by([3e9, 2e9, 5e9, 4e9]),
            typical: 1.0,
            ..CostModel::default()
        },
        ..calibration()
    }
}

fn ask(calibration: &Calibration, ask: Ask) -> Result<Choice, String> {
    calibration.choose("segment", &ask, &mut size, 1.0, 0.0).map_err(|error| error.to_string())
}

#[test]
fn what_fits_at_its_bound_is_taken_and_the_reason_is_told() {
    let four = four();
    let any = Ask::default();
    // At least a tenth more than the model says, and at most 0.6.
    let chosen = |seconds| ask(&four, Ask { seconds: Some(seconds), ..any }).map(|c| c.setting);
    assert_eq!([9.91, 9.89, 4.41, 4.39].map(|s| chosen(s).unwrap()), ["d", "c", "c", "a"]);
    let mut slow = four.clone();
    (slow.model.error, slow.model.reserve) = (0.7, 0.9);
    let of_slow = |seconds| ask(&slow, Ask { seconds: Some(seconds), ..any }).unwrap().setting;
    assert_eq!((of_slow(14.41), of_slow(14.39)), ("d".to_owned(), "c".to_owned()));
    let best = ask(&four, Ask { seconds: Some(5.0), ..any }).unwrap();
    let want = Choice {
        setting: "c".to_owned(),
        seconds: 4.0,
        f_miou: 0.35,
        share: 0.35 / 0.4,
        why: "the best of 3 settings that fit, of 4 measured".to_owned(),
    };
    assert_eq!(best, want);
    // Without a time the cheapest; of equally cheap ones the better.
    let cheapest = ask(&four, Ask { min_quality: Some(0.74), ..any }).unwrap();
    assert_eq!(
        (cheapest.setting.as_str(), cheapest.why.as_str()),
        ("c", "the cheapest of 3 settings that fit, of 4 measured")
    );
    assert_eq!(ask(&four, any).unwrap().setting, "a");
    // Of equally good ones the cheaper.
    let mut equal = four.clone();
    (equal.settings[0].f_miou, equal.settings[2].f_miou) = (0.3, 0.3);
    assert_eq!(ask(&equal, Ask { seconds: Some(5.0), ..any }).unwrap().setting, "a");
    // Memory at its bound, and what lacks.
    let within = |bytes| ask(&four, Ask { max_memory: Some(bytes), seconds: Some(99.0), ..any });
    assert_eq!(
        (within(4_000_000_000).unwrap().setting, within(3_999_999_999).unwrap().setting),
        ("d".into(), "b".into())
    );
    let lacking = format!(
        "no setting fits into {} here; b needs least, about {}",
        Bytes(1_999_999_999),
        Bytes(2_000_000_000)
    );
    assert_eq!(within(1_999_999_999).unwrap_err(), lacking);
    assert_eq!(
        ask(&four, Ask { seconds: Some(1.0), ..any }).unwrap_err(),
        "no setting takes 1 s or less here; the cheapest, a, takes about 2.2 s"
    );
    assert_eq!(
        ask(&four, Ask { seconds: Some(4.0), min_quality: Some(0.74), ..any }).unwrap_err(),
        "no setting takes 4 s or less here; the cheapest that is good enough, b, takes about 4.4 s"
    );
    assert_eq!(
        ask(&four, Ask { min_quality: Some(1.001), ..any }).unwrap_err(),
        "no setting keeps 100.1 % of the reference's quality; the best, d, keeps 100.0 %"
    );
    let unknown = four.choose("query", &any, &mut size, 1.0, 0.0).unwrap_err();
    assert_eq!(unknown, BudgetError::Nothing);
    // A machine half as fast after 3 s: 3 + 2 · 9.
    let later = four
        .choose("segment", &Ask { min_quality: Some(1.0), ..any }, &mut size, 2.0, 3.0)
        .unwrap();
    assert_eq!(later.seconds, 21.0);
}
