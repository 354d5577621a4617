//! Networks without a file of settings: released shapes by name and from their weights alone, and model
//! folders of every architecture.

use crate::support::*;
use scenesplat::models::{ModelConfig, ParamStore};
use scenesplat::scene::LabelledPoints;
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use std::io::Write;
use std::path::Path;

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
    let folder = Folder::new();
    let (room, out) = (folder.room("room.ply", 300, 5), folder.at("out"));
    let weights = folder.at("weights.safetensors");
    let run = |words: &str| run!("{words} --weights {weights} --out {out}");
    let segmentation = shapes(&ModelConfig::semseg());
    for (classes, config) in [(20, ""), (200, "--config semseg")] {
        let mut shapes = segmentation.clone();
        for (name, shape) in &mut shapes {
            if name.starts_with("seg_head.") {
                shape[0] = classes;
            }
        }
        checkpoint(&shapes, Path::new(&weights));
        let list: Vec<String> = (0..classes).map(|i| format!("class {i}")).collect();
        let names = folder.write("names.txt", list.join("\n"));
        done(&run(&format!("segment {room} --text-names {names} {config}")));
        // Zeros say each class alike: that many classes there are.
        let scores = floats(folder.path("out/scores.npy"));
        let even = 1.0 / classes as f32;
        assert!(scores.iter().all(|s| (s - even).abs() < 1e-6), "{classes}: {}", scores[0]);
    }
    checkpoint(&shapes(&ModelConfig::ssl()), Path::new(&weights));
    done(&run(&format!("features {room}")));
    assert_eq!(npy(folder.path("out/features.npy")).shape(), [300, 64]);
    has(&printed(&run!("weights {weights} --config ssl")), &["ssl: fits"]);
    // A name that they do not belong to is refused.
    refused(&run(&format!("features {room} --config language")), 1, &[]);
}

const POINTS_1: &str = r#"architecture = "point_transformer_v1"
grid_size = 0.15
num_classes = 41
stride = [1, 2]
enc_depths = [1, 1]
channels = [16, 32]
neighbors = [6, 8]
dec_depths = [1, 1]
"#;

const POINTS_2: &str = r#"architecture = "point_transformer_v2"
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
    let folder = Folder::new();
    let (scene, names, json_file) =
        (folder.room("room.ply", 1200, 5), folder.names(), folder.at("seen.json"));
    let truth = room(1200, 5).segment.unwrap();
    for (name, model) in [("v1", POINTS_1), ("v2", POINTS_2)] {
        let experiment = segmentation(model).replace("epochs = 2", "epochs = 1");
        let weights = train(&folder, name, &experiment);
        done(&run!("inspect {scene} --weights {weights} --no-sheet --json {json_file}"));
        let cost = &json(&json_file)["estimate"]["bytes"];
        assert!(cost.as_f64().is_some_and(|b| b > 0.0), "{cost}");
        let with = format!("--weights {weights} --text-names {names} --out {}", folder.at("out"));
        done(&run!("segment {scene} {with}"));
        let found = labels(folder.path("out/labels.npy"));
        assert!(found.len() == 1200 && found.iter().all(|l| (0..41).contains(l)));
        // The same network names the same rows when it is scored.
        done(&run!("evaluate {scene} {with} --label-names {names} --vote-k 25"));
        let figures = json(folder.path("out/evaluation.json"));
        let pairs = found.iter().zip(&truth).filter(|(_, t)| **t >= 0);
        let all = pairs.clone().count();
        let right = pairs.filter(|(l, t)| **l == i64::from(**t)).count();
        let (got, due) = (figures["all_acc"].as_f64().unwrap(), right as f64 / all as f64);
        assert!((got - due).abs() < 1e-6, "{name}: {got}, by hand {due}");
    }
}

#[test]
fn scenes_with_labelled_points_only_are_evaluated() {
    let folder = Folder::new();
    let mut scene = room(6000, 4);
    let labels = scene.segment.take().unwrap();
    scene.instance = None;
    // Beside every second Gaussian.
    let coord = scene.coord.iter().step_by(2).map(|c| [c[0] + 0.001, c[1], c[2]]).collect();
    let segment = Some(labels.iter().step_by(2).copied().collect());
    scene.labelled_points = Some(LabelledPoints { coord, segment, instance: None });
    write_npy_folder(&scene, &folder.path("scene"), false).unwrap();
    assert!(!folder.path("scene/segment.npy").exists());
    assert!(folder.path("scene/pc_segment.npy").exists());
    let (names, out) = (folder.names(), folder.at("out"));
    let evaluate = |more: &str| {
        let said = printed(&run!(
            "evaluate {} --label-names {names} --out {out} {more}",
            folder.at("scene")
        ));
        has(&said, &["3000 scored points"]);
        let figures = json(folder.path("out/evaluation.json"));
        let value = |row: &serde_json::Value| row["all_acc"].as_f64().unwrap();
        [&figures, &figures["random_labels"], &figures["oracle"]].map(value)
    };
    let [found, random, oracle] = evaluate("");
    assert!(found > 5.0 * random && oracle > found, "{found} {random} {oracle}");
    // With each point's own Gaussian alone, the truth loses nothing.
    let [.., oracle] = evaluate("--features oracle --vote-k 1");
    assert!(oracle > 0.99, "{oracle}");
}
