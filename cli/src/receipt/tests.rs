use super::report::{bytes_text, thousands};
use super::*;

fn sleep(ms: u64) {
    std::thread::sleep(Duration::from_millis(ms));
}

#[test]
fn stages_add_up_to_the_wall_time() {
    let receipt = Receipt::new("test");
    receipt.time("read", || sleep(5));
    for _ in 0..2 {
        let _network = receipt.stage("network");
        receipt.time("conv", || sleep(4));
        receipt.time("attention", || sleep(2));
    }
    sleep(3);
    let report = receipt.finish();
    let names: Vec<&str> = report.stages.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["read", "network", "network/conv", "network/attention", "other"]);
    let outer: f64 =
        report.stages.iter().filter(|s| !s.name.contains('/')).map(|s| s.seconds).sum();
    assert!((outer - report.wall_seconds).abs() < 1e-6, "{outer} {}", report.wall_seconds);
    let shares: f64 = report.stages.iter().filter(|s| !s.name.contains('/')).map(|s| s.share).sum();
    assert!((shares - 1.0).abs() < 1e-6);
    let parts = report.seconds("network/conv") + report.seconds("network/attention");
    assert!(parts <= report.seconds("network") && parts >= 0.012);
    assert!(report.seconds(OTHER_STAGE) >= 0.003);
    assert_eq!(report.stages[2].runs, 2);
}

#[test]
fn guards_may_end_in_any_order() {
    let receipt = Receipt::new("test");
    let outer = receipt.stage("outer");
    let inner = receipt.stage("inner");
    drop(outer);
    drop(inner);
    let _running = receipt.stage("still running");
    let report = receipt.finish();
    assert_eq!(report.stages.len(), 4);
    assert!(report.stages.iter().all(|s| s.runs == 1));
}

#[test]
fn json_returns_unchanged_and_is_renamed_into_place() {
    let receipt = Receipt::new("encode room.ply");
    receipt.add_rows_in(1_234_567);
    receipt.add_rows_out(5);
    receipt.add_bytes_written(10);
    receipt.setting("grid_size", 0.02, "default");
    receipt.setting("grid_size", 0.05, "command line");
    receipt.warning("3 zero quaternions became the identity");
    receipt.computation("f32", "avx512");
    receipt.threads(2);
    let report = receipt.finish();
    let text = report.to_json().unwrap();
    let back: ReceiptReport = serde_json::from_str(&text).unwrap();
    assert_eq!(back.settings, report.settings);
    assert_eq!(back.settings.len(), 1);
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut names: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    names.sort_unstable();
    assert_eq!(
        names,
        [
            "bytes_written",
            "command",
            "files",
            "machine",
            "peak_memory_bytes",
            "rows_in",
            "rows_out",
            "settings",
            "stages",
            "wall_seconds",
            "warnings",
            "written"
        ]
    );
    let table = report.to_string();
    for part in ["1 234 567", "grid_size = 0.05", "a warning", "avx512, f32", "total"] {
        assert!(table.contains(part), "{part} in\n{table}");
    }
}

#[test]
fn a_long_value_does_not_widen_the_lines_of_others() {
    let receipt = Receipt::new("render room.ply");
    receipt.setting("plan", "p".repeat(480), "what is computed");
    receipt.setting("preset", "gsplat-1.6", "constants");
    receipt.setting("depth_scale", 1000, "steps");
    let table = receipt.finish().to_string();
    assert!(table.contains("= gsplat-1.6  constants"), "{table}");
    assert!(table.contains("= 1000        steps"), "{table}");
    assert!(!table.contains(&" ".repeat(30)), "{table}");
}

#[test]
fn fingerprints_of_files_and_folders() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("b.npy"), b"abc").unwrap();
    std::fs::create_dir(folder.path().join("sub")).unwrap();
    std::fs::write(folder.path().join("sub/a.npy"), b"").unwrap();
    let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!(sha256_of(&folder.path().join("b.npy")).unwrap(), (abc.to_owned(), 3));
    let (before, bytes) = sha256_of(folder.path()).unwrap();
    assert_eq!(bytes, 3);
    std::fs::rename(folder.path().join("b.npy"), folder.path().join("c.npy")).unwrap();
    assert_ne!(sha256_of(folder.path()).unwrap().0, before);
    let receipt = Receipt::new("test");
    assert!(receipt.fingerprint("input", &folder.path().join("none")).is_err());
    receipt.time("read", || receipt.fingerprint("weights", &folder.path().join("c.npy"))).unwrap();
    let report = receipt.finish();
    assert_eq!(report.files[0].sha256, abc);
    // The one that failed was begun outside of any stage.
    let runs = |name| report.stages.iter().find(|s| s.name == name).map(|s| s.runs);
    assert_eq!((runs("fingerprint"), runs("read/fingerprint")), (Some(1), Some(1)));
}

#[test]
fn texts() {
    assert_eq!(
        [0, 999, 1000, 1_234_567].map(thousands),
        ["0", "999", "1 000", "1 234 567"].map(str::to_owned)
    );
    assert_eq!(bytes_text(12_345_678), "12.3 MB");
    if cfg!(target_os = "linux") {
        assert!(peak_memory_bytes().unwrap() > 1_000_000);
    }
}
