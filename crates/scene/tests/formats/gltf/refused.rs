//! What is not read, and files that lie or are damaged.

use super::document::Doc;
use crate::common::{SplitMix, random_scene};
use scenesplat_scene::ReadOptions;
use scenesplat_scene::formats::gltf::{is_gltf_json, read_gltf};
use serde_json::{Value, json};
use std::path::Path;

#[test]
fn what_is_not_read_is_named() {
    let scene = random_scene(3, 1, 10);
    let mut base = Doc::new();
    base.mesh(&scene, true);
    base.node(json!({"mesh": 0}), true);
    let with = |change: &dyn Fn(&mut Value)| {
        let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
        change(&mut doc.json);
        doc.error()
    };
    let attribute = |name: &'static str| {
        move |json: &mut Value| {
            let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
            attributes.as_object_mut().unwrap().remove(name);
        }
    };
    let error = with(&|json| json["extensionsRequired"] = json!(["EXT_meshopt_compression"]));
    assert!(error.contains("EXT_meshopt_compression"), "{error}");
    let error = with(&|json| {
        json["bufferViews"][0]["extensions"] = json!({"EXT_meshopt_compression": {"buffer": 0}});
    });
    assert!(error.contains("EXT_meshopt_compression"), "{error}");
    assert!(with(&attribute("POSITION")).contains("POSITION"));
    let error = with(&attribute("KHR_gaussian_splatting:SH_DEGREE_1_COEF_1"));
    assert!(error.contains("SH_DEGREE_1_COEF_1"), "{error}");
    let error = with(&|json| json["accessors"][0]["count"] = json!(2));
    assert!(error.contains("has 3 elements, POSITION 2"), "{error}");
    let error = with(&|json| json["accessors"][1]["type"] = json!("VEC3"));
    assert!(error.contains("ROTATION has 3 components"), "{error}");
    let error = with(&|json| json["accessors"][1]["componentType"] = json!(5124));
    assert!(error.contains("component type 5124"), "{error}");
    let error = with(&|json| {
        json["accessors"][1].as_object_mut().unwrap().remove("bufferView");
    });
    assert!(error.contains("has no bytes"), "{error}");
}

#[test]
fn counts_and_lengths_that_lie() {
    let scene = random_scene(10, 1, 11);
    let mut base = Doc::new();
    base.mesh(&scene, true);
    base.node(json!({"mesh": 0}), true);
    for huge in [11u64, 1 << 20, u64::from(u32::MAX), 1 << 40, u64::MAX] {
        for accessors in [0..1, 0..20] {
            let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
            for accessor in accessors {
                if let Some(accessor) = doc.json["accessors"].get_mut(accessor) {
                    accessor["count"] = json!(huge);
                }
            }
            doc.error();
        }
        for field in ["byteLength", "byteOffset", "byteStride"] {
            let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
            doc.json["bufferViews"][0][field] = json!(huge.saturating_mul(100));
            doc.error();
        }
        // Elements that are all 0 cost no bytes.
        let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
        let accessors = doc.json["accessors"].as_array_mut().unwrap();
        for accessor in accessors.iter_mut() {
            accessor["count"] = json!(huge.max(1 << 20));
            accessor.as_object_mut().unwrap().remove("bufferView");
            accessor["sparse"] = json!({"count": 0, "indices": {"bufferView": 0,
                "componentType": 5121}, "values": {"bufferView": 0}});
        }
        assert!(doc.error().contains("can hold"));
    }
    // One mesh under very many nodes.
    let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
    for _ in 0..70_000 {
        doc.node(json!({"mesh": 0}), true);
    }
    assert!(doc.error().contains("primitives"));
    // A document of nothing but braces.
    let braces = format!("{{\"asset\":{{}},\"nodes\":[{}{{}}]}}", "{},".repeat(1 << 20));
    let error = read_gltf(braces.as_bytes(), Path::new("a"), &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("objects"));
    let deep = "[".repeat(100_000);
    let deep = format!("{{\"asset\":{{}},\"extras\":{deep}");
    assert!(read_gltf(deep.as_bytes(), Path::new("a"), &ReadOptions::default()).is_err());
    assert!(!is_gltf_json(deep.as_bytes()));
}

#[test]
fn damaged_files_are_refused_without_panic() {
    let scene = random_scene(9, 1, 12);
    let mut doc = Doc::new();
    doc.mesh(&scene, true);
    doc.node(json!({"mesh": 0, "scale": [1, 2, 1]}), true);
    let options = ReadOptions::default();
    let (glb, text) = (doc.glb(), doc.gltf());
    for cut in 0..glb.len() {
        assert!(read_gltf(&glb[..cut], Path::new("a"), &options).is_err(), "cut at {cut}");
    }
    for cut in 0..text.len() {
        assert!(read_gltf(&text[..cut], Path::new("a"), &options).is_err(), "cut at {cut}");
    }
    let body = glb.windows(4).position(|w| w == b"BIN\0").unwrap() + 4;
    let mut rng = SplitMix(13);
    for (file, seeds) in [(&glb, 2000), (&text, 2000)] {
        for _ in 0..seeds {
            let mut bytes = file.clone();
            let mut only_body = std::ptr::eq(file, &glb);
            for _ in 0..=rng.below(3) {
                let at = rng.below(bytes.len());
                only_body &= at >= body;
                bytes[at] = match rng.below(3) {
                    0 => rng.next() as u8,
                    1 => bytes[at] ^ 1 << rng.below(8),
                    _ => b"0123456789-,[]{}\"e"[rng.below(18)],
                };
            }
            match read_gltf(&bytes, Path::new("a"), &options) {
                Ok(loaded) => {
                    loaded.scene.check_rows().unwrap();
                    assert_eq!(loaded.source_rows(), 9);
                }
                // Numbers can be spoilt so that no row is usable, but never the structure.
                Err(error) => {
                    assert!(!only_body || error.to_string().contains("usable"), "{error}");
                }
            }
        }
    }
}
