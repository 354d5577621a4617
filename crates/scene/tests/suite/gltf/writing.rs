//! What is written comes back.

use crate::common::{labelled, open, random_scene, write};
use scenesplat_scene::SceneFormat;
use serde_json::Value;

#[test]
fn what_is_written_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.glb");
    for degree in 0..=4 {
        let mut scene = labelled(500, degree);
        (scene.opacity_logit[3], scene.opacity_logit[4]) = (f32::INFINITY, f32::NEG_INFINITY);
        let report = write(&scene, &path, SceneFormat::Glb);
        assert!(report.limits.is_empty(), "{report}");
        let loaded = open(&path);
        assert_eq!(loaded.kind, SceneFormat::Gltf);
        let mut back = loaded.scene;
        for (a, b) in back.log_scale.iter().flatten().zip(scene.log_scale.iter().flatten()) {
            assert!((a - b).abs() < 2e-6, "{a} {b}");
        }
        for (a, b) in back.opacity_logit.iter().zip(&scene.opacity_logit) {
            assert!(a == b || (a - b).abs() < 1e-3 * b.abs().max(1.0), "{a} {b}");
        }
        // The rest does not pass through an exponential, and is the same bit for bit.
        back.log_scale.clone_from(&scene.log_scale);
        back.opacity_logit.clone_from(&scene.opacity_logit);
        assert_eq!(back, scene);
    }
    // In the file the frame is glTF's: left, up, forward.
    let scene = random_scene(1, 0, 2);
    write(&scene, &path, SceneFormat::Glb);
    let bytes = std::fs::read(&path).unwrap();
    let length = u32::from_le_bytes(*bytes[12..].first_chunk().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let [x, y, z] = scene.coord[0];
    for end in ["min", "max"] {
        let value = |a: usize| json["accessors"][0][end][a].as_f64().unwrap() as f32;
        assert_eq!([0, 1, 2].map(value), [-x, -y, z]);
    }
    assert_eq!((bytes.len() % 4, length % 4), (0, 0));
}
