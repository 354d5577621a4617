//! Networks without a file of settings: released shapes by name and from their weights alone, and model
//! folders of every architecture.

use crate::training::EXPERIMENT;
use crate::{class_names, done, scenesplat, stderr};
use scenesplat::models::{ModelConfig, ParamStore};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::LabelledPoints;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A room of so many Gaussians, with normals.
fn room(folder: &Path, gaussians: usize) -> PathBuf {
    let scene = generate(&SyntheticRoomSettings::with_count(gaussians, 5)).unwrap().scene;
    let path = folder.join("room.ply");
    write_inria_ply(&scene, &[], &path).unwrap();
    path
}

/// A checkpoint of these shapes, all zeros, which take no room on the disk.
fn checkpoint(shapes: &[(String, Vec<usize>)], path: &Path) {
    let mut header = serde_json::Map::new();
    let mut end = 0;
    for (name, shape) in shapes {
        let start = end;
        end += 4 * shape.iter().product::<usize>();
        let entry =
            serde_json::json!({ "dtype": "F32", "shape": shape, "data_offsets": [start, end] });
        header.insert(name.clone(), entry);
    }
    let mut header = serde_json::to_vec(&header).unwrap();
    header.resize(header.len().next_multiple_of(8), b' ');
    let mut file = std::fs::File::create(path).unwrap();
    file.write_all(&(header.len() as u64).to_le_bytes()).unwrap();
    file.write_all(&header).unwrap();
    file.set_len((8 + header.len() + end) as u64).unwrap();
}

fn shapes(model: &ModelConfig) -> Vec<(String, Vec<usize>)> {
    let store = ParamStore::trainable(0);
    model.build(store.builder()).unwrap();
    store.shapes().into_iter().collect()
}

#[test]
fn released_networks_are_known_by_their_weights_and_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path(), 300);
    let room = room.to_str().unwrap();
    let (file, out) = (folder.path().join("weights.safetensors"), folder.path().join("out"));
    let (weights, out_arg) = (file.to_str().unwrap(), out.to_str().unwrap());
    let run = |args: &[&str]| {
        let args = [args, &["--weights", weights, "--out", out_arg]].concat();
        let output = scenesplat(&args);
        done(&output);
    };
    let segmentation = shapes(&ModelConfig::semseg());
    for (classes, name) in [(20, None), (100, Some("semseg")), (200, None)] {
        let mut shapes = segmentation.clone();
        for (name, shape) in &mut shapes {
            if name.starts_with("seg_head.") {
                shape[0] = classes;
            }
        }
        checkpoint(&shapes, &file);
        let names = folder.path().join("names.txt");
        let list: Vec<String> = (0..classes).map(|i| format!("class {i}")).collect();
        std::fs::write(&names, list.join("\n")).unwrap();
        let mut args = vec!["segment", room, "--text-names", names.to_str().unwrap()];
        args.extend(name.iter().flat_map(|name| ["--config", name]));
        run(&args);
        // Zeros say each class alike: that many classes there are.
        let scores = NpyFile::open(&out.join("scores.npy")).unwrap().read_f32().unwrap();
        let even = 1.0 / classes as f32;
        assert!(scores.iter().all(|s| (s - even).abs() < 1e-6), "{classes}: {}", scores[0]);
    }
    checkpoint(&shapes(&ModelConfig::ssl()), &file);
    for name in [None, Some("ssl")] {
        let mut args = vec!["features", room];
        args.extend(name.iter().flat_map(|name| ["--config", name]));
        run(&args);
        let features = NpyFile::open(&out.join("features.npy")).unwrap();
        assert_eq!(features.shape(), [300, 64], "{name:?}");
    }
    // A name that they do not belong to is refused.
    let args = ["features", room, "--config", "language", "--weights", weights, "--out", out_arg];
    assert_eq!(scenesplat(&args).status.code(), Some(1));
}

const POINTS_1: &str = r#"[model]
architecture = "point_transformer_v1"
grid_size = 0.15
num_classes = 41
stride = [1, 2]
enc_depths = [1, 1]
channels = [16, 32]
neighbors = [6, 8]
dec_depths = [1, 1]
"#;

const POINTS_2: &str = r#"[model]
architecture = "point_transformer_v2"
grid_size = 0.15
num_classes = 41
patch_embed_channels = 12
patch_embed_groups = 3
stride = [2]
enc_depths = [1]
enc_channels = [24]
enc_groups = [6]
enc_neighbors = [8]
dec_depths = [1]
dec_channels = [12]
dec_groups = [3]
dec_neighbors = [8]
"#;

#[test]
fn networks_of_points_go_through_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path(), 1200);
    let names = folder.path().join("names.txt");
    std::fs::write(&names, class_names().join("\n")).unwrap();
    let [room, names] = [&room, &names].map(|p| p.to_str().unwrap());
    for (name, model) in [("point_transformer_v1", POINTS_1), ("point_transformer_v2", POINTS_2)] {
        let (from, to) =
            (EXPERIMENT.find("[model]").unwrap(), EXPERIMENT.find("[[train]]").unwrap());
        let text = format!("{}{model}{}", &EXPERIMENT[..from], &EXPERIMENT[to..]);
        let config = folder.path().join("experiment.toml");
        std::fs::write(&config, text.replace("epochs = 2", "epochs = 1")).unwrap();
        let at = |place: &str| folder.path().join(format!("{name}-{place}"));
        let path = |place: &str| at(place).to_str().unwrap().to_owned();
        done(&scenesplat(&["train", config.to_str().unwrap(), "--out", &path("run")]));
        let weights = path("run/model");
        let json = path("seen.json");
        done(&scenesplat(&["inspect", room, "--weights", &weights, "--no-sheet", "--json", &json]));
        let seen: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        assert!(
            seen["estimate"]["bytes"].as_f64().is_some_and(|b| b > 0.0),
            "{}",
            seen["estimate"]
        );
        let out = path("labels");
        let with = ["--weights", &weights, "--text-names", names, "--out", &out];
        done(&scenesplat(&[&["segment", room][..], &with].concat()));
        let labels = NpyFile::open(&at("labels/labels.npy")).unwrap().read_i64().unwrap();
        assert!(labels.len() == 1200 && labels.iter().all(|l| (0..41).contains(l)));
        // The same network names the same rows when it is scored.
        let more = ["--label-names", names, "--vote-k", "25"];
        let output = scenesplat(&[&["evaluate", room][..], &with, &more].concat());
        done(&output);
        let figures: serde_json::Value =
            serde_json::from_slice(&std::fs::read(at("labels/evaluation.json")).unwrap()).unwrap();
        let truth = generate(&SyntheticRoomSettings::with_count(1200, 5)).unwrap().scene.segment;
        let pairs = labels.iter().zip(truth.as_ref().unwrap()).filter(|(_, t)| **t >= 0);
        let (mut right, mut all) = (0, 0);
        pairs.for_each(|(l, t)| {
            all += 1;
            right += usize::from(*l == i64::from(*t));
        });
        let due = right as f64 / all as f64;
        let got = figures["all_acc"].as_f64().unwrap();
        assert!((got - due).abs() < 1e-6, "{name}: {got}, by hand {due}; {}", stderr(&output));
    }
}

#[test]
fn scenes_with_labelled_points_only_are_evaluated() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = generate(&SyntheticRoomSettings::with_count(6000, 4)).unwrap().scene;
    let labels = scene.segment.take().unwrap();
    scene.instance = None;
    // Beside every second Gaussian.
    let coord = scene.coord.iter().step_by(2).map(|c| [c[0] + 0.001, c[1], c[2]]).collect();
    let segment = Some(labels.iter().step_by(2).copied().collect());
    scene.labelled_points = Some(LabelledPoints { coord, segment, instance: None });
    let path = folder.path().join("scene");
    write_npy_folder(&scene, &path, false).unwrap();
    assert!(!path.join("segment.npy").exists() && path.join("pc_segment.npy").exists());
    let names = folder.path().join("names.txt");
    std::fs::write(&names, class_names().join("\n")).unwrap();
    let out = folder.path().join("out");
    let [scene, names, out_arg] = [&path, &names, &out].map(|p| p.to_str().unwrap());
    let output = scenesplat(&["evaluate", scene, "--label-names", names, "--out", out_arg]);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("3000 scored points"), "{said}");
    let figures: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("evaluation.json")).unwrap()).unwrap();
    let value = |row: &serde_json::Value| row["all_acc"].as_f64().unwrap();
    assert!(value(&figures) > 5.0 * value(&figures["random_labels"]), "{figures}");
    assert!(value(&figures["oracle"]) > value(&figures), "{figures}");
    // With each point's own Gaussian alone, the truth loses nothing.
    done(&scenesplat(&[
        "evaluate",
        scene,
        "--label-names",
        names,
        "--features",
        "oracle",
        "--vote-k",
        "1",
        "--out",
        out_arg,
    ]));
    let figures: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("evaluation.json")).unwrap()).unwrap();
    assert!(value(&figures["oracle"]) > 0.99, "{figures}");
}
