//! Compressed PLY files: both versions, other encodings, steps, order.

use crate::common::ply::with_header;
use crate::common::{SplitMix, open, order_of, random_scene, save, write};
use scenesplat_scene::formats::ply::{ColumnValues, PlyColumn, PlyFile, write_ply_with_columns};
use scenesplat_scene::{GaussianScene, ReadOptions, SceneFormat, open_scene};
use std::path::Path;

/// A compressed file of `n` Gaussians with coefficients of degree 1.
pub fn compressed(n: usize, bounds: usize) -> Vec<u8> {
    let chunks = n.div_ceil(256);
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n");
    let corners = [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]];
    for names in &corners[..bounds / 6] {
        for end in ["min", "max"] {
            names.iter().for_each(|name| out += &format!("property float {end}_{name}\n"));
        }
    }
    out += &format!("element vertex {n}\n");
    for name in ["position", "rotation", "scale", "color"] {
        out += &format!("property uint packed_{name}\n");
    }
    out += &format!("element sh {n}\n");
    (0..9).for_each(|i| out += &format!("property uchar f_rest_{i}\n"));
    out += "end_header\n";
    let mut out = out.into_bytes();
    for _ in 0..chunks * bounds / 6 {
        for v in [-1.0f32, -1.0, -1.0, 1.0, 2.0, 3.0] {
            out.extend_from_slice(&v.to_le_bytes());
        }
    }
    let mut rng = SplitMix(n as u64);
    for _ in 0..n {
        out.extend_from_slice(&rng.next().to_le_bytes());
        out.extend_from_slice(&rng.next().to_le_bytes());
    }
    for _ in 0..n * 9 {
        out.push(rng.next() as u8);
    }
    out
}

#[test]
fn compressed_files_of_both_versions() {
    let dir = tempfile::tempdir().unwrap();
    for bounds in [12, 18] {
        let scene = open(&save(dir.path(), "a.ply", &compressed(300, bounds))).scene;
        assert_eq!((scene.len(), scene.sh_degree, scene.sh_rest.len()), (300, 1, 2700));
        let in_bounds = |p: &[f32; 3]| (0..3).all(|i| (-1.0..=[1.0, 2.0, 3.0][i]).contains(&p[i]));
        assert!(scene.coord.iter().all(in_bounds) && scene.log_scale.iter().all(in_bounds));
        let color = |dc: f32| 0.5 + dc * scenesplat_scene::gaussian_scene::SH_C0;
        let outside =
            scene.sh_dc.iter().flatten().any(|&dc| !(-1e-6..1.000_001).contains(&color(dc)));
        assert_eq!(outside, bounds == 18, "without bounds colors are 0 to 1");
    }
}

#[test]
fn compressed_files_whose_parts_do_not_match() {
    let dir = tempfile::tempdir().unwrap();
    for (from, to, message) in [
        ("element chunk 2", "element chunk 1", "1 chunks for 300 vertices"),
        ("element sh 300", "element sh 299", "299 rows"),
        ("property uchar f_rest_8\n", "", "8 coefficients"),
        ("uchar f_rest_8", "uchar f_rest_9", "f_rest_8"),
        ("element chunk", "element lump", "no element chunk"),
        ("float max_x", "float max_q", "no property max_x"),
        ("uint packed_scale", "uint packed_size", "packed_scale"),
        ("uint packed_scale", "list uchar uint packed_scale", ""),
    ] {
        let bytes = with_header(&compressed(300, 18), from, to);
        let path = save(dir.path(), "a.ply", &bytes);
        let error = open_scene(&path, &ReadOptions::default()).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
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
    write(&scene, &path, SceneFormat::CompressedPly);
    let due = open(&path).scene;
    for big in [true, false] {
        std::fs::write(&other, as_text(&path, big)).unwrap();
        assert_eq!(open(&other).scene, due, "big-endian: {big}");
    }
    // Words cannot be floats.
    let text = with_header(&as_text(&path, true), "int packed_scale", "float packed_scale");
    std::fs::write(&other, text).unwrap();
    let error = open_scene(&other, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("packed_scale") && error.contains("float"), "{error}");
}

/// The values of both scenes are equal within the steps.
pub fn check_close(scene: &GaussianScene, back: &GaussianScene, what: &str) {
    // Beyond these bounds of sizes and colors the writer cuts, and says so.
    let color = |dc: &[f32; 3], i: usize| f64::from(dc[i].clamp(-1e30, 1e30)) * 0.282_094_8 + 0.5;
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
                let min = rows.clone().map(|r| value(scene, r)).fold(f64::INFINITY, f64::min);
                let max = rows.clone().map(|r| value(scene, r)).fold(f64::NEG_INFINITY, f64::max);
                for row in rows.clone() {
                    let (x, y) = (value(scene, row), value(back, row));
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

#[test]
fn orders_that_are_barely_good_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["a.ply", "b.ply"].map(|name| folder.path().join(name));
    let mut scenes = Vec::new();
    let mut rng = SplitMix(2);
    // The decision whether an order is good must be the same the second time.
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
        scenes.push((format!("barely {round}"), scene));
    }
    for (what, scene) in scenes {
        let report = write(&scene, &first, SceneFormat::CompressedPly);
        let back = open(&first).scene;
        check_close(&scene.select_rows(&order_of(&report)).unwrap(), &back, &what);
        let again = write(&back, &second, SceneFormat::CompressedPly);
        assert!(again.limits.is_empty() && again.order.is_none(), "{what}: {again}");
        assert!(std::fs::read(&first).unwrap() == std::fs::read(&second).unwrap(), "{what}");
    }
}

#[test]
fn the_file_has_the_elements_that_old_readers_expect() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    for degree in [0, 3] {
        let mut scene = random_scene(300, degree, 1);
        scene.segment = Some(vec![3; 300]);
        write(&scene, &path, SceneFormat::CompressedPly);
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
fn columns_added_to_the_vertices_are_still_read() {
    let folder = tempfile::tempdir().unwrap();
    let [path, out] = ["a.ply", "b.ply"].map(|name| folder.path().join(name));
    let scene = random_scene(300, 1, 4);
    write(&scene, &path, SceneFormat::CompressedPly);
    let source = PlyFile::open(&path).unwrap();
    let label: Vec<i32> = (0..300).collect();
    let columns = [
        PlyColumn { name: "label", values: ColumnValues::I32(&label) },
        PlyColumn { name: "instance", values: ColumnValues::I32(&label) },
    ];
    write_ply_with_columns(&source, &[], &columns, &[], &out).unwrap();
    let mut back = open(&out).scene;
    assert_eq!((back.segment.take(), back.instance.take()), (Some(label.clone()), Some(label)));
    assert_eq!(back, open(&path).scene);
}
