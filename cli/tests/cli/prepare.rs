//! `prepare`: a scan and its scene become what training reads; what does not fit is refused.

use crate::{done, scenesplat, stderr};
use half::f16;
use scenesplat::scene::GaussianScene;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_writer::write_npy;
use std::path::Path;
use std::process::Output;
use tempfile::TempDir;

/// Four Gaussians near a scan of ScanNet's layout, one far from it.
fn world() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let coord =
        vec![[0.02, 0.0, 0.0], [1.0, 0.01, 0.0], [1.0, 1.0, 0.1], [0.5, 0.5, 0.2], [9.0, 9.0, 9.0]];
    let scene = GaussianScene {
        log_scale: vec![[-3.0; 3]; 5],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 5],
        opacity_logit: vec![1.0; 5],
        sh_dc: vec![[0.2; 3]; 5],
        coord,
        ..GaussianScene::default()
    };
    write_inria_ply(&scene, &[], &at("splat.ply")).unwrap();
    std::fs::create_dir(at("scene0001_00")).unwrap();
    let mesh = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n\
                3 0 1 2\n3 0 2 3\n";
    let file = |name: &str, text: &str| std::fs::write(at(name), text).unwrap();
    file("scene0001_00/scene0001_00_vh_clean_2.ply", mesh);
    file(
        "scene0001_00/scene0001_00_vh_clean_2.0.010000.segs.json",
        r#"{"segIndices": [1, 1, 2, 2]}"#,
    );
    file(
        "scene0001_00/scene0001_00.aggregation.json",
        r#"{"segGroups": [{"id": 0, "objectId": 0, "segments": [1], "label": "chair"},
                          {"id": 1, "objectId": 1, "segments": [2], "label": "thing"}]}"#,
    );
    file("labels.tsv", "id\traw_category\tnyu40id\n2\tchair\t5\n1\twall\t1\n");
    file("train.txt", "scene0009_00\n");
    file("val.txt", "scene0001_00\n");
    let rows: Vec<f16> = (0..10).map(|i| f16::from_f32(if i < 4 { 1.0 } else { 0.0 })).collect();
    write_npy(&at("lang_feat.npy"), &[5, 2], &rows).unwrap();
    dir
}

fn prepare(dir: &Path, more: &[&str]) -> Output {
    let at = |name: &str| dir.join(name).to_str().unwrap().to_owned();
    let (scene, scan, out, table) =
        (at("splat.ply"), at("scene0001_00"), at("out"), at("labels.tsv"));
    let mut words = vec!["prepare", "scan", &scene, "--scan", &scan, "--out", &out];
    if !more.contains(&"--layout") {
        words.extend(["--layout", "scannet", "--label-table", &table]);
    }
    words.extend(more);
    scenesplat(&words)
}

#[test]
fn a_scan_becomes_a_folder_and_its_points_go_to_chunks() {
    let dir = world();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let lists = format!("train={},val={}", at("train.txt"), at("val.txt"));
    let features = at("lang_feat.npy");
    let output = prepare(dir.path(), &["--splits", &lists, "--lang-feat", &features]);
    done(&output);
    let said = stderr(&output);
    for part in ["4 of 5 Gaussians are inside", "segment20: 2 Gaussians", "thing (2)"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let folder = dir.path().join("out/val/scene0001_00");
    let ints = |name: &str| NpyFile::open(&folder.join(name)).unwrap().read_i64().unwrap();
    // The fourth is 0.73 m from any vertex.
    assert_eq!(ints("segment20.npy"), [4, 4, -1, -1]);
    assert_eq!(ints("segment200.npy"), [1, 1, -1, -1]);
    assert_eq!(ints("instance.npy"), [0, 0, 1, -1]);
    // The receipt counts what was written.
    let receipt = std::fs::read_to_string(dir.path().join("out/receipt.json")).unwrap();
    let receipt: serde_json::Value = serde_json::from_str(&receipt).unwrap();
    let files = std::fs::read_dir(&folder).unwrap().map(|f| f.unwrap().metadata().unwrap());
    let bytes: u64 = files.filter(|m| m.is_file()).map(|m| m.len()).sum();
    assert_eq!(receipt["bytes_written"].as_u64(), Some(bytes));
    assert!(receipt["written"].to_string().contains("segment200.npy"), "{}", receipt["written"]);
    assert_eq!(ints("pc_segment20.npy"), [4, 4, -1, -1]);
    assert_eq!(ints("valid_feat_mask.npy"), [1, 1, 0, 0]);
    assert_eq!(NpyFile::open(&folder.join("lang_feat.npy")).unwrap().shape(), [4, 2]);
    assert_eq!(
        NpyFile::open(&folder.join("normal.npy")).unwrap().read_f32().unwrap()[..3],
        [0.0, 0.0, 1.0]
    );
    // The program itself reads it.
    done(&scenesplat(&[
        "inspect",
        folder.to_str().unwrap(),
        "--out",
        &at("look"),
        "--segment-name",
        "segment20",
    ]));

    // A chunk with the first Gaussian, and one of a scene that is not there.
    let chunks = dir.path().join("val_chunk");
    for (name, mask) in [("scene0001_00_0", 1i64), ("scene0001_00_1", 0)] {
        std::fs::create_dir_all(chunks.join(name)).unwrap();
        write_npy(&chunks.join(name).join("coord.npy"), &[1, 3], &[0.02f32, 0.0, 0.0]).unwrap();
        write_npy(&chunks.join(name).join("valid_feat_mask.npy"), &[1], &[mask]).unwrap();
    }
    let (scenes, cut) = (at("out/val"), at("val_chunk"));
    let words = ["prepare", "chunks", &scenes, &cut, "--filtered", "0.5"];
    let output = scenesplat(&words);
    done(&output);
    assert!(stderr(&output).contains("2 of 2 chunks have labelled points"), "{}", stderr(&output));
    let points = NpyFile::open(&chunks.join("scene0001_00_0/pc_segment20.npy")).unwrap();
    assert_eq!(points.read_i64().unwrap(), [4]);
    let filtered = dir.path().join("val_chunk_filtered");
    assert!(filtered.join("scene0001_00_0/pc_coord.npy").is_file());
    assert!(!filtered.join("scene0001_00_1").exists());
}

#[test]
fn limits_are_choices_and_what_does_not_fit_is_refused() {
    let dir = world();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    done(&prepare(dir.path(), &["--max-distance", "0", "--keep-all"]));
    let folder = dir.path().join("out/scene0001_00");
    let ints = |name: &str| NpyFile::open(&folder.join(name)).unwrap().read_i64().unwrap();
    // Of equally near points the first; far ones take a label too.
    assert_eq!(ints("instance.npy"), [0, 0, 1, 0, 1]);
    let features = at("lang_feat.npy");
    let output = prepare(dir.path(), &["--lang-feat", &features, "--min-valid", "0.9"]);
    done(&output);
    assert!(stderr(&output).contains("left out") && !folder.join("lang_feat.npy").exists());

    let refused = |more: &[&str], code: i32, parts: &[&str]| {
        let output = prepare(dir.path(), more);
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{text}");
        assert!(parts.iter().all(|part| text.contains(part)), "{parts:?}: {text}");
    };
    refused(&["--layout", "hypersim"], 1, &["metadata_scene.csv"]);
    refused(&["--layout", "nuscenes"], 2, &["no layout", "scannetpp"]);
    refused(&["--layout", "replica"], 1, &["replica", "names of classes"]);
    refused(&["--layout", "scannet"], 1, &["scannetv2-labels.combined.tsv"]);
    refused(&["--max-distance", "nan"], 2, &["--max-distance"]);
    refused(&["--splits", "train"], 2, &["train=scannetv2_train.txt"]);
    refused(&["--name", "../x"], 2, &["--name"]);
    write_npy(Path::new(&features), &[4, 2], &[f16::ONE; 8]).unwrap();
    refused(&["--lang-feat", &features], 1, &["lang_feat.npy", "has 4 rows", "the scene 5 rows"]);
    let nan = [f16::NAN; 10];
    write_npy(Path::new(&features), &[5, 2], &nan).unwrap();
    refused(&["--lang-feat", &features], 1, &["row 0, column 0", "NaN"]);
    let segments = dir.path().join("scene0001_00/scene0001_00_vh_clean_2.0.010000.segs.json");
    std::fs::write(segments, r#"{"segIndices": [1]}"#).unwrap();
    refused(&[], 1, &["segs.json", "of 1 vertices", "has 4"]);
}

#[test]
fn features_of_the_lifting_program_are_a_pair() {
    let dir = world();
    // As `torch.save((features, step), …)` writes it: five rows of two, and a number.
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/tests/data/tuple.pth");
    done(&prepare(dir.path(), &["--lang-feat", path]));
    let folder = dir.path().join("out/scene0001_00");
    let rows = NpyFile::open(&folder.join("lang_feat.npy")).unwrap().read_f32().unwrap();
    assert_eq!(rows, [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
}
