//! `prepare`: a scan and its scene become what training reads; what does not fit is refused.

use crate::collect_end_to_end::{Size, train, world};
use crate::support::*;
use half::f16;
use scenesplat::scene::Camera;
use scenesplat::scene::formats::cameras::open_cameras;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Samples, read_png};
use std::path::Path;
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

/// The cameras of a folder with their pictures and depths as a `.sens` file of ScanNet: PNG colors, raw depths of
/// 1000 steps per meter; the last frame has lost its pose.
fn sens(shots: &Path, cameras: &[Camera]) -> Vec<u8> {
    let matrix = |rows: [[f64; 4]; 4]| -> Vec<u8> {
        rows.as_flattened().iter().flat_map(|v| (*v as f32).to_le_bytes()).collect()
    };
    let [first, ..] = cameras else { panic!("no cameras") };
    // The file counts from the center of the first pixel.
    let (cx, cy) = (first.cx - 0.5, first.cy - 0.5);
    let still = |fx, fy, cx, cy| {
        matrix([[fx, 0.0, cx, 0.0], [0.0, fy, cy, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    };
    let lens = still(first.fx, first.fy, cx, cy);
    let place = still(1.0, 1.0, 0.0, 0.0);
    let mut out = [&4u32.to_le_bytes()[..], &4u64.to_le_bytes(), b"Test"].concat();
    [&lens, &place, &lens, &place].into_iter().for_each(|bytes| out.extend(bytes));
    let sizes = [first.width, first.height, first.width, first.height];
    [1, 0].into_iter().chain(sizes).for_each(|v: u32| out.extend(v.to_le_bytes()));
    out.extend(1000f32.to_le_bytes());
    out.extend((cameras.len() as u64 + 1).to_le_bytes());
    let lost = [[f64::NEG_INFINITY; 4]; 4];
    let poses = cameras.iter().map(|camera| camera.camera_to_world());
    for (pose, camera) in poses.chain([lost]).zip(cameras.iter().chain([first])) {
        let color = bytes(shots.join(format!("{}.png", camera.name)));
        let depth = read_png(&shots.join(format!("depth/{}.png", camera.name))).unwrap();
        let Samples::Sixteen(depth) = depth.into_samples() else { panic!("16 bits") };
        let depth: Vec<u8> = depth.iter().flat_map(|v| v.to_le_bytes()).collect();
        out.extend(matrix(pose));
        let counts = [0, 0, color.len() as u64, depth.len() as u64];
        counts.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(color);
        out.extend(depth);
    }
    out
}

/// From a benchmark's file to a network that is measured, by commands alone.
#[test]
fn frames_of_a_benchmark_become_a_scene_labels_and_a_network() {
    let folder = Folder::new();
    let run = |words: &str| line(&words.replace('@', &folder.at("")));
    let size = Size { gaussians: 4000, views: 8, picture: [64, 48], room: 0, epochs: 1 };
    world(folder.root(), &size);
    done(&run("render @scene --cameras @cameras.json --depth --out @shots --quiet"));
    let cameras = open_cameras(&folder.path("cameras.json")).unwrap().cameras;
    folder.write("scan/scene0000_00.sens", sens(&folder.path("shots"), &cameras));

    let output = run("prepare frames @scan --layout scannet --out @frames");
    done(&output);
    has(
        &stderr(&output),
        &["8 frames", "of 9 chosen", "1 frames were skipped (1: pose not finite)"],
    );
    let frames = "--cameras @frames/cameras.json --images @frames/images";
    let next =
        format!("next: scenesplat optimise {frames} --depth @frames/depth --out @frames-scene");
    has(&stdout(&output), &[&next.replace('@', &folder.at(""))]);
    let report = json(folder.path("frames/frames.json"));
    assert_eq!((&report["written"], &report["with_depth"]), (&8.into(), &8.into()));
    assert_eq!(report["skipped"][0]["frame"], "000008");
    let found = open_cameras(&folder.path("frames/cameras.json")).unwrap().cameras;
    for (number, (found, camera)) in found.iter().zip(&cameras).enumerate() {
        assert_eq!(found.name, format!("{number:06}.png"));
        let (a, b) = (found.centre(), camera.centre());
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-4), "{a:?} {b:?}");
        let [image, depth] = ["images", "depth"].map(|f| format!("frames/{f}/{number:06}.png"));
        let shot = |name: String| bytes(folder.path("shots").join(name));
        assert_eq!(bytes(folder.path(&image)), shot(format!("{}.png", camera.name)));
        assert!(folder.path(&depth).is_file());
    }

    let optimise = "--depth @frames/depth --initial 1500 --cap 1500 --steps 20 --test-every 0";
    done(&run(&format!("optimise {frames} {optimise} --out @made --quiet")));
    done(&run(&format!("collect-labels @made/scene.ply {frames} --out @labels {SMALL_PICTURE}")));
    std::fs::create_dir(folder.path("train")).unwrap();
    done(&run("convert @made/scene.ply @train/room"));
    for name in ["lang_feat.npy", "valid_feat_mask.npy"] {
        std::fs::copy(folder.path("labels").join(name), folder.path("train/room").join(name))
            .unwrap();
    }
    let f_miou = train(folder.root(), size.epochs);
    assert!((0.0..=1.0).contains(&f_miou), "{f_miou}");
}

#[test]
fn frames_are_chosen_and_what_does_not_fit_is_refused() {
    let folder = Folder::new();
    let run = |words: &str| line(&format!("prepare frames {words}").replace('@', &folder.at("")));
    folder.write("scan/camera-intrinsics.txt", "40 0 19.5\n0 40 14.5\n0 0 1\n");
    let png = scenesplat::scene::picture::RgbPicture::filled(40, 30, [9; 3]).encode_png().unwrap();
    for number in 0..9 {
        folder.write(&format!("scan/frame-{number}.color.png"), &png);
        folder.write(&format!("scan/frame-{number}.pose.txt"), "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1");
    }
    let said = told(&run("@scan --layout rgbd --out @few --every 2 --max-frames 2"));
    has(&said, &["2 frames", "2 chosen, 9 in all", "2 of 2 frames have no depth"]);
    let names = open_cameras(&folder.path("few/cameras.json")).unwrap().cameras;
    assert_eq!([&names[0].name, &names[1].name], ["frame-0.png", "frame-4.png"]);
    assert!(!folder.path("few/depth").exists());
    // Again into the same folder; not into one of others.
    done(&run("@scan --layout rgbd --out @few"));
    folder.write("other/depth/a.png", &png);
    let cases = [
        ("@scan --layout rgbd --out @other", 2, "other/depth is there"),
        ("@scan --layout nuscenes --out @out", 2, "no layout; there are: scannet, scannetpp"),
        ("@scan --layout replica --out @out", 1, "cam_params.json"),
        ("@scan --layout rgbd --every 0 --out @out", 2, "--every"),
    ];
    all_refused(cases, run);
    for number in 0..9 {
        folder.write(&format!("scan/frame-{number}.pose.txt"), "nan ".repeat(16));
    }
    let none = run("@scan --layout rgbd --out @out");
    refused(&none, 1, &["none of 9 frames can be used (9: pose not finite)"]);
    assert!(!folder.path("out/cameras.json").exists());
}
