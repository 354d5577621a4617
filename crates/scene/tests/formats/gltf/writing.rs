//! What is written comes back.

use crate::common::random_scene;
use scenesplat_scene::{
    GaussianScene, ReadOptions, SceneFormat, WriteOptions, open_scene, write_scene,
};
use serde_json::Value;
use std::path::Path;

#[test]
fn what_is_written_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let [first, second] = ["a.glb", "b.glb"].map(|name| dir.path().join(name));
    let options = WriteOptions::default();
    for degree in 0..=4 {
        let mut scene = random_scene(500, degree, 11);
        scene.segment = Some((0..500).map(|i| i % 7 - 1).collect());
        (scene.opacity_logit[3], scene.opacity_logit[4]) = (f32::INFINITY, f32::NEG_INFINITY);
        let overwrite = WriteOptions { overwrite: true, ..options.clone() };
        let write = |scene: &GaussianScene, path: &Path| {
            write_scene(scene, path, SceneFormat::Glb, &overwrite, &mut |_| true).unwrap()
        };
        let report = write(&scene, &first);
        assert!(report.limits.is_empty(), "{report}");
        let back = open_scene(&first, &ReadOptions::default()).unwrap();
        assert_eq!((back.kind, back.scene.sh_degree), (SceneFormat::Gltf, degree));
        let back = back.scene;
        // Bit for bit, but for what passes through an exponential.
        assert_eq!((&back.coord, &back.quat), (&scene.coord, &scene.quat));
        assert_eq!((&back.sh_dc, &back.sh_rest), (&scene.sh_dc, &scene.sh_rest));
        assert_eq!(back.segment, scene.segment);
        for (a, b) in back.log_scale.iter().flatten().zip(scene.log_scale.iter().flatten()) {
            assert!((a - b).abs() < 2e-6, "{a} {b}");
        }
        for (a, b) in back.opacity_logit.iter().zip(&scene.opacity_logit) {
            assert!(a == b || (a - b).abs() < 1e-3 * b.abs().max(1.0), "{a} {b}");
        }
        write(&back, &second);
        assert!(std::fs::read(&first).unwrap() == std::fs::read(&second).unwrap());
    }
    // In the file the frame is glTF's: left, up, forward.
    let scene = random_scene(1, 0, 2);
    let overwrite = WriteOptions { overwrite: true, ..options };
    write_scene(&scene, &first, SceneFormat::Glb, &overwrite, &mut |_| true).unwrap();
    let bytes = std::fs::read(&first).unwrap();
    let length = u32::from_le_bytes(*bytes[12..].first_chunk().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let [x, y, z] = scene.coord[0];
    for end in ["min", "max"] {
        let value = |a: usize| json["accessors"][0][end][a].as_f64().unwrap() as f32;
        assert_eq!([0, 1, 2].map(value), [-x, -y, z]);
    }
    assert_eq!((bytes.len() % 4, length % 4), (0, 0));
}
