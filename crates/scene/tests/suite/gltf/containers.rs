//! Containers and the file of another program.

use super::placement::{TO_CANONICAL, check_moved, shine};
use crate::common::gltf::{Doc, read};
use crate::common::{close, pool, random_scene, shared, strict};
use scenesplat_scene::formats::gltf::{is_glb, is_gltf_json, read_gltf};
use scenesplat_scene::gaussian_scene::{dc_to_u8, sigmoid};
use scenesplat_scene::{ReadOptions, SceneFormat};
use serde_json::{Value, json};

#[test]
fn the_file_of_cesium() {
    let Some(path) = shared("real/fixtures/cesium_synthetic_legacy.gltf") else { return };
    let bytes = std::fs::read(&path).unwrap();
    assert!(is_gltf_json(&bytes) && !is_glb(&bytes));
    let loaded = read_gltf(&bytes, &path, &strict()).unwrap();
    let scene = &loaded.scene;
    assert_eq!((scene.len(), loaded.kind, scene.sh_degree), (5, SceneFormat::Gltf, 0));
    // The node takes (x, y, z) to (x, z, −y) + (2, 12, −7), the frame then negates x and y.
    for (row, at) in [-2.0, -1.0, 0.0, 1.0, 2.0].into_iter().enumerate() {
        close(&scene.coord[row], &[-(at + 2.0), -(at + 12.0), -at - 7.0], 1e-6);
        // The sizes are the powers of e from 1.0 to 1.4.
        close(&scene.log_scale[row], &[1.0 + 0.1 * row as f32; 3], 1e-6);
    }
    assert_eq!(scene.sh_dc[0].map(dc_to_u8), [127, 199, 255]);
    assert_eq!(scene.sh_dc[4].map(dc_to_u8), [156, 228, 255]);
    let alpha: Vec<u8> =
        scene.opacity_logit.iter().map(|&v| (sigmoid(v) * 255.0).round() as u8).collect();
    assert_eq!(alpha, [140, 152, 164, 175, 186]);
    // No rotation of its own; node and frame together are half a turn about (0, 1, −1).
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let [w, x, y, z] = scene.quat[0];
    close(&[w, x, y.abs(), z.abs()], &[0.0, 0.0, half, half], 1e-6);
    assert!(y * z < 0.0);
    // x, y, z, w = (1, 2, 3, 10) / √114, times that half turn.
    let norm = 114f32.sqrt();
    // (0, v) · (10, u) with v = (0, 1, −1), u = (1, 2, 3): −v·u, and 10 v + v × u.
    let due = [1.0, 5.0, 9.0, -11.0].map(|v| v * half / norm);
    let q = scene.quat[1];
    let dot: f32 = q.iter().zip(due).map(|(a, b)| a * b).sum();
    assert!((dot.abs() - 1.0).abs() < 1e-5, "{q:?} {due:?}");
    assert!(loaded.report.notes.iter().any(|n| n.contains("standard deviations")));
}

#[test]
fn containers_hold_the_same_scene() {
    let scene = random_scene(300, 3, 1);
    let mut doc = Doc::new();
    let mesh = doc.mesh(&scene, false);
    doc.node(json!({"mesh": mesh}), true);
    let glb = doc.glb();
    assert!(is_glb(&glb) && !is_gltf_json(&glb));
    let loaded = read(&glb);
    assert_eq!(loaded.scene.sh_degree, 3);
    check_moved(&scene, &loaded.scene, &TO_CANONICAL);
    // Axis flips change signs only.
    for (a, b) in loaded.scene.coord.iter().zip(&scene.coord) {
        assert_eq!(*a, [-b[0], -b[1], b[2]]);
    }
    assert_eq!(loaded.scene.sh_dc, scene.sh_dc);
    for row in 0..scene.len() {
        let (a, b) = (
            shine(&loaded.scene, row, 1, [-0.6, -0.0, 0.8]),
            shine(&scene, row, 1, [0.6, 0.0, 0.8]),
        );
        assert!((a - b).abs() < 1e-6);
        assert!((loaded.scene.opacity_logit[row] - scene.opacity_logit[row]).abs() < 1e-3);
    }

    let text = doc.gltf();
    assert!(is_gltf_json(&text));
    assert_eq!(read(&text).scene, loaded.scene);
    assert_eq!(read(&[b"\xef\xbb\xbf", &text[..]].concat()).scene, loaded.scene);

    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("sub dir")).unwrap();
    std::fs::write(folder.path().join("sub dir/a.bin"), &doc.bin).unwrap();
    let mut json = doc.json.clone();
    json["buffers"] = json!([{"uri": "sub%20dir/a.bin", "byteLength": doc.bin.len()}]);
    let path = folder.path().join("a.gltf");
    let options = ReadOptions::default();
    let open = |json: &Value| read_gltf(&serde_json::to_vec(json).unwrap(), &path, &options);
    assert_eq!(open(&json).unwrap().scene, loaded.scene);
    for uri in ["../a.bin", "/etc/passwd", "http://a/b", "sub dir/../../a.bin", "%2e%2e/a.bin"] {
        json["buffers"][0]["uri"] = json!(uri);
        let error = open(&json).unwrap_err().to_string();
        assert!(error.contains("buffer 0"), "{error}");
    }
    for uri in ["none.bin", "sub dir"] {
        json["buffers"][0]["uri"] = json!(uri);
        let error = open(&json).unwrap_err().to_string();
        assert!(error.contains(uri), "{error}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same() {
    let scene = random_scene(10_000, 1, 2);
    let mut doc = Doc::new();
    let mesh = doc.mesh(&scene, true);
    doc.node(
        json!({"mesh": mesh, "scale": [1.0, 2.0, 3.0], "rotation": [0.1, 0.2, 0.3, 0.9]}),
        true,
    );
    let glb = doc.glb();
    let run = |threads| pool(threads).install(|| read(&glb));
    assert_eq!(run(1), run(3));
}
