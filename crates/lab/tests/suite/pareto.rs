//! The front among measured settings, and its report.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_lab::pareto::{Around, Record, Summary, TrainingCurve, front, write_report};
use std::collections::BTreeMap;

#[test]
fn a_front_is_what_no_other_point_beats() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..200 {
        // Few values, so that points share a cost, a worth, or both.
        let points: Vec<[f64; 2]> = (0..rng.random_range(1..12))
            .map(|_| [(); 2].map(|()| f64::from(rng.random_range(0..5))))
            .collect();
        let no_worse = |a: [f64; 2], b: [f64; 2]| a[0] <= b[0] && a[1] >= b[1];
        for (i, kept) in front(&points).into_iter().enumerate() {
            let beaten = points.iter().enumerate().any(|(j, other)| {
                // Of equal points the first stays.
                no_worse(*other, points[i]) && (*other != points[i] || j < i)
            });
            assert_eq!(kept, !beaten, "{points:?}: {i}");
        }
    }
}

/// A record of a setting, as a file of records has it.
fn record(setting: &str, seconds: f64, quality: f64) -> Record {
    let value = serde_json::json!({
        "kind": "setting", "setting": setting, "changes_result": true, "neutral": null, "rule": null, "holds": null,
        "scenes": "rooms", "repeats": 5, "seconds_p50": seconds, "seconds_p95": seconds, "seconds_low": 0.9 * seconds,
        "seconds_high": 1.1 * seconds, "load_seconds": 0.01, "peak_bytes": 100_000_000, "bytes_written": 1000,
        "f_miou": quality, "f_miou_low": quality - 0.02, "f_miou_high": quality + 0.02, "miou": quality,
        "f_macc": quality, "macc": quality, "all_acc": quality, "agreement": 1.0, "query_hit1": 1.0, "ece": 0.1,
        "stages": [{ "name": "network", "seconds": seconds, "share": 1.0 }], "stage_coverage": 1.0, "width": 96,
        "classes": 20, "prediction_hash": setting, "conditions": "c", "weights_hash": "w", "input_hash": "i",
        "truth_hash": "t", "machine": { "cpu": "</script><script>globalThis.attacked=1</script>", "cores": 2,
        "threads": 2, "simd": "", "os": "", "version": "", "dtype": "" }, "fingerprint": "m", "per_scene": [],
    });
    serde_json::from_value(value).unwrap()
}

/// The report with names that would be markup. `.ci/page` opens it in a browser from the folder `SCENESPLAT_PAGES`.
#[test]
fn the_report_is_a_page_in_which_no_name_is_markup() {
    let temporary = tempfile::tempdir().unwrap();
    let named = std::env::var_os("SCENESPLAT_PAGES").map(std::path::PathBuf::from);
    let folder = named.unwrap_or_else(|| temporary.path().to_owned());
    std::fs::create_dir_all(&folder).unwrap();
    let attack = "<img src=x onerror=globalThis.attacked=1></script>";
    let records = [
        record("k=1", 0.5, 0.40),
        record(&format!("k=8,net={attack}"), 1.0, 0.62),
        record("k=25", 4.0, 0.65),
        record("k=25,voxel=0.01", 5.0, 0.64),
    ];
    let training = vec![TrainingCurve {
        name: attack.to_owned(),
        metric: "zero_shot/f-mIoU".to_owned(),
        points: vec![[10.0, 0.1], [100.0, 0.5], [200.0, 0.55]],
        best: 0.55,
        seconds_to_99: 200.0,
    }];
    let networks = BTreeMap::from([(attack.to_owned(), "folder".to_owned())]);
    let around = Around { training, networks, ..Around::default() };
    let summary = Summary::of(&records, around).unwrap();
    let written = write_report(&summary, &records, &folder).unwrap();
    let page = std::fs::read_to_string(folder.join("pareto.html")).unwrap();
    assert_eq!(written.last().map(|(_, bytes)| *bytes), Some(page.len() as u64));
    assert_eq!(page.matches("</script").count(), 2);
    assert!(page.contains("default-src 'none'") && !page.contains("unsafe-inline"));
    assert!(!page.contains("<img") && !page.contains("<script>globalThis"));
}
