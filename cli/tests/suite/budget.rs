//! `--budget` and `--min-quality`: the choice, its receipt, foreign fronts and wrong times.

use crate::support::*;
use serde_json::{Value, json as value};

const FINE: &str = "voxel=0.1,k=8";
const COARSE: &str = "voxel=0.4,k=1";

#[test]
fn a_calibrated_machine_keeps_budgets() {
    let folder = Folder::new();
    let (scene, fronts, receipt) =
        (folder.room("room.ply", 3000, 3), folder.at("fronts"), folder.at("receipt.json"));
    let grid = format!("reference = \"{FINE}\"\npoints = [\"{COARSE}\"]\n");
    let grid = folder.write("grid.toml", grid);
    // With fronts in that folder and nowhere else.
    let run = |line: &str| {
        program().args(words(line)).env("SCENESPLAT_FRONTS", &fronts).output().unwrap()
    };
    let more = "--sizes 1500 5000 --repeats 1 --threads 2";
    done(&run(&format!("pareto --calibrate --grid {grid} --scenes {scene} {more}")));
    let stored = std::fs::read_dir(&fronts).unwrap().next().unwrap().unwrap().path();
    let measured = json(&stored);
    assert_eq!(measured["settings"].as_array().unwrap().len(), 2);
    assert!(measured["model"]["network"][COARSE].is_array(), "{measured}");

    // The same front with figures by hand: the fine setting takes 20 s, the coarse one 5 s.
    let mut front = measured;
    front["settings"] =
        value!([{ "setting": FINE, "f_miou": 0.7 }, { "setting": COARSE, "f_miou": 0.6 }]);
    let zero = value!([0.0, 0.0, 0.0]);
    front["model"] = value!({
        "start": 0.0, "read": [0.0, 0.0], "labels": [0.0, 0.0, 0.0, 0.0], "error": 0.0,
        "network": { FINE: [20.0, 0.0, 0.0], COARSE: [5.0, 0.0, 0.0] },
        "results": { "segment": zero, "features": zero, "query": zero },
        "peak": { FINE: [4e8, 0.0, 0.0], COARSE: [2e8, 0.0, 0.0] },
    });
    let put = |front: &Value| std::fs::write(&stored, front.to_string()).unwrap();
    put(&front);
    let command = |name: &str, more: &str| {
        let chair = if name == "query" { "chair" } else { "" };
        let out = folder.at("out");
        let words = format!("{name} {scene} {chair} {SMALL_PICTURE} --out {out}");
        run(&format!("{words} --receipt {receipt} --threads 2 {more}"))
    };
    for (name, more, setting, expected) in [
        ("segment", "--budget 30s", FINE, 20.0),
        ("segment", "--budget 10s", COARSE, 5.0),
        ("query", "--budget 10s", COARSE, 5.0),
        ("features", "--budget 1m", FINE, 20.0),
        ("segment", "--min-quality 0.95", FINE, 20.0),
        ("segment", "--min-quality 0.8", COARSE, 5.0),
        ("segment", "--budget 1m --max-memory 300MB", COARSE, 5.0),
    ] {
        let output = command(name, more);
        done(&output);
        assert!(stderr(&output).contains(setting), "{more:?}: {}", stderr(&output));
        let budget = &json(&receipt)["budget"];
        assert_eq!(budget["setting"], setting, "{name} {more:?}");
        let about = budget["expected_s"].as_f64().unwrap();
        assert!((expected..expected + 4.0).contains(&about), "{budget}");
        let spent = budget["spent_s"].as_f64().unwrap();
        assert!(spent > 0.0 && spent < 60.0, "{budget}");
        assert_eq!(budget["asked_s"].is_null(), more.starts_with("--min-quality"));
        let used = json(&receipt)["settings"].as_array().unwrap().clone();
        let used = used.iter().find(|s| s["name"] == "setting").unwrap();
        assert!(setting.starts_with(used["value"].as_str().unwrap()), "{used}");
    }
    for (more, part) in [
        ("--budget 1s", "the cheapest, voxel=0.4,k=1, takes about 5"),
        ("--budget 10s --min-quality 0.95", "good enough"),
        ("--budget 10s --max-memory 50MB", "needs least, about 200"),
        ("--budget 10s --setting k=1", "leave out --setting"),
        ("--budget 10s --vote-k 1", "leave out --vote-k"),
        ("--budget 0", "above 0"),
        ("--budget -2s", "above 0"),
        ("--budget nan", "above 0"),
        ("--budget '2 parsecs'", "parsecs"),
        ("--min-quality 1.5", "up to 1"),
        ("--min-quality nan", "up to 1"),
        ("--budget 10s --weights seeded:0 --config tiny", "--calibrate"),
    ] {
        refused(&command("segment", more), 2, &[part]);
    }

    // Of another machine, of another version: named, and not used.
    for (field, value, part) in [
        ("/fingerprint", value!("0123456789abcdef"), "another machine"),
        ("/machine/threads", value!(64), "another machine"),
        ("/version", value!("9.9.9"), "version 9.9.9"),
        ("/machine/version", value!("9.9.8"), "version 9.9.8"),
        ("/weights_hash", value!("0123456789abcdef"), "other weights"),
    ] {
        let mut foreign = front.clone();
        *foreign.pointer_mut(field).unwrap() = value;
        put(&foreign);
        let said = told(&command("segment", "--budget 1h"));
        assert!(said.contains(part) && said.contains("is not used"), "{said}");
        has(&said, &["by the speed of the processors"]);
        assert_ne!(json(&receipt)["budget"]["setting"], FINE);
    }
    put(&value!({ "what": 1 }));
    refused(&command("segment", "--budget 1h"), 1, &["front-"]);
}
