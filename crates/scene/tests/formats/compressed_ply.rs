//! Compressed PLY files: reading, writing, damage. More of the reading is in `real_files`.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::{SplitMix, random_scene, shared};
use half::f16;
use scenesplat_scene::formats::compressed_ply::write_compressed_ply;
use scenesplat_scene::formats::ply::{ColumnValues, PlyColumn, PlyFile, write_ply_with_columns};
use scenesplat_scene::{
    GaussianScene, LanguageCode, LanguageCodebook, LoadedScene, ReadOptions, SceneError,
    SceneFormat, WriteOptions, WriteReport, open_scene,
};
use std::path::Path;

fn open(path: &Path) -> LoadedScene {
    let loaded = open_scene(path, &ReadOptions::default()).unwrap();
    assert_eq!(loaded.kind, SceneFormat::CompressedPly);
    loaded
}

fn write(scene: &GaussianScene, path: &Path) -> WriteReport {
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    write_compressed_ply(scene, path, &options, &mut |_| true).unwrap()
}

#[test]
fn real_files() {
    for (name, rows, degree) in [
        ("real/objects/biker.compressed.ply", 152_746, 0),
        ("real/objects/guitar.compressed.ply", 90_854, 0),
        ("real/parity/biker.compressed.ply", 152_746, 0),
        ("real/parity/playbot_lod4.compressed.ply", 8406, 2),
    ] {
        let Some(path) = shared(name) else { continue };
        let loaded = open(&path);
        assert_eq!((loaded.scene.len(), loaded.scene.sh_degree), (rows, degree), "{name}");
        assert!(loaded.report.is_clean());
        let bare = ReadOptions { sh_rest: false, ..ReadOptions::default() };
        let bare = open_scene(&path, &bare).unwrap().scene;
        assert_eq!((bare.sh_degree, bare.sh_rest.len()), (0, 0));
        assert_eq!(bare.sh_dc, loaded.scene.sh_dc);
    }
}

/// The same file with other encodings of its numbers: `packed` as `int`, coefficients as floats.
fn as_text(path: &Path, big: bool) -> Vec<u8> {
    let file = PlyFile::open(path).unwrap();
    let encoding = if big { "binary_big_endian" } else { "ascii" };
    let mut out = format!("ply\nformat {encoding} 1.0\n").into_bytes();
    let mut data = Vec::new();
    for element in file.elements() {
        out.extend(format!("element {} {}\n", element.name, element.count).bytes());
        let ty = ["float", "int", "float"]
            [["chunk", "vertex", "sh"].iter().position(|n| *n == element.name).unwrap()];
        let mut columns = Vec::new();
        for property in &element.properties {
            out.extend(format!("property {ty} {}\n", property.name).bytes());
            columns.push(file.column_f64(&element.name, &property.name).unwrap());
        }
        for row in 0..element.count {
            for column in &columns {
                let value = column[row];
                match (ty, big) {
                    ("int", true) => data.extend((value as u32).to_be_bytes()),
                    ("int", false) => data.extend(format!("{} ", value as u32 as i32).bytes()),
                    (_, true) => data.extend((value as f32).to_be_bytes()),
                    (_, false) => data.extend(format!("{} ", value as f32).bytes()),
                }
            }
            if !big {
                data.push(b'\n');
            }
        }
    }
    out.extend(b"end_header\n");
    out.extend(data);
    out
}

#[test]
fn other_encodings_hold_the_same_scene() {
    let folder = tempfile::tempdir().unwrap();
    let [path, other] = ["a.ply", "b.ply"].map(|name| folder.path().join(name));
    let scene = random_scene(300, 2, 1);
    write(&scene, &path);
    let due = open(&path).scene;
    for big in [true, false] {
        std::fs::write(&other, as_text(&path, big)).unwrap();
        assert_eq!(open(&other).scene, due, "big-endian: {big}");
    }
    // Words cannot be floats.
    let text = as_text(&path, true);
    let at = text.windows(11).position(|w| w == b"end_header\n").unwrap();
    let head = String::from_utf8(text[..at].to_vec()).unwrap();
    let head = head.replace("int packed_scale", "float packed_scale");
    std::fs::write(&other, [head.as_bytes(), &text[at..]].concat()).unwrap();
    let error = open_scene(&other, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("packed_scale") && error.contains("float"), "{error}");
}

/// Values of both scenes, the second in the order of the first, are equal within the steps.
fn check_close(scene: &GaussianScene, back: &GaussianScene, order: Option<&[u32]>, what: &str) {
    let rows: Vec<usize> =
        (0..scene.len()).map(|row| order.map_or(row, |order| order[row] as usize)).collect();
    let scene = scene.select_rows(&rows).unwrap();
    let color = |dc: &[f32; 3], i: usize| f64::from(dc[i]) * 0.282_094_8 + 0.5;
    for first in (0..scene.len()).step_by(256) {
        let rows = first..(first + 256).min(scene.len());
        for axis in 0..3 {
            type Value<'a> = &'a dyn Fn(&GaussianScene, usize) -> f64;
            let coord = |s: &GaussianScene, row: usize| f64::from(s.coord[row][axis]);
            let scale = |s: &GaussianScene, row: usize| {
                f64::from(s.log_scale[row][axis].clamp(-20.0, 20.0))
            };
            let shown = |s: &GaussianScene, row: usize| color(&s.sh_dc[row], axis);
            let steps = [2047.0, 1023.0, 2047.0][axis];
            let all: [(Value<'_>, f64); 3] = [(&coord, steps), (&scale, steps), (&shown, 255.0)];
            for (value, steps) in all {
                let min = rows.clone().map(|r| value(&scene, r)).fold(f64::INFINITY, f64::min);
                let max = rows.clone().map(|r| value(&scene, r)).fold(f64::NEG_INFINITY, f64::max);
                for row in rows.clone() {
                    let (x, y) = (value(&scene, row), value(back, row));
                    let allowed = (max - min) / steps * 0.501 + (x.abs() + 1.0) * 3e-7;
                    assert!((x - y).abs() <= allowed, "{what} row {row}: {x} {y}");
                }
            }
        }
        for row in rows {
            let dot: f32 = (0..4).map(|i| scene.quat[row][i] * back.quat[row][i]).sum();
            assert!(dot.abs() > 0.999_98, "{what} row {row}: {dot}");
            assert!((scene.opacity(row) - back.opacity(row)).abs() < 0.501 / 255.0, "{what}");
        }
    }
    let kept = back.sh_rest_len() * 3;
    for row in 0..scene.len() {
        let width = scene.sh_rest_len() * 3;
        let (x, y) = (&scene.sh_rest[row * width..], &back.sh_rest[row * kept..]);
        for (x, y) in x[..kept].iter().zip(&y[..kept]) {
            assert!((x.clamp(-4.0, 4.0) - y).abs() <= 8.0 / 256.0, "{what} row {row}: {x} {y}");
        }
    }
}

/// Writes, reads and writes again; gives what the first time said.
fn check_fixed_point(scene: &GaussianScene, what: &str) -> WriteReport {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["a.ply", "b.ply"].map(|name| folder.path().join(name));
    let report = write(scene, &first);
    assert_eq!((report.gaussians, report.format), (scene.len(), SceneFormat::CompressedPly));
    let loaded = open(&first);
    let back = &loaded.scene;
    assert_eq!(back.len(), scene.len(), "{what}: no row is lost");
    assert_eq!(back.sh_degree, scene.sh_degree.min(3));
    check_close(scene, back, report.order.as_deref(), what);
    let again = write(back, &second);
    assert!(again.limits.is_empty(), "{what}: nothing is lost a second time: {again}");
    assert!(again.order.is_none(), "{what}: the order is kept");
    assert!(std::fs::read(&first).unwrap() == std::fs::read(&second).unwrap(), "{what}");
    report
}

#[test]
fn random_scenes_come_back_byte_for_byte() {
    for rows in [1, 2, 255, 256, 257, 511, 513, 3000] {
        for degree in 0..=4 {
            let scene = random_scene(rows, degree, rows as u64 + u64::from(degree));
            let report = check_fixed_point(&scene, &format!("{rows} rows, degree {degree}"));
            assert_eq!(report.order.is_some(), rows >= 3000, "{rows}");
        }
    }
}

#[test]
fn hard_scenes_come_back_byte_for_byte() {
    let mut rng = SplitMix(2);
    let mut extreme = random_scene(1000, 1, 1);
    for row in 0..1000 {
        // Any finite number.
        extreme.coord[row] = [(); 3].map(|()| f32::from_bits(rng.next() as u32 & 0xff7f_ffff));
        extreme.log_scale[row] = [(); 3].map(|()| rng.float() * 40.0);
        extreme.opacity_logit[row] = rng.float() * 30.0;
        extreme.quat[row] =
            [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.5, -0.5, 0.5, -0.5]][row % 3];
        extreme.sh_dc[row] = [(); 3].map(|()| rng.float() * 10f32.powi(rng.below(9) as i32 - 4));
        extreme.sh_rest[row] = rng.float() * 100.0;
    }
    extreme.opacity_logit[0] = f32::INFINITY;
    extreme.opacity_logit[999] = f32::NEG_INFINITY;
    extreme.log_scale[3] = [f32::NEG_INFINITY; 3];
    check_fixed_point(&extreme, "extreme");

    let same = random_scene(1, 3, 5).select_rows(&[0; 700]).unwrap();
    assert!(check_fixed_point(&same, "identical rows").order.is_none());

    for width in [1e-3f32, 1e-5, 1e-6, 3e-7, 1e-7, 1e-20, 1e-40] {
        for middle in [0.0f32, 1.0, -1000.0] {
            let mut tiny = random_scene(600, 1, 9);
            for row in 0..600 {
                tiny.coord[row] = [(); 3].map(|()| middle + rng.float() * width);
                tiny.log_scale[row] =
                    [(); 3].map(|()| middle.clamp(-20.0, 20.0) + rng.float() * width);
                tiny.sh_dc[row] = [(); 3].map(|()| middle + rng.float() * width);
            }
            check_fixed_point(&tiny, &format!("{width} about {middle}"));
        }
    }
    // Orders that are barely good enough, or barely not: the decision must stand.
    for round in 0..120 {
        let mut scene = random_scene(257 + rng.below(1500), 0, round);
        let rows = scene.len();
        scene.coord.sort_by(|a, b| a[0].total_cmp(&b[0]));
        for coord in &mut scene.coord {
            coord[1] *= 0.02 * (round % 12) as f32;
            coord[2] *= 0.02 * (round / 12) as f32;
        }
        for _ in 0..rng.below(8) {
            let (i, j) = (rng.below(rows), rng.below(rows));
            scene.coord.swap(i, j);
        }
        check_fixed_point(&scene, &format!("barely {round}"));
    }
}

#[test]
fn real_scenes_come_back_byte_for_byte() {
    for name in [
        "real/parity/playbot_lod4.ply",
        "real/objects/guitar.compressed.ply",
        "real/objects/hamburger.ply",
    ] {
        let Some(path) = shared(name) else { continue };
        let scene = open_scene(&path, &ReadOptions::default()).unwrap().scene;
        let report = check_fixed_point(&scene, name);
        println!("{name}: {report}");
        // What this format already held keeps its order.
        assert!(!name.contains("compressed") || report.order.is_none());
    }
}

#[test]
fn the_file_has_the_elements_that_old_readers_expect() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    for degree in [0, 3] {
        let mut scene = random_scene(300, degree, 1);
        scene.segment = Some(vec![3; 300]);
        write(&scene, &path);
        let file = PlyFile::open(&path).unwrap();
        let names: Vec<_> = file.elements().iter().map(|e| (e.name.as_str(), e.count)).collect();
        let due = [("chunk", 2), ("vertex", 300), ("sh", 300)];
        assert_eq!(names, due[..if degree == 0 { 2 } else { 3 }]);
        let chunk = &file.elements()[0].properties;
        assert_eq!(
            (chunk.len(), chunk[0].name.as_str(), chunk[17].name.as_str()),
            (18, "min_x", "max_b")
        );
        let packed = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
        assert!(file.elements()[1].properties.iter().map(|p| p.name.as_str()).eq(packed));
        assert_eq!(file.trailing_bytes(), 0);
        // The last chunk has bounds of its own rows.
        let bounds = file.rows_f32("chunk", ["min_x", "max_x"]).unwrap();
        let scene = open(&path).scene;
        for (chunk, bounds) in bounds.iter().enumerate() {
            let rows = chunk * 256..(chunk * 256 + 256).min(300);
            let xs = || scene.coord[rows.clone()].iter().map(|c| c[0]);
            assert_eq!(*bounds, [xs().fold(9e9, f32::min), xs().fold(-9e9, f32::max)]);
        }
    }
}

#[test]
fn limits_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let mut scene = random_scene(700, 4, 4);
    scene.opacity_logit = vec![0.0; 700];
    scene.opacity_logit[600] = 8.0;
    scene.opacity_logit[601] = f32::INFINITY;
    scene.log_scale[10] = [-25.0, 0.0, 21.0];
    scene.log_scale[5][1] = f32::NEG_INFINITY;
    scene.log_scale[6] = [20.0, -20.0, 0.0];
    scene.sh_rest[72 * 8 + 1] = 4.5;
    scene.sh_rest[72 * 9] = -6.0;
    scene.sh_rest[72 * 12 + 60] = 100.0;
    scene.sh_dc[80][0] = -1e33;
    let report = write(&scene, &path);
    let found: Vec<_> =
        report.limits.iter().map(|l| (l.field, l.rows, l.first_row, l.largest_change)).collect();
    assert_eq!(found[0], ("log_scale", 2, 5, f64::INFINITY));
    assert_eq!((found[1].0, found[1].1, found[1].2), ("opacity_logit", 1, 600));
    assert!((found[1].3 - 1.0 / (1.0 + 8f64.exp())).abs() < 1e-9);
    assert_eq!((found[2].0, found[2].1, found[2].2), ("sh_dc", 1, 80));
    // The one in band 4 is beyond the format anyway.
    assert_eq!(found[3], ("sh_rest", 2, 8, 2.0));
    assert_eq!((found[4].0, found[4].1), ("sh_rest", 700));
    assert_eq!(found.len(), 5, "{report}");
}

fn labelled(rows: usize) -> GaussianScene {
    let mut scene = random_scene(rows, 1, 4);
    let n = rows as i32;
    scene.segment = Some((0..n).map(|i| i % 21 - 1).collect());
    scene.instance = Some((0..n).map(|i| i / 3).collect());
    scene.segment_score = Some((0..n).map(|i| i as f32 * 0.25).collect());
    let codebook = LanguageCodebook { mean: vec![0.5; 6], axes: vec![0.25; 12] };
    let values = (0..2 * n).map(|i| f16::from_f32(i as f32)).collect();
    scene.lang_code = Some(LanguageCode { values, codebook });
    scene
}

#[test]
fn labels_and_codes_follow_their_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.compressed.ply");
    for rows in [200, 6000] {
        let scene = labelled(rows);
        let report = write(&scene, &path);
        assert_eq!((report.files.len(), report.order.is_some()), (2, rows > 256));
        let order: Vec<usize> = match &report.order {
            Some(order) => order.iter().map(|&row| row as usize).collect(),
            None => (0..rows).collect(),
        };
        let due = scene.select_rows(&order).unwrap();
        let back = open(&path).scene;
        assert_eq!(
            (&back.segment, &back.instance, &back.segment_score, &back.lang_code),
            (&due.segment, &due.instance, &due.segment_score, &due.lang_code)
        );
        let sidecar = std::fs::read(&report.files[1]).unwrap();
        write(&back, &path);
        assert_eq!(std::fs::read(&report.files[1]).unwrap(), sidecar);
    }
}

#[test]
fn columns_added_to_the_vertices_are_still_read() {
    let folder = tempfile::tempdir().unwrap();
    let [path, out] = ["a.ply", "b.ply"].map(|name| folder.path().join(name));
    let scene = random_scene(300, 1, 4);
    write(&scene, &path);
    let source = PlyFile::open(&path).unwrap();
    let label: Vec<i32> = (0..300).collect();
    let columns = [
        PlyColumn { name: "label", values: ColumnValues::I32(&label) },
        PlyColumn { name: "instance", values: ColumnValues::I32(&label) },
    ];
    write_ply_with_columns(&source, &[], &columns, &out).unwrap();
    let mut back = open(&out).scene;
    assert_eq!((back.segment.take(), back.instance.take()), (Some(label.clone()), Some(label)));
    assert_eq!(back, open(&path).scene);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let scene = labelled(20_000);
    let result = |threads: usize| {
        let path = folder.path().join(format!("{threads}.ply"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (report, back) = pool.install(|| (write(&scene, &path), open(&path).scene));
        (report.order, report.limits, std::fs::read(&path).unwrap(), back)
    };
    let one = result(1);
    assert!(one.0.is_some() && one == result(3));
}

#[test]
fn stopping_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let scene = random_scene(70_000, 0, 4);
    let mut calls = 0;
    loop {
        let mut left = calls;
        let result = write_compressed_ply(&scene, &path, &WriteOptions::default(), &mut |_| {
            left -= 1;
            left >= 0
        });
        if result.is_ok() {
            break;
        }
        assert!(matches!(result, Err(SceneError::Stopped)));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "after {calls} calls");
        calls += 1;
    }
    assert!(calls > 3, "{calls}");
    let mut broken = random_scene(3, 0, 1);
    broken.sh_dc[2][1] = f32::INFINITY;
    let error = write_compressed_ply(&broken, &path, &WriteOptions::default(), &mut |_| true);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("element 2") && error.contains("sh_dc"), "{error}");
}

#[test]
fn damage_is_an_error_or_the_right_number_of_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let mut fixtures = Vec::new();
    for (rows, degree) in [(3, 0), (2, 3), (260, 1)] {
        write(&random_scene(rows, degree, 1), &path);
        fixtures.push((rows, std::fs::read(&path).unwrap()));
    }
    let read = |bytes: &[u8]| {
        // A new file each time: some file systems flush one that is written anew.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, bytes).unwrap();
        open_scene(&path, &ReadOptions::default())
    };
    for (rows, bytes) in &fixtures[..2] {
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "{rows} rows cut at {length}");
        }
    }
    let mut rng = SplitMix(6);
    let (mut good, mut refused) = (0, 0);
    for round in 0..2000 * fixtures.len() {
        let (_, bytes) = &fixtures[round % fixtures.len()];
        let mut bytes = bytes.clone();
        for _ in 0..=rng.below(3) {
            let at = rng.below(bytes.len());
            match rng.below(5) {
                0 => bytes[at] = b"0123456789"[rng.below(10)],
                1 => bytes.truncate(at.max(1)),
                2 => {
                    bytes.remove(at);
                }
                _ => bytes[at] = [rng.next() as u8, 0, 255, 127][rng.below(4)],
            }
        }
        match std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| read(&bytes))) {
            Ok(Ok(loaded)) => {
                let file = PlyFile::open(&path).unwrap();
                assert_eq!(loaded.source_rows(), file.element("vertex").unwrap().count);
                good += 1;
            }
            Ok(Err(_)) => refused += 1,
            Err(_) => panic!("round {round}: {:?}", String::from_utf8_lossy(&bytes)),
        }
    }
    assert!(good > 500 && refused > 500, "{good} read, {refused} refused");
}
