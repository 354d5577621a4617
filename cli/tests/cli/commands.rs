//! What each command writes.

use crate::{asset, class_names, done, scenesplat, stderr, tiny};
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::ply::PlyFile;
use std::path::Path;

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn is_png(path: &Path) -> bool {
    bytes(path).starts_with(b"\x89PNG\r\n\x1a\n")
}

#[test]
fn features_are_the_same_for_any_thread_count_and_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        done(&tiny("features", &asset("room.ply"), &out, more));
        bytes(&out.join("features.npy"))
    };
    let one = run("one", &["--threads", "1"]);
    assert_eq!(one, run("two", &["--threads", "2"]));
    assert_eq!(one, run("three", &["--threads", "3"]));
    assert_eq!(one, run("again", &["--threads", "2"]));
    let array = NpyFile::open(&folder.path().join("one/features.npy")).unwrap();
    assert_eq!(array.shape(), [16_000, 64]);
    let values = array.read_f32().unwrap();
    for row in values.chunks_exact(64).step_by(501) {
        let norm: f32 = row.iter().map(|v| v * v).sum();
        assert!((norm - 1.0).abs() < 1e-5, "rows are unit vectors: {norm}");
    }
    assert!(values[..64] != values[64 * 9000..64 * 9001], "features differ between places");
    assert!(is_png(&folder.path().join("one/preview.png")));
    let half = run("half", &["--dtype", "f16"]);
    assert_eq!((half.len() - 128) * 2, one.len() - 128);
    done(&tiny(
        "features",
        &asset("room.ply"),
        &folder.path().join("st"),
        &["--format", "safetensors"],
    ));
    let file = bytes(&folder.path().join("st/features.safetensors"));
    let parsed = safetensors::SafeTensors::deserialize(&file).unwrap();
    assert_eq!(parsed.tensor("features").unwrap().data(), &one[one.len() - 16_000 * 64 * 4..]);
}

#[test]
fn segment_writes_labels_a_colored_scene_and_a_receipt() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let receipt = folder.path().join("r.json");
    let text = asset("classes.safetensors");
    let output = tiny(
        "segment",
        &asset("room.ply"),
        &out,
        &["--text", text.to_str().unwrap(), "--receipt", receipt.to_str().unwrap()],
    );
    done(&output);
    assert!(stderr(&output).contains("SEEDED WEIGHTS"), "meaningless labels are named so");
    let labels = NpyFile::open(&out.join("labels.npy")).unwrap().read_i64().unwrap();
    let source = PlyFile::open(&asset("room.ply")).unwrap();
    let colored = PlyFile::open(&out.join("segmented.ply")).unwrap();
    assert_eq!(colored.column_i64("vertex", "label").unwrap(), labels);
    for kept in ["x", "y", "z", "opacity", "scale_2", "rot_3", "nx"] {
        let a = source.column_f32("vertex", kept).unwrap();
        assert_eq!(a, colored.column_f32("vertex", kept).unwrap(), "{kept}");
    }
    let dc = source.column_f32("vertex", "f_dc_1").unwrap();
    assert_eq!(dc, colored.column_f32("vertex", "source_f_dc_1").unwrap());
    assert_ne!(dc, colored.column_f32("vertex", "f_dc_1").unwrap());
    let scores = NpyFile::open(&out.join("scores.npy")).unwrap().read_f32().unwrap();
    assert_eq!(colored.column_f32("vertex", "score").unwrap(), scores);
    // The rows were made from this room with weights that mean nothing: twice as good as chance among
    // its 22 classes, or the chain is broken.
    let truth = source.column_i64("vertex", "segment").unwrap();
    let names: Vec<String> = serde_json::from_slice(&bytes(&out.join("classes.json"))).unwrap();
    let hits = labels.iter().zip(&truth).filter(|(a, b)| a == b && **b >= 0).count();
    assert!(names.len() > 5 && hits * 11 > labels.len(), "{hits} of {}", labels.len());
    assert!(is_png(&out.join("preview.png")));

    let receipt: serde_json::Value = serde_json::from_slice(&bytes(&receipt)).unwrap();
    assert_eq!(receipt["rows_in"], 16_000);
    let stages = receipt["stages"].as_array().unwrap();
    let sum: f64 = stages
        .iter()
        .filter(|s| !s["name"].as_str().unwrap().contains('/'))
        .map(|s| s["seconds"].as_f64().unwrap())
        .sum();
    assert!((sum / receipt["wall_seconds"].as_f64().unwrap() - 1.0).abs() < 0.03);
    assert!(receipt["files"][0]["sha256"].as_str().unwrap().len() == 64);
    assert!(receipt["warnings"].to_string().contains("SEEDED"));
}

#[test]
fn segment_with_integers_says_so_and_agrees_with_f32() {
    let folder = tempfile::tempdir().unwrap();
    let text = asset("classes.safetensors");
    let run = |name: &str, more: &[&str]| {
        let (out, receipt) = (folder.path().join(name), folder.path().join(format!("{name}.json")));
        let paths = [&text, &receipt].map(|p| p.to_str().unwrap());
        let mut args = vec!["--text", paths[0], "--receipt", paths[1], "--vote-k", "0"];
        args.extend(more);
        done(&tiny("segment", &asset("room.ply"), &out, &args));
        let receipt: serde_json::Value = serde_json::from_slice(&bytes(&receipt)).unwrap();
        let labels = NpyFile::open(&out.join("labels.npy")).unwrap().read_i64().unwrap();
        let scores = NpyFile::open(&out.join("scores.npy")).unwrap().read_f32().unwrap();
        (labels, scores, receipt)
    };
    let (exact, exact_scores, receipt) = run("f32", &[]);
    // A table of texts is no vocabulary: labels agree on surfaces where it is asked for.
    let surfaces = |receipt: &serde_json::Value| {
        let settings = receipt["settings"].as_array().unwrap();
        settings.iter().find(|s| s["name"] == "surfaces").unwrap()["value"].clone()
    };
    assert_eq!(surfaces(&receipt), "off");
    let (agreed, _, receipt) = run("surfaces", &["--surfaces", "on"]);
    assert_ne!(surfaces(&receipt), "off");
    assert_ne!(agreed, exact);
    let (labels, scores, receipt) = run("int8", &["--precision", "int8"]);
    assert_eq!(receipt["machine"]["dtype"], "int8", "{receipt}");
    let same = labels.iter().zip(&exact).filter(|(a, b)| a == b).count();
    assert!(scores != exact_scores, "nothing was rounded");
    assert!(same * 100 >= labels.len() * 97, "{same} of {}", labels.len());
    // The same by its part of a setting, whatever the number of threads.
    let (again, again_scores, receipt) =
        run("setting", &["--setting", "precision=int8", "--threads", "1"]);
    assert_eq!((again, again_scores), (labels, scores));
    assert_eq!(receipt["machine"]["dtype"], "int8");
}

#[test]
fn unknown_thresholds_withhold_labels() {
    let folder = tempfile::tempdir().unwrap();
    let text = asset("classes.safetensors");
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let mut args = vec!["--text", text.to_str().unwrap(), "--vote-k", "0"];
        args.extend(more);
        done(&tiny("segment", &asset("room.ply"), &out, &args));
        NpyFile::open(&out.join("labels.npy")).unwrap().read_i64().unwrap()
    };
    let all = run("all", &[]);
    assert!(all.iter().all(|l| *l >= 0));
    let some = run("some", &["--min-margin", "0.02"]);
    let unknown = some.iter().filter(|l| **l < 0).count();
    assert!(unknown > 0 && unknown < some.len(), "{unknown}");
    assert!(some.iter().zip(&all).all(|(s, a)| *s == -1 || s == a));
    assert!(run("none", &["--min-score", "1.1"]).iter().all(|l| *l == -1));
    // The vote of the default run does not fill what was withheld.
    let out = folder.path().join("voted");
    let args = ["--text", text.to_str().unwrap(), "--min-margin", "0.02"];
    done(&tiny("segment", &asset("room.ply"), &out, &args));
    let voted = NpyFile::open(&out.join("labels.npy")).unwrap().read_i64().unwrap();
    assert!(some.iter().zip(&voted).all(|(s, v)| *s >= 0 || *v == -1));
    assert!(voted.iter().any(|v| *v >= 0));
    let without = run("without", &["--without", "floor,wall"]);
    let names = ["floor", "wall"].map(|n| {
        scenesplat::text::read_text_table(&text, None)
            .unwrap()
            .names
            .iter()
            .position(|m| m == n)
            .unwrap() as i64
    });
    assert!(without.iter().all(|l| !names.contains(l)));
}

#[test]
fn query_selects_and_says_what_to_do_about_unknown_names() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("q");
    let text = asset("classes.safetensors");
    let text = text.to_str().unwrap();
    let output = tiny("query", &asset("room.ply"), &out, &["Floor", "--text", text]);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("of 16000 Gaussians, centre"), "{said}");
    let selected = NpyFile::open(&out.join("selection.npy")).unwrap().read_u8().unwrap();
    let scores = NpyFile::open(&out.join("scores.npy")).unwrap().read_f32().unwrap();
    assert!(selected.contains(&1) && selected.contains(&0));
    let mean = |want: u8| {
        let picked: Vec<f32> =
            scores.iter().zip(&selected).filter(|(_, s)| **s == want).map(|(v, _)| *v).collect();
        picked.iter().sum::<f32>() / picked.len() as f32
    };
    assert!(mean(1) > mean(0), "what is selected scores higher");

    let output = tiny("query", &asset("room.ply"), &out, &["robot arm", "--text", text]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("nearest:") && stderr(&output).contains("--embedding"));

    // Any other text works through its embedding.
    let vector = folder.path().join("v.npy");
    scenesplat::scene::formats::npy_writer::write_npy(&vector, &[64], &[0.1f32; 64]).unwrap();
    let vector = vector.to_str().unwrap();
    let alone = tiny("query", &asset("room.ply"), &out, &["robot arm", "--embedding", vector]);
    assert_eq!(alone.status.code(), Some(2), "without rivals or a threshold everything would win");
    let count = || {
        let selected = NpyFile::open(&out.join("selection.npy")).unwrap().read_u8().unwrap();
        selected.iter().filter(|s| **s == 1).count()
    };
    let by_score = |min: &str| {
        let args = ["robot arm", "--embedding", vector, "--min-score", min, "--vote-k", "0"];
        done(&tiny("query", &asset("room.ply"), &out, &args));
        count()
    };
    assert_eq!(by_score("-1"), 16_000);
    let mut scores = NpyFile::open(&out.join("scores.npy")).unwrap().read_f32().unwrap();
    scores.sort_by(f32::total_cmp);
    let some = by_score(&scores[12_000].to_string());
    assert!((3_900..=4_000).contains(&some), "{some}");
    done(&tiny(
        "query",
        &asset("room.ply"),
        &out,
        &["robot arm", "--embedding", vector, "--text", text],
    ));
    // The query's own row among the texts is no rival, and an embedding of another width is refused.
    done(&tiny(
        "query",
        &asset("room.ply"),
        &out,
        &["floor", "--embedding", vector, "--text", text],
    ));
    let wide = folder.path().join("wide.npy");
    scenesplat::scene::formats::npy_writer::write_npy(&wide, &[65], &[0.1f32; 65]).unwrap();
    let wide = wide.to_str().unwrap();
    let output =
        tiny("query", &asset("room.ply"), &out, &["floor", "--embedding", wide, "--text", text]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    // Barred rivals cannot win against the query.
    done(&tiny("query", &asset("room.ply"), &out, &["floor", "--text", text]));
    let all = count();
    done(&tiny(
        "query",
        &asset("room.ply"),
        &out,
        &["floor", "--text", text, "--without", "wall,ceiling,table"],
    ));
    assert!(count() > all, "{} {all}", count());
}

#[test]
fn evaluate_passes_its_oracle_and_refuses_a_broken_one() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("e");
    let text = asset("classes.safetensors");
    let names = folder.path().join("names.txt");
    let all = class_names().join("\n");
    std::fs::write(&names, all).unwrap();
    let base = ["--text", text.to_str().unwrap(), "--label-names", names.to_str().unwrap()];
    for vote in ["0", "25"] {
        let mut args = base.to_vec();
        args.extend(["--vote-k", vote]);
        done(&tiny("evaluate", &asset("room.ply"), &out, &args));
        let json: serde_json::Value =
            serde_json::from_slice(&bytes(&out.join("evaluation.json"))).unwrap();
        let oracle = json["oracle"]["all_acc"].as_f64().unwrap();
        let random = json["random_labels"]["all_acc"].as_f64().unwrap();
        let features = json["all_acc"].as_f64().unwrap();
        if vote == "0" {
            assert_eq!(oracle, 1.0, "without a vote the oracle is perfect");
        }
        assert!(oracle > features && features > random, "oracle > features > random");
        args.extend(["--break-oracle", "100"]);
        let broken = tiny("evaluate", &asset("room.ply"), &folder.path().join("no"), &args);
        assert_eq!(broken.status.code(), Some(1));
        assert!(stderr(&broken).contains("evaluation refused"), "{}", stderr(&broken));
        assert!(!folder.path().join("no/evaluation.json").exists(), "nothing is reported");
    }
}

#[test]
fn evaluate_reads_features_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    done(&tiny("features", &asset("room.ply"), &folder.path().join("f"), &[]));
    let text = asset("classes.safetensors");
    let names = folder.path().join("names.txt");
    std::fs::write(&names, class_names().join("\n")).unwrap();
    let features = folder.path().join("f/features.npy");
    let common = ["--text", text.to_str().unwrap(), "--label-names", names.to_str().unwrap()];
    let value = |more: &[&str]| {
        let out = folder.path().join("e");
        let mut args = common.to_vec();
        args.extend(more);
        done(&tiny("evaluate", &asset("room.ply"), &out, &args));
        let json: serde_json::Value =
            serde_json::from_slice(&bytes(&out.join("evaluation.json"))).unwrap();
        json["miou"].as_f64().unwrap()
    };
    assert_eq!(value(&[]), value(&["--features", features.to_str().unwrap()]));
}

#[test]
fn weights_names_the_network_that_fits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tiny.safetensors");
    let store = scenesplat::models::ParamStore::trainable(3);
    let config = scenesplat::models::PointTransformerV3Config::tiny();
    scenesplat::models::PointTransformerV3::new(&config, store.builder()).unwrap();
    store.save(&path).unwrap();
    let json = folder.path().join("w.json");
    let output = scenesplat(&["weights", path.to_str().unwrap(), "--json", json.to_str().unwrap()]);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("tiny: fits") && said.contains("language: does not fit"), "{said}");
    assert!(said.contains("sha256"));
    let json: serde_json::Value = serde_json::from_slice(&bytes(&json)).unwrap();
    assert_eq!(
        json["networks"].as_array().unwrap().iter().filter(|n| n["fits"] == true).count(),
        1
    );
    // And they work.
    let out = folder.path().join("f");
    let room = asset("room.ply");
    done(&scenesplat(&[
        "features",
        room.to_str().unwrap(),
        "--config",
        "tiny",
        "--weights",
        path.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--quiet",
    ]));
    // A network they do not fit refuses them and says what is missing.
    let output = scenesplat(&[
        "features",
        room.to_str().unwrap(),
        "--config",
        "semseg",
        "--weights",
        path.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("missing") && stderr(&output).contains("do not fit"));
}

#[test]
fn wrong_use_is_exit_code_2() {
    for args in [
        vec!["features"],
        vec!["fly", "x.ply"],
        vec!["features", "x.ply", "--config", "giant"],
        vec!["features", "x.ply", "--max-memory", "lots"],
        vec!["features", "x.ply", "--device", "tpu"],
        vec!["features", "x.ply", "--config", "tiny"],
        vec!["features", "x.ply", "--config", "tiny", "--weights", "embedded"],
        vec!["segment", "x.ply", "--config", "tiny", "--weights", "seeded:0"],
        vec!["query", "x.ply", "qwzxk vbnmp"],
        vec!["query", "x.ply", "volcano"],
        vec!["text"],
        vec!["text", "qwzxk vbnmp", "--out", "t.safetensors"],
        vec!["evaluate", "synthetic:many:1"],
        vec!["segment", "x.ply", "--text", "vocabulary:wide"],
        vec!["query", "x.ply", "chair", "--text", "vocabulary:"],
        vec!["train"],
        vec!["features", "x.ply", "--weights", "seeded:0", "--threads", "0"],
    ] {
        let output = scenesplat(&args);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
    }
    assert_eq!(scenesplat(&["--help"]).status.code(), Some(0));
    assert_eq!(
        scenesplat(&[
            "features",
            "nowhere.ply",
            "--weights",
            "seeded:0",
            "--config",
            "tiny",
            "--out",
            std::env::temp_dir().join("scenesplat-none").to_str().unwrap()
        ])
        .status
        .code(),
        Some(1)
    );
}

#[test]
fn tiles_and_the_exact_mode_agree_with_the_plain_run_where_they_should() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let output = tiny("features", &asset("room.ply"), &out, more);
        done(&output);
        (NpyFile::open(&out.join("features.npy")).unwrap().read_f32().unwrap(), stderr(&output))
    };
    let (plain, _) = run("plain", &[]);
    let (roomy, said) = run("roomy", &["--max-memory", "4GB"]);
    assert_eq!(plain, roomy, "a limit that is not reached changes nothing");
    assert!(said.contains("1 tiles"));
    let (tiled, said) = run("tiled", &["--max-memory", "85MB", "--halo", "24"]);
    assert!(!said.contains(" 1 tiles"), "{said}");
    let cosine: Vec<f32> = plain
        .chunks_exact(64)
        .zip(tiled.chunks_exact(64))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum())
        .collect();
    let mut sorted = cosine;
    sorted.sort_by(f32::total_cmp);
    // Attention patches and curve codes differ in a tile, so features do; unrelated places of this
    // room have cosines around 0.5.
    assert!(sorted[sorted.len() / 2] > 0.97, "median cosine {}", sorted[sorted.len() / 2]);
    let (exact, _) = run("exact", &["--exact"]);
    let agree: f32 = plain
        .chunks_exact(64)
        .zip(exact.chunks_exact(64))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>())
        .sum::<f32>()
        / 16_000.0;
    assert!(agree > 0.95, "mean cosine {agree}");
}

#[test]
fn a_folder_of_arrays_works_like_the_file_it_came_from() {
    use scenesplat::scene::formats::npy_folder::write_npy_folder;
    use scenesplat::scene::{LabelledPoints, ReadOptions, open_scene};
    let folder = tempfile::tempdir().unwrap();
    let mut scene = open_scene(&asset("room.ply"), &ReadOptions::default()).unwrap().scene;
    // Points to score on, as benchmarks have them: every third Gaussian, moved a little.
    let rows: Vec<usize> = (0..scene.len()).step_by(3).collect();
    let segment = scene.segment.clone().unwrap();
    scene.labelled_points = Some(LabelledPoints {
        coord: rows.iter().map(|&r| scene.coord[r].map(|v| v + 0.001)).collect(),
        segment: Some(rows.iter().map(|&r| segment[r]).collect()),
        instance: None,
    });
    let path = folder.path().join("scene");
    write_npy_folder(&scene, &path, false).unwrap();

    let features = |scene: &Path, name: &str| {
        let out = folder.path().join(name);
        done(&tiny("features", scene, &out, &[]));
        NpyFile::open(&out.join("features.npy")).unwrap().read_f32().unwrap()
    };
    let (a, b) = (features(&asset("room.ply"), "a"), features(&path, "b"));
    // Opacities and scales are stored after activation there: equal to a few units in the last place.
    let worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 2e-4, "{worst}");

    let names = folder.path().join("names.txt");
    std::fs::write(&names, class_names().join("\n")).unwrap();
    let text = asset("classes.safetensors");
    let out = folder.path().join("e");
    let args = ["--text", text.to_str().unwrap(), "--label-names", names.to_str().unwrap()];
    let output = tiny("evaluate", &path, &out, &args);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains(&format!("{} scored points", rows.len())), "{said}");
}

#[test]
fn a_segmentation_network_labels_and_is_evaluated_by_its_own_classes() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("seg.toml");
    let classes = class_names();
    let tiny_shape = scenesplat::models::ModelConfig::tiny().with_classes(classes.len());
    std::fs::write(&config, toml::to_string(&tiny_shape).unwrap()).unwrap();
    let names = folder.path().join("names.txt");
    std::fs::write(&names, classes.join("\n")).unwrap();
    let (config, names) = (config.to_str().unwrap(), names.to_str().unwrap());
    let room = asset("room.ply");
    let run = |command: &str, more: &[&str]| {
        let out = folder.path().join(command);
        let mut args = vec![command, room.to_str().unwrap(), "--config", config];
        args.extend(["--weights", "seeded:0", "--out", out.to_str().unwrap()]);
        args.extend(more);
        scenesplat(&args)
    };
    done(&run("segment", &["--text-names", names]));
    let labels =
        NpyFile::open(&folder.path().join("segment/labels.npy")).unwrap().read_i64().unwrap();
    assert!(labels.iter().all(|l| (0..classes.len() as i64).contains(l)));
    let scores =
        NpyFile::open(&folder.path().join("segment/scores.npy")).unwrap().read_f32().unwrap();
    assert!(scores.iter().all(|p| (0.0..=1.0).contains(p)), "scores are probabilities");
    done(&run("segment", &["--text-names", names, "--min-score", "1.1"]));
    let labels =
        NpyFile::open(&folder.path().join("segment/labels.npy")).unwrap().read_i64().unwrap();
    assert!(labels.iter().all(|l| *l == -1));
    done(&run("evaluate", &["--text-names", names, "--label-names", names]));
    let text = asset("classes.safetensors");
    for (command, more) in [
        ("evaluate", vec!["--text", text.to_str().unwrap()]),
        ("segment", vec!["--text", text.to_str().unwrap()]),
        ("query", vec!["--text", text.to_str().unwrap()]),
    ] {
        let mut args = vec![];
        if command == "query" {
            args.push("floor");
        }
        args.extend(more);
        assert_eq!(run(command, &args).status.code(), Some(2), "{command}");
    }
}

#[test]
fn features_of_a_file_stand_in_for_a_network() {
    let folder = tempfile::tempdir().unwrap();
    let [made, by_network, by_file] = ["made", "network", "file"].map(|n| folder.path().join(n));
    let (room, text) = (asset("room.ply"), asset("classes.safetensors"));
    let text = text.to_str().unwrap();
    done(&tiny("features", &room, &made, &[]));
    done(&tiny("segment", &room, &by_network, &["--text", text]));
    let features = made.join("features.npy");
    let [room, out, features] = [&room, &by_file, &features].map(|p| p.to_str().unwrap());
    let args = ["segment", room, "--features", features, "--text", text, "--out", out];
    done(&scenesplat(&args));
    let labels = |out: &Path| NpyFile::open(&out.join("labels.npy")).unwrap().read_i64().unwrap();
    assert_eq!(labels(&by_network), labels(&by_file));
    let args = ["query", room, "floor", "--features", features, "--text", text, "--out", out];
    done(&scenesplat(&args));
    let selected = NpyFile::open(&by_file.join("selection.npy")).unwrap().read_u8().unwrap();
    assert!(selected.contains(&1) && selected.contains(&0));

    // Of another scene, or beside a network: refused.
    let short = folder.path().join("short.npy");
    scenesplat::scene::formats::npy_writer::write_npy(&short, &[3, 64], &[0.1f32; 192]).unwrap();
    let short = short.to_str().unwrap();
    let output = scenesplat(&["segment", room, "--features", short, "--text", text, "--out", out]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("belong to another scene"), "{}", stderr(&output));
    let args = ["segment", room, "--features", features, "--weights", "embedded", "--out", out];
    assert_eq!(scenesplat(&args).status.code(), Some(2));
}
