//! Files that other programs wrote. Skipped, with a line saying so, where they are not installed.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::shared;
use scenesplat_scene::formats::labelled_ply::read_labelled_ply;
use scenesplat_scene::formats::ply::{ColumnValues, PlyColumn, PlyFile, write_ply_with_columns};
use scenesplat_scene::label_set::read_names;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    GaussianScene, LabelSet, LoadedScene, Policy, ReadOptions, SceneFormat, TextTable, open_scene,
};

fn open(relative: &str) -> Option<LoadedScene> {
    let path = shared(relative)?;
    // Real files need no repair, so the strict policy must take them.
    let options = ReadOptions { policy: Policy::Strict, ..ReadOptions::default() };
    Some(open_scene(&path, &options).unwrap())
}

fn close(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance}");
    }
}

fn check_unit(scene: &GaussianScene) {
    for q in &scene.quat {
        let norm: f64 = q.iter().map(|&v| f64::from(v).powi(2)).sum();
        assert!((norm - 1.0).abs() < 1e-6 && q[0] >= 0.0, "{q:?}");
    }
}

#[test]
fn biker_compressed() {
    let Some(loaded) = open("real/objects/biker.compressed.ply") else { return };
    let scene = &loaded.scene;
    assert_eq!(scene.len(), 152_746);
    assert_eq!(loaded.kind, SceneFormat::CompressedPly);
    assert_eq!(scene.sh_degree, 0);
    // The first record, unpacked by hand in the description of the format.
    close(&scene.coord[0], &[-0.104_537, -2.387_898, -0.360_811], 1e-6);
    close(&scene.log_scale[0], &[-6.068_917, -4.206_543, -7.050_748], 1e-5);
    close(&scene.quat[0], &[0.461_036, -0.062_9, 0.884_855, 0.022_81], 1e-5);
    close(&[scene.opacity_logit[0]], &[-2.577_688], 1e-5);
    check_unit(scene);
}

#[test]
fn plain_files_have_the_right_number_of_rows() {
    for (name, rows) in [
        ("real/objects/hamburger.ply", 52_709),
        ("real/objects/tmp_model_unnormalised.ply", 49_744),
        ("real/objects/monkey404.ply", 36_295),
        ("real/fixtures/unitCube-ascii.ply", 20),
    ] {
        let Some(loaded) = open(name) else { continue };
        assert_eq!(loaded.scene.len(), rows, "{name}");
        assert_eq!(loaded.source_rows(), rows, "{name}");
        assert_eq!(loaded.kind, SceneFormat::Ply);
        check_unit(&loaded.scene);
    }
}

#[test]
fn quaternions_of_any_norm() {
    let Some(loaded) = open("real/objects/tmp_model_unnormalised.ply") else { return };
    assert!(loaded.report.count(Rule::QuatNotUnit) > 40_000, "{}", loaded.report);
    let raw = PlyFile::open(&loaded.path).unwrap();
    let raw = raw.rows_f32("vertex", ["rot_0", "rot_1", "rot_2", "rot_3"]).unwrap();
    for (raw, quat) in raw.iter().zip(&loaded.scene.quat) {
        let norm = raw.iter().map(|v| v * v).sum::<f32>().sqrt().copysign(raw[0]);
        close(&raw.map(|v| v / norm), quat, 1e-6);
    }
}

#[test]
fn the_ascii_cube() {
    let Some(loaded) = open("real/fixtures/unitCube-ascii.ply") else { return };
    let scene = loaded.scene;
    assert_eq!(scene.coord[1], [10.0, 0.0, 0.0]);
    assert_eq!(scene.opacity_logit[0], 20.0);
    assert_eq!(scene.log_scale[0], [0.1; 3]);
    assert_eq!(scene.color_u8(1), [255, 0, 0]);
}

#[test]
fn compressed_and_plain_agree_within_the_quantum() {
    let Some(plain) = open("real/parity/playbot_lod4.ply") else { return };
    let Some(packed) = open("real/parity/playbot_lod4.compressed.ply") else { return };
    let (a, b) = (&plain.scene, &packed.scene);
    assert_eq!((a.len(), b.len()), (8406, 8406));
    assert_eq!((a.sh_degree, b.sh_degree), (2, 2));
    for chunk in 0..a.len().div_ceil(256) {
        let rows = chunk * 256..(chunk * 256 + 256).min(a.len());
        // Half a step of the range of the chunk, by 11, 10 and 11 bits, and rounding.
        for axis in 0..3 {
            let steps = [2047.0, 1023.0, 2047.0][axis];
            for (va, vb) in [(&a.coord, &b.coord), (&a.log_scale, &b.log_scale)] {
                let values = || va[rows.clone()].iter().map(|v| v[axis].clamp(-20.0, 20.0));
                let range = values().fold(f32::MIN, f32::max) - values().fold(f32::MAX, f32::min);
                for (x, y) in values().zip(&vb[rows.clone()]) {
                    assert!((x - y[axis]).abs() <= range / steps * 0.501 + 2e-5, "{x} {}", y[axis]);
                }
            }
            let values = || a.sh_dc[rows.clone()].iter().map(|v| v[axis]);
            let range = values().fold(f32::MIN, f32::max) - values().fold(f32::MAX, f32::min);
            for (x, y) in values().zip(&b.sh_dc[rows.clone()]) {
                assert!((x - y[axis]).abs() <= range / 255.0 * 0.501 + 2e-5, "{x} {}", y[axis]);
            }
        }
    }
    for row in 0..a.len() {
        assert!((a.opacity(row) - b.opacity(row)).abs() <= 0.501 / 255.0);
        let dot: f32 = a.quat[row].iter().zip(&b.quat[row]).map(|(x, y)| x * y).sum();
        assert!(dot.abs() > 0.999_99, "row {row}: {dot}");
    }
    let mut largest = 0.0f32;
    for (x, y) in a.sh_rest.iter().zip(&b.sh_rest) {
        // A step of 8/256; the last code stands for 4 itself.
        assert!((x.clamp(-4.0, 4.0) - y).abs() <= 8.0 / 256.0, "{x} {y}");
        largest = largest.max(x.abs());
    }
    assert!(largest > 0.5, "coefficients of all sizes were compared");
}

#[test]
fn results_can_be_added_to_files_of_both_kinds() {
    for name in ["real/parity/playbot_lod4.ply", "real/parity/playbot_lod4.compressed.ply"] {
        let Some(loaded) = open(name) else { continue };
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out.ply");
        let source = PlyFile::open(&loaded.path).unwrap();
        let label: Vec<i32> = (0..loaded.source_rows() as i32).collect();
        let column = [PlyColumn { name: "label", values: ColumnValues::I32(&label) }];
        write_ply_with_columns(&source, &[], &column, &out).unwrap();
        let mut copy = open_scene(&out, &ReadOptions::default()).unwrap();
        assert_eq!(copy.kind, loaded.kind);
        assert_eq!(copy.scene.segment.take(), Some(label));
        assert_eq!(copy.scene, loaded.scene);
    }
}

#[test]
fn the_labelled_house() {
    let Some(path) = shared("real/small_house_labelled.ply") else { return };
    let (cloud, report) = read_labelled_ply(&path, Policy::Strict, None).unwrap();
    assert_eq!(cloud.coord.len(), 774_287);
    assert!(report.is_clean());
    let color = cloud.color.unwrap();
    assert!(color.len() == 774_287 && color.iter().any(|c| c[0] != c[2]));
    let unit = |n: &[f32; 3]| (n.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-3;
    assert!(cloud.normal.unwrap().iter().filter(|n| unit(n)).count() > 770_000);
    let instance = cloud.instance.unwrap();
    assert!(instance.iter().all(|id| (-1..65_535).contains(id)));

    let Some(names) = shared("real/small_house_labels.json") else { return };
    let names = LabelSet::read(&names).unwrap();
    assert_eq!(names.len(), 41);
    assert_eq!(names.index_of("coffee table").unwrap(), 8);
    assert!(cloud.segment.iter().all(|&label| (-1..41).contains(&label)));
    assert_eq!(cloud.segment.iter().max(), Some(&40));
}

#[test]
fn text_vectors_of_the_benchmarks() {
    for (name, classes) in [
        ("scannet20", 20),
        ("scannet200", 200),
        ("scannetpp_top100", 100),
        ("matterport21", 21),
        ("matterport-nyu160", 160),
    ] {
        let file = format!("real/text_embeddings/{name}_text_embeddings_siglip2.safetensors");
        let Some(path) = shared(&file) else { continue };
        let table = TextTable::read(&path, None).unwrap();
        assert_eq!((table.len(), table.dim), (classes, 768), "{name}");
        for row in 0..classes {
            let norm: f64 = table.row(row).unwrap().iter().map(|&v| f64::from(v).powi(2)).sum();
            assert!((norm - 1.0).abs() < 1e-6);
        }
        let set = LabelSet::from_text(table).unwrap();
        assert_eq!(set.index_of("Wall").unwrap(), 0, "{name}");
    }
    let file = "real/text_embeddings/holicity_text_embeddings_siglip2.safetensors";
    let Some(path) = shared(file) else { return };
    // Its list of labels is two shorter than its table.
    let error = TextTable::read(&path, None).unwrap_err().to_string();
    assert!(error.contains("4 class names for 6 text vectors"), "{error}");
    let dir = tempfile::tempdir().unwrap();
    let names = dir.path().join("names.txt");
    std::fs::write(&names, "a\nb\nc\nd\ne\nf\n").unwrap();
    assert_eq!(read_names(&names).unwrap().len(), 6);
    assert_eq!(TextTable::read(&path, Some(&names)).unwrap().len(), 6);
}

/// Every scene of the shared data: what it is and how many Gaussians it has.
const SCENES: &[(&str, &str, usize)] = &[
    ("objects/biker.compressed.ply", "compressed-ply", 152_746),
    ("objects/biker.spz", "spz", 152_746),
    ("objects/guitar.compressed.ply", "compressed-ply", 90_854),
    ("objects/playbot_sog2_lod", "sog", 500_000),
    ("objects/playbot_sog2_lod/lod-meta.json", "sog", 500_000),
    ("objects/playbot_sog2_lod/0_0", "sog", 500_000),
    ("objects/playbot_sog2_lod/3_0/meta.json", "sog", 31_000),
    ("objects/playbot_sog2_lod/4_0", "sog", 8406),
    ("objects/playbot_sog2_lod/5_0", "sog", 3000),
    ("objects/playbot_sog2_lod/6_0", "sog", 1873),
    ("objects/playcanvas_logo_sog1", "sog", 307_128),
    ("objects/monkey_0001.sog", "sog", 31_658),
    ("objects/hamburger.ply", "ply", 52_709),
    ("objects/monkey404.ply", "ply", 36_295),
    ("objects/tmp_model_unnormalised.ply", "ply", 49_744),
    ("objects/robocop.v2-zstdwrapped.spz", "spz", 267_776),
    ("scenes/arkit_brush/scene.splat", "splat", 116_906),
    ("fixtures/minimal-raw.spz", "spz", 4),
    ("fixtures/minimal-v2.spz", "spz", 4),
    ("fixtures/minimal-v3.spz", "spz", 4),
    ("fixtures/minimal-v4.spz", "spz", 4),
    ("fixtures/minimal.ksplat", "ksplat", 4),
    ("fixtures/minimal.splat", "splat", 4),
    ("fixtures/unitCube-ascii.ply", "ply", 20),
    ("fixtures/cesium_synthetic_legacy.gltf", "gltf", 5),
    ("parity/biker.compressed.ply", "compressed-ply", 152_746),
    ("parity/biker.l1.ksplat", "ksplat", 152_746),
    ("parity/biker.splat", "splat", 152_746),
    ("parity/biker.v2.spz", "spz", 152_746),
    ("parity/biker.v3.spz", "spz", 152_746),
    ("parity/biker.v4.spz", "spz", 152_746),
    ("parity/playbot_lod4.compressed.ply", "compressed-ply", 8406),
    ("parity/playbot_lod4.l0.ksplat", "ksplat", 8406),
    ("parity/playbot_lod4.l1.ksplat", "ksplat", 8406),
    ("parity/playbot_lod4.l2.ksplat", "ksplat", 8406),
    ("parity/playbot_lod4.ply", "ply", 8406),
    ("parity/playbot_lod4.splat", "splat", 8406),
    ("parity/playbot_lod4.v2.spz", "spz", 8406),
    ("parity/playbot_lod4.v3.spz", "spz", 8406),
    ("parity/playbot_lod4.v4.spz", "spz", 8406),
];

#[test]
fn every_scene_opens_whatever_it_is_called() {
    let dir = tempfile::tempdir().unwrap();
    let disguise = dir.path().join("scene.bin");
    for &(name, kind, gaussians) in SCENES {
        let Some(path) = shared(&format!("real/{name}")) else { continue };
        let loaded = open_scene(&path, &ReadOptions::default());
        let loaded = loaded.unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!((loaded.kind.name(), loaded.source_rows()), (kind, gaussians), "{name}");
        assert_eq!(loaded.scene.len(), gaussians, "{name}: no row is left out");
        // The content decides, not the name; what is made of several files needs them beside it.
        if path.is_file() && path.extension().is_none_or(|e| e != "json") {
            std::fs::copy(&path, &disguise).unwrap();
            let again = open_scene(&disguise, &ReadOptions::default());
            let again = again.unwrap_or_else(|e| panic!("{name} under another name: {e}"));
            assert!(again.scene == loaded.scene && again.kind == loaded.kind, "{name}");
        }
    }
}

#[test]
fn what_is_no_scene_is_named() {
    for (name, what) in [
        ("real/scenes/arkit_brush/cameras.json", "cameras"),
        ("real/text_embeddings/manifest_text_embeddings.json", "JSON"),
        ("real/posed/test_garden.npz", "zip archive"),
        ("real/objects/playbot_sog2_lod/0_0/quats.webp", "no scene"),
    ] {
        let Some(path) = shared(name) else { continue };
        let Err(error) = open_scene(&path, &ReadOptions::default()) else {
            panic!("{name} opened as a scene")
        };
        assert!(error.to_string().contains(what), "{error}");
    }
}
