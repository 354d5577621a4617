//! `--budget` and `--min-quality`: the choice, its receipt, foreign fronts and wrong times.

use crate::support::*;
use serde_json::{Value, json as value};
use std::path::PathBuf;
use std::process::Output;

const FINE: &str = "voxel=0.1,k=8";
const COARSE: &str = "voxel=0.4,k=1";

/// A machine that was calibrated.
struct Machine {
    folder: Folder,
    /// What commands label: as small as can be, since the front's times are by hand.
    scene: String,
    fronts: String,
    receipt: String,
    /// Where the front is.
    stored: PathBuf,
    /// What it is.
    front: Value,
}

impl Machine {
    /// Calibrates; its front has figures by hand then.
    fn calibrated() -> Self {
        let folder = Folder::new();
        let (scene, fronts, receipt) =
            (folder.room("small.ply", 300, 3), folder.at("fronts"), folder.at("receipt.json"));
        let grid = format!("reference = \"{FINE}\"\npoints = [\"{COARSE}\"]\n");
        let grid = folder.write("grid.toml", grid);
        let mut machine =
            Self { folder, scene, fronts, receipt, stored: PathBuf::new(), front: Value::Null };
        let more = "--sizes 1500 5000 --repeats 1 --threads 2";
        let scene = machine.folder.room("room.ply", 3000, 3);
        done(&machine.run(&format!("pareto --calibrate --grid {grid} --scenes {scene} {more}")));
        let stored = std::fs::read_dir(&machine.fronts).unwrap().next().unwrap().unwrap();
        machine.stored = stored.path();
        let measured = json(&machine.stored);
        assert_eq!(measured["settings"].as_array().unwrap().len(), 2);
        assert!(measured["model"]["network"][COARSE].is_array(), "{measured}");
        machine.front = by_hand(measured);
        machine.put(&machine.front);
        machine
    }

    /// With fronts in that folder and nowhere else.
    fn run(&self, line: &str) -> Output {
        program().args(words(line)).env("SCENESPLAT_FRONTS", &self.fronts).output().unwrap()
    }

    fn put(&self, front: &Value) {
        std::fs::write(&self.stored, front.to_string()).unwrap();
    }

    fn command(&self, name: &str, more: &str) -> Output {
        let chair = if name == "query" { "chair" } else { "" };
        let (scene, out, receipt) = (&self.scene, self.folder.at("out"), &self.receipt);
        let words = format!("{name} {scene} {chair} {SMALL_PICTURE} --out {out}");
        self.run(&format!("{words} --receipt {receipt} --threads 2 {more}"))
    }

    /// The command takes the setting that is expected to take so many seconds, and the receipt says so.
    fn keeps(&self, name: &str, more: &str, setting: &str, expected: f64) {
        let output = self.command(name, more);
        done(&output);
        assert!(stderr(&output).contains(setting), "{more:?}: {}", stderr(&output));
        let receipt = json(&self.receipt);
        let budget = &receipt["budget"];
        assert_eq!(budget["setting"], setting, "{name} {more:?}");
        let about = budget["expected_s"].as_f64().unwrap();
        assert!((expected..expected + 4.0).contains(&about), "{budget}");
        let spent = budget["spent_s"].as_f64().unwrap();
        assert!(spent > 0.0 && spent < 60.0, "{budget}");
        assert_eq!(budget["asked_s"].is_null(), more.starts_with("--min-quality"));
        let mut used = receipt["settings"].as_array().unwrap().iter();
        let used = used.find(|s| s["name"] == "setting").unwrap();
        assert!(setting.starts_with(used["value"].as_str().unwrap()), "{used}");
    }
}

/// The same front with figures by hand: the fine setting takes 20 s, the coarse one 5 s.
fn by_hand(mut front: Value) -> Value {
    front["settings"] =
        value!([{ "setting": FINE, "f_miou": 0.7 }, { "setting": COARSE, "f_miou": 0.6 }]);
    let zero = value!([0.0, 0.0, 0.0]);
    front["model"] = value!({
        "start": 0.0, "read": [0.0, 0.0], "labels": [0.0, 0.0, 0.0, 0.0], "error": 0.0,
        "network": { FINE: [20.0, 0.0, 0.0], COARSE: [5.0, 0.0, 0.0] },
        "results": { "segment": zero, "features": zero, "query": zero },
        "peak": { FINE: [4e8, 0.0, 0.0], COARSE: [2e8, 0.0, 0.0] },
    });
    front
}

#[test]
fn a_calibrated_machine_keeps_budgets() {
    let machine = Machine::calibrated();
    for (name, more, setting, expected) in [
        ("segment", "--budget 30s", FINE, 20.0),
        ("segment", "--budget 10s", COARSE, 5.0),
        ("query", "--budget 10s", COARSE, 5.0),
        ("features", "--budget 1m", FINE, 20.0),
        ("segment", "--min-quality 0.95", FINE, 20.0),
        ("segment", "--min-quality 0.8", COARSE, 5.0),
        ("segment", "--budget 1m --max-memory 300MB", COARSE, 5.0),
    ] {
        machine.keeps(name, more, setting, expected);
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
        refused(&machine.command("segment", more), 2, &[part]);
    }

    // Of another machine, of another version: named, and not used.
    for (field, value, part) in [
        ("/fingerprint", value!("0123456789abcdef"), "another machine"),
        ("/machine/threads", value!(64), "another machine"),
        ("/version", value!("9.9.9"), "version 9.9.9"),
        ("/machine/version", value!("9.9.8"), "version 9.9.8"),
        ("/weights_hash", value!("0123456789abcdef"), "other weights"),
    ] {
        let mut foreign = machine.front.clone();
        *foreign.pointer_mut(field).unwrap() = value;
        machine.put(&foreign);
        let said = told(&machine.command("segment", "--budget 1h"));
        assert!(said.contains(part) && said.contains("is not used"), "{said}");
        has(&said, &["by the speed of the processors"]);
        assert_ne!(json(&machine.receipt)["budget"]["setting"], FINE);
    }
    machine.put(&value!({ "what": 1 }));
    refused(&machine.command("segment", "--budget 1h"), 1, &["front-"]);
}
