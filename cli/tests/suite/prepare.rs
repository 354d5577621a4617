//! `prepare`: a scan and its scene become what training reads; what does not fit is refused.

use crate::support::*;
use half::f16;
use scenesplat::scene::formats::npy_writer::write_npy;
use std::process::Output;

/// Four Gaussians near a scan of ScanNet's layout, one far from it.
struct World(Folder);

impl World {
    fn new() -> Self {
        let folder = Folder::new();
        let coord =
            [[0.02, 0.0, 0.0], [1.0, 0.01, 0.0], [1.0, 1.0, 0.1], [0.5, 0.5, 0.2], [9.0; 3]];
        folder.scene("splat.ply", &balls(coord.to_vec(), 0.05, 1.0));
        let mesh = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n\
                    3 0 1 2\n3 0 2 3\n";
        folder.write("scene0001_00/scene0001_00_vh_clean_2.ply", mesh);
        folder.write(SEGMENTS, r#"{"segIndices": [1, 1, 2, 2]}"#);
        folder.write(
            "scene0001_00/scene0001_00.aggregation.json",
            r#"{"segGroups": [{"id": 0, "objectId": 0, "segments": [1], "label": "chair"},
                              {"id": 1, "objectId": 1, "segments": [2], "label": "thing"}]}"#,
        );
        folder.write("labels.tsv", "id\traw_category\tnyu40id\n2\tchair\t5\n1\twall\t1\n");
        folder.write("train.txt", "scene0009_00\n");
        folder.write("val.txt", "scene0001_00\n");
        let rows: Vec<f16> = (0..10).map(|i| f16::from_f32(f32::from(i < 4))).collect();
        write_npy(&folder.path("lang_feat.npy"), &[5, 2], &rows).unwrap();
        Self(folder)
    }

    /// Prepares; `@` stands for the folder.
    fn prepare(&self, more: &str) -> Output {
        let layout = match more.contains("--layout") {
            true => "",
            false => "--layout scannet --label-table @labels.tsv",
        };
        let words = "prepare scan @splat.ply --scan @scene0001_00 --out @out";
        line(&format!("{words} {layout} {more}").replace("@", &self.0.at("")))
    }
}

const SEGMENTS: &str = "scene0001_00/scene0001_00_vh_clean_2.0.010000.segs.json";

#[test]
fn a_scan_becomes_a_folder_and_its_points_go_to_chunks() {
    let world = World::new();
    let lists = "--splits train=@train.txt,val=@val.txt";
    let said = told(&world.prepare(&format!("{lists} --lang-feat @lang_feat.npy")));
    has(&said, &["4 of 5 Gaussians are inside", "segment20: 2 Gaussians", "thing (2)"]);
    let folder = world.0.path("out/val/scene0001_00");
    let ints = |name: &str| labels(folder.join(name));
    // The fourth is 0.73 m from any vertex.
    assert_eq!(ints("segment20.npy"), [4, 4, -1, -1]);
    assert_eq!(ints("segment200.npy"), [1, 1, -1, -1]);
    assert_eq!(ints("instance.npy"), [0, 0, 1, -1]);
    // The receipt counts what was written.
    let receipt = json(world.0.path("out/receipt.json"));
    let files = std::fs::read_dir(&folder).unwrap().map(|f| f.unwrap().metadata().unwrap());
    let bytes: u64 = files.filter(|m| m.is_file()).map(|m| m.len()).sum();
    assert_eq!(receipt["bytes_written"].as_u64(), Some(bytes));
    has(&receipt["written"].to_string(), &["segment200.npy"]);
    assert_eq!(ints("pc_segment20.npy"), [4, 4, -1, -1]);
    assert_eq!(ints("valid_feat_mask.npy"), [1, 1, 0, 0]);
    assert_eq!(npy(folder.join("lang_feat.npy")).shape(), [4, 2]);
    assert_eq!(floats(folder.join("normal.npy"))[..3], [0.0, 0.0, 1.0]);
    // The program itself reads it.
    let look = world.0.at("look");
    done(&run!("inspect {} --out {look} --segment-name segment20", folder.display()));

    // A chunk with the first Gaussian, and one of a scene that is not there.
    let chunks = world.0.path("val_chunk");
    for (name, mask) in [("scene0001_00_0", 1i64), ("scene0001_00_1", 0)] {
        std::fs::create_dir_all(chunks.join(name)).unwrap();
        write_npy(&chunks.join(name).join("coord.npy"), &[1, 3], &[0.02f32, 0.0, 0.0]).unwrap();
        write_npy(&chunks.join(name).join("valid_feat_mask.npy"), &[1], &[mask]).unwrap();
    }
    let (scenes, cut) = (world.0.at("out/val"), world.0.at("val_chunk"));
    let said = told(&run!("prepare chunks {scenes} {cut} --filtered 0.5"));
    has(&said, &["2 of 2 chunks have labeled points"]);
    assert_eq!(labels(chunks.join("scene0001_00_0/pc_segment20.npy")), [4]);
    let filtered = world.0.path("val_chunk_filtered");
    assert!(filtered.join("scene0001_00_0/pc_coord.npy").is_file());
    assert!(!filtered.join("scene0001_00_1").exists());
}

#[test]
fn limits_are_choices_and_what_does_not_fit_is_refused() {
    let world = World::new();
    let folder = world.0.path("out/scene0001_00");
    done(&world.prepare("--max-distance 0 --keep-all"));
    // Of equally near points the first; far ones take a label too.
    assert_eq!(labels(folder.join("instance.npy")), [0, 0, 1, 0, 1]);
    let features = "--lang-feat @lang_feat.npy";
    has(&told(&world.prepare(&format!("{features} --min-valid 0.9"))), &["left out"]);
    assert!(!folder.join("lang_feat.npy").exists());

    let refused = |more: &str, code: i32, parts: &[&str]| {
        refused(&world.prepare(more), code, parts);
    };
    refused("--layout hypersim", 1, &["metadata_scene.csv"]);
    refused("--layout nuscenes", 2, &["no layout", "scannetpp"]);
    refused("--layout replica", 1, &["replica", "names of classes"]);
    refused("--layout scannet", 1, &["scannetv2-labels.combined.tsv"]);
    refused("--max-distance nan", 2, &["--max-distance"]);
    refused("--splits train", 2, &["train=scannetv2_train.txt"]);
    refused("--name ../x", 2, &["--name"]);
    let file = world.0.path("lang_feat.npy");
    write_npy(&file, &[4, 2], &[f16::ONE; 8]).unwrap();
    refused(features, 1, &["lang_feat.npy", "has 4 rows", "the scene 5 rows"]);
    write_npy(&file, &[5, 2], &[f16::NAN; 10]).unwrap();
    refused(features, 1, &["row 0, column 0", "NaN"]);
    world.0.write(SEGMENTS, r#"{"segIndices": [1]}"#);
    refused("", 1, &["segs.json", "of 1 vertices", "has 4"]);
}

#[test]
fn features_of_the_lifting_program_are_a_pair() {
    let world = World::new();
    // As `torch.save((features, step), …)` writes it: five rows of two, and a number.
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/tests/data/tuple.pth");
    done(&world.prepare(&format!("--lang-feat {path}")));
    let rows = floats(world.0.path("out/scene0001_00/lang_feat.npy"));
    assert_eq!(rows, [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
}
