//! `--setting`: each part reaches the computation, and what cannot be used is refused by name.

use crate::demo_scene::asset;
use crate::{done, scenesplat, stderr, tiny};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use std::path::{Path, PathBuf};

fn room(folder: &Path, gaussians: usize) -> PathBuf {
    let scene = generate(&SyntheticRoomSettings::with_count(gaussians, 5)).unwrap().scene;
    let path = folder.join("room.ply");
    write_inria_ply(&scene, &[], &path).unwrap();
    path
}

struct Case {
    folder: tempfile::TempDir,
    scene: PathBuf,
}

impl Case {
    fn new(gaussians: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = room(folder.path(), gaussians);
        Self { folder, scene }
    }
    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }
    /// A file that a command with the seeded tiny network writes.
    fn tiny(&self, file: &str, more: &[&str]) -> Vec<u8> {
        done(&tiny("features", &self.scene, &self.out(), more));
        std::fs::read(self.out().join(file)).unwrap()
    }
    /// A file that a command with the network inside the program writes.
    fn own(&self, command: &str, file: &str, more: &[&str]) -> Vec<u8> {
        let mut args = vec![command, self.scene.to_str().unwrap()];
        args.extend((command == "query").then_some("chair"));
        let out = self.out();
        args.extend(["--out", out.to_str().unwrap()]);
        args.extend(more);
        done(&scenesplat(&args));
        std::fs::read(out.join(file)).unwrap()
    }
    /// What an evaluation of a made room writes.
    fn evaluated(&self, more: &[&str]) -> serde_json::Value {
        let out = self.out();
        let args = [&["evaluate", "synthetic:1:3", "--out", out.to_str().unwrap()][..], more];
        done(&scenesplat(&args.concat()));
        serde_json::from_slice(&std::fs::read(out.join("evaluation.json")).unwrap()).unwrap()
    }
    fn receipt(&self, name: &str) -> Option<String> {
        let text = std::fs::read(self.out().join("receipt.json")).unwrap();
        let json: serde_json::Value = serde_json::from_slice(&text).unwrap();
        let settings = json["settings"].as_array().unwrap();
        let found = settings.iter().find(|s| s["name"] == name)?;
        Some(found["value"].as_str().unwrap().to_owned())
    }
}

#[test]
fn a_setting_is_the_flags_that_say_the_same() {
    let case = Case::new(3000);
    let plain = case.tiny("features.npy", &[]);
    assert_eq!(case.receipt("setting"), None);
    for (setting, flags) in [
        ("voxel=0.1", &["--grid-size", "0.1"][..]),
        ("precision=bf16", &["--precision", "bf16"]),
        ("passes=all", &["--exact"]),
        ("passes=all,voxel=0.2", &["--exact", "--grid-size", "0.2"]),
    ] {
        let by_setting = case.tiny("features.npy", &["--setting", setting]);
        let mut parts: Vec<&str> = setting.split(',').collect();
        parts.sort_unstable_by_key(|part| *part != "voxel=0.2");
        assert_eq!(case.receipt("setting"), Some(parts.join(",")));
        assert_ne!(by_setting, plain, "{setting} changes nothing");
        assert_eq!(by_setting, case.tiny("features.npy", flags), "{setting}");
        assert_eq!(case.receipt("setting"), Some(parts.join(",")), "flags name it too");
        // Said twice alike is no contradiction.
        let both = [&["--setting", setting][..], flags].concat();
        assert_eq!(by_setting, case.tiny("features.npy", &both), "{setting}");
    }
    // What the network does anyway.
    let own = "voxel=0.02,precision=f32,patch=256,stage=fine,passes=1";
    assert_eq!(plain, case.tiny("features.npy", &["--setting", own]));
    assert_eq!(case.receipt("setting").as_deref(), Some(own));
    let patches = case.tiny("features.npy", &["--setting", "patch=16"]);
    assert_ne!(plain, patches, "patch=16 changes nothing");
    let some = case.tiny("features.npy", &["--setting", "passes=2,voxel=0.2"]);
    assert_ne!(some, case.tiny("features.npy", &["--setting", "passes=1,voxel=0.2"]));
    assert_ne!(some, case.tiny("features.npy", &["--setting", "passes=all,voxel=0.2"]));
    let said = tiny("features", &case.scene, &case.out(), &["--setting", "passes=2,voxel=0.2"]);
    assert!(stderr(&said).contains(" 2 passes,"), "{}", stderr(&said));
}

#[test]
fn votes_and_networks_are_parts_too() {
    let case = Case::new(3000);
    let voted = case.own("segment", "labels.npy", &[]);
    let alone = case.own("segment", "labels.npy", &["--setting", "k=0"]);
    assert_eq!(case.receipt("vote_k").as_deref(), Some("0"));
    assert_ne!(voted, alone);
    assert_eq!(alone, case.own("segment", "labels.npy", &["--vote-k", "0"]));
    assert_eq!(case.receipt("setting").as_deref(), Some("k=0"));
    assert_eq!(voted, case.own("segment", "labels.npy", &["--setting", "net=embedded,k=25"]));
    assert_eq!(case.receipt("setting").as_deref(), Some("net=embedded,k=25"));
    let found = case.own("query", "selection.npy", &["--setting", "k=0,voxel=0.12"]);
    let flags = ["--vote-k", "0", "--grid-size", "0.12"];
    assert_eq!(found, case.own("query", "selection.npy", &flags));
    // Of a configuration, the weights are given beside it; a folder has both.
    let seeded = ["--weights", "seeded:0", "--setting", "net=tiny"];
    let by_name = case.own("features", "features.npy", &seeded);
    assert_eq!(by_name, case.tiny("features.npy", &[]));
    // Evaluation as well, without a receipt of its own votes.
    let figures = |more: &[&str]| {
        let json = case.evaluated(more);
        (json["miou"].clone(), json["vote_k"].clone())
    };
    let coarse = figures(&["--setting", "voxel=0.2,k=1"]);
    assert_eq!(coarse, figures(&["--grid-size", "0.2", "--vote-k", "1"]));
    assert_ne!(coarse, figures(&["--setting", "voxel=0.3,k=1"]));
}

#[test]
fn labels_agree_on_surfaces_by_themselves_or_as_asked_for() {
    let case = Case::new(20_000);
    let auto = case.own("segment", "labels.npy", &[]);
    let counts = case.receipt("surfaces").unwrap();
    assert_eq!(counts.split(' ').count(), 5, "{counts}");
    assert_eq!(auto, case.own("segment", "labels.npy", &["--surfaces", "on"]));
    assert_ne!(auto, case.own("segment", "labels.npy", &["--surfaces", "off"]));
    assert_eq!(case.receipt("surfaces").as_deref(), Some("off"));
    case.own("objects", "objects.json", &[]);
    assert_eq!(case.receipt("surfaces"), Some(counts));
    let figures = |more: &[&str]| case.evaluated(more)["miou"].clone();
    let auto = figures(&[]);
    assert_eq!(auto, figures(&["--surfaces", "on"]));
    assert_ne!(auto, figures(&["--surfaces", "off"]));
}

#[test]
fn what_is_less_probable_stays_unknown() {
    let case = Case::new(20_000);
    let unknown_of = |more: &[&str]| {
        case.own("segment", "labels.npy", more);
        let labels = NpyFile::open(&case.out().join("labels.npy")).unwrap().read_i64().unwrap();
        labels.iter().filter(|label| **label < 0).count()
    };
    let unknown = |more: &[&str]| unknown_of(&[&["--surfaces", "off"][..], more].concat());
    let found = ["0", "0.5", "0.9", "1"].map(|p| unknown(&["--min-probability", p]));
    assert_eq!(case.receipt("min_probability").as_deref(), Some("1"));
    let temperature: f32 = case.receipt("temperature").unwrap().parse().unwrap();
    let stored = scenesplat::calibration::Calibration::embedded().unwrap().temperature;
    assert_eq!(temperature, stored);
    assert_eq!((found[0], unknown(&[])), (0, 0));
    assert!(found[0] < found[1] && found[1] < found[2] && found[2] < found[3], "{found:?}");
    assert!(found[1] < 10_000 && found[3] > 15_000, "{found:?}");
    // Withheld labels have no say on surfaces, and get none there.
    assert_eq!(unknown_of(&["--min-probability", "0.9"]), found[2]);
    // In evaluations they are wrong.
    let figures = |more: &[&str]| case.evaluated(more)["macc"].as_f64().unwrap();
    assert!(figures(&["--min-probability", "0.9"]) < figures(&[]) - 0.05);
    // Cosines of other networks are not calibrated, and the truth has no probability.
    let text = asset("classes.safetensors");
    let half = ["--min-probability", "0.5"];
    let with_text = [&half[..], &["--text", text.to_str().unwrap()]].concat();
    let of_another = tiny("segment", &case.scene, &case.out(), &with_text);
    let of_truth = [&["evaluate", "synthetic:1:3", "--features", "oracle"][..], &half].concat();
    let scene = case.scene.to_str().unwrap();
    for (failed, words) in [
        (of_another, "give a least cosine (--min-score)"),
        (scenesplat(&of_truth), "--min-probability is about labels"),
        (scenesplat(&["segment", scene, "--min-probability", "1.5"]), "expected 0 to 1"),
    ] {
        assert_eq!(failed.status.code(), Some(2));
        assert!(stderr(&failed).contains(words), "{}", stderr(&failed));
    }
}

#[test]
fn the_last_stage_is_shortened() {
    let case = Case::new(3000);
    let plain = case.own("features", "features.npy", &[]);
    let mut seen = vec![plain];
    for setting in ["stage=coarse", "rank=8", "stage=coarse,rank=8"] {
        let found = case.own("features", "features.npy", &["--setting", setting]);
        assert!(!seen.contains(&found), "{setting} changes nothing");
        assert_eq!(case.receipt("setting").as_deref(), Some(setting));
        let kept = case.receipt("rank_keeps");
        assert_eq!(kept.is_some(), setting.contains("rank"), "{kept:?}");
        assert!(kept.is_none_or(|text| text.contains("% in dec.dec0.block0")));
        // The same for any number of threads.
        let alone = ["--setting", setting, "--threads", "1"];
        assert_eq!(found, case.own("features", "features.npy", &alone), "{setting}");
        seen.push(found);
    }
    // The estimate knows what is left out.
    let seconds = |more: &[&str]| {
        let json = case.folder.path().join("seen.json");
        let args = ["inspect", case.scene.to_str().unwrap(), "--no-sheet", "--config", "language"];
        done(&scenesplat(&[&args[..], &["--json", json.to_str().unwrap()], more].concat()));
        let seen: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        seen["estimate"]["seconds"].as_f64().unwrap()
    };
    let [all, coarse, low] =
        [seconds(&[]), seconds(&["--setting", "stage=coarse"]), seconds(&["--setting", "rank=96"])];
    assert!(coarse < low && low < all, "{all} {coarse} {low}");
}

#[test]
fn features_are_written_as_codes_and_compared_as_such() {
    let case = Case::new(3000);
    let shape = |file: &str| NpyFile::open(&case.out().join(file)).unwrap().shape().to_vec();
    let values = |file: &str| NpyFile::open(&case.out().join(file)).unwrap().read_f32().unwrap();
    case.own("features", "features.npy", &[]);
    let plain = values("features.npy");
    assert!(!case.out().join("feature_axes.npy").exists());
    case.own("features", "features.npy", &["--setting", "codes=32"]);
    assert_eq!((shape("features.npy"), shape("feature_axes.npy")), (vec![3000, 32], vec![32, 96]));
    assert!(case.receipt("codes_keep").unwrap().contains('%'));
    let (codes, axes) = (values("features.npy"), values("feature_axes.npy"));
    let mut mean = 0.0;
    for (row, code) in plain.chunks_exact(96).zip(codes.chunks_exact(32)) {
        let mut back = [0f32; 96];
        for (c, axis) in code.iter().zip(axes.chunks_exact(96)) {
            back.iter_mut().zip(axis).for_each(|(b, a)| *b += c * a);
        }
        mean += row.iter().zip(&back).map(|(a, b)| a * b).sum::<f32>() / 3000.0;
    }
    assert!(mean > 0.9, "{mean}");
    // Labels and selections come from the codes, and are mostly what they were.
    let same = |command: &str, file: &str, setting: &str| {
        let plain = case.own(command, file, &[]);
        let coded = case.own(command, file, &["--setting", setting]);
        let equal = plain.iter().zip(&coded).filter(|(a, b)| a == b).count();
        equal as f64 / plain.len() as f64
    };
    assert!(same("segment", "labels.npy", "codes=64") > 0.98);
    assert!(same("query", "selection.npy", "codes=64") > 0.98);
    let scores = same("segment", "scores.npy", "codes=16");
    assert!(scores < 0.9, "16 numbers are others: {scores}");
}

#[test]
fn estimates_follow_the_setting() {
    let case = Case::new(3000);
    let json = case.folder.path().join("seen.json");
    let estimate = |more: &[&str]| {
        let args = ["inspect", case.scene.to_str().unwrap(), "--no-sheet", "--config", "language"];
        let args = [&args[..], &["--json", json.to_str().unwrap()], more].concat();
        done(&scenesplat(&args));
        let seen: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        let number = |name: &str| seen["estimate"][name].as_f64().unwrap();
        (number("voxels"), number("seconds"))
    };
    let own = estimate(&[]);
    let wide = estimate(&["--setting", "voxel=0.3"]);
    assert!(wide.0 < own.0 / 2.0 && wide.1 < own.1, "{own:?} {wide:?}");
    assert!(estimate(&["--setting", "patch=64"]).1 < own.1);
    assert_eq!(estimate(&["--setting", "passes=1,precision=f32"]), own);
    for part in ["k=8", "codes=16", "anchor=world", "precision=bf16", "passes=all", "passes=2"] {
        let path = case.scene.to_str().unwrap();
        let output = scenesplat(&["inspect", path, "--no-sheet", "--setting", part]);
        assert_eq!(output.status.code(), Some(2), "{part}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{part}: {}", stderr(&output));
    }
}

#[test]
fn what_cannot_be_used_is_refused_by_name() {
    let case = Case::new(300);
    let scene = case.scene.to_str().unwrap();
    let out = case.out();
    let refused = |args: &[&str], parts: &[&str]| {
        let output = scenesplat(&[args, &["--out", out.to_str().unwrap()]].concat());
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
        assert!(parts.iter().all(|part| said.contains(part)), "{parts:?} not in: {said}");
        assert!(!said.contains("panicked"), "{said}");
        assert!(!out.join("features.npy").exists() && !out.join("labels.npy").exists());
    };
    for (setting, parts) in [
        ("", &["no part is named"][..]),
        ("speed=9", &["\"speed\" is unknown", "voxel, net, precision"]),
        ("k=8,voxel=0.1,k=9", &["setting k", "twice"]),
        ("voxel=0", &["voxel", "above 0"]),
        ("voxel=nan", &["voxel", "above 0"]),
        ("voxel=-1", &["voxel", "above 0"]),
        ("anchor=room", &["anchor", "box or world"]),
        ("voxel", &["KEY=VALUE"]),
        ("voxel=", &["voxel"]),
        ("rank=0", &["rank", "1 to"]),
        ("stage=middle", &["stage", "fine or coarse"]),
        ("precision=f64", &["precision", "bf16"]),
        ("passes=0", &["passes", "all"]),
        ("net=nowhere", &["net=nowhere", "litept-s"]),
        ("net=tiny", &["net", "--weights"]),
    ] {
        refused(&["segment", scene, "--setting", setting], parts);
    }
    refused(&["features", scene, "--setting", "k=3"], &["--setting k"]);
    // What the network has nothing of.
    for (config, part, words) in [
        ("litept-s", "stage=coarse", "only Point Transformer V3"),
        ("litept-s-decoder", "rank=8", "only Point Transformer V3"),
        ("litept-s", "patch=65536", "16384"),
        ("tiny", "rank=65", "1 to 64"),
        ("tiny", "rank=16384", "1 to 64"),
        ("tiny", "codes=64", "64 numbers"),
        ("tiny", "codes=256", "64 numbers"),
        ("semseg", "codes=16", "probabilities"),
    ] {
        let args =
            ["features", scene, "--config", config, "--weights", "seeded:0", "--setting", part];
        refused(&args, &[part, words]);
    }
    // What a flag says otherwise.
    for (flags, part) in [
        (&["--grid-size", "0.1"][..], "voxel=0.2"),
        (&["--precision", "f32"], "precision=bf16"),
        (&["--vote-k", "25"], "k=8"),
        (&["--exact"], "passes=1"),
        (&["--exact"], "passes=2"),
        (&["--weights", "seeded:0"], "net=embedded"),
        (&["--config", "language", "--weights", "seeded:0"], "net=tiny"),
        (&["--weights", "seeded:0"], &format!("net={scene}")),
    ] {
        let args = [&["segment", scene, "--setting", part][..], flags].concat();
        refused(&args, &[flags[0], part, "contradicts"]);
    }
    let both = ["--config", "tiny", "--setting", "net=embedded"];
    refused(&[&["segment", scene][..], &both].concat(), &["--config tiny", "contradicts"]);
    // About a network, where none is run.
    let oracle = ["evaluate", "synthetic:1:1", "--features", "oracle", "--setting", "voxel=0.1"];
    refused(&oracle, &["--setting voxel"]);
    let made = ["segment", scene, "--features", scene, "--setting", "voxel=0.1"];
    refused(&made, &["--setting", "--features"]);
}
