//! Small files of every format.

use crate::common::gltf::Doc;
use crate::common::ksplat::{ksplat, sections};
use crate::common::ply::{Encoding, inria_columns, ply_bytes};
use crate::common::spz::{self, small_files};
use crate::common::{labelled, random_scene, shared, write_as};
use scenesplat_scene::{SceneFormat, WriteOptions};
use serde_json::json;

/// A file as bytes.
pub struct Fixture {
    /// For messages.
    pub name: String,
    /// What the reader must call it.
    pub kind: &'static str,
    /// The file.
    pub bytes: Vec<u8>,
}

/// Gaussians of the files that are made here.
const ROWS: usize = 600;

/// The real fixtures, and one of our own for every format that can be written.
pub fn all() -> Vec<Fixture> {
    let mut all = Vec::new();
    for (name, kind) in [
        ("minimal-raw.spz", "spz"),
        ("minimal-v2.spz", "spz"),
        ("minimal-v3.spz", "spz"),
        ("minimal-v4.spz", "spz"),
        ("minimal.ksplat", "ksplat"),
        ("minimal.splat", "splat"),
        ("unitCube-ascii.ply", "ply"),
        ("cesium_synthetic_legacy.gltf", "gltf"),
    ] {
        if let Some(path) = shared(&format!("real/fixtures/{name}")) {
            all.push(Fixture { name: name.to_owned(), kind, bytes: std::fs::read(path).unwrap() });
        }
    }
    let dir = tempfile::tempdir().unwrap();
    for (name, format, kind, degree, spz_version) in [
        ("own-sh2.ply", SceneFormat::Ply, "ply", 2, 4),
        ("own-sh1.compressed.ply", SceneFormat::CompressedPly, "compressed-ply", 1, 4),
        ("own-v2-sh1.spz", SceneFormat::Spz, "spz", 1, 2),
        ("own-v3-sh3.spz", SceneFormat::Spz, "spz", 3, 3),
        ("own-v4-sh4.spz", SceneFormat::Spz, "spz", 4, 4),
        ("own.splat", SceneFormat::Splat, "splat", 0, 4),
        ("own-sh1.sog", SceneFormat::Sog, "sog", 1, 4),
    ] {
        let scene = labelled(ROWS, degree);
        let path = dir.path().join(name);
        let options = WriteOptions { spz_version, ..WriteOptions::default() };
        write_as(&scene, &path, format, &options).unwrap();
        all.push(Fixture { name: name.to_owned(), kind, bytes: std::fs::read(&path).unwrap() });
    }
    let mut own = |name: String, kind, bytes| all.push(Fixture { name, kind, bytes });
    for level in 0..=2 {
        own(format!("own-l{level}.ksplat"), "ksplat", ksplat(level, &sections()));
    }
    for (name, bytes) in small_files() {
        own(format!("own-{name}.spz"), "spz", bytes);
    }
    let columns = inria_columns(&random_scene(ROWS, 0, 2));
    for (encoding, line_end) in [(Encoding::Ascii, "\n"), (Encoding::Big, "\r\n")] {
        own(format!("own-{encoding:?}.ply"), "ply", ply_bytes(&columns, encoding, line_end));
    }
    // The counts of the program read one mesh that is used once.
    let mut doc = Doc::new();
    let view = doc.view(&spz::write(&random_scene(20, 1, 6), 4));
    let inner = json!({"KHR_gaussian_splatting_compression_spz_2": {"bufferView": view}});
    let extensions = json!({"KHR_gaussian_splatting": {"extensions": inner}});
    let primitive = json!({"mode": 0, "attributes": {}, "extensions": extensions});
    doc.push("meshes", json!({"primitives": [primitive]}));
    doc.node(json!({"mesh": 0, "translation": [1, 2, 3]}), true);
    own("own-spz.glb".to_owned(), "gltf", doc.glb());
    let mut doc = Doc::new();
    doc.mesh(&random_scene(20, 1, 7), false);
    doc.node(json!({"mesh": 0, "scale": [1, 2, 1]}), true);
    own("own-attributes.glb".to_owned(), "gltf", doc.glb());
    own("own-attributes.gltf".to_owned(), "gltf", doc.gltf());
    all
}
