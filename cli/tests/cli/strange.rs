//! Scenes that look like nothing that the network inside the program was trained on.

use crate::{done, scenesplat, stderr, tiny};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::GaussianScene;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use std::path::Path;

fn room() -> GaussianScene {
    let settings =
        SyntheticRoomSettings { seed: 779, num_gaussians: Some(40_000), ..Default::default() };
    let scene = generate(&settings).unwrap().scene;
    GaussianScene { segment: None, instance: None, normal: None, ..scene }
}

/// The same Gaussians on spirals in a ball: neither floor nor walls nor things.
fn heap() -> GaussianScene {
    let mut scene = room();
    for (i, p) in scene.coord.iter_mut().enumerate() {
        let t = i as f32;
        let (around, radius) = (2.399_963 * t, (t / 40_000.0).cbrt());
        let z = (0.754_877 * t).fract() * 2.0 - 1.0;
        let flat = (1.0 - z * z).sqrt();
        *p = [radius * flat * around.cos(), radius * flat * around.sin(), radius * z];
    }
    scene
}

fn strangeness(out: &Path) -> (f64, usize) {
    let text = std::fs::read_to_string(out.join("receipt.json")).unwrap();
    let receipt: serde_json::Value = serde_json::from_str(&text).unwrap();
    let warned = receipt["warnings"].as_array().map_or(0, |all| {
        all.iter().filter(|w| w.to_string().contains("looks like nothing")).count()
    });
    let all = receipt["settings"].as_array().unwrap();
    let found = &all.iter().find(|s| s["name"] == "strangeness").unwrap()["value"];
    let found = found.as_str().map_or_else(|| found.as_f64(), |s| s.parse().ok());
    (found.unwrap_or_else(|| panic!("{receipt:#}")), warned)
}

fn labels(out: &Path) -> Vec<i64> {
    NpyFile::open(&out.join("labels.npy")).unwrap().read_i64().unwrap()
}

#[test]
fn a_strange_scene_is_said_to_be_one_and_stays_unknown_if_asked() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    write_inria_ply(&room(), &[], &path("room.ply")).unwrap();
    write_inria_ply(&heap(), &[], &path("heap.ply")).unwrap();
    let run = |scene: &str, out: &str, more: &[&str]| {
        let (scene, out) = (path(scene), path(out));
        let mut args = vec!["segment", scene.to_str().unwrap(), "--out", out.to_str().unwrap()];
        args.extend(more);
        let output = scenesplat(&args);
        done(&output);
        let (found, warned) = strangeness(&out);
        (found, warned, labels(&out), stderr(&output))
    };
    let unknown = ["--strange", "unknown"];
    let (usual, warned, found, said) = run("room.ply", "room", &unknown);
    assert!(warned == 0 && !said.contains("looks like nothing"), "{said}");
    let labelled = found.iter().filter(|l| **l >= 0).count();
    assert!(labelled > 35_000, "{labelled} of a room");

    let (strange, warned, found, said) = run("heap.ply", "heap", &["--strange", "label"]);
    assert!(strange > usual && warned == 1 && said.contains("looks like nothing"), "{said}");
    let labelled = found.iter().filter(|l| **l >= 0).count();
    assert!(labelled > 35_000, "{labelled} of a heap that is labelled all the same");
    for (out, more) in [("left", &unknown[..]), ("auto", &[][..])] {
        let (again, warned, found, said) = run("heap.ply", out, more);
        assert_eq!((again.to_bits(), warned), (strange.to_bits(), 1));
        assert!(found.iter().all(|l| *l == -1), "{said}");
        assert!(said.contains("labels are left out"), "{said}");
    }

    // What is asked of a strange scene is said to be a guess, too.
    let (heap, out) = (path("heap.ply"), path("asked"));
    let output =
        scenesplat(&["query", heap.to_str().unwrap(), "chair", "--out", out.to_str().unwrap()]);
    done(&output);
    assert!(stderr(&output).contains("what is found is a guess"), "{}", stderr(&output));
    assert_eq!(strangeness(&out).0.to_bits(), strange.to_bits());
}

#[test]
fn other_networks_have_no_strangeness() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("room.ply");
    write_inria_ply(&room(), &[], &scene).unwrap();
    let out = dir.path().join("out");
    let output = tiny("segment", &scene, &out, &["--strange", "unknown"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("network inside the program"), "{}", stderr(&output));
    // Codes do not tell: said, and refused if it is asked for.
    let (scene, out) = (scene.to_str().unwrap(), out.to_str().unwrap());
    let codes = ["segment", scene, "--out", out, "--setting", "codes=16"];
    done(&scenesplat(&codes));
    let receipt = std::fs::read_to_string(Path::new(out).join("receipt.json")).unwrap();
    assert!(receipt.contains("not judged"), "{receipt}");
    let output = scenesplat(&[&codes[..], &["--strange", "unknown"]].concat());
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("do not tell"), "{}", stderr(&output));
}
