//! What each command writes.

use crate::support::*;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::formats::ply::PlyFile;
use serde_json::Value;
use std::path::PathBuf;
use std::process::Output;

/// A folder for the results of commands with the tiny network on the demo room.
struct Case {
    folder: Folder,
    room: String,
    texts: String,
}

impl Case {
    fn new() -> Self {
        let [room, texts] = ["room.ply", "classes.safetensors"].map(asset_at);
        Self { folder: Folder::new(), room, texts }
    }

    /// Runs the command with results in the folder `out`.
    fn run(&self, command: &str, out: &str, more: &str) -> Output {
        let (name, rest) = command.split_once(' ').unwrap_or((command, ""));
        run!("{name} {} {rest} {TINY} --out {} {more}", self.room, self.folder.at(out))
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path(name)
    }

    /// Labels and scores of `segment` with the texts, and the receipt.
    fn segment(&self, out: &str, more: &str) -> (Vec<i64>, Vec<f32>, Value) {
        done(&self.run("segment", out, &format!("--text {} {more}", self.texts)));
        let at = |name: &str| self.out(out).join(name);
        (labels(at("labels.npy")), floats(at("scores.npy")), json(at("receipt.json")))
    }
}

fn is_png(path: PathBuf) -> bool {
    bytes(path).starts_with(b"\x89PNG\r\n\x1a\n")
}

#[test]
fn features_are_the_same_for_any_thread_count_and_run() {
    let case = Case::new();
    let run = |out: &str, more: &str| {
        done(&case.run("features", out, more));
        bytes(case.out(out).join("features.npy"))
    };
    let one = run("one", "--threads 1");
    for (out, threads) in [("two", 2), ("three", 3), ("again", 2)] {
        assert!(one == run(out, &format!("--threads {threads}")), "{out}");
    }
    let array = npy(case.out("one/features.npy"));
    assert_eq!(array.shape(), [16_000, 64]);
    let values = array.read_f32().unwrap();
    for row in values.chunks_exact(64).step_by(501) {
        let norm: f32 = row.iter().map(|v| v * v).sum();
        assert!((norm - 1.0).abs() < 1e-5, "rows are unit vectors: {norm}");
    }
    assert!(values[..64] != values[64 * 9000..64 * 9001], "features differ between places");
    assert!(is_png(case.out("one/preview.png")));
    let half = run("half", "--dtype f16");
    assert_eq!((half.len() - 128) * 2, one.len() - 128);
    done(&case.run("features", "st", "--format safetensors"));
    let file = bytes(case.out("st/features.safetensors"));
    let parsed = safetensors::SafeTensors::deserialize(&file).unwrap();
    assert_eq!(parsed.tensor("features").unwrap().data(), &one[one.len() - 16_000 * 64 * 4..]);
}

#[test]
fn segment_writes_labels_a_colored_scene_and_a_receipt() {
    let case = Case::new();
    let receipt = case.folder.at("r.json");
    let more = format!("--text {} --receipt {receipt}", case.texts);
    has(&told(&case.run("segment", "out", &more)), &["SEEDED WEIGHTS"]);
    let labels = labels(case.out("out/labels.npy"));
    let source = PlyFile::open(&asset("room.ply")).unwrap();
    let colored = PlyFile::open(&case.out("out/segmented.ply")).unwrap();
    assert_eq!(colored.column_i64("vertex", "label").unwrap(), labels);
    let column = |file: &PlyFile, name: &str| file.column_f32("vertex", name).unwrap();
    for kept in ["x", "y", "z", "opacity", "scale_2", "rot_3", "nx"] {
        assert_eq!(column(&source, kept), column(&colored, kept), "{kept}");
    }
    let dc = column(&source, "f_dc_1");
    assert_eq!(dc, column(&colored, "source_f_dc_1"));
    assert_ne!(dc, column(&colored, "f_dc_1"));
    assert_eq!(column(&colored, "score"), floats(case.out("out/scores.npy")));
    // The rows were made from this room with weights that mean nothing: twice as good as chance among
    // its 22 classes, or the chain is broken.
    let truth = source.column_i64("vertex", "segment").unwrap();
    let names = json(case.out("out/classes.json")).as_array().unwrap().len();
    let hits = labels.iter().zip(&truth).filter(|(a, b)| a == b && **b >= 0).count();
    assert!(names > 5 && hits * 11 > labels.len(), "{hits} of {}", labels.len());
    assert!(is_png(case.out("out/preview.png")));

    let receipt = json(receipt);
    assert_eq!(receipt["rows_in"], 16_000);
    let stages = receipt["stages"].as_array().unwrap();
    let outer = stages.iter().filter(|s| !s["name"].as_str().unwrap().contains('/'));
    let sum: f64 = outer.map(|s| s["seconds"].as_f64().unwrap()).sum();
    assert!((sum / receipt["wall_seconds"].as_f64().unwrap() - 1.0).abs() < 0.03);
    assert_eq!(receipt["files"][0]["sha256"].as_str().unwrap().len(), 64);
    has(&receipt["warnings"].to_string(), &["SEEDED"]);
}

#[test]
fn segment_with_integers_says_so_and_agrees_with_f32() {
    let case = Case::new();
    let (exact, exact_scores, receipt) = case.segment("f32", "--vote-k 0");
    // A table of texts is no vocabulary: labels agree on surfaces where it is asked for.
    assert_eq!(setting(&receipt, "surfaces").as_deref(), Some("off"));
    let (agreed, _, receipt) = case.segment("surfaces", "--vote-k 0 --surfaces on");
    assert_ne!(setting(&receipt, "surfaces").as_deref(), Some("off"));
    assert_ne!(agreed, exact);
    let (labels, scores, receipt) = case.segment("int8", "--vote-k 0 --precision int8");
    assert_eq!(receipt["machine"]["dtype"], "int8", "{receipt}");
    let same = labels.iter().zip(&exact).filter(|(a, b)| a == b).count();
    assert!(scores != exact_scores, "nothing was rounded");
    assert!(same * 100 >= labels.len() * 97, "{same} of {}", labels.len());
    // The same by its part of a setting, whatever the number of threads.
    let more = "--vote-k 0 --setting precision=int8 --threads 1";
    let (again, again_scores, receipt) = case.segment("setting", more);
    assert_eq!((again, again_scores), (labels, scores));
    assert_eq!(receipt["machine"]["dtype"], "int8");
}

#[test]
fn unknown_thresholds_withhold_labels() {
    let case = Case::new();
    let run = |out: &str, more: &str| case.segment(out, more).0;
    let all = run("all", "--vote-k 0");
    assert!(all.iter().all(|l| *l >= 0));
    let some = run("some", "--vote-k 0 --min-margin 0.02");
    let unknown = some.iter().filter(|l| **l < 0).count();
    assert!(unknown > 0 && unknown < some.len(), "{unknown}");
    assert!(some.iter().zip(&all).all(|(s, a)| *s == -1 || s == a));
    assert!(run("none", "--vote-k 0 --min-score 1.1").iter().all(|l| *l == -1));
    // The vote of the default run does not fill what was withheld.
    let voted = run("voted", "--min-margin 0.02");
    assert!(some.iter().zip(&voted).all(|(s, v)| *s >= 0 || *v == -1));
    assert!(voted.iter().any(|v| *v >= 0));
    let without = run("without", "--vote-k 0 --without floor,wall");
    let names = scenesplat::text::read_text_table(case.texts.as_ref(), None).unwrap().names;
    assert!(without.iter().all(|l| !["floor", "wall"].contains(&names[*l as usize].as_str())));
}

#[test]
fn query_selects_and_says_what_to_do_about_unknown_names() {
    let case = Case::new();
    let texts = &case.texts;
    let query = |phrase: &str, more: &str| case.run(&format!("query {phrase}"), "q", more);
    let selected = || npy(case.out("q/selection.npy")).read_u8().unwrap();
    let count = || selected().iter().filter(|s| **s == 1).count();
    let said = printed(&query("Floor", &format!("--text {texts}")));
    has(&said, &["of 16000 Gaussians, center"]);
    let (found, mut scores) = (selected(), floats(case.out("q/scores.npy")));
    let mean = |want: u8| {
        let of = scores.iter().zip(&found).filter(|(_, s)| **s == want).map(|(v, _)| *v);
        of.clone().sum::<f32>() / of.count() as f32
    };
    assert!(mean(1) > mean(0), "what is selected scores higher");
    let unknown = query("'robot arm'", &format!("--text {texts}"));
    refused(&unknown, 2, &["nearest:", "--embedding"]);

    // Any other text works through its embedding.
    let vector = case.folder.at("v.npy");
    write_npy(vector.as_ref(), &[64], &[0.1f32; 64]).unwrap();
    let arm = |more: &str| query("'robot arm'", &format!("--embedding {vector} {more}"));
    // Without rivals or a threshold everything would win.
    refused(&arm(""), 2, &["--min-score"]);
    let by_score = |min: &str| {
        done(&arm(&format!("--min-score {min} --vote-k 0")));
        count()
    };
    assert_eq!(by_score("-1"), 16_000);
    scores = floats(case.out("q/scores.npy"));
    scores.sort_by(f32::total_cmp);
    let some = by_score(&scores[12_000].to_string());
    assert!((3_900..=4_000).contains(&some), "{some}");
    done(&arm(&format!("--text {texts}")));
    // The query's own row among the texts is no rival, and an embedding of another width is refused.
    done(&query("floor", &format!("--embedding {vector} --text {texts}")));
    let wide = case.folder.at("wide.npy");
    write_npy(wide.as_ref(), &[65], &[0.1f32; 65]).unwrap();
    refused(&query("floor", &format!("--embedding {wide} --text {texts}")), 2, &["65"]);
    // Barred rivals cannot win against the query.
    done(&query("floor", &format!("--text {texts}")));
    let all = count();
    done(&query("floor", &format!("--text {texts} --without wall,ceiling,table")));
    assert!(count() > all, "{} {all}", count());
}

#[test]
fn evaluate_passes_its_oracle_and_refuses_a_broken_one() {
    let case = Case::new();
    let names = case.folder.names();
    let base = format!("--text {} --label-names {names}", case.texts);
    let evaluate = |out: &str, more: &str| case.run("evaluate", out, &format!("{base} {more}"));
    for vote in ["0", "25"] {
        done(&evaluate("e", &format!("--vote-k {vote}")));
        let figures = json(case.out("e/evaluation.json"));
        let right = |json: &Value| json["all_acc"].as_f64().unwrap();
        let oracle = right(&figures["oracle"]);
        assert!(vote != "0" || oracle == 1.0, "without a vote the oracle is perfect");
        assert!(oracle > right(&figures) && right(&figures) > right(&figures["random_labels"]));
        let broken = evaluate("no", &format!("--vote-k {vote} --break-oracle 100"));
        refused(&broken, 1, &["evaluation refused"]);
        assert!(!case.out("no/evaluation.json").exists(), "nothing is reported");
    }
    // Features of a file are those of the network that made them.
    done(&case.run("features", "f", ""));
    let value = |more: &str| {
        done(&evaluate("e", more));
        json(case.out("e/evaluation.json"))["miou"].as_f64().unwrap()
    };
    let features = case.folder.at("f/features.npy");
    assert_eq!(value(""), value(&format!("--features {features}")));
}

#[test]
fn weights_names_the_network_that_fits() {
    let case = Case::new();
    let weights = case.folder.at("tiny.safetensors");
    let store = scenesplat::models::ParamStore::trainable(3);
    let config = scenesplat::models::PointTransformerV3Config::tiny();
    scenesplat::models::PointTransformerV3::new(&config, store.builder()).unwrap();
    store.save(weights.as_ref()).unwrap();
    let report = case.folder.at("w.json");
    let said = printed(&run!("weights {weights} --json {report}"));
    has(&said, &["tiny: fits", "language: does not fit", "sha256"]);
    let report = json(report);
    let networks = report["networks"].as_array().unwrap();
    assert_eq!(networks.iter().filter(|n| n["fits"] == true).count(), 1);
    // And they work.
    let words = format!("features {} --weights {weights} --out {}", case.room, case.folder.at("f"));
    done(&run!("{words} --config tiny --quiet"));
    // A network they do not fit refuses them and says what is missing.
    refused(&run!("{words} --config semseg"), 1, &["missing", "do not fit"]);
}

#[test]
fn wrong_use_is_exit_code_2() {
    for line in [
        "features",
        "fly x.ply",
        "features x.ply --config giant",
        "features x.ply --max-memory lots",
        "features x.ply --device tpu",
        "features x.ply --config tiny",
        "features x.ply --config tiny --weights embedded",
        "segment x.ply --config tiny --weights seeded:0",
        "query x.ply 'qwzxk vbnmp'",
        "query x.ply volcano",
        "text",
        "text 'qwzxk vbnmp' --out t.safetensors",
        "evaluate synthetic:many:1",
        "segment x.ply --text vocabulary:wide",
        "query x.ply chair --text vocabulary:",
        "train",
        "features x.ply --weights seeded:0 --threads 0",
    ] {
        refused(&run!("{line}"), 2, &[]);
    }
    done(&run!("--help"));
    refused(&run!("features nowhere.ply {TINY} --out {}", Folder::new().at("out")), 1, &[]);
}

#[test]
fn tiles_and_the_exact_mode_agree_with_the_plain_run_where_they_should() {
    let case = Case::new();
    // Memory is that of the process.
    let run = |out: &str, more: &str| {
        let at = case.folder.at(out);
        let line = format!("features {} {TINY} --out {at} --verbose {more}", case.room);
        let said = told(&process(&words(&line)));
        (floats(case.out(out).join("features.npy")), said)
    };
    let (plain, _) = run("plain", "");
    let (roomy, said) = run("roomy", "--max-memory 4GB");
    assert_eq!(plain, roomy, "a limit that is not reached changes nothing");
    has(&said, &["1 tiles"]);
    let (tiled, said) = run("tiled", "--max-memory 85MB --halo 24");
    assert!(!said.contains(" 1 tiles"), "{said}");
    let cosines = |other: &[f32]| -> Vec<f32> {
        let rows = plain.chunks_exact(64).zip(other.chunks_exact(64));
        rows.map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum()).collect()
    };
    let mut sorted = cosines(&tiled);
    sorted.sort_by(f32::total_cmp);
    // Attention patches and curve codes differ in a tile, so features do; unrelated places of this
    // room have cosines around 0.5.
    assert!(sorted[sorted.len() / 2] > 0.97, "median cosine {}", sorted[sorted.len() / 2]);
    let (exact, _) = run("exact", "--exact");
    let agree = cosines(&exact).iter().sum::<f32>() / 16_000.0;
    assert!(agree > 0.95, "mean cosine {agree}");
}

#[test]
fn a_folder_of_arrays_works_like_the_file_it_came_from() {
    use scenesplat::scene::LabelledPoints;
    use scenesplat::scene::formats::npy_folder::write_npy_folder;
    let case = Case::new();
    let mut scene = read(asset("room.ply"));
    // Points to score on, as benchmarks have them: every third Gaussian, moved a little.
    let rows: Vec<usize> = (0..scene.len()).step_by(3).collect();
    let segment = scene.segment.clone().unwrap();
    scene.labelled_points = Some(LabelledPoints {
        coord: rows.iter().map(|&r| scene.coord[r].map(|v| v + 0.001)).collect(),
        segment: Some(rows.iter().map(|&r| segment[r]).collect()),
        instance: None,
    });
    write_npy_folder(&scene, &case.out("scene"), false).unwrap();
    let case = Case { room: case.folder.at("scene"), ..case };
    done(&case.run("features", "b", ""));
    done(&run!("features {} {TINY} --out {}", asset_at("room.ply"), case.folder.at("a")));
    let [a, b] = ["a", "b"].map(|out| floats(case.out(out).join("features.npy")));
    // Opacities and scales are stored after activation there: equal to a few units in the last place.
    let worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 2e-4, "{worst}");
    let more = format!("--text {} --label-names {}", case.texts, case.folder.names());
    let said = printed(&case.run("evaluate", "e", &more));
    has(&said, &[&format!("{} scored points", rows.len())]);
}

#[test]
fn a_segmentation_network_labels_and_is_evaluated_by_its_own_classes() {
    let case = Case::new();
    let classes = class_names().len();
    let shape = scenesplat::models::ModelConfig::tiny().with_classes(classes);
    let config = case.folder.write("seg.toml", toml::to_string(&shape).unwrap());
    let (names, out) = (case.folder.names(), case.folder.at("out"));
    let network = format!("--config {config} --weights seeded:0 --out {out}");
    let run = |command: &str, more: &str| run!("{command} {} {more} {network}", case.room);
    done(&run("segment", &format!("--text-names {names}")));
    assert!(labels(case.out("out/labels.npy")).iter().all(|l| (0..classes as i64).contains(l)));
    let scores = floats(case.out("out/scores.npy"));
    assert!(scores.iter().all(|p| (0.0..=1.0).contains(p)), "scores are probabilities");
    done(&run("segment", &format!("--text-names {names} --min-score 1.1")));
    assert!(labels(case.out("out/labels.npy")).iter().all(|l| *l == -1));
    done(&run("evaluate", &format!("--text-names {names} --label-names {names}")));
    let texts = format!("--text {}", case.texts);
    for (command, more) in [("evaluate", ""), ("segment", ""), ("query", "floor")] {
        refused(&run(command, &format!("{more} {texts}")), 2, &[]);
    }
}

#[test]
fn features_of_a_file_stand_in_for_a_network() {
    let case = Case::new();
    done(&case.run("features", "made", ""));
    let (by_network, ..) = case.segment("network", "");
    let (features, out) = (case.folder.at("made/features.npy"), case.folder.at("file"));
    let with = |features: &str| format!("--features {features} --text {} --out {out}", case.texts);
    done(&run!("segment {} {}", case.room, with(&features)));
    assert_eq!(by_network, labels(case.out("file/labels.npy")));
    done(&run!("query {} floor {}", case.room, with(&features)));
    let selected = npy(case.out("file/selection.npy")).read_u8().unwrap();
    assert!(selected.contains(&1) && selected.contains(&0));

    // Of another scene, or beside a network: refused.
    let short = case.folder.at("short.npy");
    write_npy(short.as_ref(), &[3, 64], &[0.1f32; 192]).unwrap();
    refused(&run!("segment {} {}", case.room, with(&short)), 1, &["belong to another scene"]);
    let beside = format!("--features {features} --weights embedded --out {out}");
    refused(&run!("segment {} {beside}", case.room), 2, &[]);
}
