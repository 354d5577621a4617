//! Gaussians that are an SPZ file inside.

use crate::common::gltf::Doc;
use crate::common::{close, dot, labelled, random_scene, spz};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{Frame, GaussianScene};
use serde_json::json;

#[test]
fn spz_inside_is_the_same_gaussians() {
    let bytes = spz_bytes(&labelled(50, 2));
    let alone = spz::read(&bytes).scene;
    let plain = {
        let mut doc = Doc::new();
        // The mesh is written in glTF's frame, so the alone scene goes there first.
        let mut there = alone;
        there.change_frame(Frame::CANONICAL, Frame::LUF);
        let mesh = doc.mesh(&there, true);
        doc.node(json!({"mesh": mesh, "translation": [1, 2, 3]}), true);
        doc.read().scene
    };
    for nested in [true, false] {
        let mut doc = Doc::new();
        let view = doc.view(&bytes);
        let about = json!({"bufferView": view});
        let extensions = if nested {
            let inner = json!({"KHR_gaussian_splatting_compression_spz_2": about});
            json!({"KHR_gaussian_splatting": {"extensions": inner}})
        } else {
            json!({"KHR_spz_gaussian_splats_compression": about})
        };
        let primitive = json!({"attributes": {}, "mode": 0, "extensions": extensions});
        let mesh = doc.push("meshes", json!({"primitives": [primitive]}));
        doc.node(json!({"mesh": mesh, "translation": [1, 2, 3]}), true);
        let read = doc.read().scene;
        assert_eq!(read.len(), 50);
        close(read.coord.as_flattened(), plain.coord.as_flattened(), 1e-5);
        close(&read.sh_rest, &plain.sh_rest, 1e-6);
        for (a, b) in read.quat.iter().zip(&plain.quat) {
            assert!(dot(a, b) > 1.0 - 1e-6, "{a:?} {b:?}");
        }
        // Damage inside is damage of the whole.
        let at = doc.bin.len() / 2;
        doc.bin[at..].fill(0x55);
        assert!(doc.error().contains("a.glb"), "{}", doc.error());
    }
}

/// The bytes of a scene as an SPZ file.
fn spz_bytes(scene: &GaussianScene) -> Vec<u8> {
    spz::write(scene, 4)
}

/// A document with a mesh that is an SPZ file.
fn doc_of_spz(bytes: &[u8]) -> Doc {
    let mut doc = Doc::new();
    let view = doc.view(bytes);
    let inner = json!({"KHR_gaussian_splatting_compression_spz_2": {"bufferView": view}});
    let extensions = json!({"KHR_gaussian_splatting": {"extensions": inner}});
    let primitive = json!({"attributes": {}, "mode": 0, "extensions": extensions});
    doc.push("meshes", json!({"primitives": [primitive]}));
    doc
}

#[test]
fn spz_grows_no_more_than_attributes() {
    // 64 KiB of text and a few bytes of Gaussians would be a million of them.
    let equal = random_scene(1, 0, 4).select_rows(&vec![0; 5000]).unwrap();
    let mut doc = doc_of_spz(&spz_bytes(&equal));
    for _ in 0..200 {
        doc.node(json!({"mesh": 0}), true);
    }
    let error = doc.error();
    assert!(error.contains("shows 1000000 Gaussians in 200 primitives"), "{error}");
    // So would many meshes with a view each of the same bytes.
    let mut doc = doc_of_spz(&spz_bytes(&equal));
    for i in 1..200 {
        let view = doc.json["bufferViews"][0].clone();
        doc.push("bufferViews", view);
        let mut mesh = doc.json["meshes"][0].clone();
        mesh["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["extensions"]["KHR_gaussian_splatting_compression_spz_2"]
            ["bufferView"] = json!(i);
        doc.push("meshes", mesh);
    }
    for mesh in 0..200 {
        doc.node(json!({"mesh": mesh}), true);
    }
    assert!(doc.error().contains("can hold"));
    // An attribute without harmonics gets the degree of the SPZ beside it.
    let mut doc = doc_of_spz(&spz_bytes(&random_scene(1, 4, 4)));
    doc.mesh(&random_scene(60_000, 0, 5), false);
    doc.node(json!({"mesh": 0}), true);
    doc.node(json!({"mesh": 1}), true);
    assert_eq!(doc.read().scene.sh_rest.len(), 60_001 * 72);
    // Harmonics that are 0 take no room in the file, and are nothing to be suspicious of.
    let mut dark = random_scene(60_000, 4, 6);
    dark.sh_rest.fill(0.0);
    let mut doc = doc_of_spz(&spz_bytes(&dark));
    doc.node(json!({"mesh": 0}), true);
    assert_eq!(doc.read().scene.len(), 60_000);
    // Where harmonics are not asked for, they do not count.
    let mut doc = doc_of_spz(&spz_bytes(&equal));
    (0..50).for_each(|_| {
        doc.node(json!({"mesh": 0}), true);
    });
    assert_eq!(doc.read().scene.len(), 250_000);
}

#[test]
fn spz_shown_by_several_nodes_is_read_once() {
    let scene = random_scene(30, 1, 8);
    let mut bytes = spz_bytes(&scene);
    bytes.extend_from_slice(b"more");
    let mut doc = doc_of_spz(&bytes);
    let alone = {
        doc.node(json!({"mesh": 0}), true);
        doc.read().scene
    };
    doc.mesh(&random_scene(3, 2, 9), true);
    doc.node(json!({"mesh": 1}), true);
    doc.node(json!({"mesh": 0, "translation": [1, 0, 0]}), true);
    doc.node(json!({"mesh": 0}), true);
    let loaded = doc.read();
    assert_eq!(loaded.report.count(Rule::FileTrailing), 1, "{}", loaded.report);
    let rows = |from: usize| {
        let mut part = loaded.scene.select_rows(&(from..from + 30).collect::<Vec<_>>()).unwrap();
        part.sh_rest = part.sh_rest.chunks(24).flat_map(|rest| rest[..9].to_vec()).collect();
        part.sh_degree = 1;
        part
    };
    assert_eq!(loaded.scene.len(), 93);
    assert_eq!(rows(0), alone);
    assert_eq!(rows(63), alone);
    let moved = rows(33);
    for (a, b) in moved.coord.iter().zip(&alone.coord) {
        close(a, &[b[0] - 1.0, b[1], b[2]], 1e-5);
    }
    assert_eq!((moved.sh_rest, moved.sh_dc), (alone.sh_rest, alone.sh_dc));
}
