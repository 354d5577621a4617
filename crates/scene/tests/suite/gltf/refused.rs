//! What is not read, and counts that are wrong.

use crate::common::gltf::Doc;
use crate::common::random_scene;
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
    let attributes = "/meshes/0/primitives/0/attributes";
    let cases: [(&str, &str, Option<Value>, &str); 8] = [
        ("", "extensionsRequired", Some(json!(["EXT_meshopt_compression"])), "EXT_meshopt"),
        (
            "/bufferViews/0",
            "extensions",
            Some(json!({"EXT_meshopt_compression": {"buffer": 0}})),
            "EXT_meshopt_compression",
        ),
        (attributes, "POSITION", None, "POSITION"),
        (attributes, "KHR_gaussian_splatting:SH_DEGREE_1_COEF_1", None, "SH_DEGREE_1_COEF_1"),
        ("/accessors/0", "count", Some(json!(2)), "has 3 elements, POSITION 2"),
        ("/accessors/1", "type", Some(json!("VEC3")), "ROTATION has 3 components"),
        ("/accessors/1", "componentType", Some(json!(5124)), "component type 5124"),
        ("/accessors/1", "bufferView", None, "has no bytes"),
    ];
    for (at, field, value, due) in cases {
        let mut doc = base.clone();
        let object = doc.json.pointer_mut(at).unwrap().as_object_mut().unwrap();
        match value {
            Some(value) => object.insert(field.to_owned(), value),
            None => object.remove(field),
        };
        let error = doc.error();
        assert!(error.contains(due), "{error}");
    }
}

#[test]
fn counts_and_lengths_that_lie() {
    let scene = random_scene(10, 1, 11);
    let mut base = Doc::new();
    base.mesh(&scene, true);
    base.node(json!({"mesh": 0}), true);
    for huge in [11u64, 1 << 20, u64::from(u32::MAX), 1 << 40, u64::MAX] {
        for accessors in [0..1, 0..20] {
            let mut doc = base.clone();
            for accessor in accessors {
                if let Some(accessor) = doc.json["accessors"].get_mut(accessor) {
                    accessor["count"] = json!(huge);
                }
            }
            doc.error();
        }
        for field in ["byteLength", "byteOffset", "byteStride"] {
            let mut doc = base.clone();
            doc.json["bufferViews"][0][field] = json!(huge.saturating_mul(100));
            doc.error();
        }
        // Elements that are all 0 cost no bytes.
        let mut doc = base.clone();
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
    let mut doc = base.clone();
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
