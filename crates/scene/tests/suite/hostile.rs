//! Files that are cut, that lie about their sizes, or that are no scene: an error each.

use crate::common::gltf::Doc;
use crate::common::ksplat::{ksplat, sections};
use crate::common::ply::{Encoding, inria_columns, mixed, ply_bytes};
use crate::common::spz::small_files;
use crate::common::{SplitMix, labelled, npy_bytes, random_scene, shared, write};
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::ply::PlyFile;
use scenesplat_scene::formats::semantics;
use scenesplat_scene::{
    GaussianScene, ReadOptions, RepairReport, SceneError, SceneFormat, open_scene, open_scene_bytes,
};
use serde_json::json;
use std::path::Path;

/// A file, whether bytes open, and at which lengths below its own they may.
struct Cut {
    name: String,
    bytes: Vec<u8>,
    opens: fn(&[u8]) -> bool,
    may_end: Box<dyn Fn(usize) -> bool>,
}

impl Cut {
    fn new(name: &str, bytes: Vec<u8>) -> Self {
        let opens = |bytes: &[u8]| {
            open_scene_bytes(bytes, Path::new("a.part"), &ReadOptions::default()).is_ok()
        };
        Self { name: name.to_owned(), bytes, opens, may_end: Box::new(|_| false) }
    }
}

fn all_to_cut() -> Vec<Cut> {
    let mut all = Vec::new();
    let columns = inria_columns(&random_scene(4, 1, 2));
    for encoding in [Encoding::Little, Encoding::Big, Encoding::Ascii] {
        let mut cut = Cut::new(&format!("{encoding:?} PLY"), ply_bytes(&columns, encoding, "\n"));
        if encoding == Encoding::Ascii {
            // The last number may lose digits unnoticed.
            let rows = &cut.bytes[..cut.bytes.len() - 1];
            let last = rows.iter().rposition(|&b| b == b'\n').unwrap();
            cut.may_end = Box::new(move |length| length > last);
        } else {
            let opens = |bytes: &[u8]| PlyFile::from_bytes(bytes, Path::new("a.ply")).is_ok();
            let name = format!("{encoding:?} PLY with lists");
            all.push(Cut { opens, ..Cut::new(&name, mixed(encoding)) });
        }
        all.push(cut);
    }
    for (name, bytes) in small_files() {
        let mut cut = Cut::new(&format!("SPZ {name}"), bytes);
        if name == "raw" {
            // Without the record of labels it has just none.
            cut.may_end = Box::new(|length| length == 16 + 40 * 29);
        }
        all.push(cut);
    }
    for level in 0..=2 {
        all.push(Cut::new("ksplat", ksplat(level, &sections())));
    }
    for (name, ends) in [("minimal.splat", 32), ("minimal.ksplat", usize::MAX)] {
        let Some(path) = shared(&format!("real/fixtures/{name}")) else { continue };
        let mut cut = Cut::new(name, std::fs::read(path).unwrap());
        cut.may_end = Box::new(move |length| length > 0 && length.is_multiple_of(ends));
        all.push(cut);
    }
    let dir = tempfile::tempdir().unwrap();
    for (name, format, rows, degree) in [
        ("a.sog", SceneFormat::Sog, 50, 1),
        ("a.compressed.ply", SceneFormat::CompressedPly, 3, 0),
        ("b.compressed.ply", SceneFormat::CompressedPly, 2, 3),
    ] {
        let path = dir.path().join(name);
        write(&random_scene(rows, degree, 3), &path, format);
        all.push(Cut::new(name, std::fs::read(path).unwrap()));
    }
    let mut doc = Doc::new();
    doc.mesh(&random_scene(9, 1, 12), true);
    doc.node(json!({"mesh": 0, "scale": [1, 2, 1]}), true);
    all.extend([Cut::new("glb", doc.glb()), Cut::new("glTF", doc.gltf())]);
    let dict = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }";
    let labels = semantics::encode(&labelled(3, 0), None).unwrap();
    let opens = |bytes: &[u8]| decode(bytes, 3).is_ok();
    all.push(Cut { opens, ..Cut::new("labels", labels) });
    let opens = |bytes: &[u8]| NpyFile::from_bytes(bytes, Path::new("a.npy")).is_ok();
    all.push(Cut { opens, ..Cut::new("npy", npy_bytes(2, dict, &[0; 24])) });
    all
}

fn decode(labels: &[u8], rows: usize) -> Result<(), SceneError> {
    let (mut scene, mut report) = (GaussianScene::default(), RepairReport::default());
    semantics::decode(labels, rows, &mut scene, &mut report, Path::new("a"))
}

#[test]
fn labels_of_another_scene_are_refused() {
    let labels = semantics::encode(&labelled(3, 0), None).unwrap();
    let error = decode(&labels, 4).unwrap_err().to_string();
    assert!(error.contains("3 Gaussians, not 4"), "{error}");
}

#[test]
fn files_cut_anywhere_are_errors() {
    for Cut { name, bytes, opens, may_end } in all_to_cut() {
        assert!(opens(&bytes), "{name}");
        // Most of a large file is one block after another.
        let step = if bytes.len() < 10_000 { 1 } else { 23 };
        let end = bytes.len() - 300.min(bytes.len());
        for length in (0..end).step_by(step).chain(end..bytes.len()) {
            let opened = opens(&bytes[..length]);
            assert!(!opened || may_end(length), "{name} cut at {length} of {}", bytes.len());
        }
    }
}

#[test]
fn what_is_no_scene() {
    let open = |bytes: &[u8]| open_scene_bytes(bytes, Path::new("a.ply"), &ReadOptions::default());
    let dir = tempfile::tempdir().unwrap();
    let mut rng = SplitMix(3);
    let garbage: Vec<u8> = (0..4096).map(|_| rng.next() as u8).collect();
    for bytes in [&garbage[..], b"", b"ply", b"PLY\n", b"\0\0\0\0"] {
        let error = open(bytes).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("supported are ") && error.contains(".ply") && error.contains(".spz"),
            "{error}"
        );
    }
    for path in [dir.path().to_owned(), dir.path().join("missing.ply")] {
        assert!(open_scene(&path, &ReadOptions::default()).is_err());
    }
    let npy = npy_bytes(1, "{}", &[]);
    let error = open(&npy).unwrap_err();
    assert!(error.to_string().contains("give the folder"), "{error}");
}
