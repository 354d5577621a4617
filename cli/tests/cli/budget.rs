//! `--budget` and `--min-quality`: the choice, its receipt, foreign fronts and wrong times.

use crate::{done, stderr};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const FINE: &str = "voxel=0.1,k=8";
const COARSE: &str = "voxel=0.4,k=1";

fn room(folder: &Path) -> PathBuf {
    let path = folder.join("room.ply");
    let settings = SyntheticRoomSettings { room: 1, ..SyntheticRoomSettings::with_count(3000, 3) };
    write_inria_ply(&generate(&settings).unwrap().scene, &[], &path).unwrap();
    path
}

/// Runs the program with fronts in that folder and nowhere else.
fn run(fronts: &Path, args: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_scenesplat");
    Command::new(program).args(args).env("SCENESPLAT_FRONTS", fronts).output().unwrap()
}

fn json_of(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_calibrated_machine_keeps_budgets() {
    let folder = tempfile::tempdir().unwrap();
    let scene = room(folder.path());
    let scene = scene.to_str().unwrap();
    let fronts = folder.path().join("fronts");
    let grid = folder.path().join("grid.toml");
    std::fs::write(&grid, format!("reference = \"{FINE}\"\npoints = [\"{COARSE}\"]\n")).unwrap();
    let words = ["pareto", "--calibrate", "--grid", grid.to_str().unwrap(), "--scenes", scene];
    let more = ["--sizes", "1500", "5000", "--repeats", "1", "--threads", "2"];
    done(&run(&fronts, &[words.as_slice(), &more].concat()));
    let stored = std::fs::read_dir(&fronts).unwrap().next().unwrap().unwrap().path();
    let measured = json_of(&stored);
    assert_eq!(measured["settings"].as_array().unwrap().len(), 2);
    assert!(measured["model"]["network"][COARSE].is_array(), "{measured}");

    // The same front with figures by hand: the fine setting takes 20 s, the coarse one 5 s.
    let mut front = measured;
    front["settings"] =
        json!([{ "setting": FINE, "f_miou": 0.7 }, { "setting": COARSE, "f_miou": 0.6 }]);
    let zero = json!([0.0, 0.0, 0.0]);
    front["model"] = json!({
        "start": 0.0, "read": [0.0, 0.0], "labels": [0.0, 0.0, 0.0, 0.0], "error": 0.0,
        "network": { FINE: [20.0, 0.0, 0.0], COARSE: [5.0, 0.0, 0.0] },
        "results": { "segment": zero, "features": zero, "query": zero },
        "peak": { FINE: [4e8, 0.0, 0.0], COARSE: [2e8, 0.0, 0.0] },
    });
    let put = |front: &Value| std::fs::write(&stored, front.to_string()).unwrap();
    put(&front);
    let out = folder.path().join("out");
    let receipt = folder.path().join("receipt.json");
    let command = |name: &str, more: &[&str]| {
        let mut words = vec![name, scene];
        words.extend((name == "query").then_some("chair"));
        words.extend(["--out", out.to_str().unwrap(), "--receipt", receipt.to_str().unwrap()]);
        words.extend(["--threads", "2"]);
        words.extend(more);
        run(&fronts, &words)
    };
    for (name, more, setting, expected) in [
        ("segment", ["--budget", "30s"].as_slice(), FINE, 20.0),
        ("segment", &["--budget", "10s"], COARSE, 5.0),
        ("query", &["--budget", "10s"], COARSE, 5.0),
        ("features", &["--budget", "1m"], FINE, 20.0),
        ("segment", &["--min-quality", "0.95"], FINE, 20.0),
        ("segment", &["--min-quality", "0.8"], COARSE, 5.0),
        ("segment", &["--budget", "1m", "--max-memory", "300MB"], COARSE, 5.0),
    ] {
        let output = command(name, more);
        done(&output);
        assert!(stderr(&output).contains(setting), "{more:?}: {}", stderr(&output));
        let budget = &json_of(&receipt)["budget"];
        assert_eq!(budget["setting"], setting, "{name} {more:?}");
        let about = budget["expected_s"].as_f64().unwrap();
        assert!((expected..expected + 4.0).contains(&about), "{budget}");
        let spent = budget["spent_s"].as_f64().unwrap();
        assert!(spent > 0.0 && spent < 60.0, "{budget}");
        assert_eq!(budget["asked_s"].is_null(), more[0] == "--min-quality");
        let used = json_of(&receipt)["settings"].as_array().unwrap().clone();
        let used = used.iter().find(|s| s["name"] == "setting").unwrap();
        assert!(setting.starts_with(used["value"].as_str().unwrap()), "{used}");
    }
    for (more, part) in [
        (["--budget", "1s"].as_slice(), "the cheapest, voxel=0.4,k=1, takes about 5"),
        (&["--budget", "10s", "--min-quality", "0.95"], "good enough"),
        (&["--budget", "10s", "--max-memory", "50MB"], "needs least, about 200"),
        (&["--budget", "10s", "--setting", "k=1"], "leave out --setting"),
        (&["--budget", "10s", "--vote-k", "1"], "leave out --vote-k"),
        (&["--budget", "0"], "above 0"),
        (&["--budget", "-2s"], "above 0"),
        (&["--budget", "nan"], "above 0"),
        (&["--budget", "2 parsecs"], "parsecs"),
        (&["--min-quality", "1.5"], "up to 1"),
        (&["--min-quality", "nan"], "up to 1"),
        (&["--budget", "10s", "--weights", "seeded:0", "--config", "tiny"], "--calibrate"),
    ] {
        let output = command("segment", more);
        assert_eq!(output.status.code(), Some(2), "{more:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{more:?}: {}", stderr(&output));
    }

    // Of another machine, of another version: named, and not used.
    for (field, value, part) in [
        ("/fingerprint", json!("0123456789abcdef"), "another machine"),
        ("/machine/threads", json!(64), "another machine"),
        ("/version", json!("9.9.9"), "version 9.9.9"),
        ("/machine/version", json!("9.9.8"), "version 9.9.8"),
        ("/weights_hash", json!("0123456789abcdef"), "other weights"),
    ] {
        let mut foreign = front.clone();
        *foreign.pointer_mut(field).unwrap() = value;
        put(&foreign);
        let output = command("segment", &["--budget", "1h"]);
        done(&output);
        let said = stderr(&output);
        assert!(said.contains(part) && said.contains("is not used"), "{said}");
        assert!(said.contains("by the speed of the processors"), "{said}");
        assert_ne!(json_of(&receipt)["budget"]["setting"], FINE);
    }
    put(&json!({ "what": 1 }));
    let output = command("segment", &["--budget", "1h"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("front-"), "{}", stderr(&output));
}
