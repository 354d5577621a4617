//! Sources on small folders that are as the preprocessing writes them.

use scenesplat_datasets::sources::{SceneFolders, SceneFoldersOptions};
use scenesplat_datasets::{Benchmark, DataError, Dataset, SourceConfig, Split};
use scenesplat_scene::formats::npy_writer::write_npy;
use serde_json::json;
use std::path::Path;

/// What a scene's folder holds beside its Gaussians.
#[derive(Default)]
struct Contents<'a> {
    labels: &'a [(&'a str, usize, Vec<i32>)],
    scale: f32,
    points: bool,
}

const ROWS: usize = 3;

fn write_scene(folder: &Path, contents: &Contents<'_>) {
    std::fs::create_dir_all(folder).unwrap();
    let file = |stem: &str| folder.join(format!("{stem}.npy"));
    let coord: Vec<f32> = (0..ROWS * 3).map(|i| i as f32).collect();
    write_npy(&file("coord"), &[ROWS, 3], &coord).unwrap();
    write_npy(&file("scale"), &[ROWS, 3], &[contents.scale; ROWS * 3]).unwrap();
    write_npy(&file("quat"), &[ROWS, 4], &[0.5_f32; ROWS * 4]).unwrap();
    write_npy(&file("opacity"), &[ROWS], &[1e-6_f32; ROWS]).unwrap();
    write_npy(&file("color"), &[ROWS, 3], &[7_u8; ROWS * 3]).unwrap();
    for (stem, columns, values) in contents.labels {
        let shape = if *columns == 1 { vec![ROWS] } else { vec![ROWS, *columns] };
        write_npy(&file(stem), &shape, values).unwrap();
    }
    if contents.points {
        write_npy(&file("pc_coord"), &[2, 3], &[1.0_f32; 6]).unwrap();
        for (stem, columns, values) in contents.labels {
            let shape = if *columns == 1 { vec![2] } else { vec![2, *columns] };
            let values = &values[..2 * columns];
            write_npy(&file(&format!("pc_{stem}")), &shape, values).unwrap();
        }
    }
}

fn config(kind: &str, root: &Path, more: serde_json::Value) -> SourceConfig {
    let mut value = json!({"type": kind, "root": root});
    let serde_json::Value::Object(more) = more else { panic!("{more} is no object") };
    value.as_object_mut().unwrap().extend(more);
    serde_json::from_value(value).unwrap()
}

#[test]
fn every_benchmark_reads_its_own_labels_from_its_own_folders() {
    for benchmark in Benchmark::ALL {
        let root = tempfile::tempdir().unwrap();
        // Labels of every name, of different values: reading another file would show.
        let labels = [
            ("segment", 3, vec![1, 8, 8, -1, 9, 9, 2, 7, 7]),
            ("segment20", 1, vec![3, 4, -1]),
            ("segment200", 1, vec![5, 6, -1]),
            ("segment_nyu_160", 1, vec![7, 8, -1]),
        ];
        for split in [Split::Train, Split::Validation, Split::Test] {
            for folder in benchmark.folders(split) {
                let path = root.path().join(folder).join("scene0000_00_0");
                write_scene(&path, &Contents { labels: &labels, scale: 0.1, points: true });
            }
        }
        let expected = match benchmark {
            Benchmark::Scannet20 => [3, 4, -1],
            Benchmark::Scannet200 => [5, 6, -1],
            Benchmark::Matterport160 => [7, 8, -1],
            _ => [1, -1, 2],
        };
        for (name, split) in
            [("train", Split::Train), ("validation", Split::Validation), ("test", Split::Test)]
        {
            let more = json!({"split": name, "labelled_points": split != Split::Train});
            let config = config(benchmark.name(), root.path(), more);
            assert_eq!(config.benchmark().unwrap().0, benchmark);
            let source = config.build().unwrap();
            assert_eq!(source.scene_ids().len(), benchmark.folders(split).len());
            let scene = source.load(&source.scene_ids()[0]).unwrap().scene;
            assert_eq!(scene.segment.unwrap(), expected, "{benchmark:?} {name}");
            match scene.labelled_points {
                Some(points) => assert_eq!(points.segment.unwrap(), expected[..2]),
                None => assert_eq!(split, Split::Train),
            }
        }
    }
}

#[test]
fn labels_of_other_classes_are_never_taken() {
    let root = tempfile::tempdir().unwrap();
    let labels = [("segment200", 1, vec![5, 6, -1])];
    let scene = root.path().join("train/scene0000_00");
    write_scene(&scene, &Contents { labels: &labels, scale: 0.1, points: true });
    let more = json!({"folders": ["train"], "labelled_points": true});
    let loaded = config("scannet20", root.path(), more.clone()).build().unwrap();
    let loaded = loaded.load("scene0000_00").unwrap();
    assert!(
        loaded.scene.segment.is_none() && loaded.scene.labelled_points.unwrap().segment.is_none()
    );
    assert!(loaded.report.notes.iter().any(|n| n.contains("no segment20")), "{:?}", loaded.report);
    // ScanNet++ falls back to that name.
    let loaded = config("scannetpp", root.path(), more).build().unwrap();
    assert_eq!(loaded.load("scene0000_00").unwrap().scene.segment.unwrap(), [5, 6, -1]);
}

#[test]
fn exact_limits_values_as_the_original_does_and_the_default_does_not() {
    let limited = |kind: &str, scale: f32, exact: bool| {
        let root = tempfile::tempdir().unwrap();
        write_scene(&root.path().join("a/s"), &Contents { scale, ..<_>::default() });
        let config = config(kind, root.path(), json!({"folders": ["a"], "exact": exact}));
        let sample = config.dataset(vec![], 0, 1).unwrap().get(0, 0).unwrap();
        let near = |a: f32, b: f32| (a - b).abs() <= 1e-6 * b.abs();
        if !exact {
            assert!(near(sample.scale[0][0], scale) && near(sample.opacity[0], 1e-6));
        }
        (sample.coord[1][0], sample.scale[0][0], sample.opacity[0])
    };
    for kind in ["scannet20", "scannet200", "scannetpp", "scannetpp_v2", "matterport21"] {
        let (coord, scale, opacity) = limited(kind, 9.0, true);
        assert_eq!((coord, scale), (3.0, 1.5));
        assert!(opacity < 2e-6);
        assert_eq!(limited(kind, 9.0, false).0, 3.0);
    }
    for kind in ["replica", "hypersim", "3rscan", "arkitscenes", "holicity", "generic"] {
        assert_eq!(limited(kind, 9.0, true), (3.0, 1.0, 0.001));
        assert_eq!(limited(kind, 1e-7, true), (3.0, 1e-4, 0.001));
        limited(kind, 9.0, false);
    }
    assert_eq!(limited("kitti360", 200.0, true), (0.3, 10.0, 0.001));
    assert_eq!(limited("kitti360", 0.05, true), (0.3, 0.01, 0.001));
    assert_eq!(limited("kitti360", 200.0, false).0, 3.0);
}

#[test]
fn folders_ids_exclusions_and_limits() {
    let root = tempfile::tempdir().unwrap();
    for scene in
        ["train/scene0001_00_0", "train/scene0001_00_1", "train/scene0002_00_0", "val/scene0003_00"]
    {
        write_scene(&root.path().join(scene), &Contents { scale: 0.1, ..<_>::default() });
    }
    std::fs::create_dir_all(root.path().join("train/notes")).unwrap();
    std::fs::write(root.path().join("train/list.txt"), "").unwrap();
    let ids = |more| config("scannet20", root.path(), more).build().unwrap().scene_ids().to_vec();
    let train = ["scene0001_00_0", "scene0001_00_1", "scene0002_00_0"];
    assert_eq!(ids(json!({"folders": ["train"]})), train);
    assert_eq!(ids(json!({"folders": ["train"], "excluded_scenes": ["scene0001"]})), train[2..]);
    assert_eq!(
        ids(json!({"folders": ["train"], "excluded_scenes": ["scene0001_00_1", "scene000"]})),
        ["scene0001_00_0", "scene0002_00_0"]
    );
    assert_eq!(ids(json!({"folders": ["train"], "limit": 1})), train[..1]);
    let both = ids(json!({"folders": ["val", "train"]}));
    assert_eq!((both.len(), both[0].as_str()), (4, "val/scene0003_00"));
    let error = config("scannet20", root.path(), json!({})).build().err().unwrap().to_string();
    assert!(
        error.contains("train_grid1.0cm_chunk6x6_stride3x3") && error.contains("train, val"),
        "{error}"
    );
    assert!(error.contains("scenesplat chunk"), "{error}");
    let empty = config("generic", &root.path().join("train/notes"), json!({})).build();
    assert!(empty.err().unwrap().to_string().contains("no scene"));
}

#[test]
fn generic_folders_hold_scenes_of_any_format() {
    let root = tempfile::tempdir().unwrap();
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
               property float z\nproperty int label\nend_header\n1 2 3 4\n";
    std::fs::write(root.path().join("b.ply"), ply).unwrap();
    std::fs::write(root.path().join("broken.spz"), "no").unwrap();
    let labels = [("segment", 1, vec![1, 2, 3]), ("classes", 1, vec![4, 5, 6])];
    write_scene(&root.path().join("a"), &Contents { labels: &labels, scale: 0.1, points: false });
    let source = config("generic", root.path(), json!({})).build().unwrap();
    assert_eq!(source.scene_ids(), ["a", "b.ply", "broken.spz"]);
    assert_eq!(source.load("a").unwrap().scene.segment.unwrap(), [1, 2, 3]);
    assert_eq!(source.load("b.ply").unwrap().scene.segment.unwrap(), [4]);
    let error = source.load("broken.spz").unwrap_err();
    assert!(matches!(&error, DataError::Scene { id, .. } if id == "broken.spz"), "{error}");
    assert!(matches!(source.load("../a"), Err(DataError::UnknownScene { known: 3, .. })));
    assert!(config("generic", root.path(), json!({})).label_set().unwrap().is_none());
}

#[test]
fn a_broken_array_names_its_scene() {
    let root = tempfile::tempdir().unwrap();
    let scene = root.path().join("val/scene0011_00");
    write_scene(&scene, &Contents { scale: 0.1, ..<_>::default() });
    std::fs::write(scene.join("opacity.npy"), "not an array").unwrap();
    let data = config("scannet20", root.path(), json!({"split": "validation"}));
    let error = data.dataset(vec![], 0, 1).unwrap().get(0, 0).unwrap_err();
    assert!(matches!(&error, DataError::Scene { id, .. } if id == "scene0011_00"), "{error}");
}

#[test]
fn configurations_survive_a_file_and_refuse_what_they_do_not_know() {
    let config = config("3rscan", Path::new("data"), json!({"limit": 3, "exact": true}));
    let text = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<SourceConfig>(&text).unwrap(), config);
    for wrong in [
        json!({"type": "scannet20"}),
        json!({"type": "scannet20", "root": "a", "folder": ["b"]}),
        json!({"type": "scannet21", "root": "a"}),
        json!({"type": "scannet20", "root": "a", "split": "training"}),
    ] {
        assert!(serde_json::from_value::<SourceConfig>(wrong.clone()).is_err(), "{wrong}");
    }
    let rooms = json!({"type": "synthetic", "count": 2, "room": {"num_gaussians": 300}});
    let rooms: SourceConfig = serde_json::from_value(rooms).unwrap();
    assert_eq!(rooms.build().unwrap().scene_ids().len(), 2);
    assert!(!rooms.label_set().unwrap().unwrap().is_empty());
}

#[test]
fn a_missing_root_is_an_error() {
    let missing = SceneFolders::new(Path::new("nowhere"), &[], SceneFoldersOptions::default());
    assert!(missing.unwrap_err().to_string().contains("nowhere"));
}
