//! Scenes far from 0: what files hold as doubles survives reading, editing and writing.

use crate::common::gltf::Doc;
use crate::common::ply::{Encoding, inria_columns, ply_bytes};
use crate::common::{
    SplitMix, contents, labelled, limit, npy_bytes, open, random_scene, save, strict, write,
};
use scenesplat_scene::edit::{CropBox, EulerAngles, Offset, SceneEdit, UpSource, merge};
use scenesplat_scene::formats::FORMATS;
use scenesplat_scene::formats::labelled_ply::read_labelled_ply;
use scenesplat_scene::formats::ply::PlyFile;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    Camera, Distortion, GaussianScene, LabelledPoints, LoadedScene, Policy, ReadOptions, Up,
    open_cameras, open_scene,
};
use serde_json::json;
use std::path::Path;

const SURVEY: [f64; 3] = [431_000.25, -5_411_000.5, 230.125];
const ROWS: usize = 300;

/// Positions about `center` that differ by centimeters within 20 m.
fn around(center: [f64; 3], rows: usize) -> Vec<[f64; 3]> {
    let mut rng = SplitMix(9);
    let mut step = || (f64::from(rng.float()) * 1000.0).round() / 100.0;
    (0..rows).map(|_| center.map(|c| c + step())).collect()
}

/// A PLY file of the original trainer whose `x y z` are doubles.
fn double_ply(scene: &GaussianScene, position: &[[f64; 3]], big_endian: bool) -> Vec<u8> {
    let order = if big_endian { "big" } else { "little" };
    let columns = inria_columns(scene);
    let mut out =
        format!("ply\nformat binary_{order}_endian 1.0\nelement vertex {}\n", scene.len());
    for (i, (name, _)) in columns.iter().enumerate() {
        out += &format!("property {} {name}\n", if i < 3 { "double" } else { "float" });
    }
    let mut out = (out + "end_header\n").into_bytes();
    for (row, p) in position.iter().enumerate() {
        let doubles = p.iter().map(|v| v.to_le_bytes().to_vec());
        let floats = columns[3..].iter().map(|(_, v)| v[row].to_le_bytes().to_vec());
        for mut bytes in doubles.chain(floats) {
            if big_endian {
                bytes.reverse();
            }
            out.extend(bytes);
        }
    }
    out
}

fn positions(scene: &GaussianScene) -> Vec<[f64; 3]> {
    (0..scene.len()).map(|row| scene.position(row)).collect()
}

/// The largest difference of a coordinate.
fn worst(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// A scene about `center` as it comes from a PLY file of doubles.
fn read_about(center: [f64; 3]) -> (LoadedScene, Vec<[f64; 3]>) {
    let folder = tempfile::tempdir().unwrap();
    let exact = around(center, ROWS);
    let bytes = double_ply(&random_scene(ROWS, 1, 3), &exact, false);
    (open(&save(folder.path(), "a.ply", &bytes)), exact)
}

#[test]
fn doubles_survive_reading_and_writing() {
    let folder = tempfile::tempdir().unwrap();
    for center in [SURVEY, [1e9, -1e9, 0.0]] {
        let exact = around(center, ROWS);
        for big_endian in [false, true] {
            let bytes = double_ply(&random_scene(ROWS, 1, 3), &exact, big_endian);
            let loaded = open(&save(folder.path(), "a.ply", &bytes));
            assert!(loaded.scene.has_origin());
            assert!(worst(&positions(&loaded.scene), &exact) < 1e-6);
            let note = loaded.report.notes.join("\n");
            assert!(note.contains("kept relative to that origin"), "{note}");
            for (k, name) in ["b.ply", "folder", "b.glb"].into_iter().enumerate() {
                let path = folder.path().join(name);
                let format = scenesplat_scene::SceneFormat::from_path(&path).unwrap();
                let report = write(&loaded.scene, &path, format);
                assert!(report.limits.iter().all(|l| l.field != "coord"), "{report}");
                let again = open(&path);
                assert!(worst(&positions(&again.scene), &exact) < 1e-6, "{name}");
                if k == 0 {
                    assert_eq!(again.scene, loaded.scene);
                    // What was written here is the same if it is read and written again.
                    let first = std::fs::read(&path).unwrap();
                    write(&again.scene, &path, format);
                    assert!(std::fs::read(&path).unwrap() == first);
                }
            }
        }
    }
}

#[test]
fn a_far_scene_is_the_near_one_moved() {
    let folder = tempfile::tempdir().unwrap();
    let base = random_scene(ROWS, 1, 3);
    let near = around([0.0; 3], ROWS);
    let far: Vec<[f64; 3]> = near.iter().map(|p| [p[0] + 5e5, p[1] - 2e6, p[2]]).collect();
    let near = open(&save(folder.path(), "near.ply", &double_ply(&base, &near, false))).scene;
    let far = open(&save(folder.path(), "far.ply", &double_ply(&base, &far, false))).scene;
    assert!(!near.has_origin());
    let edit = SceneEdit { translate: Some(Offset([-5e5, 2e6, 0.0])), ..SceneEdit::default() };
    let (back, _) = edit.apply(far.clone()).unwrap();
    assert!(!back.has_origin(), "near 0 there is no origin: {:?}", back.origin);
    assert!(worst(&positions(&back), &positions(&near)) < 2e-6);
    assert_eq!(
        GaussianScene { coord: Vec::new(), ..back },
        GaussianScene { coord: Vec::new(), ..near }
    );
    // Half the way it is still far, and stays exact.
    let edit = SceneEdit { translate: Some(Offset([-25e4, 0.125, 0.0])), ..SceneEdit::default() };
    let (moved, _) = edit.apply(far.clone()).unwrap();
    assert_eq!(moved.coord, far.coord);
    assert_eq!(moved.origin, [far.origin[0] - 25e4, far.origin[1] + 0.125, far.origin[2]]);
}

#[test]
fn near_scenes_and_floats_are_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let scene = random_scene(ROWS, 1, 3);
    for offset in [0.0f32, 100.0] {
        let mut scene = scene.clone();
        scene.coord.iter_mut().for_each(|p| p[0] += offset);
        let exact: Vec<[f64; 3]> = scene.coord.iter().map(|p| p.map(f64::from)).collect();
        let doubles = open(&save(folder.path(), "d.ply", &double_ply(&scene, &exact, false)));
        let bytes = ply_bytes(&inria_columns(&scene), Encoding::Little, "\n");
        let floats = open(&save(folder.path(), "f.ply", &bytes));
        assert_eq!(doubles.scene, floats.scene);
        assert_eq!((doubles.scene.origin, doubles.report.notes.len()), ([0.0; 3], 0));
    }
    // Floats have lost their doubles already: they stay as they are, wherever they are.
    let mut far = scene;
    far.coord.iter_mut().for_each(|p| p[0] += 5e5);
    let bytes = ply_bytes(&inria_columns(&far), Encoding::Little, "\n");
    let loaded = open(&save(folder.path(), "f.ply", &bytes));
    assert_eq!((loaded.scene.origin, &loaded.scene.coord), ([0.0; 3], &far.coord));
    let path = folder.path().join("again.ply");
    write(&loaded.scene, &path, scenesplat_scene::SceneFormat::Ply);
    let vertex = PlyFile::open(&path).unwrap();
    let x = vertex.element("vertex").unwrap().property("x").unwrap().clone();
    assert!(format!("{:?}", x.kind).contains("F32"), "{x:?}");
}

#[test]
fn one_row_and_none() {
    let folder = tempfile::tempdir().unwrap();
    let one = random_scene(1, 0, 3);
    let at = |p: [f64; 3]| save(folder.path(), "a.ply", &double_ply(&one, &[p], false));
    let far = open(&at([5e5 + 0.37, 0.0, -1e6 - 0.01])).scene;
    assert!(worst(&positions(&far), &[[5e5 + 0.37, 0.0, -1e6 - 0.01]]) < 1e-7);
    let near = open(&at([5.3, 0.0, 1.0])).scene;
    assert_eq!((near.origin, near.coord[0]), ([0.0; 3], [5.3, 0.0, 1.0]));
    let none = save(folder.path(), "none.ply", &double_ply(&random_scene(0, 0, 3), &[], false));
    let error = open_scene(&none, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("no Gaussian at all"), "{error}");
}

#[test]
fn values_that_no_f32_holds_follow_the_policy() {
    let folder = tempfile::tempdir().unwrap();
    let base = random_scene(ROWS, 1, 3);
    for center in [[0.0; 3], SURVEY] {
        let mut exact = around(center, ROWS);
        exact[3][0] = f64::NAN;
        exact[5][1] = f64::NEG_INFINITY;
        exact[7][2] = 1e300;
        let path = save(folder.path(), "a.ply", &double_ply(&base, &exact, false));
        let loaded = open(&path);
        let finding = loaded.report.finding(Rule::CoordNotFinite).unwrap();
        assert_eq!((finding.count, finding.first_element), (3, 3));
        let kept = loaded.kept_rows.as_ref().unwrap();
        let left: Vec<[f64; 3]> = kept.iter().map(|&row| exact[row as usize]).collect();
        assert!(worst(&positions(&loaded.scene), &left) < 1e-6);
        assert!(open_scene(&path, &strict()).unwrap_err().to_string().contains("coord"));
        // Finite but far outside: a stray row, about the same origin.
        exact[7] = [1e30, 0.0, 0.0];
        let path = save(folder.path(), "a.ply", &double_ply(&base, &exact, false));
        assert_eq!(open(&path).scene.origin, loaded.scene.origin);
    }
    let all = vec![[1e300, 0.0, 0.0]; ROWS];
    let path = save(folder.path(), "a.ply", &double_ply(&base, &all, false));
    let error = open_scene(&path, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("no Gaussian is usable"), "{error}");
}

#[test]
fn nodes_place_gaussians_in_f64() {
    let mut base = random_scene(ROWS, 1, 3);
    base.coord.iter_mut().for_each(|p| *p = p.map(|v| (v * 64.0).round() / 64.0));
    // glTF's frame is left, up, forward.
    let due = |t: [f64; 3]| -> Vec<[f64; 3]> {
        let lufs = base.coord.iter().map(|p| [0, 1, 2].map(|i| f64::from(p[i]) + t[i]));
        lufs.map(|p| [-p[0], -p[1], p[2]]).collect()
    };
    let far = [6_378_137.25, -4e6 - 0.5, 12.75];
    let single = |node: serde_json::Value| {
        let mut doc = Doc::new();
        let mesh = doc.mesh(&base, true);
        let mut node = node;
        node["mesh"] = json!(mesh);
        doc.node(node, true);
        doc.read()
    };
    let loaded = single(json!({"translation": far}));
    assert!(loaded.scene.has_origin());
    assert!(worst(&positions(&loaded.scene), &due(far)) < 1e-6);
    assert!(loaded.report.notes.join("\n").contains("relative to that origin"));
    let m = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., far[0], far[1], far[2], 1.];
    assert_eq!(single(json!({ "matrix": m })).scene, loaded.scene);
    // Stretched: another way of moving.
    let stretched = single(json!({"translation": far, "scale": [1.0, 1.0, 2.0]})).scene;
    let twice: Vec<_> =
        due([far[0], far[1], 0.0]).iter().map(|p| [p[0], p[1], 2.0 * p[2] + far[2]]).collect();
    assert!(worst(&positions(&stretched), &twice) < 1e-5);
    let near = single(json!({"translation": [3.0, 0.0, 0.0]})).scene;
    assert_eq!(near.origin, [0.0; 3]);
    assert!(worst(&positions(&near), &due([3.0, 0.0, 0.0])) < 1e-5);
}

#[test]
fn tiles_of_one_document_share_an_origin() {
    let mut base = random_scene(ROWS, 0, 3);
    base.coord.iter_mut().for_each(|p| *p = p.map(|v| (v * 64.0).round() / 64.0));
    let mut doc = Doc::new();
    let mesh = doc.mesh(&base, true);
    // Two tiles under a root that is far away.
    let a = doc.node(json!({"mesh": mesh, "translation": [0.0, 0.0, 0.0]}), false);
    let b = doc.node(json!({"mesh": mesh, "translation": [0.015625, 0.0, 30.0]}), false);
    doc.node(json!({"children": [a, b], "translation": [4_000_000.0, 0.0, 5e6]}), true);
    let scene = doc.read().scene;
    assert!(scene.has_origin());
    for row in 0..ROWS {
        let (p, q) = (scene.position(row), scene.position(row + ROWS));
        assert!((p[0] - q[0] - 0.015625).abs() < 1e-6 && (q[2] - p[2] - 30.0).abs() < 1e-5);
    }
    // Each tile is far from 0 for its size, all together they are not: nothing is subtracted.
    let mut small = base;
    small.coord.iter_mut().for_each(|p| *p = p.map(|v| v / 100.0));
    let mut doc = Doc::new();
    let mesh = doc.mesh(&small, true);
    for x in [-30.0, -10.0, 10.0, 30.0] {
        doc.node(json!({"mesh": mesh, "translation": [x, 0.0, 0.0]}), true);
    }
    assert_eq!(doc.read().scene.origin, [0.0; 3]);
}

/// `coord.npy` of doubles, row by row or column by column.
fn npy_doubles(rows: &[[f64; 3]], fortran: bool) -> Vec<u8> {
    let flag = if fortran { "True" } else { "False" };
    let dict =
        format!("{{'descr': '<f8', 'fortran_order': {flag}, 'shape': ({}, 3), }}", rows.len());
    let values: Vec<f64> = match fortran {
        false => rows.as_flattened().to_vec(),
        true => (0..3).flat_map(|i| rows.iter().map(move |p| p[i])).collect(),
    };
    npy_bytes(1, &dict, &values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>())
}

#[test]
fn folders_of_doubles() {
    let folder = tempfile::tempdir().unwrap();
    let exact = around(SURVEY, ROWS);
    let points = around([SURVEY[0] + 0.5, SURVEY[1], SURVEY[2]], 40);
    for fortran in [false, true] {
        save(folder.path(), "coord.npy", &npy_doubles(&exact, fortran));
        save(folder.path(), "pc_coord.npy", &npy_doubles(&points, fortran));
        let loaded = open(folder.path());
        assert!(loaded.scene.has_origin());
        assert!(worst(&positions(&loaded.scene), &exact) < 1e-6);
        let of_points = |scene: &GaussianScene| -> Vec<[f64; 3]> {
            let LabelledPoints { coord, .. } = scene.labelled_points.clone().unwrap();
            let place = |p: &[f32; 3]| [0, 1, 2].map(|i| f64::from(p[i]) + scene.origin[i]);
            coord.iter().map(place).collect()
        };
        assert!(worst(&of_points(&loaded.scene), &points) < 1e-6);
        let out = folder.path().join("out");
        write(&loaded.scene, &out, scenesplat_scene::SceneFormat::NpyFolder);
        let again = open(&out).scene;
        assert_eq!((again.origin, &again.coord), (loaded.scene.origin, &loaded.scene.coord));
        assert!(worst(&of_points(&again), &points) < 1e-6);
    }
    let near: Vec<[f64; 3]> = exact.iter().map(|p| [0, 1, 2].map(|i| p[i] - SURVEY[i])).collect();
    save(folder.path(), "coord.npy", &npy_doubles(&near, false));
    let scene = open(folder.path()).scene;
    let rounded: Vec<[f32; 3]> = near.iter().map(|p| p.map(|v| v as f32)).collect();
    assert_eq!((scene.origin, scene.coord), ([0.0; 3], rounded));
}

#[test]
fn every_format_holds_the_place_or_says_that_it_does_not() {
    let (loaded, exact) = read_about(SURVEY);
    let mut scene = labelled(ROWS, 1);
    (scene.coord, scene.origin) = (loaded.scene.coord, loaded.scene.origin);
    let folder = tempfile::tempdir().unwrap();
    let mut held = 0;
    for row in FORMATS.iter().filter(|row| row.is_writable()) {
        let ending = row.endings.first().copied().unwrap_or("");
        let name = if ending.starts_with('.') {
            format!("a{ending}")
        } else {
            format!("{}/{ending}", row.name)
        };
        let path = folder.path().join(name.trim_end_matches('/'));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let report = write(&scene, &path, row.format);
        let read = open(&path).scene;
        let order = crate::common::order_of(&report);
        let due: Vec<[f64; 3]> = order.iter().map(|&i| exact[i]).collect();
        if report.limits.iter().all(|l| l.field != "coord") {
            held += 1;
            assert!(worst(&positions(&read), &due) < 1e-6, "{}", row.name);
            continue;
        }
        let (rows, first, by) = limit(&report, "coord", "relative to that origin");
        let far = scene.origin.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert_eq!((rows, first, by), (ROWS, 0, far), "{}", row.name);
        let origin = scene.origin;
        let back: Vec<[f64; 3]> =
            positions(&read).iter().map(|p| [0, 1, 2].map(|i| p[i] + origin[i])).collect();
        assert!(worst(&back, &due) < 0.02, "{}: {report}", row.name);
        let text = report.to_string();
        assert!(text.contains(&format!("({}, {}, {})", origin[0], origin[1], origin[2])), "{text}");
    }
    assert_eq!(held, 5, "PLY, .glb, .npy, .usda and .usdz");
    assert!(!contents(folder.path()).is_empty());
}

#[test]
fn crop_is_in_the_coordinates_of_the_file() {
    let (loaded, exact) = read_about(SURVEY);
    let mut scene = loaded.scene;
    scene.labelled_points =
        Some(LabelledPoints { coord: scene.coord.clone(), segment: None, instance: None });
    // No coordinate lies on an edge that f32 could tell from its neighbors.
    let text =
        format!("{},{},{},{},{},{}", SURVEY[0] + 0.105, -6e6, -1e3, SURVEY[0] + 4.105, 0.0, 1e3);
    let crop: CropBox = text.parse().unwrap();
    let edit = SceneEdit { crop: Some(crop), ..SceneEdit::default() };
    let (cut, report) = edit.apply(scene.clone()).unwrap();
    let inside = |p: &[f64; 3]| (SURVEY[0] + 0.105..=SURVEY[0] + 4.105).contains(&p[0]);
    let due: Vec<usize> = (0..ROWS).filter(|&row| inside(&exact[row])).collect();
    assert!(due.len() > 20 && due.len() < ROWS / 2);
    assert_eq!(report.rows, Some(due.clone()));
    assert_eq!(cut.origin, scene.origin);
    assert_eq!(cut.labelled_points.unwrap().coord.len(), due.len());
    let crop = Some("0,0,0,1,1,1".parse().unwrap());
    let error = SceneEdit { crop, ..SceneEdit::default() }.apply(scene).unwrap_err().to_string();
    assert!(error.contains("[4309") && error.contains("-54110"), "{error}");
}

#[test]
fn crop_near_zero_compares_as_f32() {
    let mut scene = random_scene(3, 0, 3);
    scene.coord = vec![[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [0.7, 0.0, 0.0]];
    let crop = Some("0.1,0,0,0.3,0,0".parse().unwrap());
    let (cut, _) = SceneEdit { crop, ..SceneEdit::default() }.apply(scene.clone()).unwrap();
    assert_eq!(cut.coord, scene.coord[..2]);
    let crop = Some("5,5,5,6,6,6".parse().unwrap());
    let error = SceneEdit { crop, ..SceneEdit::default() }.apply(scene).unwrap_err().to_string();
    assert!(error.contains("[0.1, 0.0, 0.0] to [0.7, 0.0, 0.0]"), "{error}");
}

#[test]
fn merged_scenes_keep_their_distance() {
    let (a, exact_a) = read_about(SURVEY);
    let (b, exact_b) = read_about([SURVEY[0] + 70.0, SURVEY[1] - 3.0, SURVEY[2]]);
    assert_ne!(a.scene.origin, b.scene.origin);
    let (joined, report) = merge(vec![a.scene.clone(), b.scene]).unwrap();
    let exact = [exact_a.clone(), exact_b].concat();
    assert!(worst(&positions(&joined), &exact) < 1e-5);
    assert_eq!((joined.origin, &joined.coord[..ROWS]), (a.scene.origin, &a.scene.coord[..]));
    assert!(report.notes.join("\n").contains("one origin"), "{:?}", report.notes);
    // Far from each other: the origin is that of both together.
    let (c, exact_c) = read_about([SURVEY[0], 0.0, 0.0]);
    let (joined, _) = merge(vec![a.scene, c.scene]).unwrap();
    assert!(worst(&positions(&joined), &[exact_a, exact_c].concat()) < 0.3);
    // Without origins nothing is touched, however far the scenes are.
    let mut far = random_scene(5, 0, 3);
    far.coord.iter_mut().for_each(|p| p[0] += 1e6);
    let (joined, report) = merge(vec![far.clone(), far.clone()]).unwrap();
    assert_eq!((joined.origin, joined.coord[7]), ([0.0; 3], far.coord[2]));
    assert!(report.notes.is_empty());
}

#[test]
fn turns_scales_and_leveling_are_about_the_file_s_zero() {
    let (loaded, exact) = read_about(SURVEY);
    let scene = loaded.scene;
    let angles = EulerAngles([0.0, 0.0, 30.0]);
    let edit = SceneEdit { rotate: Some(angles), scale: Some(0.5), ..SceneEdit::default() };
    let (turned, _) = edit.apply(scene.clone()).unwrap();
    let m = angles.matrix();
    let turn = |p: &[f64; 3]| m.map(|r| 0.5 * (r[0] * p[0] + r[1] * p[1] + r[2] * p[2]));
    let due: Vec<[f64; 3]> = exact.iter().map(turn).collect();
    assert!(worst(&positions(&turned), &due) < 1e-6);
    // Level: the floor comes to z = 0, wherever the survey has it.
    let up = Some(UpSource::Given(Up::PLUS_Z));
    let edit = SceneEdit { up, level: true, ..SceneEdit::default() };
    let (level, report) = edit.apply(scene).unwrap();
    assert!(report.level.unwrap().floor > 200.0);
    let lowest = positions(&level).iter().map(|p| p[2]).fold(f64::INFINITY, f64::min);
    assert!((-1.0..=0.5).contains(&lowest), "{lowest}");
    let edit = SceneEdit { scale: Some(1e307), ..SceneEdit::default() };
    assert!(edit.apply(turned).is_err(), "beyond what a number holds");
}

#[test]
fn labeled_clouds_of_doubles() {
    let folder = tempfile::tempdir().unwrap();
    let exact = around(SURVEY, 50);
    let mut text = "ply\nformat ascii 1.0\nelement vertex 50\nproperty double x\n\
                    property double y\nproperty double z\nproperty int label\nend_header\n"
        .to_owned();
    for [x, y, z] in &exact {
        text += &format!("{x} {y} {z} 1\n");
    }
    let path = save(folder.path(), "cloud.ply", text.as_bytes());
    let (cloud, report) = read_labelled_ply(&path, Policy::Strict, None).unwrap();
    let of = |coord: &[[f32; 3]], origin: [f64; 3]| -> Vec<[f64; 3]> {
        coord.iter().map(|p| [0, 1, 2].map(|i| f64::from(p[i]) + origin[i])).collect()
    };
    assert!(worst(&of(&cloud.coord, cloud.origin), &exact) < 1e-6);
    assert!(report.notes.join("\n").contains("relative to that origin"));
    let other = [cloud.origin[0] - 8.0, cloud.origin[1], cloud.origin[2] + 1.0];
    let points = cloud.into_points(other);
    assert!(worst(&of(&points.coord, other), &exact) < 1e-5);
}

#[test]
fn cameras_follow_the_origin() {
    let camera = Camera {
        name: "a.jpg".to_owned(),
        width: 640,
        height: 480,
        fx: 500.0,
        fy: 500.0,
        cx: 320.0,
        cy: 240.0,
        distortion: Distortion::None,
        rotation: [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
        translation: [SURVEY[1], SURVEY[2], 5.0 - SURVEY[0]],
    };
    let moved = camera.relative_to(SURVEY);
    assert_eq!(moved.translation, [0.0, 0.0, 5.0]);
    let seen = camera.project([SURVEY[0] + 1.0, SURVEY[1] + 0.5, SURVEY[2]]).unwrap();
    let due = moved.project([1.0, 0.5, 0.0]).unwrap();
    assert!((seen[0] - due[0]).abs() < 1e-6 && (seen[1] - due[1]).abs() < 1e-6);
    assert_eq!(moved.relative_to(SURVEY.map(|v| -v)), camera);
    assert_eq!(camera.relative_to([0.0; 3]), camera);
}

#[test]
fn points_of_colmap_say_where_a_capture_is() {
    let folder = tempfile::tempdir().unwrap();
    save(folder.path(), "cameras.txt", b"1 PINHOLE 640 480 500 500 320 240\n");
    let read = |center: [f64; 3]| {
        let [x, y, z] = center.map(|v| -v);
        let image = format!("1 1 0 0 0 {x} {y} {z} 1 a.jpg\n\n");
        save(folder.path(), "images.txt", image.as_bytes());
        let lines = around(center, 40).into_iter().enumerate();
        let lines = lines.map(|(i, [x, y, z])| format!("{} {x} {y} {z} 1 2 3 0.5 1 0\n", i + 1));
        save(folder.path(), "points3D.txt", lines.collect::<String>().as_bytes());
        open_cameras(Path::new(folder.path())).unwrap()
    };
    let near = read([0.0; 3]);
    assert_eq!(near.far_origin(), [0.0; 3]);
    assert_eq!(near.clone().relative_to([0.0; 3]), near);
    let far = read(SURVEY);
    let origin = far.far_origin();
    assert!((0..3).all(|i| (origin[i] - SURVEY[i]).abs() < 12.0), "{origin:?}");
    let moved = far.clone().relative_to(origin);
    let (points, old) = (moved.points.unwrap().coord, far.points.unwrap().coord);
    for (p, q) in points.iter().zip(&old) {
        let (a, b) = (moved.cameras[0].to_camera(*p), far.cameras[0].to_camera(*q));
        assert!((0..3).all(|i| (a[i] - b[i]).abs() < 1e-8));
    }
}
