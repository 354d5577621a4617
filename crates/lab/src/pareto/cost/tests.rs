//! Fits and predictions by hand.

use super::*;

/// Runs of a machine that follows the model to the letter.
pub(crate) fn runs() -> Vec<Observation> {
    let mut runs = Vec::new();
    for (setting, per_voxel, cell) in [("voxel=0.06,k=25", 2e-5, 3), ("voxel=0.24,k=1", 1e-5, 40)] {
        for gaussians in [10_000, 40_000, 160_000] {
            for command in ["segment", "features", "query"] {
                let k = if setting.ends_with("25") { 25 } else { 1 };
                let size = Size { gaussians, voxels: gaussians / cell, classes: 41, width: 96, k };
                let (n, v) = (gaussians as f64, size.voxels as f64);
                let labels = 1e-7 * n * k as f64 + 1e-10 * v * 41.0 * 96.0;
                let write = if command == "features" { 1e-9 * n * 96.0 } else { 1e-7 * n };
                let mut stages = BTreeMap::from([
                    ("read".to_owned(), 1e-7 * n),
                    ("network".to_owned(), 0.01 + per_voxel * v),
                    ("write".to_owned(), write),
                    ("picture".to_owned(), 0.05),
                ]);
                if command != "features" {
                    stages.insert("labels".to_owned(), labels);
                }
                let wall = 0.04 + stages.values().sum::<f64>();
                let peak_bytes = 50_000_000 + 100 * gaussians as u64 + 1000 * size.voxels as u64;
                let setting = setting.to_owned();
                let command = command.to_owned();
                runs.push(Observation { command, setting, size, stages, wall, peak_bytes });
            }
        }
    }
    runs
}

#[test]
fn slow_runs_move_what_is_expected_and_what_is_kept_in_reserve() {
    let model = CostModel::fit(&runs());
    // Each run three times: as fast as can be, a fifth slower, half slower again.
    let all: Vec<Observation> = runs()
        .into_iter()
        .flat_map(|run| {
            [1.0, 1.2, 1.8].map(|times| Observation { wall: run.wall * times, ..run.clone() })
        })
        .collect();
    let spread = model.clone().with_spread(&all);
    assert!((spread.typical - 1.2).abs() < 0.03, "{}", spread.typical);
    assert!((spread.reserve - 0.5).abs() < 0.05, "{}", spread.reserve);
    let size = Size { gaussians: 50_000, voxels: 9_000, classes: 41, width: 96, k: 25 };
    let seconds = |model: &CostModel| model.seconds("segment", "voxel=0.06,k=25", &size).unwrap();
    assert!((seconds(&spread) / seconds(&model) / spread.typical - 1.0).abs() < 1e-9);
    // Without other runs nothing is added.
    let same = model.clone().with_spread(&[]);
    assert_eq!(same, model);
}

#[test]
fn a_model_gives_back_what_it_was_fitted_to_and_what_lies_beyond() {
    let model = CostModel::fit(&runs());
    assert!(model.error < 0.02, "{model:?}");
    let size = Size { gaussians: 1_000_000, voxels: 333_333, classes: 41, width: 96, k: 25 };
    let found = model.seconds("segment", "voxel=0.06,k=25", &size).unwrap();
    let true_seconds = 0.04 + 0.1 + 0.01 + 6.667 + 2.5 + 0.131 + 0.1 + 0.05;
    assert!((found / true_seconds - 1.0).abs() < 0.1, "{found} {true_seconds}");
    assert!(model.seconds("segment", "voxel=0.3", &size).is_none());
    assert!(model.seconds("render", "voxel=0.06,k=25", &size).is_none());
    let peak = model.peak_bytes("voxel=0.06,k=25", &size).unwrap();
    assert!((peak / 483e6 - 1.0).abs() < 0.1, "{peak}");
}

#[test]
fn coefficients_are_never_below_zero() {
    // The best line falls; the best that may not fall is flat.
    let rows: Vec<Vec<f64>> = (1..5).map(|i| vec![1.0, f64::from(i)]).collect();
    let x = nonnegative_fit(&rows, &[4.0, 3.0, 2.0, 1.0]);
    assert!(x[0] > 0.0 && x[1] == 0.0, "{x:?}");
    assert_eq!(nonnegative_fit(&[], &[]), Vec::<f64>::new());
    assert_eq!(nonnegative_fit(&[vec![1.0]], &[0.0]), [0.0]);
}

/// Coefficients that are told apart in any sum.
pub(crate) fn model() -> CostModel {
    CostModel {
        start: 0.5,
        read: vec![1.0, 0.001],
        network: BTreeMap::from([("fine".to_owned(), vec![2.0, 0.01, 0.002])]),
        labels: vec![3.0, 0.004, 0.0005, 0.000_01],
        results: BTreeMap::from([
            ("segment".to_owned(), vec![5.0, 0.006, 0.000_07]),
            ("features".to_owned(), vec![7.0, 0.008, 0.000_09]),
        ]),
        peak: BTreeMap::from([("fine".to_owned(), vec![1e6, 100.0, 3000.0])]),
        error: 0.0,
        typical: 2.0,
        reserve: 0.0,
    }
}

#[test]
fn a_prediction_is_the_sum_of_its_terms() {
    // Read 1 + 1, network 2 + 4 + 2, labels 3 + 4 + 0.5 · 8 + 0.00001 · 400 · 5 · 10, results 5 + 6 + 0.7; start 0.5.
    let size = Size { gaussians: 1000, voxels: 400, classes: 5, width: 10, k: 8 };
    let near = |found: Option<f64>, want: f64| {
        assert!((found.unwrap() - want).abs() < 1e-9, "{found:?} {want}");
    };
    let (shared, labels) = (0.5 + 2.0 + 8.0, 3.0 + 4.0 + 4.0 + 0.2);
    near(model().seconds("segment", "fine", &size), 2.0 * (shared + labels + 11.7));
    // Features are not labeled: 7 + 8 + 0.9. One neighbor does not vote.
    near(model().seconds("features", "fine", &size), 2.0 * (shared + 15.9));
    let alone = Size { k: 1, ..size };
    near(model().seconds("segment", "fine", &alone), 2.0 * (shared + labels - 4.0 + 11.7));
    near(model().peak_bytes("fine", &size), 1e6 + 1e5 + 1.2e6);
    assert_eq!(model().peak_bytes("coarse", &size), None);
    // Files of before have neither of these.
    let mut old = serde_json::to_value(model()).unwrap();
    let fields = old.as_object_mut().unwrap();
    fields.remove("typical");
    fields.remove("reserve");
    let old: CostModel = serde_json::from_value(old).unwrap();
    assert_eq!((old.typical, old.reserve), (1.0, 0.0));
}

#[test]
fn a_fit_finds_what_each_stage_takes_by_setting_and_command() {
    let of = |command: &str, setting: &str, gaussians: usize, wall: f64| {
        let size = Size { gaussians, voxels: gaussians / 2, classes: 2, width: 3, k: 0 };
        let n = gaussians as f64;
        let by = if setting == "a" { 1.0 } else { 3.0 };
        let stages = [
            ("read", 0.1),
            ("network", 0.01 * n * by),
            ("query", 0.002 * n),
            ("write", 0.2),
            ("picture", 0.3),
        ];
        let stages = BTreeMap::from(stages.map(|(name, s)| (name.to_owned(), s)));
        let wall = wall + stages.values().sum::<f64>();
        Observation {
            command: command.to_owned(),
            setting: setting.to_owned(),
            size,
            stages,
            wall,
            peak_bytes: 1000 + gaussians as u64,
        }
    };
    let mut runs: Vec<_> = ["a", "b"]
        .into_iter()
        .flat_map(|s| [100, 200, 400].map(|n| of("query", s, n, 0.7)))
        .collect();
    let model = CostModel::fit(&runs);
    let seconds = |setting| {
        model
            .seconds(
                "query",
                setting,
                &Size { gaussians: 300, voxels: 150, classes: 2, width: 3, k: 0 },
            )
            .unwrap()
    };
    // 0.7 + 0.1 + 3 (or 9) + 0.6 + 0.5.
    for (setting, want) in [("a", 4.9), ("b", 10.9)] {
        assert!((seconds(setting) / want - 1.0).abs() < 1e-3, "{setting} {}", seconds(setting));
    }
    assert!((model.start - 0.7).abs() < 1e-9 && model.error < 1e-3 && model.typical == 1.0);
    // Six within nothing of the model, and a seventh that takes 1.5 times as long: 0.9 of 6 is between the last two.
    runs.push(Observation { wall: 1.5 * runs[0].wall, ..runs[0].clone() });
    let (found, off) = (CostModel::fit(&runs), 1.0 - 1.0 / 1.5);
    assert!((found.error - 0.4 * off).abs() < 0.02, "{}", found.error);
    // Of the relative errors (x − 1)² + (x / 3 − 1)²: x = (1 + 1/3) / (1 + 1/9).
    let x = nonnegative_fit(&[vec![1.0], vec![1.0], vec![1.0]], &[1.0, 3.0, -1.0]);
    assert!((x[0] - 1.2).abs() < 1e-9, "{x:?}");
}

#[test]
fn the_spread_is_that_of_all_runs_of_known_settings() {
    let size = Size { gaussians: 1000, voxels: 400, classes: 5, width: 10, k: 8 };
    let seconds = model().seconds("segment", "fine", &size).unwrap();
    let run = |setting: &str, times: f64| Observation {
        command: "segment".to_owned(),
        setting: setting.to_owned(),
        size,
        stages: BTreeMap::new(),
        wall: times * seconds,
        peak_bytes: 0,
    };
    // Of 1, 1.5, 2.5 the middle; 0.95 · 2 is 0.9 of the way to 2.5: 2.4 of 1.5 is 0.6 more. Twice 1.5 is typical.
    let runs = [run("fine", 2.5), run("unknown", 9.0), run("fine", 1.0), run("fine", 1.5)];
    let spread = model().with_spread(&runs);
    assert!(
        (spread.typical - 3.0).abs() < 1e-9 && (spread.reserve - 0.6).abs() < 1e-9,
        "{spread:?}"
    );
    // Faster ones than the fastest do not count as typical.
    let fast = model().with_spread(&[run("fine", 0.5)]);
    assert_eq!((fast.typical, fast.reserve), (2.0, 0.0));
}
