//! Files that other programs wrote. Skipped, with a line saying so, where they are not installed.

use super::compressed_ply::check_close;
use crate::common::{check_unit, close, shared, strict};
use scenesplat_scene::formats::labelled_ply::read_labelled_ply;
use scenesplat_scene::formats::ply::{ColumnValues, PlyColumn, PlyFile, write_ply_with_columns};
use scenesplat_scene::label_set::read_names;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{LabelSet, LoadedScene, Policy, ReadOptions, TextTable, open_scene};

fn open(relative: &str) -> Option<LoadedScene> {
    let path = shared(relative)?;
    Some(open_scene(&path, &strict()).unwrap())
}

#[test]
fn biker_compressed() {
    let Some(loaded) = open("real/objects/biker.compressed.ply") else { return };
    let scene = &loaded.scene;
    // The first record, unpacked by hand in the description of the format.
    close(&scene.coord[0], &[-0.104_537, -2.387_898, -0.360_811], 1e-6);
    close(&scene.log_scale[0], &[-6.068_917, -4.206_543, -7.050_748], 1e-5);
    close(&scene.quat[0], &[0.461_036, -0.062_9, 0.884_855, 0.022_81], 1e-5);
    close(&[scene.opacity_logit[0]], &[-2.577_688], 1e-5);
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
fn compressed_and_plain_agree_within_the_steps() {
    let Some(plain) = open("real/parity/playbot_lod4.ply") else { return };
    let Some(packed) = open("real/parity/playbot_lod4.compressed.ply") else { return };
    check_close(&plain.scene, &packed.scene, "playbot");
    assert!(plain.scene.sh_rest.iter().any(|v| v.abs() > 0.5), "coefficients of all sizes");
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
        write_ply_with_columns(&source, &[], &column, &[], &out).unwrap();
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

/// Every scene of the shared data: what it is, how many Gaussians it has, and their degree.
const SCENES: &[(&str, &str, usize, u8)] = &[
    ("objects/biker.compressed.ply", "compressed-ply", 152_746, 0),
    ("objects/biker.spz", "spz", 152_746, 0),
    ("objects/guitar.compressed.ply", "compressed-ply", 90_854, 0),
    ("objects/playbot_sog2_lod", "sog", 500_000, 2),
    ("objects/playbot_sog2_lod/lod-meta.json", "sog", 500_000, 2),
    ("objects/playbot_sog2_lod/0_0", "sog", 500_000, 2),
    ("objects/playbot_sog2_lod/3_0/meta.json", "sog", 31_000, 2),
    ("objects/playbot_sog2_lod/4_0", "sog", 8406, 2),
    ("objects/playbot_sog2_lod/5_0", "sog", 3000, 2),
    ("objects/playbot_sog2_lod/6_0", "sog", 1873, 2),
    ("objects/playcanvas_logo_sog1", "sog", 307_128, 0),
    ("objects/monkey_0001.sog", "sog", 31_658, 0),
    ("objects/hamburger.ply", "ply", 52_709, 0),
    ("objects/monkey404.ply", "ply", 36_295, 0),
    ("objects/tmp_model_unnormalised.ply", "ply", 49_744, 0),
    ("objects/robocop.v2-zstdwrapped.spz", "spz", 267_776, 0),
    ("scenes/arkit_brush/scene.splat", "splat", 116_906, 0),
    ("fixtures/minimal-raw.spz", "spz", 4, 0),
    ("fixtures/minimal-v2.spz", "spz", 4, 0),
    ("fixtures/minimal-v3.spz", "spz", 4, 0),
    ("fixtures/minimal-v4.spz", "spz", 4, 0),
    ("fixtures/minimal.ksplat", "ksplat", 4, 0),
    ("fixtures/minimal.splat", "splat", 4, 0),
    ("fixtures/unitCube-ascii.ply", "ply", 20, 0),
    ("fixtures/cesium_synthetic_legacy.gltf", "gltf", 5, 0),
    ("parity/biker.compressed.ply", "compressed-ply", 152_746, 0),
    ("parity/biker.l1.ksplat", "ksplat", 152_746, 0),
    ("parity/biker.splat", "splat", 152_746, 0),
    ("parity/biker.v2.spz", "spz", 152_746, 0),
    ("parity/biker.v3.spz", "spz", 152_746, 0),
    ("parity/biker.v4.spz", "spz", 152_746, 0),
    ("parity/playbot_lod4.compressed.ply", "compressed-ply", 8406, 2),
    ("parity/playbot_lod4.l0.ksplat", "ksplat", 8406, 2),
    ("parity/playbot_lod4.l1.ksplat", "ksplat", 8406, 2),
    ("parity/playbot_lod4.l2.ksplat", "ksplat", 8406, 2),
    ("parity/playbot_lod4.ply", "ply", 8406, 2),
    ("parity/playbot_lod4.splat", "splat", 8406, 0),
    ("parity/playbot_lod4.v2.spz", "spz", 8406, 2),
    ("parity/playbot_lod4.v3.spz", "spz", 8406, 2),
    ("parity/playbot_lod4.v4.spz", "spz", 8406, 2),
];

#[test]
fn every_scene_opens_whatever_it_is_called() {
    let dir = tempfile::tempdir().unwrap();
    let disguise = dir.path().join("scene.bin");
    for &(name, kind, gaussians, degree) in SCENES {
        let Some(path) = shared(&format!("real/{name}")) else { continue };
        // Real files need no repair, so the strict policy accepts them.
        let loaded = open_scene(&path, &strict());
        let loaded = loaded.unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(loaded.scene.sh_degree, degree, "{name}");
        check_unit(&loaded.scene);
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
        ("real/posed/test_garden.npz", "NumPy archive"),
        ("real/objects/playbot_sog2_lod/0_0/quats.webp", "no scene"),
    ] {
        let Some(path) = shared(name) else { continue };
        let Err(error) = open_scene(&path, &ReadOptions::default()) else {
            panic!("{name} opened as a scene")
        };
        assert!(error.to_string().contains(what), "{error}");
    }
}
