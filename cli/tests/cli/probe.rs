//! `scenesplat probe` on what self-supervised training leaves behind.

use crate::{done, scenesplat, stderr};
use serde_json::Value;
use std::path::Path;

pub const EXPERIMENT: &str = r#"
task = "self_supervised"
[model]
grid_size = 0.25
stride = [2]
enc_depths = [1, 1]
enc_channels = [8, 16]
enc_num_head = [1, 2]
enc_patch_size = [32, 32]
dec_depths = [1]
dec_channels = [8]
dec_num_head = [1]
dec_patch_size = [32]
mask_token = true
[[train]]
source = { type = "synthetic", count = 4, seed = 1, room = { num_gaussians = 800 } }
transforms = [{ type = "center_shift" }, { type = "views", groups = [
    { kind = "global", views = [[{ type = "random_flip" }, { type = "grid_sample", grid_size = 0.25 }]] },
    { kind = "local", crop = { ratio = [0.3, 0.5], point_max = 800 }, views = [[{ type = "grid_sample", grid_size = 0.25 }]] },
] }]
[loader]
workers = 0
mix_probability = 0.0
[self_supervised]
masking = { shape = { patches = 0.6 }, ratio = [0.3, 0.3], scenes = 1.0, weight = "per_gaussian" }
EXPORT
[[self_supervised.terms]]
type = "masked_gaussians"
[[self_supervised.terms]]
type = "sim_dino"
hidden = 16
out = 8
[optimizer]
groups = []
"#;

/// Trains two steps, and gives the model folder.
fn trained(folder: &Path, name: &str, export: &str) -> String {
    run(folder, name, &EXPERIMENT.replace("EXPORT", export))
}

/// Trains, and gives the model folder.
pub fn run(folder: &Path, name: &str, experiment: &str) -> String {
    let file = folder.join(format!("{name}.toml"));
    std::fs::write(&file, experiment).unwrap();
    let out = folder.join(name);
    let args = ["train", file.to_str().unwrap(), "--out", out.to_str().unwrap(), "--quiet"];
    done(&scenesplat(&args));
    out.join("model").to_str().unwrap().to_owned()
}

fn files(folder: &str) -> Vec<(String, Vec<u8>)> {
    let mut all: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.display().to_string(), std::fs::read(&path).unwrap()))
        .collect();
    all.sort();
    all
}

fn report(model: &str, json: &Path, more: &[&str]) -> Value {
    let mut args = vec!["probe", model, "synthetic:4:7", "--steps", "40", "--quiet", "--json"];
    args.push(json.to_str().unwrap());
    args.extend(more);
    done(&scenesplat(&args));
    serde_json::from_str(&std::fs::read_to_string(json).unwrap()).unwrap()
}

#[test]
fn probes_leave_the_network_as_it_is_and_stand_beside_two_others() {
    let folder = tempfile::tempdir().unwrap();
    let model = trained(folder.path(), "student", "");
    let before = files(&model);
    let json = folder.path().join("probe.json");
    let linear = report(&model, &json, &["--kind", "linear"]);
    assert_eq!(linear["train_scenes"].as_array().unwrap().len(), 3);
    assert_eq!(linear["test_scenes"].as_array().unwrap().len(), 1);
    for rows in ["backbone", "random", "raw_inputs"] {
        let miou = linear[rows]["miou"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&miou), "{rows}: {miou}");
        assert!(linear[rows]["objects"]["test_objects"].as_u64().unwrap() > 0, "{rows}");
    }
    // All scales side by side, and color, opacity, quat, scale with the height.
    assert_eq!(linear["backbone"]["width"], 24);
    assert_eq!(linear["raw_inputs"]["width"], 12);
    assert_ne!(linear["backbone"]["miou"], linear["random"]["miou"]);
    let again = report(&model, &json, &["--kind", "linear", "--threads", "1"]);
    assert_eq!(linear["backbone"]["class_iou"], again["backbone"]["class_iou"]);
    let mlp = report(&model, &json, &["--kind", "mlp3", "--labels", "20", "--no-objects"]);
    assert_eq!(mlp["learned_rows"], 60);
    assert!(mlp["backbone"]["objects"].is_null());
    let decoder = report(&model, &json, &["--kind", "decoder", "--labels", "10%"]);
    assert!(decoder["backbone"]["miou"].as_f64().unwrap() > 0.0);
    assert_eq!(files(&model), before, "the model is what it was, bit for bit");
}

#[test]
fn models_of_self_supervised_training_are_models_like_others() {
    let folder = tempfile::tempdir().unwrap();
    let student = trained(folder.path(), "student", "");
    let teacher = trained(folder.path(), "teacher", "export = \"teacher\"");
    // The same run, the other network of it.
    assert_ne!(files(&student)[1].1, files(&teacher)[1].1);
    let out = folder.path().join("features");
    let rooms = folder.path().join("room.ply");
    let scene =
        scenesplat::rooms::generate(&scenesplat::rooms::SyntheticRoomSettings::with_count(900, 3));
    scenesplat::scene::formats::inria_ply::write_inria_ply(&scene.unwrap().scene, &[], &rooms)
        .unwrap();
    for model in [&student, &teacher] {
        let args = [
            "features",
            rooms.to_str().unwrap(),
            "--weights",
            model,
            "--out",
            out.to_str().unwrap(),
            "--quiet",
        ];
        done(&scenesplat(&args));
        std::fs::remove_dir_all(&out).unwrap();
    }
    // As the first values of a segmentation.
    let text = EXPERIMENT.replace("EXPORT", "");
    let model = &text[text.find("[model]").unwrap()..text.find("[[train]]").unwrap()];
    let file = folder.path().join("fine.toml");
    let fine = format!(
        "task = \"semantic_segmentation\"\ninit_from = '{student}'\n{model}num_classes = 41\n\
         [[train]]\nsource = {{ type = \"synthetic\", count = 2, seed = 1, room = {{ num_gaussians = 500 }} }}\n\
         transforms = \"validation\"\n[loader]\nworkers = 0\nmix_probability = 0.0\n\
         [[losses]]\ntype = \"cross_entropy\"\n[optimizer]\ngroups = []\n[trainer]\nidle = [\"mask_token\"]\n"
    );
    std::fs::write(&file, fine).unwrap();
    let run = folder.path().join("fine");
    let args = ["train", file.to_str().unwrap(), "--out", run.to_str().unwrap()];
    let output = scenesplat(&args);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("entries matched") && said.contains("seg_head"), "{said}");
}

#[test]
fn what_cannot_be_probed_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let model = trained(folder.path(), "student", "");
    let refused = |args: &[&str], part: &str| {
        let output = scenesplat(args);
        assert!(!output.status.success(), "{args:?}");
        assert!(stderr(&output).contains(part), "{args:?}: {}", stderr(&output));
    };
    refused(&["probe", &model, "synthetic:1:1", "--quiet"], "two or more");
    refused(&["probe", &model, "synthetic:x", "--quiet"], "synthetic:COUNT:SEED");
    refused(&["probe", &model, "synthetic:3:1", "--test", "3", "--quiet"], "fewer than");
    refused(&["probe", &model, "synthetic:3:1", "--labels", "some"], "10%");
    refused(&["probe", &model, "synthetic:3:1", "--labels", "0%", "--quiet"], "labels");
    refused(&["probe", "nowhere", "synthetic:3:1", "--quiet"], "nowhere");
    let both = ["probe", &model, "synthetic:2:1", "synthetic:2:1", "--quiet"];
    refused(&both, "twice");
}
