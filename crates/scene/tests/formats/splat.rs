//! `.splat` files: reading, recognising, writing, damage.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::{SplitMix, random_scene, shared};
use half::f16;
use scenesplat_scene::formats::splat::{is_splat, read_splat, splat_problem, write_splat};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    GaussianScene, LanguageCode, LanguageCodebook, LoadedScene, Policy, ReadOptions, SceneError,
    SceneFormat, WriteOptions, WriteReport, open_scene,
};
use std::collections::HashMap;
use std::path::Path;

fn read(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    read_splat(bytes, Path::new("a.splat"), &ReadOptions::default())
}

fn read_file(path: &Path) -> LoadedScene {
    read_splat(&std::fs::read(path).unwrap(), path, &ReadOptions::default()).unwrap()
}

fn write(scene: &GaussianScene, path: &Path) -> WriteReport {
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    write_splat(scene, path, &options, &mut |_| true).unwrap()
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
    let strict = ReadOptions { policy: Policy::Strict, ..ReadOptions::default() };
    assert!(read_splat(&bytes, Path::new("a.splat"), &strict).is_err());
}

#[test]
fn real_files() {
    for (name, rows) in [
        ("real/scenes/arkit_brush/scene.splat", 116_906),
        ("real/fixtures/minimal.splat", 4),
        ("real/parity/playbot_lod4.splat", 8406),
        ("real/parity/biker.splat", 152_746),
    ] {
        let Some(path) = shared(name) else { continue };
        let bytes = std::fs::read(&path).unwrap();
        assert!(is_splat(&bytes), "{name}: {:?}", splat_problem(&bytes));
        let loaded = read_file(&path);
        assert_eq!((loaded.scene.len(), loaded.source_rows()), (rows, rows), "{name}");
        for bytes in [&bytes[..bytes.len() - 1], &bytes[..bytes.len() - 31]] {
            assert!(splat_problem(bytes).unwrap().contains("bytes more"));
            assert!(read(bytes).unwrap_err().to_string().contains("records of 32"));
        }
    }
    let Some(path) = shared("real/fixtures/minimal.splat") else { return };
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
        write(&random_scene(rows, 0, 3), &path);
        let mut bytes = std::fs::read(&path).unwrap();
        assert!(is_splat(&bytes), "{rows} rows");
        bytes[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(is_splat(&bytes), "{rows} rows, the first without a position");
    }
}

#[test]
fn what_is_written_is_recognised_or_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.splat");
    // Up to half of the Gaussians may be anywhere and of any size.
    for rows in [2usize, 10, 300, 3000] {
        let mut scene = random_scene(rows, 0, 5);
        for row in (1..rows).step_by(2) {
            (scene.coord[row][0], scene.log_scale[row][1]) = (-3e38, 88.0);
        }
        write(&scene, &path);
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(splat_problem(&bytes), None, "{rows} rows");
        let back = open_scene(&path, &ReadOptions::default()).unwrap();
        assert_eq!((back.kind, back.scene.coord), (SceneFormat::Splat, scene.coord.clone()));

        for row in 0..rows {
            scene.coord[row][2] = 1e20;
        }
        for overwrite in [false, true] {
            let options = WriteOptions { overwrite, ..WriteOptions::default() };
            let error = write_splat(&scene, &path, &options, &mut |_| true).unwrap_err();
            let text = error.to_string();
            assert!(text.contains("looked at 0 have a position within ±1e9 m"), "{text}");
            assert!(text.contains("scale the scene to metres"), "{text}");
        }
        assert!(bytes == std::fs::read(&path).unwrap(), "the old file is as it was");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
    let text = splat_problem(&[128; 3200]).unwrap();
    assert!(text.contains("of 100 records looked at 0 have a finite position"), "{text}");
}

/// Scenes that are hard to keep as they are.
fn hard_scenes() -> Vec<(&'static str, GaussianScene)> {
    let mut all = Vec::new();
    for rows in [1, 2, 255, 256, 257, 5000] {
        all.push(("random", random_scene(rows, 0, rows as u64)));
    }
    let mut rng = SplitMix(11);
    let mut extreme = random_scene(600, 0, 1);
    for row in 0..600 {
        // With more of them the file would not be recognised.
        if row % 2 == 0 {
            extreme.coord[row] = [(); 3].map(|()| f32::from_bits(rng.next() as u32 & 0xff7f_ffff));
            extreme.log_scale[row] = [(); 3].map(|()| rng.float() * 120.0);
        }
        extreme.opacity_logit[row] = rng.float() * 30.0;
        extreme.sh_dc[row] = [(); 3].map(|()| rng.float() * 5.0);
        extreme.quat[row] =
            [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.5, -0.5, 0.5, -0.5]][row % 3];
    }
    for (row, logit) in [(0, f32::INFINITY), (1, f32::NEG_INFINITY), (2, -0.0)] {
        extreme.opacity_logit[row] = logit;
        extreme.log_scale[row][1] = f32::NEG_INFINITY;
    }
    extreme.log_scale[6] = [f32::MAX, f32::MIN, -0.0];
    extreme.log_scale[4] = [88.722_84, 88.722_83, -103.5];
    all.push(("extreme", extreme));
    all
}

#[test]
fn what_was_written_comes_back_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["a.splat", "b.splat"].map(|name| folder.path().join(name));
    let mut scenes = hard_scenes();
    for name in ["real/parity/playbot_lod4.splat", "real/scenes/arkit_brush/scene.splat"] {
        scenes.extend(shared(name).map(|path| (name, read_file(&path).scene)));
    }
    for name in ["real/parity/playbot_lod4.ply", "real/objects/tmp_model_unnormalised.ply"] {
        let open = |path: std::path::PathBuf| open_scene(&path, &ReadOptions::default()).unwrap();
        scenes.extend(shared(name).map(|path| (name, open(path).scene)));
    }
    for (name, scene) in scenes {
        let report = write(&scene, &first);
        assert_eq!((report.gaussians, report.format), (scene.len(), SceneFormat::Splat));
        assert_eq!(report.bytes, 32 * scene.len() as u64);
        assert!(report.order.is_none());
        let back = read_file(&first).scene;
        assert_eq!(back.len(), scene.len(), "{name}: no row is lost");
        let again = write(&back, &second);
        assert!(again.limits.is_empty(), "{name}: nothing is lost a second time: {again}");
        assert_eq!(std::fs::read(&first).unwrap(), std::fs::read(&second).unwrap(), "{name}");
        assert_eq!(back.coord, scene.coord, "{name}");
        for row in 0..scene.len() {
            let dot: f32 = (0..4).map(|i| back.quat[row][i] * scene.quat[row][i]).sum();
            assert!(dot.abs() > 0.999_9, "{name} row {row}");
            assert!((back.opacity(row) - scene.opacity(row)).abs() < 0.502 / 255.0, "{name}");
        }
    }
}

#[test]
fn bytes_of_other_programs_are_kept_where_they_can_be() {
    let Some(path) = shared("real/scenes/arkit_brush/scene.splat") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.splat");
    write(&read_file(&path).scene, &out);
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

#[test]
fn limits_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.splat");
    let mut scene = random_scene(40, 2, 4);
    scene.sh_dc = vec![[0.5; 3]; 40];
    scene.opacity_logit = vec![0.0; 40];
    scene.sh_dc[7] = [0.0, 2.0, -3.0];
    scene.sh_dc[9] = [1.772_454, -1.772_454, 1.775];
    scene.opacity_logit[3] = -7.0;
    scene.opacity_logit[5] = 9.0;
    scene.opacity_logit[6] = f32::INFINITY;
    scene.log_scale[11][2] = 90.0;
    scene.log_scale[12][0] = -200.0;
    scene.log_scale[13][0] = f32::NEG_INFINITY;
    scene.log_scale[14] = [-110.0; 3];
    let report = write(&scene, &path);
    let find = |field: &str, word: &str| {
        let mut found = report.limits.iter().filter(|l| l.field == field && l.limit.contains(word));
        let limit = found.next().unwrap();
        (limit.rows, limit.first_row, limit.largest_change)
    };
    let color = find("sh_dc", "clipped");
    assert_eq!((color.0, color.1), (1, 7));
    assert!((color.2 - (3.0 - 1.772_454)).abs() < 1e-5, "{color:?}");
    let alpha = find("opacity_logit", "0 or 1");
    assert_eq!((alpha.0, alpha.1), (2, 3));
    assert!((alpha.2 - 1.0 / (1.0 + 7f64.exp())).abs() < 1e-9, "{alpha:?}");
    let large = find("log_scale", "larger");
    assert_eq!((large.0, large.1), (1, 11));
    assert!((large.2 - (90.0 - 88.722_84)).abs() < 1e-4, "{large:?}");
    assert_eq!(find("log_scale", "becomes 0"), (2, 12, f64::INFINITY));
    assert_eq!(find("sh_rest", "no place").0, 40);
    assert_eq!(report.limits.len(), 5, "{report}");
    assert!(write(&random_scene(40, 0, 4), &path).limits.len() <= 2);
}

#[test]
fn labels_and_codes_travel_beside_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.splat");
    let mut scene = random_scene(300, 0, 4);
    scene.segment = Some((0..300).map(|i| i % 21 - 1).collect());
    scene.instance = Some((0..300).map(|i| i / 3).collect());
    scene.segment_score = Some((0..300).map(|i| i as f32 * 0.25).collect());
    let codebook = LanguageCodebook { mean: vec![0.5; 6], axes: vec![0.25; 12] };
    let values = (0..600).map(|i| f16::from_f32(i as f32)).collect();
    scene.lang_code = Some(LanguageCode { values, codebook });
    let report = write(&scene, &path);
    assert_eq!(report.files.len(), 2);
    let back = read_file(&path).scene;
    assert_eq!(
        (&back.segment, &back.instance, &back.segment_score, &back.lang_code),
        (&scene.segment, &scene.instance, &scene.segment_score, &scene.lang_code)
    );
    let sidecar = std::fs::read(&report.files[1]).unwrap();
    write(&back, &path);
    assert_eq!(std::fs::read(&report.files[1]).unwrap(), sidecar);
}

#[test]
fn stopping_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.splat");
    let scene = random_scene(70_000, 0, 4);
    let mut seen = Vec::new();
    let stopped = write_splat(&scene, &path, &WriteOptions::default(), &mut |done| {
        seen.push(done);
        seen.len() < 2
    });
    assert!(matches!(stopped, Err(SceneError::Stopped)));
    assert!(seen.len() == 2 && seen[0] > 0.0 && seen[1] > seen[0] && seen[1] < 1.0);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);

    let mut broken = random_scene(3, 0, 1);
    broken.coord[1][2] = f32::NAN;
    let error = write_splat(&broken, &path, &WriteOptions::default(), &mut |_| true).unwrap_err();
    assert!(error.to_string().contains("element 1") && error.to_string().contains("coord"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
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
        let b = open_scene(&other, &ReadOptions::default()).unwrap().scene;
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
            let dot: f32 = (0..4).map(|i| a.quat[row][i] * b.quat[other][i]).sum();
            assert!(dot.abs() > 0.999_8, "row {row}: {dot}");
        }
    }
}

#[test]
fn damage_is_an_error_or_the_right_number_of_rows() {
    let Some(path) = shared("real/fixtures/minimal.splat") else { return };
    let fixture = std::fs::read(path).unwrap();
    for length in 0..fixture.len() {
        let result = read(&fixture[..length]);
        match length % 32 {
            0 if length > 0 => assert_eq!(result.unwrap().source_rows(), length / 32),
            _ => assert!(result.is_err(), "cut at {length}"),
        }
    }
    let mut rng = SplitMix(5);
    let mut refused = 0;
    for round in 0..2000 {
        let mut bytes = fixture.clone();
        for _ in 0..=rng.below(4) {
            let at = rng.below(bytes.len());
            bytes[at] = rng.next() as u8;
        }
        if rng.below(4) == 0 {
            bytes.truncate(rng.below(bytes.len()));
        }
        let result = std::panic::catch_unwind(|| (splat_problem(&bytes), read(&bytes)));
        match result {
            Ok((_, Ok(loaded))) => assert_eq!(loaded.source_rows() * 32, bytes.len()),
            Ok((_, Err(_))) => refused += 1,
            Err(_) => panic!("round {round}: {bytes:?}"),
        }
    }
    assert!((300..700).contains(&refused), "{refused}: cut files and no others");
}
