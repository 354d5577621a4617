//! `--setting`: each part reaches the computation, and what cannot be used is refused by name.

use crate::support::*;

struct Case {
    folder: Folder,
    scene: String,
}

impl Case {
    fn new(gaussians: usize) -> Self {
        let folder = Folder::new();
        let scene = folder.room("room.ply", gaussians, 5);
        Self { folder, scene }
    }
    fn out(&self, file: &str) -> String {
        self.folder.at(&format!("out/{file}"))
    }
    /// A file that `features` with the seeded tiny network writes.
    fn tiny(&self, more: &str) -> Vec<u8> {
        self.own("features", "features.npy", &format!("{TINY} {more}"))
    }
    /// A file that a command with the network inside the program writes.
    fn own(&self, command: &str, file: &str, more: &str) -> Vec<u8> {
        let chair = if command == "query" { "chair" } else { "" };
        done(&run!("{command} {} {chair} --out {} {more}", self.scene, self.out("")));
        bytes(self.out(file))
    }
    /// What an evaluation of its room writes.
    fn evaluated(&self, more: &str) -> serde_json::Value {
        let words = format!("evaluate {} --label-names {}", self.scene, self.folder.names());
        done(&run!("{words} --out {} {more}", self.out("")));
        json(self.out("evaluation.json"))
    }
    fn receipt(&self, name: &str) -> Option<String> {
        setting(&json(self.out("receipt.json")), name)
    }
    /// What `inspect` says it costs.
    fn estimate(&self, more: &str) -> (f64, f64) {
        let file = self.folder.at("seen.json");
        let words = format!("--no-sheet --config language --json {file}");
        done(&run!("inspect {} {words} {more}", self.scene));
        let estimate = &json(file)["estimate"];
        let number = |name: &str| estimate[name].as_f64().unwrap();
        (number("voxels"), number("seconds"))
    }
}

#[test]
fn a_setting_is_the_flags_that_say_the_same() {
    let case = Case::new(3000);
    let plain = case.tiny("");
    assert_eq!(case.receipt("setting"), None);
    for (setting, flags) in [
        ("voxel=0.1", "--grid-size 0.1"),
        ("precision=bf16", "--precision bf16"),
        ("passes=all", "--exact"),
        ("voxel=0.2,passes=all", "--exact --grid-size 0.2"),
    ] {
        // Said twice alike is no contradiction, and flags name the setting, too.
        let by_setting = case.tiny(&format!("--setting {setting}"));
        assert_ne!(by_setting, plain, "{setting} changes nothing");
        for more in [flags, &format!("--setting {setting} {flags}")] {
            assert_eq!(case.receipt("setting").as_deref(), Some(setting));
            assert_eq!(by_setting, case.tiny(more), "{setting}");
        }
        assert_eq!(case.receipt("setting").as_deref(), Some(setting));
    }
    // What the network does anyway.
    let own = "voxel=0.02,precision=f32,patch=256,stage=fine,passes=1";
    assert_eq!(plain, case.tiny(&format!("--setting {own}")));
    assert_eq!(case.receipt("setting").as_deref(), Some(own));
    assert_ne!(plain, case.tiny("--setting patch=16"));
    let some = case.tiny("--setting passes=2,voxel=0.2");
    assert_ne!(some, case.tiny("--setting passes=1,voxel=0.2"));
    assert_ne!(some, case.tiny("--setting passes=all,voxel=0.2"));
    let two = format!("{} {TINY} --setting passes=2,voxel=0.2 --out {}", case.scene, case.out(""));
    has(&told(&run!("features {two}")), &[" 2 passes,"]);
    // The mean over copies, which the receipt and the console count.
    let one = case.tiny("--setting tta=1,voxel=0.2");
    assert_eq!(one, case.tiny("--setting passes=1,voxel=0.2"));
    let copies = format!("{} {TINY} --setting tta=4,voxel=0.2 --out {}", case.scene, case.out(""));
    has(&told(&run!("features {copies}")), &[" 4 passes,"]);
    assert_ne!(one, bytes(case.out("features.npy")));
}

#[test]
fn votes_and_networks_are_parts_too() {
    let case = Case::new(3000);
    let voted = case.own("segment", "labels.npy", "");
    let alone = case.own("segment", "labels.npy", "--setting k=0");
    assert_eq!(case.receipt("vote_k").as_deref(), Some("0"));
    assert_ne!(voted, alone);
    assert_eq!(alone, case.own("segment", "labels.npy", "--vote-k 0"));
    assert_eq!(case.receipt("setting").as_deref(), Some("k=0"));
    assert_eq!(voted, case.own("segment", "labels.npy", "--setting net=embedded,k=25"));
    assert_eq!(case.receipt("setting").as_deref(), Some("net=embedded,k=25"));
    let found = case.own("query", "selection.npy", "--setting k=0,voxel=0.12");
    assert_eq!(found, case.own("query", "selection.npy", "--vote-k 0 --grid-size 0.12"));
    // Of a configuration, the weights are given beside it; a folder has both.
    let by_name = case.own("features", "features.npy", "--weights seeded:0 --setting net=tiny");
    assert_eq!(by_name, case.tiny(""));
    // Evaluation as well, without a receipt of its own votes.
    let figures = |more: &str| {
        let json = case.evaluated(more);
        (json["miou"].clone(), json["vote_k"].clone())
    };
    let coarse = figures("--setting voxel=0.2,k=1");
    assert_eq!(coarse, figures("--grid-size 0.2 --vote-k 1"));
    assert_ne!(coarse, figures("--setting voxel=0.3,k=1"));
}

#[test]
fn labels_agree_on_surfaces_by_themselves_or_as_asked_for() {
    let case = Case::new(4000);
    let auto = case.own("segment", "labels.npy", "");
    let counts = case.receipt("surfaces").unwrap();
    assert_eq!(counts.split(' ').count(), 5, "{counts}");
    assert_eq!(auto, case.own("segment", "labels.npy", "--surfaces on"));
    assert_ne!(auto, case.own("segment", "labels.npy", "--surfaces off"));
    assert_eq!(case.receipt("surfaces").as_deref(), Some("off"));
    case.own("objects", "objects.json", "");
    assert_eq!(case.receipt("surfaces"), Some(counts));
    let figures = |more: &str| case.evaluated(more)["miou"].clone();
    let auto = figures("");
    assert_eq!(auto, figures("--surfaces on"));
    assert_ne!(auto, figures("--surfaces off"));
}

#[test]
fn objects_refine_labels_if_that_is_asked_for() {
    let case = Case::new(4000);
    let plain = case.own("segment", "labels.npy", "");
    assert_eq!(case.receipt("refine"), None);
    assert_eq!(plain, case.own("segment", "labels.npy", "--refine off"));
    let refined = case.own("segment", "labels.npy", "--refine objects");
    assert_eq!(case.receipt("refine").as_deref(), Some("objects"));
    assert_ne!(plain, refined);
    assert_eq!(refined, case.own("segment", "labels.npy", "--refine objects --threads 1"));
    let alone = |more: &str| case.own("segment", "labels.npy", &format!("--surfaces off {more}"));
    assert_ne!(alone(""), alone("--refine objects"));
    let figures = |more: &str| case.evaluated(more)["miou"].clone();
    let unrefined = figures("");
    assert_ne!(unrefined, figures("--refine objects"));
    assert_eq!(unrefined, figures("--refine off"));
    // Objects are made of the same labels.
    assert_ne!(
        case.own("objects", "instances.npy", "--pieces"),
        case.own("objects", "instances.npy", "--pieces --refine objects")
    );
    let (scene, texts) = (&case.scene, asset("classes.safetensors").display().to_string());
    let cases = [
        (
            &*format!("segment {scene} {TINY} --text {texts} --refine objects"),
            2,
            "--refine: cosines of this network",
        ),
        (
            "evaluate synthetic:1:3 --features oracle --refine objects",
            2,
            "--refine is about labels",
        ),
        (&format!("segment {scene} --refine labels"), 2, "--refine <WHAT>"),
    ];
    all_refused(cases, |words| run!("{words} --out {}", case.out("")));
}

#[test]
fn what_is_less_probable_stays_unknown() {
    let case = Case::new(8000);
    let unknown = |more: &str| {
        case.own("segment", "labels.npy", more);
        labels(case.out("labels.npy")).iter().filter(|label| **label < 0).count()
    };
    let off = |p: &str| unknown(&format!("--surfaces off --min-probability {p}"));
    let found = ["0", "0.5", "0.9", "1"].map(off);
    assert_eq!(case.receipt("min_probability").as_deref(), Some("1"));
    let temperature: f32 = case.receipt("temperature").unwrap().parse().unwrap();
    let stored = scenesplat::calibration::Calibration::embedded().unwrap().temperature;
    assert_eq!(temperature, stored);
    assert_eq!((found[0], unknown("--surfaces off")), (0, 0));
    assert!(found[0] < found[1] && found[1] < found[2] && found[2] < found[3], "{found:?}");
    assert!(found[1] < 4000 && found[3] > 6000, "{found:?}");
    // Withheld labels have no say on surfaces, and get none there.
    assert_eq!(unknown("--min-probability 0.9"), found[2]);
    // In evaluations they are wrong.
    let figures = |more: &str| case.evaluated(more)["macc"].as_f64().unwrap();
    assert!(figures("--min-probability 0.9") < figures("") - 0.05);
    // Cosines of other networks are not calibrated, and the truth has no probability.
    let (scene, texts) = (&case.scene, asset("classes.safetensors").display().to_string());
    let half = "--min-probability 0.5";
    let cases = [
        (
            &*format!("segment {scene} {TINY} --text {texts} {half}"),
            2,
            "give a least cosine (--min-score)",
        ),
        (
            &format!("evaluate synthetic:1:3 --features oracle {half}"),
            2,
            "--min-probability is about labels",
        ),
        (&format!("segment {scene} --min-probability 1.5"), 2, "expected 0 to 1"),
    ];
    all_refused(cases, |words| run!("{words} --out {}", case.out("")));
}

#[test]
fn the_last_stage_is_shortened() {
    let case = Case::new(3000);
    let mut seen = vec![case.own("features", "features.npy", "")];
    for part in ["stage=coarse", "rank=8", "stage=coarse,rank=8"] {
        let found = case.own("features", "features.npy", &format!("--setting {part}"));
        assert!(!seen.contains(&found), "{part} changes nothing");
        assert_eq!(case.receipt("setting").as_deref(), Some(part));
        let kept = case.receipt("rank_keeps");
        assert_eq!(kept.is_some(), part.contains("rank"), "{kept:?}");
        assert!(kept.is_none_or(|text| text.contains("% in dec.dec0.block0")));
        // The same for any number of threads.
        let alone = format!("--setting {part} --threads 1");
        assert_eq!(found, case.own("features", "features.npy", &alone), "{part}");
        seen.push(found);
    }
    // The estimate knows what is left out.
    let [all, coarse, low] =
        ["", "--setting stage=coarse", "--setting rank=96"].map(|more| case.estimate(more).1);
    assert!(coarse < low && low < all, "{all} {coarse} {low}");
}

#[test]
fn features_are_written_as_codes_and_compared_as_such() {
    let case = Case::new(3000);
    let shape = |file: &str| npy(case.out(file)).shape().to_vec();
    case.own("features", "features.npy", "");
    let plain = floats(case.out("features.npy"));
    assert!(!case.folder.path("out/feature_axes.npy").exists());
    case.own("features", "features.npy", "--setting codes=32");
    assert_eq!((shape("features.npy"), shape("feature_axes.npy")), (vec![3000, 32], vec![32, 96]));
    assert!(case.receipt("codes_keep").unwrap().contains('%'));
    let [codes, axes] = ["features.npy", "feature_axes.npy"].map(|file| floats(case.out(file)));
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
    let same = |command: &str, file: &str, part: &str| {
        let plain = case.own(command, file, "");
        let coded = case.own(command, file, &format!("--setting {part}"));
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
    let own = case.estimate("");
    let wide = case.estimate("--setting voxel=0.3");
    assert!(wide.0 < own.0 / 2.0 && wide.1 < own.1, "{own:?} {wide:?}");
    assert!(case.estimate("--setting patch=64").1 < own.1);
    assert_eq!(case.estimate("--setting passes=1,precision=f32"), own);
    for part in
        ["k=8", "codes=16", "anchor=world", "precision=bf16", "passes=all", "passes=2", "tta=4"]
    {
        refused(&run!("inspect {} --no-sheet --setting {part}", case.scene), 2, &[part]);
    }
}

/// The command ends with these words and writes nothing.
fn is_refused(case: &Case, words: &str, parts: &[&str]) {
    refused(&run!("{words} --out {}", case.out("")), 2, parts);
    assert!(!case.folder.path("out/features.npy").exists());
    assert!(!case.folder.path("out/labels.npy").exists());
}

#[test]
fn what_cannot_be_used_is_refused_by_name() {
    let case = Case::new(300);
    let scene = &case.scene;
    let refused = |words: &str, parts: &[&str]| is_refused(&case, words, parts);
    for (part, said) in [
        ("''", &["no part is named"][..]),
        ("speed=9", &["\"speed\" is unknown", "voxel, net, precision"]),
        ("k=8,voxel=0.1,k=9", &["setting k", "twice"]),
        ("voxel=0", &["voxel", "above 0"]),
        ("voxel=nan", &["voxel", "above 0"]),
        ("voxel=1e30", &["voxel", "at most 1000000"]),
        ("k=18446744073709551615", &["k", "0 to 4096"]),
        ("voxel=-1", &["voxel", "above 0"]),
        ("anchor=room", &["anchor", "box or world"]),
        ("voxel", &["KEY=VALUE"]),
        ("voxel=", &["voxel"]),
        ("rank=0", &["rank", "1 to"]),
        ("stage=middle", &["stage", "fine or coarse"]),
        ("precision=f64", &["precision", "bf16"]),
        ("passes=0", &["passes", "all"]),
        ("tta=13", &["tta", "1 to 12"]),
        ("net=nowhere", &["net=nowhere", "litept-s"]),
        ("net=tiny", &["net", "--weights"]),
    ] {
        refused(&format!("segment {scene} --setting {part}"), said);
    }
    refused(&format!("features {scene} --setting k=3"), &["--setting k"]);
    // What the network has nothing of.
    for (config, part, said) in [
        ("litept-s", "stage=coarse", "only Point Transformer V3"),
        ("litept-s-decoder", "rank=8", "only Point Transformer V3"),
        ("litept-s", "patch=65536", "16384"),
        ("tiny", "rank=65", "1 to 64"),
        ("tiny", "rank=16384", "1 to 64"),
        ("tiny", "codes=64", "64 numbers"),
        ("tiny", "codes=256", "64 numbers"),
        ("semseg", "codes=16", "probabilities"),
    ] {
        let words = format!("--config {config} --weights seeded:0 --setting {part}");
        refused(&format!("features {scene} {words}"), &[part, said]);
    }
    // About a network, where none is run.
    let oracle = "evaluate synthetic:1:1 --features oracle --setting voxel=0.1";
    refused(oracle, &["--setting voxel"]);
    let made = format!("segment {scene} --features {scene} --setting voxel=0.1");
    refused(&made, &["--setting", "--features"]);
}

#[test]
fn what_a_flag_says_otherwise_is_refused() {
    let case = Case::new(300);
    let scene = &case.scene;
    for (flags, part) in [
        ("--grid-size 0.1", "voxel=0.2"),
        ("--precision f32", "precision=bf16"),
        ("--vote-k 25", "k=8"),
        ("--exact", "passes=1"),
        ("--exact", "passes=2"),
        ("--weights seeded:0", "net=embedded"),
        ("--config language --weights seeded:0", "net=tiny"),
        ("--weights seeded:0", &format!("net={scene}")),
        ("--config tiny", "net=embedded"),
    ] {
        let flag = flags.split(' ').next().unwrap();
        let words = format!("segment {scene} --setting {part} {flags}");
        is_refused(&case, &words, &[flag, part, "contradicts"]);
    }
}
