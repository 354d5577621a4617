//! Chunks on disk: every array, resumed runs, odd scenes.

use half::f16;
use scenesplat_datasets::DataError;
use scenesplat_datasets::chunking::{ChunkFolder, ChunkReport, ChunkSettings};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use scenesplat_scene::formats::npy::{NpyFile, NpyType};
use scenesplat_scene::formats::npy_writer::write_npy;
use scenesplat_scene::{ReadOptions, SceneFormat, WriteOptions, open_scene, write_scene};
use std::path::Path;

const N: usize = 2000;

/// A scene as the original's preprocessing writes it: 10 m x 5 m, arrays of many types.
fn write_folder(folder: &Path) {
    std::fs::create_dir_all(folder).unwrap();
    let file = |stem: &str| folder.join(format!("{stem}.npy"));
    let place = |i: usize| [(i % 100) as f32 * 0.1 - 3.0, (i / 100) as f32 * 0.25, 1.0];
    let coord: Vec<f32> = (0..N).flat_map(place).collect();
    write_npy(&file("coord"), &[N, 3], &coord).unwrap();
    write_npy(&file("color"), &[N, 3], &(0..N * 3).map(|i| i as u8).collect::<Vec<_>>()).unwrap();
    write_npy(&file("opacity"), &[N], &vec![0.5_f32; N]).unwrap();
    write_npy(&file("scale"), &[N, 3], &vec![0.01_f32; N * 3]).unwrap();
    write_npy(&file("quat"), &[N, 4], &vec![0.5_f32; N * 4]).unwrap();
    write_npy(&file("normal"), &[N, 3], &vec![0.0_f64; N * 3]).unwrap();
    let numbers = |width: usize| 0..N * width;
    write_npy(&file("segment20"), &[N], &numbers(1).map(|i| i as i16).collect::<Vec<_>>()).unwrap();
    write_npy(&file("segment"), &[N, 3], &numbers(3).map(|i| i as i32).collect::<Vec<_>>())
        .unwrap();
    write_npy(&file("instance"), &[N], &numbers(1).map(|i| i as i64).collect::<Vec<_>>()).unwrap();
    let mask: Vec<i64> = (0..N).map(|i| i64::from(i % 2 == 0)).collect();
    write_npy(&file("valid_feat_mask"), &[N], &mask).unwrap();
    let feat = |i: usize| if i.is_multiple_of(2) { [3.0, 4.0] } else { [0.0, 0.0] };
    let feat: Vec<f16> = (0..N).flat_map(feat).map(f16::from_f32).collect();
    write_npy(&file("lang_feat"), &[N, 2], &feat).unwrap();
    let points: Vec<f32> = (0..50).flat_map(|i| [i as f32 * 0.2 - 3.0, 1.0, 0.0]).collect();
    write_npy(&file("pc_coord"), &[50, 3], &points).unwrap();
    write_npy(&file("pc_segment"), &[50], &(0..50).collect::<Vec<i32>>()).unwrap();
}

fn settings() -> ChunkSettings {
    ChunkSettings { grid_size: None, minimum_size: 100, ..ChunkSettings::default() }
}

fn cut(folder: &ChunkFolder, scene: &str, source: &Path) -> ChunkReport {
    folder.cut(scene, source, &mut |_| true).unwrap()
}

fn read(folder: &Path, stem: &str) -> NpyFile {
    NpyFile::open(&folder.join(format!("{stem}.npy"))).unwrap()
}

#[test]
fn every_array_is_cut_alike_and_keeps_its_type() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("train/scene");
    write_folder(&source);
    let folder = ChunkFolder::open(dir.path(), "train", settings()).unwrap();
    let report = cut(&folder, "scene", &source);
    // 9.9 m: chunks at 0 and 3 and 6 along x; 4.75 m: at 0 along y.
    let chunks: Vec<_> = report.chunks.iter().map(|(name, rows)| (name.as_str(), *rows)).collect();
    assert_eq!(chunks, [("scene_0", 1200), ("scene_1", 1200), ("scene_2", 800)]);
    assert!(report.notes.is_empty(), "{:?}", report.notes);
    let chunk = folder.path().join("scene_1");
    let numbers = read(&chunk, "segment20").read_i64().unwrap();
    assert_eq!(numbers.len(), 1200);
    assert!(numbers.iter().all(|&i| (30..90).contains(&(i % 100))));
    let expected: Vec<i64> = (0..N as i64).filter(|i| (30..90).contains(&(i % 100))).collect();
    assert_eq!(numbers, expected);
    let triple = read(&chunk, "segment");
    assert_eq!(triple.shape(), [1200, 3]);
    assert_eq!(triple.read_i64().unwrap()[3], 3 * numbers[1]);
    assert_eq!(read(&chunk, "instance").read_i64().unwrap(), numbers);
    for (stem, ty) in [
        ("coord", NpyType::Float(4)),
        ("color", NpyType::UInt(1)),
        ("normal", NpyType::Float(8)),
        ("segment20", NpyType::Int(2)),
        ("segment", NpyType::Int(4)),
        ("instance", NpyType::Int(8)),
        ("lang_feat", NpyType::Float(2)),
        ("valid_feat_mask", NpyType::Int(8)),
    ] {
        assert_eq!(read(&chunk, stem).ty(), ty, "{stem}");
    }
    // Positions are not shifted; features are of length 1, or 0 as before.
    assert_eq!(read(&chunk, "coord").read_f32().unwrap()[0], 0.0);
    let feat = read(&chunk, "lang_feat").read_f32().unwrap();
    assert!((feat[0] - 0.6).abs() < 1e-3 && (feat[1] - 0.8).abs() < 1e-3);
    assert_eq!(feat[2..4], [0.0, 0.0]);
    // Labeled points of the same square, with their labels.
    let labels = read(&chunk, "pc_segment").read_i64().unwrap();
    let places = read(&chunk, "pc_coord").read_f32().unwrap();
    assert_eq!(labels.len() * 3, places.len());
    assert_eq!((labels[0], labels.len()), (15, 30));
    let opened = open_scene(&chunk, &ReadOptions::default()).unwrap();
    assert_eq!(opened.scene.len(), 1200);
}

#[test]
fn sampling_keeps_features_and_drops_the_rest() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("scene");
    write_folder(&source);
    // Cells of two Gaussians along x, one of which has a feature.
    let settings = ChunkSettings { grid_size: Some(0.2), ..settings() };
    let folder = ChunkFolder::open(dir.path(), "val", settings).unwrap();
    assert!(folder.path().ends_with("val_grid20.0cm_chunk6x6_stride3x3"));
    let report = cut(&folder, "scene", &source);
    assert!(report.sampled < N * 6 / 10, "{}", report.sampled);
    let mask = read(&folder.path().join("scene_0"), "valid_feat_mask").read_i64().unwrap();
    let kept = mask.iter().filter(|&&m| m == 1).count();
    // Half of all have one; the cells with only one Gaussian have no choice.
    assert!(kept * 10 > mask.len() * 7, "{kept} of {}", mask.len());
}

#[test]
fn interrupted_runs_go_on() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("scene");
    write_folder(&source);
    let folder = ChunkFolder::open(dir.path(), "train", settings()).unwrap();
    let stopped = folder.cut("scene", &source, &mut |done| done < 0.5).unwrap_err();
    assert!(stopped.to_string().contains("stopped"), "{stopped}");
    let names = || {
        let entries = std::fs::read_dir(folder.path()).unwrap();
        let mut names: Vec<_> =
            entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    assert_eq!(names(), [".chunks"], "nothing is left of it");
    assert!(folder.finished("scene").is_none());
    // What a killed run leaves, and a chunk that was complete.
    let first = cut(&folder, "scene", &source);
    assert_eq!(first.found, 0);
    let bytes = |name: &str| std::fs::read(folder.path().join(name).join("segment.npy")).unwrap();
    let before = bytes("scene_1");
    std::fs::remove_dir_all(folder.path().join("scene_1")).unwrap();
    std::fs::create_dir(folder.path().join(".scene_1.part")).unwrap();
    std::fs::write(folder.path().join(".scene_1.part/color.npy"), "half").unwrap();
    std::fs::write(folder.path().join("scene_0/mark"), "").unwrap();
    let again = cut(&folder, "scene", &source);
    assert_eq!((again.found, again.chunks), (2, first.chunks));
    assert_eq!(bytes("scene_1"), before);
    assert!(folder.path().join("scene_0/mark").exists(), "complete chunks are not touched");
    // A complete scene is not even read.
    std::fs::remove_dir_all(&source).unwrap();
    assert_eq!(cut(&folder, "scene", &source).found, 3);
    assert_eq!(names(), [".chunks", "scene_0", "scene_1", "scene_2"]);
}

#[test]
fn other_settings_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    ChunkFolder::open(dir.path(), "train", settings()).unwrap();
    ChunkFolder::open(dir.path(), "train", settings()).unwrap();
    let other = ChunkSettings { minimum_size: 7, ..settings() };
    let error = ChunkFolder::open(dir.path(), "train", other).unwrap_err().to_string();
    assert!(error.contains("minimum_size is 100 there, 7 here"), "{error}");
    let other = ChunkSettings { stride: [2.0; 2], ..settings() };
    assert!(ChunkFolder::open(dir.path(), "train", other).is_ok(), "has a folder of its own");
}

#[test]
fn any_format_can_be_cut() {
    let dir = tempfile::tempdir().unwrap();
    let room = generate(&SyntheticRoomSettings::with_count(3000, 1)).unwrap().scene;
    let source = dir.path().join("room.ply");
    write_scene(&room, &source, SceneFormat::Ply, &WriteOptions::default(), &mut |_| true).unwrap();
    let settings = ChunkSettings { range: [2.0; 2], stride: [1.0; 2], ..settings() };
    let folder = ChunkFolder::open(dir.path(), "all", settings).unwrap();
    let report = cut(&folder, "room", &source);
    assert!(report.chunks.len() > 1, "{report:?}");
    for (name, rows) in &report.chunks {
        let chunk = open_scene(&folder.path().join(name), &ReadOptions::default()).unwrap().scene;
        assert_eq!(chunk.len(), *rows);
        assert!(chunk.segment.is_some() && chunk.instance.is_some());
    }
}

#[test]
fn odd_scenes_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("scene");
    write_folder(&source);
    let exact = ChunkSettings { exact: true, range: [12.0; 2], stride: [2.0; 2], ..settings() };
    let folder = ChunkFolder::open(dir.path(), "exact", exact.clone()).unwrap();
    let report = cut(&folder, "scene", &source);
    assert!(
        report.chunks.is_empty() && report.notes[0].contains("not longer"),
        "{:?}",
        report.notes
    );
    let folder =
        ChunkFolder::open(dir.path(), "ours", ChunkSettings { exact: false, ..exact }).unwrap();
    let report = cut(&folder, "scene", &source);
    assert!(report.chunks.len() == 1 && report.notes[0].contains("original"), "{:?}", report.notes);
    let most = ChunkSettings { minimum_size: N, ..settings() };
    let folder = ChunkFolder::open(dir.path(), "few", most).unwrap();
    let report = cut(&folder, "scene", &source);
    assert!(report.notes[0].contains("fewer than 2000"), "{:?}", report.notes);
    assert_eq!(report.below_minimum, 3);
    // A Gaussian that cannot be used, and an array that is of something else.
    let mut coord = NpyFile::open(&source.join("coord.npy")).unwrap().read_f32().unwrap();
    coord[0] = f32::NAN;
    write_npy(&source.join("coord.npy"), &[N, 3], &coord).unwrap();
    write_npy(&source.join("camera.npy"), &[4, 4], &[0.0_f32; 16]).unwrap();
    let folder = ChunkFolder::open(dir.path(), "odd", settings()).unwrap();
    let report = cut(&folder, "scene", &source);
    assert_eq!((report.dropped_rows, report.chunks[0].1), (1, 1199));
    let first = read(&folder.path().join("scene_0"), "instance").read_i64().unwrap()[0];
    assert_eq!(first, 1, "rows of the file, not of what is left of it");
    let notes = report.notes.join("\n");
    assert!(
        notes.contains("used: 1 Gaussians") && notes.contains("camera.npy is left out"),
        "{notes}"
    );
    let missing = folder.cut("none", &dir.path().join("none"), &mut |_| true).unwrap_err();
    assert!(matches!(missing, DataError::Rows(_)), "{missing}");
}
