//! Streamed scenes: what is written comes back, level by level.

use crate::common::{limit, random_scene, write_as};
use scenesplat_scene::{
    GaussianScene, ReadOptions, SceneFormat, WriteOptions, WriteReport, open_scene,
};
use std::path::Path;

fn write(scene: &GaussianScene, path: &Path, levels: u8, overwrite: bool) -> WriteReport {
    let options = WriteOptions { lod_levels: levels, overwrite, ..WriteOptions::default() };
    write_as(scene, path, SceneFormat::SogStreamed, &options).unwrap()
}

fn open(path: &Path, lod: usize) -> GaussianScene {
    open_scene(path, &ReadOptions { lod, ..ReadOptions::default() }).unwrap().scene
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn every_level_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("room/lod-meta.json");
    // More than one leaf.
    let scene = random_scene(100_000, 1, 3);
    let report = write(&scene, &path, 3, false);
    assert_eq!(names(path.parent().unwrap()), ["0_0", "1_0", "2_0", "lod-meta.json"]);
    assert_eq!((report.gaussians, report.files[0].as_path()), (100_000, path.as_path()));
    let back = open(&path, 0);
    assert_eq!((back.len(), back.sh_degree), (100_000, 1));
    let order = report.order.unwrap();
    let mut rows = order.clone();
    rows.sort_unstable();
    assert!(rows.iter().enumerate().all(|(i, &row)| i == row as usize), "every row once");
    for (new, &row) in back.coord.iter().zip(&order).step_by(97) {
        let old = scene.coord[row as usize];
        assert!((0..3).all(|a| (new[a] - old[a]).abs() < 2e-3), "{new:?} {old:?}");
    }
    // Both leaves have a quarter, and a sixteenth, of their rows.
    for (lod, count) in [(1, 25_000), (2, 6_250)] {
        let coarse = open(&path, lod);
        assert_eq!(coarse.len(), count, "level {lod}");
        let area = |scene: &GaussianScene| -> f64 {
            let cover = |row: usize| {
                let mut s = scene.scale(row);
                s.sort_by(f32::total_cmp);
                f64::from(scene.opacity(row)) * f64::from(s[1]) * f64::from(s[2])
            };
            (0..scene.len()).map(cover).sum()
        };
        let share = area(&coarse) / area(&back);
        assert!((0.3..1.2).contains(&share), "level {lod} covers {share} of the scene");
    }
    assert!(open_scene(&path, &ReadOptions { lod: 3, ..ReadOptions::default() }).is_err());
    // The folder is the scene too, and inner nodes bound their leaves.
    assert_eq!(open(path.parent().unwrap(), 0), back);
    let meta: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(meta["counts"], serde_json::json!([100_000, 25_000, 6_250]));
    for child in meta["tree"]["children"].as_array().unwrap() {
        for a in 0..3 {
            let of = |node: &serde_json::Value, end: &str| node["bound"][end][a].as_f64().unwrap();
            assert!(of(&meta["tree"], "min") <= of(child, "min"));
            assert!(of(&meta["tree"], "max") >= of(child, "max"));
        }
    }
}

#[test]
fn a_smaller_scene_leaves_nothing_of_the_larger_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("lod-meta.json");
    let scene = random_scene(3000, 0, 5);
    write(&scene, &path, 4, false);
    std::fs::create_dir(dir.path().join("mine")).unwrap();
    std::fs::create_dir(dir.path().join("7_7")).unwrap();
    let error = write_as(&scene, &path, SceneFormat::SogStreamed, &WriteOptions::default());
    assert!(error.unwrap_err().to_string().contains("is there already"));
    let few = scene.select_rows(&[1, 2, 3]).unwrap();
    write(&few, &path, 2, true);
    assert_eq!(names(dir.path()), ["0_0", "1_0", "7_7", "lod-meta.json", "mine"]);
    assert_eq!((open(&path, 0).len(), open(&path, 1).len()), (3, 1));
    // Written again from what was read: the same Gaussians.
    let again = dir.path().join("again/lod-meta.json");
    write(&open(&path, 0), &again, 2, false);
    assert_eq!(open(&again, 0), open(&path, 0));
}

#[test]
fn what_has_no_place_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let mut scene = random_scene(2000, 4, 5);
    scene.segment = Some(vec![1; 2000]);
    scene.opacity_logit = vec![0.0; 2000];
    scene.opacity_logit[1500] = 40.0;
    let report = write(&scene, &dir.path().join("lod-meta.json"), 2, false);
    let find = |field| limit(&report, field, "");
    assert_eq!((find("segment").0, find("sh_rest").0), (2000, 2000));
    let (rows, first, _) = find("opacity_logit");
    assert_eq!((rows, first), (1, 1500), "the row of the scene, not of a chunk");
}
