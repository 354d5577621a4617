//! Attributes: integers, strides, sparse accessors, color spaces.

use crate::common::gltf::{Doc, PREFIX};
use crate::common::{close, random_scene};
use scenesplat_scene::gaussian_scene::{SH_C0, dc_to_u8};
use scenesplat_scene::value_policy::Rule;
use serde_json::json;

#[test]
fn integers_and_strides() {
    let mut doc = Doc::new();
    // Interleaved: a position of three u16 (not normalized), 2 bytes nothing, four i8.
    let mut bytes = Vec::new();
    for (p, q) in [([1u16, 2, 3], [0i8, 0, 0, 127]), ([400, 500, 600], [-128, 0, 0, 0])] {
        p.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        bytes.extend_from_slice(&[0xaa, 0xbb]);
        q.iter().for_each(|v| bytes.push(*v as u8));
    }
    let view = doc.view(&bytes);
    doc.json["bufferViews"][view]["byteStride"] = json!(12);
    let position = doc.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5123, "type": "VEC3", "count": 2}),
    );
    let rotation = doc.push(
        "accessors",
        json!({"bufferView": view, "byteOffset": 8, "componentType": 5120, "type": "VEC4",
               "count": 2, "normalized": true}),
    );
    let i16s = |values: &[i16]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let scale = doc.accessor(&i16s(&[32767, 0, 3277, 1, 2, 3]), 5122, "VEC3", 2);
    let color = doc.accessor(&i16s(&[-1, 0, 13107, -1, 0, -1, 0, 0]), 5123, "VEC4", 2);
    let attributes = json!({"POSITION": position, "_ROTATION": rotation, "_SCALE": scale,
                            "COLOR_0": color});
    doc.push("meshes", json!({"primitives": [{"attributes": attributes, "mode": 0}]}));
    doc.node(json!({"mesh": 0}), true);
    let scene = doc.read().scene;
    assert_eq!(scene.coord, [[-1.0, -2.0, 3.0], [-400.0, -500.0, 600.0]]);
    assert_eq!(scene.quat[0], [1.0, 0.0, 0.0, 0.0]);
    assert_eq!(scene.quat[1].map(f32::abs), [0.0, 1.0, 0.0, 0.0]);
    close(&scene.log_scale[0][..1], &[0.0], 0.0);
    assert_eq!(scene.log_scale[0][1], f32::NEG_INFINITY);
    close(&scene.log_scale[1], &[1.0f32, 2.0, 3.0].map(|v| (v / 32767.0).ln()), 1e-6);
    close(&scene.sh_dc[0], &[0.5 / SH_C0, -0.5 / SH_C0, -0.3 / SH_C0], 1e-6);
    assert_eq!(scene.opacity_logit, [f32::INFINITY, f32::NEG_INFINITY]);
}

#[test]
fn bytes_of_colors_and_probabilities() {
    // Every byte of a color comes back, normalized or not; three channels leave alpha missing.
    let mut doc = Doc::new();
    let base = random_scene(256, 0, 7);
    doc.mesh(&base, false);
    doc.node(json!({"mesh": 0}), true);
    let bytes: Vec<u8> = (0..=255).flat_map(|v| [v, 255 - v, 7]).collect();
    let color = doc.accessor(&bytes, 5121, "VEC3", 256);
    let attributes = &mut doc.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["COLOR_0"] = json!(color);
    let attributes = attributes.as_object_mut().unwrap();
    attributes.remove(&format!("{PREFIX}SH_DEGREE_0_COEF_0"));
    let opacity = attributes.remove(&format!("{PREFIX}OPACITY")).unwrap();
    for normalized in [true, false] {
        doc.json["accessors"][color]["normalized"] = json!(normalized);
        let loaded = doc.read();
        for (v, dc) in loaded.scene.sh_dc.iter().enumerate() {
            assert_eq!(dc.map(dc_to_u8), [v as u8, 255 - v as u8, 7]);
        }
        assert_eq!(loaded.report.count(Rule::OpacityMissing), 256);
    }
    // Probabilities outside 0 to 1 are reported and clipped.
    let values: Vec<f32> = (0..256).map(|i| (i as f32 - 10.0) / 200.0).collect();
    let bad = doc.floats(&values, "SCALAR", 256);
    assert_ne!(json!(bad), opacity);
    let attributes = &mut doc.json["meshes"][0]["primitives"][0]["attributes"];
    attributes[format!("{PREFIX}OPACITY")] = json!(bad);
    let loaded = doc.read();
    assert_eq!(loaded.report.count(Rule::OpacityOutside), 10 + 45);
    assert_eq!(loaded.scene.opacity_logit[0], f32::NEG_INFINITY);
    assert_eq!(loaded.scene.opacity_logit[255], f32::INFINITY);
}

#[test]
fn sparse_accessors_replace_elements() {
    let scene = random_scene(5000, 0, 8);
    let mut doc = Doc::new();
    doc.mesh(&scene, true);
    doc.node(json!({"mesh": 0}), true);
    let before = doc.read().scene;
    let rows: [u16; 4] = [0, 4095, 4096, 4999];
    let values: Vec<f32> = (0..12).map(|v| v as f32).collect();
    let indices = doc.view(&rows.map(u16::to_le_bytes).concat());
    let values = doc.view(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>());
    doc.json["accessors"][0]["sparse"] = json!({"count": 4,
        "indices": {"bufferView": indices, "componentType": 5123},
        "values": {"bufferView": values}});
    let after = doc.read().scene;
    let mut due = before;
    for (i, row) in rows.into_iter().enumerate() {
        let at = 3.0 * i as f32;
        due.coord[usize::from(row)] = [-at, -(at + 1.0), at + 2.0];
    }
    assert_eq!(after, due);
    // Without bytes of its own every other element is 0.
    doc.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    let zeros = doc.read().scene;
    assert_eq!(zeros.coord[1], [0.0; 3]);
    assert_eq!(zeros.coord[4999], due.coord[4999]);
    for (field, value, due) in [
        ("count", json!(5), "replaces 5 elements"),
        ("count", json!(u64::MAX), "replaces"),
        ("count", json!(6000), "replaces 6000 elements of 5000"),
        ("indices", json!({"bufferView": indices, "componentType": 5126}), "type 5126"),
        ("indices", json!({"bufferView": 0, "componentType": 5123}), "after"),
        ("indices", json!({"bufferView": 99, "componentType": 5123}), "buffer view 99"),
    ] {
        let mut broken = doc.clone();
        broken.json["accessors"][0]["sparse"][field] = value;
        let error = broken.error();
        assert!(error.contains(due), "{field}: {error}");
    }
}

#[test]
fn linear_colors_become_srgb() {
    let mut scene = random_scene(50, 1, 9);
    scene.sh_dc[0] = [0.0, (1.0 - 0.5) / SH_C0, (0.0 - 0.5) / SH_C0];
    let mut doc = Doc::new();
    doc.mesh(&scene, true);
    doc.node(json!({"mesh": 0}), true);
    let plain = doc.read().scene;
    let about = &mut doc.json["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"];
    about["colorSpace"] = json!("lin_rec709_display");
    let loaded = doc.read();
    assert!(loaded.report.notes.iter().any(|n| n.contains("sRGB")));
    let color = loaded.scene.sh_dc[0].map(|dc| 0.5 + SH_C0 * dc);
    close(&color, &[0.735_357, 1.0, 0.0], 1e-5);
    // Slope of the transfer function at 0.5, and in its linear part.
    close(&[loaded.scene.sh_rest[0] / plain.sh_rest[0]], &[0.658_631], 1e-4);
    close(&[loaded.scene.sh_rest[2] / plain.sh_rest[2]], &[12.92], 1e-3);
}
