//! Small files of every format.

use crate::common::{language_code, random_scene, shared};
use scenesplat_scene::{SceneFormat, WriteOptions, write_scene};

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
    all
}
