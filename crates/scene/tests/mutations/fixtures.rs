//! Small files of every format.

use crate::common::{language_code, random_scene, shared};
use scenesplat_scene::{SceneFormat, WriteOptions, write_scene};
use serde_json::{Value, json};

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
        let mut scene = random_scene(ROWS, degree, 5);
        scene.segment = Some((0..ROWS as i32).map(|i| i % 7 - 1).collect());
        scene.segment_score = Some(vec![0.5; ROWS]);
        scene.lang_code = Some(language_code(ROWS, 3, 8));
        let path = dir.path().join(name);
        let options = WriteOptions { spz_version, ..WriteOptions::default() };
        write_scene(&scene, &path, format, &options, &mut |_| true).unwrap();
        all.push(Fixture { name: name.to_owned(), kind, bytes: std::fs::read(&path).unwrap() });
    }
    all.push(Fixture { name: "own-spz.glb".to_owned(), kind: "gltf", bytes: glb_of_spz() });
    all.push(Fixture { name: "own-attributes.glb".to_owned(), kind: "gltf", bytes: plain_glb() });
    all
}

/// A mesh of one primitive that is an SPZ file and has no attributes.
fn glb_of_spz() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.spz");
    let (scene, options) = (random_scene(20, 1, 6), WriteOptions::default());
    write_scene(&scene, &path, SceneFormat::Spz, &options, &mut |_| true).unwrap();
    let spz = std::fs::read(&path).unwrap();
    let inner = json!({"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}});
    let primitive = json!({"mode": 0, "attributes": {},
                           "extensions": {"KHR_gaussian_splatting": {"extensions": inner}}});
    glb(&primitive, &json!([{"buffer": 0, "byteLength": spz.len()}]), &json!([]), spz)
}

/// A mesh of one primitive with the attributes of `KHR_gaussian_splatting`.
fn plain_glb() -> Vec<u8> {
    let scene = random_scene(20, 0, 7);
    let (mut attributes, mut accessors, mut views) = (json!({}), Vec::new(), Vec::new());
    let mut bin: Vec<u8> = Vec::new();
    let size: Vec<f32> = scene.log_scale.as_flattened().iter().map(|v| v.exp()).collect();
    for (name, shape, values) in [
        ("POSITION", "VEC3", scene.coord.as_flattened()),
        ("KHR_gaussian_splatting:ROTATION", "VEC4", scene.quat.as_flattened()),
        ("KHR_gaussian_splatting:SCALE", "VEC3", &size),
        ("KHR_gaussian_splatting:OPACITY", "SCALAR", &[0.5; 20]),
        ("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0", "VEC3", scene.sh_dc.as_flattened()),
    ] {
        attributes[name] = json!(accessors.len());
        let (view, offset) = (views.len(), bin.len());
        accessors.push(
            json!({"bufferView": view, "componentType": 5126, "type": shape, "count": scene.len()}),
        );
        bin.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        let length = bin.len() - offset;
        views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": length}));
    }
    let primitive = json!({"mode": 0, "attributes": attributes,
                           "extensions": {"KHR_gaussian_splatting": {"kernel": "ellipse"}}});
    glb(&primitive, &json!(views), &json!(accessors), bin)
}

/// A document that shows one primitive, and its bytes.
fn glb(primitive: &Value, views: &Value, accessors: &Value, mut bin: Vec<u8>) -> Vec<u8> {
    let json = json!({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "scene": 0,
        "nodes": [{"mesh": 0, "translation": [1, 2, 3]}], "meshes": [{"primitives": [primitive]}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": bin.len()}]});
    let mut text = serde_json::to_vec(&json).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    bin.resize(bin.len().next_multiple_of(4), 0);
    let word = |n: usize| (n as u32).to_le_bytes();
    let total = 12 + 8 + text.len() + 8 + bin.len();
    let head = [&b"glTF"[..], &word(2), &word(total), &word(text.len()), b"JSON"].concat();
    [head, text, word(bin.len()).to_vec(), b"BIN\0".to_vec(), bin].concat()
}
