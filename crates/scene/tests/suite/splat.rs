//! `.splat` files: reading, recognizing, writing.

use crate::common::{SplitMix, dot, open, random_scene, shared, strict, write, write_as};
use scenesplat_scene::formats::splat::{is_splat, read_splat, splat_problem};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    GaussianScene, LoadedScene, ReadOptions, SceneError, SceneFormat, WriteOptions,
};
use std::collections::HashMap;
use std::path::Path;

fn read(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    read_splat(bytes, Path::new("a.splat"), &ReadOptions::default())
}

fn read_file(path: &Path) -> LoadedScene {
    read_splat(&std::fs::read(path).unwrap(), path, &ReadOptions::default()).unwrap()
}

fn record(coord: [f32; 3], scale: [f32; 3], color: [u8; 4], rotation: [u8; 4]) -> Vec<u8> {
    let floats = coord.into_iter().chain(scale).flat_map(f32::to_le_bytes);
    floats.chain(color).chain(rotation).collect()
}

#[test]
fn a_record_by_hand() {
    let bytes = record([1.5, -2.0, 1e-3], [0.5, 0.0, 2.0], [0, 51, 255, 102], [192, 64, 192, 64]);
    let loaded = read(&bytes).unwrap();
    let scene = &loaded.scene;
    assert_eq!(loaded.kind, SceneFormat::Splat);
    assert_eq!(scene.coord, [[1.5, -2.0, 1e-3]]);
    assert_eq!(scene.log_scale, [[0.5f32.ln(), f32::NEG_INFINITY, 2.0f32.ln()]]);
    assert_eq!(scene.quat, [[0.5, -0.5, 0.5, -0.5]]);
    assert_eq!(scene.color_u8(0), [0, 51, 255]);
    assert!((scene.opacity(0) - 0.4).abs() < 1e-6);
    assert!((scene.sh_dc[0][1] - (0.2 - 0.5) / 0.282_094_8).abs() < 1e-6);
    assert_eq!(loaded.report.count(Rule::ScaleZero), 1);
}

#[test]
fn values_without_a_meaning_follow_the_policy() {
    let good = record([0.0; 3], [0.1; 3], [1, 2, 3, 4], [255, 128, 128, 128]);
    let negative = record([0.0; 3], [0.1, -0.1, 0.1], [0; 4], [255, 128, 128, 128]);
    let nan = record([f32::NAN, 0.0, 0.0], [0.1; 3], [0; 4], [255, 128, 128, 128]);
    let still = record([0.0; 3], [0.1; 3], [0, 0, 0, 255], [128; 4]);
    let bytes = [good, negative, nan, still].concat();
    let loaded = read(&bytes).unwrap();
    assert_eq!((loaded.scene.len(), loaded.source_rows()), (2, 4));
    assert_eq!(loaded.kept_rows, Some(vec![0, 3]));
    for (rule, first) in [(Rule::ScaleNan, 1), (Rule::CoordNotFinite, 2), (Rule::QuatZero, 3)] {
        assert_eq!(loaded.report.finding(rule).unwrap().first_element, first, "{rule:?}");
    }
    assert_eq!(loaded.scene.opacity_logit[1], f32::INFINITY);
    assert_eq!(loaded.scene.quat[1], [1.0, 0.0, 0.0, 0.0]);
    assert!(read_splat(&bytes, Path::new("a.splat"), &strict()).is_err());
}

#[test]
fn the_smallest_real_file() {
    let Some(path) = shared("real/fixtures/minimal.splat") else { return };
    let bytes = std::fs::read(&path).unwrap();
    for bytes in [&bytes[..bytes.len() - 1], &bytes[..bytes.len() - 31]] {
        assert!(splat_problem(bytes).unwrap().contains("bytes more"));
        assert!(read(bytes).unwrap_err().to_string().contains("records of 32"));
    }
    let scene = read_file(&path).scene;
    assert_eq!(scene.coord, [[-1.0, 0.0, -1.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0; 3]]);
    assert_eq!(scene.color_u8(1), [0xaa, 0x55, 0x80]);
    assert_eq!(scene.quat[0], [0.0, 0.0, 0.0, 1.0]);
    assert!((scene.opacity(3) - 230.0 / 255.0).abs() < 1e-6);
}

#[test]
fn other_files_are_not_splats() {
    for name in [
        "real/fixtures/minimal.ksplat",
        "real/fixtures/unitCube-ascii.ply",
        "real/fixtures/minimal-v4.spz",
        "real/objects/hamburger.ply",
        "real/objects/biker.compressed.ply",
        "real/objects/monkey_0001.sog",
        "real/posed/test_garden.npz",
        "real/scenes/arkit_brush/cameras.json",
        "real/parity/playbot_lod4.l2.ksplat",
    ] {
        let Some(path) = shared(name) else { continue };
        let bytes = std::fs::read(path).unwrap();
        let whole = bytes.len() / 32 * 32;
        assert!(!is_splat(&bytes[..whole]), "{name}");
    }
    let mut rng = SplitMix(1);
    let noise: Vec<u8> = (0..32 * 400).map(|_| rng.next() as u8).collect();
    let text = "the quick brown fox, 0.25, 17\n".repeat(32);
    // Floats of about 1 and less, whose last four look like nothing or like a rotation.
    let floats: Vec<u8> = (0..8 * 64).flat_map(|i| (i as f32 * 0.01).to_le_bytes()).collect();
    let numbers = "=0.1>0.2?<0.3;".repeat(64);
    let at = |x: f32| record([x, 0.0, 0.0], [0.1; 3], [9; 4], [255, 128, 128, 128]);
    let far = [vec![at(2e9); 51].concat(), vec![at(2.0); 49].concat()].concat();
    for (bytes, what) in [
        (&noise[..], "noise"),
        (&[0; 3200][..], "zeros"),
        (&[255; 3200][..], "ones"),
        (&[128; 3200][..], "128"),
        (&text.as_bytes()[..text.len() / 32 * 32], "text"),
        (&numbers.as_bytes()[..numbers.len() / 32 * 32], "numbers"),
        (&floats[..], "floats"),
        (&far[..], "records of which most are too far away"),
        (&[], "nothing"),
    ] {
        assert!(splat_problem(bytes).is_some(), "{what}");
    }
}

#[test]
fn a_few_bad_records_do_not_hide_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.splat");
    for rows in [2usize, 5, 300, 1000] {
        write(&random_scene(rows, 0, 3), &path, SceneFormat::Splat);
        let mut bytes = std::fs::read(&path).unwrap();
        assert!(is_splat(&bytes), "{rows} rows");
        bytes[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(is_splat(&bytes), "{rows} rows, the first without a position");
    }
}

#[test]
fn what_is_written_is_recognized_or_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.splat");
    // Up to half of the Gaussians may be anywhere and of any size.
    for rows in [2usize, 10, 300, 3000] {
        let mut scene = random_scene(rows, 0, 5);
        for row in (1..rows).step_by(2) {
            (scene.coord[row][0], scene.log_scale[row][1]) = (-3e38, 88.0);
        }
        let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
        write_as(&scene, &path, SceneFormat::Splat, &options).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(splat_problem(&bytes), None, "{rows} rows");
        let back = open(&path);
        assert_eq!((back.kind, back.scene.coord), (SceneFormat::Splat, scene.coord.clone()));

        for row in 0..rows {
            scene.coord[row][2] = 1e20;
        }
        for path in [&path, &folder.path().join("new.splat")] {
            let error = write_as(&scene, path, SceneFormat::Splat, &options).unwrap_err();
            let text = error.to_string();
            assert!(text.contains("looked at 0 have a position within ±1e9 m"), "{text}");
            assert!(text.contains("scale the scene to meters"), "{text}");
        }
        assert!(bytes == std::fs::read(&path).unwrap(), "the old file is as it was");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
    let text = splat_problem(&[128; 3200]).unwrap();
    assert!(text.contains("of 100 records looked at 0 have a finite position"), "{text}");
}

#[test]
fn bytes_of_other_programs_are_kept_where_they_can_be() {
    let Some(path) = shared("real/scenes/arkit_brush/scene.splat") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.splat");
    write(&read_file(&path).scene, &out, SceneFormat::Splat);
    let (old, new) = (std::fs::read(&path).unwrap(), std::fs::read(&out).unwrap());
    assert_eq!(old.len(), new.len());
    for (old, new) in old.chunks_exact(32).zip(new.chunks_exact(32)) {
        assert_eq!((&old[..12], &old[24..28]), (&new[..12], &new[24..28]));
        for (a, b) in old[12..24].as_chunks::<4>().0.iter().zip(new[12..24].as_chunks::<4>().0) {
            let (a, b) = (f32::from_le_bytes(*a), f32::from_le_bytes(*b));
            // The logarithm is an f32 too, of magnitude up to 20.
            assert!((a - b).abs() <= a * 1e-6, "{a} {b}");
        }
    }
}

/// For each row of `a` the row of `b` at the same place that is most like it.
fn matching_rows(a: &GaussianScene, b: &GaussianScene, reach: f32) -> Vec<usize> {
    let cell = |v: f32| (v / reach).round() as i64;
    let mut cells = HashMap::<[i64; 3], Vec<usize>>::new();
    for (row, coord) in b.coord.iter().enumerate() {
        cells.entry(coord.map(cell)).or_default().push(row);
    }
    let unlike = |x: usize, y: usize| {
        let parts = [(a.coord[x], b.coord[y]), (a.log_scale[x], b.log_scale[y])];
        let parts = parts.into_iter().chain([(a.sh_dc[x], b.sh_dc[y])]);
        parts.map(|(x, y)| (0..3).map(|i| (x[i] - y[i]).powi(2)).sum::<f32>()).sum::<f32>()
    };
    let find = |row: usize| {
        let at = a.coord[row].map(cell);
        let around = (0..27).map(|i| [at[0] + i % 3 - 1, at[1] + i / 3 % 3 - 1, at[2] + i / 9 - 1]);
        let found = around.filter_map(|cell| cells.get(&cell)).flatten().copied();
        found.min_by(|&x, &y| unlike(row, x).total_cmp(&unlike(row, y))).unwrap()
    };
    (0..a.len()).map(find).collect()
}

#[test]
fn parity_with_the_same_scene_in_other_formats() {
    for (splat, other, size) in [
        ("real/parity/playbot_lod4.splat", "real/parity/playbot_lod4.ply", 0.0),
        // Interpolated by other software, so not to the last bit.
        ("real/parity/biker.splat", "real/objects/biker.compressed.ply", 1e-6),
    ] {
        let (Some(splat), Some(other)) = (shared(splat), shared(other)) else { continue };
        let a = read_file(&splat).scene;
        let b = open(&other).scene;
        assert_eq!(a.len(), b.len());
        // These files are sorted, the most visible first.
        let matched = matching_rows(&a, &b, 1e-5);
        let mut all = matched.clone();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), a.len(), "every row is found once");
        for (row, &other) in matched.iter().enumerate() {
            for i in 0..3 {
                let (x, y) = (a.coord[row][i], b.coord[other][i]);
                assert!((x - y).abs() <= size, "row {row}: {x} {y}");
                let (x, y) = (a.log_scale[row][i], b.log_scale[other][i]);
                assert!((x - y).abs() <= 1e-5, "row {row}: {x} {y}");
                let shown = |dc: f32| (0.5 + 0.282_094_8 * dc).clamp(0.0, 1.0);
                let (x, y) = (shown(a.sh_dc[row][i]), shown(b.sh_dc[other][i]));
                // The bytes were cut off, not rounded.
                assert!((x - y).abs() <= 1.001 / 255.0, "row {row}: {x} {y}");
            }
            assert!((a.opacity(row) - b.opacity(other)).abs() <= 1.001 / 255.0);
            assert!(dot(&a.quat[row], &b.quat[other]) > 0.999_8, "row {row}");
        }
    }
}
