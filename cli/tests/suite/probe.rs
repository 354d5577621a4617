//! `scenesplat probe` on what self-supervised training leaves behind.

use crate::support::*;
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use serde_json::Value;
use std::path::Path;

fn files(folder: &str) -> Vec<(String, Vec<u8>)> {
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut all: Vec<_> = paths.map(|path| (path.display().to_string(), bytes(&path))).collect();
    all.sort();
    all
}

#[test]
fn probes_leave_the_network_as_it_is_and_stand_beside_two_others() {
    let (folder, model) = (Folder::new(), student().at("student/model"));
    let before = files(&model);
    // Folders of arrays have instances, too.
    let scenes: Vec<String> = (0..4)
        .map(|seed| {
            let scene = folder.at(&format!("room{seed}"));
            write_npy_folder(&room(2500, seed), Path::new(&scene), false).unwrap();
            scene
        })
        .collect();
    let scenes = scenes.join(" ");
    let report = |more: &str| -> Value {
        let file = folder.at("probe.json");
        done(&run!("probe {model} {scenes} --steps 40 --quiet --json {file} {more}"));
        json(file)
    };
    let linear = report("--kind linear");
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
    let again = report("--kind linear --threads 1");
    assert_eq!(linear["backbone"]["class_iou"], again["backbone"]["class_iou"]);
    let mlp = report("--kind mlp3 --labels 20 --no-objects");
    assert_eq!(mlp["learned_rows"], 60);
    assert!(mlp["backbone"]["objects"].is_null());
    let decoder = report("--kind decoder --labels 10%");
    assert!(decoder["backbone"]["miou"].as_f64().unwrap() > 0.0);
    // Rooms that are made for it.
    let (file, few) = (folder.at("made.json"), "--kind linear --steps 2 --no-objects --quiet");
    done(&run!("probe {model} synthetic:2:7 {few} --json {file}"));
    let made = json(file);
    assert_eq!(made["test_scenes"].as_array().unwrap().len(), 1);
    assert!(made["backbone"]["miou"].as_f64().is_some_and(f64::is_finite), "{made}");
    assert_eq!(files(&model), before, "the model is what it was, bit for bit");
}

#[test]
fn a_class_that_only_the_scored_scene_has_counts_as_missed() {
    let (folder, model) = (Folder::new(), student().at("student/model"));
    // Two halves of a room are two classes; of the scored one a fifth is a third.
    let scene = |name: &str, third: i32| {
        let mut scene = room(3000, 4);
        let class = |row: usize| if row.is_multiple_of(5) { third } else { i32::from(row > 1500) };
        scene.segment = Some((0..scene.len()).map(class).collect());
        let path = folder.at(name);
        write_npy_folder(&scene, Path::new(&path), false).unwrap();
        path
    };
    let (train, test) = (scene("a", 0), scene("b", 2));
    let file = folder.at("probe.json");
    done(&run!(
        "probe {model} {train} {test} --kind linear --steps 2 --no-objects --quiet --json {file}"
    ));
    let report = json(file);
    let miou = report["backbone"]["miou"].as_f64().unwrap();
    assert!((0.0..=2.0 / 3.0).contains(&miou), "one of three classes cannot be right: {miou}");
}

#[test]
fn models_of_self_supervised_training_are_models_like_others() {
    let (folder, student) = (Folder::new(), student().at("student/model"));
    let network = masked_network().to_string();
    let experiment = self_supervised(&network, "export = \"teacher\"", TERMS);
    let teacher = train(&folder, "teacher", &experiment);
    // The same run, the other network of it.
    assert_ne!(files(&student)[1].1, files(&teacher)[1].1);
    let room = folder.room("room.ply", 900, 3);
    for (model, out) in [(&student, "a"), (&teacher, "b")] {
        done(&run!("features {room} --weights {model} --out {} --quiet", folder.at(out)));
    }
    // As the first values of a segmentation.
    let fine = format!(
        "task = \"semantic_segmentation\"\ninit_from = '{student}'\n[model]\n{network}num_classes = 41\n\
         [[train]]\nsource = {{ type = \"synthetic\", count = 2, seed = 1, room = {{ num_gaussians = 500 }} }}\n\
         transforms = \"validation\"\n[loader]\nworkers = 0\nmix_probability = 0.0\n\
         [[losses]]\ntype = \"cross_entropy\"\n[optimizer]\ngroups = []\n[trainer]\nidle = [\"mask_token\"]\n"
    );
    let fine = folder.write("fine.toml", fine);
    let said = printed(&run!("train {fine} --out {}", folder.at("fine")));
    has(&said, &["entries matched", "seg_head"]);
}

#[test]
fn what_cannot_be_probed_is_said() {
    let model = student().at("student/model");
    for (words, part) in [
        (format!("{model} synthetic:1:1"), "two or more"),
        (format!("{model} synthetic:x"), "synthetic:COUNT:SEED"),
        (format!("{model} synthetic:3:1 --test 3"), "fewer than"),
        (format!("{model} synthetic:3:1 --labels some"), "10%"),
        (format!("{model} synthetic:3:1 --labels 0%"), "labels"),
        ("nowhere synthetic:3:1".to_owned(), "nowhere"),
        (format!("{model} synthetic:2:1 synthetic:2:1"), "twice"),
    ] {
        let output = run!("probe {words} --quiet");
        assert!(!output.status.success(), "{words}");
        has(&stderr(&output), &[part]);
    }
}
