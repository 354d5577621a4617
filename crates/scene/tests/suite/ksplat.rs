//! `.ksplat` files: reading, and counts that are wrong.

use crate::common::ksplat::{BLOCK, RANGE, center, coefficient, expected, ksplat, sections};
use crate::common::{dot, labelled, open, shared};
use scenesplat_scene::formats::ksplat::{is_ksplat, read_ksplat};
use scenesplat_scene::formats::semantics;
use scenesplat_scene::formats::splat::is_splat;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{GaussianScene, LoadedScene, ReadOptions, SceneError, SceneFormat};
use serde_json::{Value, json};
use std::path::Path;

fn read(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    read_ksplat(bytes, Path::new("a.ksplat"), &ReadOptions::default())
}

fn read_file(path: &Path) -> LoadedScene {
    let bytes = std::fs::read(path).unwrap();
    assert!(is_ksplat(&bytes) && !is_splat(&bytes), "{}", path.display());
    read(&bytes).unwrap()
}

#[test]
fn sections_buckets_and_levels() {
    for level in 0..=2 {
        let bytes = ksplat(level, &sections());
        assert!(is_ksplat(&bytes));
        let loaded = read(&bytes).unwrap();
        let scene = &loaded.scene;
        assert_eq!((loaded.kind, scene.len(), scene.sh_degree), (SceneFormat::Ksplat, 19, 2));
        assert!(loaded.report.is_clean(), "{}", loaded.report);
        // Section and bucket of every row.
        let places = [(0, 0, 4), (0, 1, 4), (0, 2, 3), (0, 3, 1), (2, 0, 1), (2, 2, 2), (3, 0, 4)];
        let places = places.into_iter().flat_map(|(s, b, n)| vec![(s, b); n]);
        for (row, (section, bucket)) in places.enumerate() {
            let e = expected(row as u32);
            let offset = e.offset.map(f64::from);
            let center = center(section, bucket).map(f64::from);
            let step = BLOCK / 2.0 / RANGE;
            for i in 0..3 {
                let due =
                    if level == 0 { offset[i] } else { (offset[i] - RANGE) * step + center[i] };
                assert!(
                    (f64::from(scene.coord[row][i]) - due).abs() < 1e-6,
                    "level {level} row {row}"
                );
            }
            assert_eq!(scene.log_scale[row], e.scale.map(f32::ln), "level {level} row {row}");
            assert_eq!(scene.quat[row], e.quat);
            assert_eq!(scene.color_u8(row), [e.color[0], e.color[1], e.color[2]]);
            assert!((scene.opacity(row) - 128.0 / 255.0).abs() < 1e-6);
            let known = if section == 0 { 3 } else { 8 };
            for k in 0..8 {
                for channel in 0..3 {
                    let value = scene.sh_rest[row * 24 + k * 3 + channel];
                    let due = if k < known { coefficient(row as u32, k, channel) } else { 0.0 };
                    let allowed = if level < 2 { 0.0 } else { 2.001 / 255.0 };
                    assert!(
                        (value - due).abs() <= allowed,
                        "level {level} row {row}: {value} {due}"
                    );
                }
            }
        }
        let bare = ReadOptions { sh_rest: false, ..ReadOptions::default() };
        let bare = read_ksplat(&bytes, Path::new("a"), &bare).unwrap().scene;
        assert_eq!((bare.sh_degree, bare.sh_rest.len()), (0, 0));
        assert_eq!(bare.coord, scene.coord);
        let longer = [&bytes[..], &[0; 5]].concat();
        assert_eq!(read(&longer).unwrap().report.count(Rule::FileTrailing), 1);
    }
}

#[test]
fn the_smallest_real_file() {
    let Some(path) = shared("real/fixtures/minimal.ksplat") else { return };
    let loaded = read_file(&path);
    let scene = &loaded.scene;
    assert_eq!(scene.coord, [[-1.0, 0.0, -1.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0; 3]]);
    assert_eq!(scene.log_scale[0], [0.1f32.ln(); 3]);
    assert_eq!(scene.color_u8(2), [0x55, 0xaa, 0x80]);
    assert!((scene.opacity(0) - 230.0 / 255.0).abs() < 1e-6);
    // Its fourth number is 1; the first is w.
    assert_eq!(scene.quat[0], [0.0, 0.0, 0.0, 1.0]);
}

fn compare(a: &GaussianScene, b: &GaussianScene, i: usize, j: usize, size: f32, color: f32) {
    for axis in 0..3 {
        let (x, y) = (a.coord[i][axis], b.coord[j][axis]);
        assert!((x - y).abs() <= size + 1e-5, "coord of row {i}: {x} {y}");
        let (x, y) = (a.log_scale[i][axis].exp(), b.log_scale[j][axis].exp());
        // Half floats: 11 bits, and steps of 6e-8 for the smallest.
        assert!((x - y).abs() <= y * (6e-4 + size) + 6e-8, "scale of row {i}: {x} {y}");
        let shown = |dc: f32| (0.5 + 0.282_094_8 * dc).clamp(0.0, 1.0);
        let (x, y) = (shown(a.sh_dc[i][axis]), shown(b.sh_dc[j][axis]));
        assert!((x - y).abs() <= 1.001 / 255.0 + color, "color of row {i}: {x} {y}");
    }
    assert!((a.opacity(i) - b.opacity(j)).abs() <= 1.001 / 255.0 + color, "row {i}");
    assert!(dot(&a.quat[i], &b.quat[j]) > 0.999_9, "rotation of row {i}");
}

#[test]
fn parity_with_the_same_scene_in_ply() {
    let Some(plain) = shared("real/parity/playbot_lod4.ply") else { return };
    let plain = open(&plain).scene;
    for (name, exact, rest) in
        [("l0", true, 1e-6f32), ("l1", false, 2e-3), ("l2", false, 4.06 / 255.0)]
    {
        let Some(path) = shared(&format!("real/parity/playbot_lod4.{name}.ksplat")) else {
            continue;
        };
        let scene = read_file(&path).scene;
        assert_eq!((scene.len(), scene.sh_degree), (8406, 2), "{name}");
        // Blocks of 5 in 65534 steps, rounded.
        let size = if exact { 0.0 } else { 5.0 / 65_534.0 / 2.0 };
        for row in 0..scene.len() {
            compare(&scene, &plain, row, row, size, 0.0);
            let values = row * 24..(row + 1) * 24;
            for (x, y) in scene.sh_rest[values.clone()].iter().zip(&plain.sh_rest[values]) {
                assert!((x - y).abs() <= rest, "{name} row {row}: {x} {y}");
            }
        }
    }
}

#[test]
fn parity_of_a_larger_scene() {
    let Some(ksplat) = shared("real/parity/biker.l1.ksplat") else { return };
    let a = read_file(&ksplat).scene;
    // Both come from the same scene, which was a compressed file itself, and have its order.
    for (name, size, color) in [
        ("real/objects/biker.compressed.ply", 4e-5, 0.0),
        ("real/parity/biker.compressed.ply", 1e-3, 0.5 / 255.0),
    ] {
        let Some(packed) = shared(name) else { continue };
        let b = open(&packed).scene;
        assert_eq!((a.len(), b.len()), (152_746, 152_746));
        for row in 0..a.len() {
            compare(&a, &b, row, row, size, color);
        }
    }
}

#[test]
fn counts_that_lie() {
    let good = ksplat(1, &sections());
    read(&good).unwrap();
    let with = |at: usize, value: u32| {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        read(&bytes)
    };
    let section = 4096;
    for (at, what) in [
        (4, "headers of sections"),
        (16, "counts 4294967295 Gaussians"),
        (20, "compression level 65535"),
        (section, "at most"),
        (section + 4, "Gaussians of 42 bytes"),
        (section + 8, "Gaussians in its buckets"),
        (section + 12, "centers of buckets"),
        (section + 20, "65535 bytes"),
        (section + 32, "centers"),
        (section + 36, "counts of buckets"),
        (section + 40, "degree 65535"),
    ] {
        let error = with(at, u32::MAX).unwrap_err().to_string();
        assert!(error.contains(what), "at {at}: {error}");
    }
    // Buckets that hold one too few or too many, and more than a bucket can.
    let fill = 4096 + 4 * 1024;
    for count in [2, 4, 5, 0, u32::MAX] {
        let error = with(fill, count).unwrap_err().to_string();
        assert!(error.contains("bucket"), "{count}: {error}");
    }
    assert!(with(section + 8, 0).is_err() && with(section + 32, 1).is_err());
    for (at, value) in [(16, 18), (16, 20), (16, 0), (section, 11), (4, 3), (4, 0)] {
        assert!(with(at, value).is_err(), "{value} at {at}");
    }
    let none = [&[0u8, 1][..], &[0; 4094]].concat();
    assert!(read(&none).unwrap_err().to_string().contains("no Gaussian"));
    assert!(read(&[&[1u8, 0][..], &[0; 4094]].concat()).unwrap_err().to_string().contains("1.0"));
    // Without sections the counts must not be believed either.
    let mut none = none;
    none[16] = 1;
    assert!(read(&none).unwrap_err().to_string().contains("sections hold 0"));
}

#[test]
fn labels_beside_the_file_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ksplat");
    let bytes = ksplat(1, &sections());
    std::fs::write(&path, &bytes).unwrap();
    let labels = semantics::encode(&labelled(19, 0), None).unwrap();
    // The file they belong to is in the metadata, which begins after eight bytes of length.
    let size = u64::from_le_bytes(labels[..8].try_into().unwrap()) as usize;
    let mut head: Value = serde_json::from_slice(&labels[8..8 + size]).unwrap();
    let about = &mut head["__metadata__"]["scenesplat_labels"];
    let mut text: Value = serde_json::from_str(about.as_str().unwrap()).unwrap();
    text["scene"] = json!({"bytes": bytes.len(), "crc32": crc32fast::hash(&bytes)});
    *about = text.to_string().into();
    let head = head.to_string();
    let length = (head.len() as u64).to_le_bytes();
    let beside = [&length[..], head.as_bytes(), &labels[8 + size..]].concat();
    std::fs::write(folder.path().join("a.ksplat.labels.safetensors"), beside).unwrap();
    assert_eq!(open(&path).scene.segment, labelled(19, 0).segment);
}
