//! `collect-labels`: what is written, that a stopped run goes on to the same bits, what is refused.

use crate::support::*;
use scenesplat::preview::LookAt;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Channels, Picture, RgbPicture, Samples, read_picture};
use scenesplat::scene::{Camera, Up, open_cameras};
#[cfg(feature = "onnx")]
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

const SIZE: [u32; 2] = [80, 60];
const COUNT: usize = 6;

/// A room, cameras in its middle, and their photos.
struct World(Folder);

impl World {
    fn new() -> Self {
        let folder = Folder::new();
        let settings = SyntheticRoomSettings {
            num_gaussians: Some(6000),
            points_share: 0.0,
            ..SyntheticRoomSettings::default()
        };
        let room = generate(&settings).unwrap();
        let scene = folder.scene("room.ply", &room.scene);
        let eye = [0.5, 0.5, 0.6].map(f64::from);
        let eye = [0, 1, 2].map(|k| eye[k] * f64::from(room.size[k]));
        let camera = |i: usize| {
            let turn = std::f64::consts::TAU * i as f64 / COUNT as f64;
            let target = [eye[0] + turn.cos(), eye[1] + turn.sin(), eye[2] - 0.3];
            let look = LookAt { eye, target, fov: 60.0 };
            look.camera(&format!("{i:03}.png"), Up::PLUS_Z, SIZE).unwrap()
        };
        let cameras: Vec<Camera> = (0..COUNT).map(camera).collect();
        let cameras = folder.cameras("cameras.json", &cameras);
        done(&run!("render {scene} --cameras {cameras} --out {}", folder.at("photos")));
        Self(folder)
    }

    /// The command with results in the folder `out`; `@` stands for the folder.
    fn line(&self, out: &str, more: &str) -> String {
        let photos = match more.contains("--render") || more.contains("--cameras") {
            true => "",
            false => "--cameras @cameras.json --images @photos",
        };
        let line = format!("collect-labels @room.ply {photos} --out @{out} {more}");
        line.replace("@", &self.0.at(""))
    }

    fn collect(&self, out: &str, more: &str) -> Output {
        line(&self.line(out, more))
    }

    fn bits(&self, out: &str) -> Vec<Vec<u8>> {
        FILES.map(|name| bytes(self.0.path(out).join(name))).to_vec()
    }

    fn receipt(&self, out: &str) -> String {
        text(self.0.path(out).join("receipt.json"))
    }

    fn photo(&self, name: &str) -> RgbPicture {
        read_picture(&self.0.path("photos").join(name)).unwrap().to_rgb8()
    }
}

const FILES: [&str; 5] =
    ["lang_feat.npy", "valid_feat_mask.npy", "confidence.npy", "views.npy", "coverage.npy"];

#[test]
fn photos_become_features_and_what_is_done_is_not_done_again() {
    let world = World::new();
    done(&world.collect("out", ""));
    let out = |name: &str| world.0.path("out").join(name);
    let file = npy(out("lang_feat.npy"));
    assert_eq!(file.shape(), [6000, 487]);
    let mask = floats(out("valid_feat_mask.npy"));
    let labelled = mask.iter().filter(|v| **v == 1.0).count();
    assert!(labelled > 2000, "{labelled}");
    for (row, valid) in file.read_f32().unwrap().chunks_exact(487).zip(&mask) {
        let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((norm - valid).abs() < 2e-3, "{norm}");
    }
    for stage in ["segments", "features", "lifting", "lifting/features"] {
        has(&world.receipt("out"), &[&format!("\"name\": \"{stage}\"")]);
    }
    // The frames are a folder of segments as lift-labels reads them.
    assert_eq!(npy(out("frames/000_s.npy")).shape(), [1, 60, 80]);

    let first = world.bits("out");
    let said = told(&world.collect("out", "--threads 1"));
    has(&said, &["6 pictures were done before"]);
    assert_eq!(world.bits("out"), first);
    // From nothing, on one thread: the same bits.
    done(&world.collect("other", "--threads 1"));
    assert_eq!(world.bits("other"), first);

    // Other settings, another photo, a damaged file: made anew, and said.
    let said = told(&world.collect("out", "--compat original"));
    has(&said, &["6 pictures in frames were made from other"]);
    assert_ne!(world.bits("out"), first);
    done(&world.collect("out", ""));
    world.0.write("out/frames/002_f.npy", b"damaged");
    let photo = world.photo("004.png");
    let brighter =
        RgbPicture::from_fn(80, 60, |x, y| photo.get(x, y).unwrap().map(|v| v.saturating_add(9)));
    world.0.write("photos/004.png", brighter.encode_png().unwrap());
    let said = told(&world.collect("out", ""));
    has(&said, &["4 pictures were done before", "2 pictures in frames were made from other"]);
}

/// Starts, and kills the process as soon as `enough` of the frames folder is there.
fn killed(world: &World, out: &str, enough: impl Fn() -> bool) {
    let line = world.line(out, "--threads 1");
    let mut child = program();
    let child = child.args(words(&line)).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = child.spawn().unwrap();
    let began = Instant::now();
    while !enough() && began.elapsed() < Duration::from_secs(120) {
        if child.try_wait().unwrap().is_some() {
            break;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let _ = child.kill();
    child.wait().unwrap();
}

#[test]
fn a_run_that_was_killed_anywhere_goes_on_to_the_same_bits() {
    let world = World::new();
    done(&world.collect("whole", ""));
    let whole = world.bits("whole");
    let count = |out: &str, ending: &str| {
        let list = std::fs::read_dir(world.0.path(out).join("frames"));
        let names = list.into_iter().flatten().flatten().map(|e| e.file_name());
        names.filter(|name| name.to_string_lossy().ends_with(ending)).count()
    };
    // While the first frames are made, in the middle of one, and while labels are lifted.
    killed(&world, "a", || count("a", ".json") >= 1);
    killed(&world, "b", || {
        count("b", "_s.npy") > count("b", ".json") + 1 || count("b", "_s.npy") >= 4
    });
    killed(&world, "c", || count("c", ".json") == COUNT);
    for out in ["a", "b", "c"] {
        let late = world.0.path(out).join("lang_feat.npy").exists();
        assert!(!late, "{out} was not killed in time");
        let said = told(&world.collect(out, ""));
        assert!(!said.contains("; 0 pictures were done before"), "{out}: {said}");
        assert_eq!(world.bits(out), whole, "{out}");
    }
}

#[test]
fn the_index_form_goes_on_with_frames_that_a_killed_run_left() {
    let world = World::new();
    let form = "--form index";
    let bits = |out: &str| {
        let files = ["segment_index.npy", "segment_features.npy", "confidence.npy", "views.npy"];
        files.map(|name| bytes(world.0.path(out).join(name)))
    };
    has(&told(&world.collect("whole", form)), &["Gaussians have one of"]);
    let whole = bits("whole");
    assert!(!world.0.path("whole/lang_feat.npy").exists());
    // Frames do not depend on the form that they are lifted in.
    let frames = world.0.path("cut/frames");
    killed(&world, "cut", || frames.join("001.json").exists());
    assert!(!world.0.path("cut/lang_feat.npy").exists(), "not killed in time");
    let said = told(&world.collect("cut", &format!("{form} --threads 1")));
    assert!(!said.contains("; 0 pictures were done before"), "{said}");
    assert_eq!(bits("cut"), whole);
    refused(&world.collect("cut", &format!("{form} --robust off")), 2, &["--robust"]);
    refused(&world.collect("cut", ""), 2, &["segment_index.npy", "remove it"]);
}

/// Gray maps of the left and the right half.
fn masks(world: &World, name: &str, samples: impl Fn(Vec<u16>) -> Samples) {
    for i in 0..COUNT {
        let ids = (0..80 * 60).map(|at| if at % 80 < 40 { 7 } else { 200 }).collect();
        let map = Picture::new(80, 60, Channels::Gray, samples(ids)).unwrap();
        world.0.write(&format!("{name}/{i:03}.png"), map.encode_png().unwrap());
    }
}

#[test]
fn masks_of_8_and_16_bits_are_the_same_segments() {
    let world = World::new();
    masks(&world, "eight", |ids| Samples::Eight(ids.iter().map(|v| *v as u8).collect()));
    masks(&world, "sixteen", Samples::Sixteen);
    done(&world.collect("a", "--segments @eight"));
    done(&world.collect("b", "--segments @sixteen"));
    assert_eq!(world.bits("a"), world.bits("b"));
    has(&world.receipt("a"), &["picture_segments", "\"12\""]);
    // One of the two is none: each picture has a single segment, and that is said.
    done(&world.collect("c", "--segments @eight --no-segment 200"));
    has(&world.receipt("c"), &["6 pictures have a single segment"]);
    std::fs::remove_file(world.0.path("eight/003.png")).unwrap();
    let missing =
        ["5 of 6 cameras have a map of segments; missing: 1 (003.png)", "003.png", "is missing"];
    refused(&world.collect("d", "--segments @eight"), 1, &missing);
    // As COLMAP names masks, in folders that the cameras do not name.
    for i in 0..COUNT {
        let map = bytes(world.0.path(&format!("sixteen/{i:03}.png")));
        world.0.write(&format!("colmap/lens{}/{i:03}.png.png", i % 2), map);
    }
    let said = told(&world.collect("e", "--segments @colmap"));
    has(
        &said,
        &["6 of 6 cameras have a photo; missing: 0", "6 of 6 cameras have a map of segments"],
    );
    assert_eq!(world.bits("e"), world.bits("a"));
    std::fs::create_dir(world.0.path("empty")).unwrap();
    refused(&world.collect("d", "--segments @empty"), 1, &["empty", "holds no .png"]);
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let world = World::new();
    let cases = [
        ("--segments sam2", 2, "superpixels"),
        ("--features siglip2", 2, "colour"),
        ("--sam2-weights a.pt", 2, "--sam2-weights is for --segments sam2"),
        ("--sam2-masks original", 2, "--sam2-masks is for --segments sam2"),
        ("--siglip2-weights a", 2, "--siglip2-weights is for --features siglip2"),
        ("--picture-precision bf16", 2, "--picture-precision is for"),
        ("--no-segment 3", 2, "id maps"),
        ("--max-memory 1kB", 2, "at least 49.2 kB"),
        ("--features siglip2 --siglip2-weights @", 1, "config.json"),
    ];
    all_refused(cases, |more| world.collect("out", more));
    // Weights that are cut, and those of another network.
    let sam2 = "--segments sam2 --sam2-weights @sam2.safetensors";
    world.0.write("sam2.safetensors", [9, 0, 0, 0, 0, 0]);
    refused(&world.collect("out", sam2), 1, &["sam2.safetensors"]);
    zeros(&world, "sam2.safetensors", (2, 3));
    refused(&world.collect("out", sam2), 1, &["sam2.safetensors", "none of SAM 2 tiny"]);
    let scene = world.0.at("room.ply");
    refused(&run!("collect-labels {scene}"), 2, &["--cameras", "--images"]);
    // A photo that is cut, one that is missing, and a pose that is none.
    let cut = RgbPicture::filled(80, 50, [9; 3]);
    world.0.write("photos/001.png", cut.encode_png().unwrap());
    refused(&world.collect("out", ""), 1, &["001.png", "is 80×50", "is 80×60"]);
    std::fs::remove_file(world.0.path("photos/001.png")).unwrap();
    let said = told(&world.collect("out", ""));
    has(&said, &["5 of 6 cameras have a photo; missing: 1 (001.png)"]);
    with_number(&world, "\"position\"", "1e999");
    refused(&world.collect("out", ""), 1, &["cameras.json"]);
}

/// Writes weights that fit no network.
fn zeros(world: &World, name: &str, shape: (usize, usize)) -> Vec<u8> {
    use candle_core::{DType, Device, Tensor, safetensors};
    let tensor = Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
    let tensors = std::collections::HashMap::from([("a", tensor)]);
    safetensors::save(&tensors, world.0.path(name)).unwrap();
    bytes(world.0.path(name))
}

/// Puts another number in the place of the first behind a key of the cameras.
fn with_number(world: &World, key: &str, number: &str) {
    let cameras = text(world.0.path("cameras.json"));
    let is_number = |c: char| c.is_ascii_digit() || c == '-';
    let key = cameras.find(key).unwrap();
    let first = key + cameras[key..].find(is_number).unwrap();
    let end = first + cameras[first..].find([',', ']', '\n']).unwrap();
    world.0.write("cameras.json", format!("{}{number}{}", &cameras[..first], &cameras[end..]));
}

#[test]
fn without_photos_the_scene_is_rendered_from_planned_views() {
    let world = World::new();
    let views = |count: u8| format!("--render {count} --size 80x60 --up +z");
    has(&told(&world.collect("out", &views(5))), &["5 views inside the scene show"]);
    let first = world.bits("out");
    let said = told(&world.collect("out", &format!("{} --threads 1", views(5))));
    has(&said, &["5 pictures were done before"]);
    assert_eq!(world.bits("out"), first);
    // Fewer views: what is left in frames of others labels nothing.
    done(&world.collect("out", &views(2)));
    done(&world.collect("two", &views(2)));
    assert_eq!(world.bits("out"), world.bits("two"));
    refused(&world.collect("x", "--render 2 --images @photos"), 2, &["--render", "--images"]);
    refused(&world.collect("x", "--render 0"), 2, &["--render", "0"]);
}

#[test]
fn of_many_photos_those_are_taken_that_show_most() {
    let world = World::new();
    // A blurred copy beside each photo, of the same camera: none of them is needed.
    let cameras = world.0.path("cameras.json");
    let mut all = open_cameras(&cameras).unwrap().cameras;
    for i in 0..COUNT {
        let sharp = world.photo(&format!("{i:03}.png"));
        let blurred = RgbPicture::from_fn(80, 60, |x, y| {
            let at = |dx: u32| sharp.get((x + dx).min(79), y).unwrap();
            [0, 1, 2].map(|c| ((0..6).map(|dx| u32::from(at(dx)[c])).sum::<u32>() / 6) as u8)
        });
        let name = format!("{i:03}b.png");
        world.0.write(&format!("photos/{name}"), blurred.encode_png().unwrap());
        let twin = all.iter().find(|c| c.name.starts_with(&format!("{i:03}"))).unwrap().clone();
        all.push(Camera { name, ..twin });
    }
    all.sort_by(|a, b| a.name.cmp(&b.name));
    write_cameras_json(&all, &cameras).unwrap();
    has(&told(&world.collect("out", "--max-frames 6")), &["6 of 12 pictures"]);
    let is_there = |name: String| world.0.path("out/frames").join(name).exists();
    for i in 0..COUNT {
        assert!(is_there(format!("{i:03}.json")) && !is_there(format!("{i:03}b.json")), "{i}");
    }
}

/// A PNG file with an Exif mark to turn it by.
fn with_exif(png: &[u8], mark: u8) -> Vec<u8> {
    let mut block = b"eXIfMM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    block.extend([mark, 0, 0]);
    let mut crc = u32::MAX;
    for byte in &block {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { 0xedb8_8320 ^ (crc >> 1) } else { crc >> 1 };
        }
    }
    let mut out = png[..33].to_vec();
    out.extend((block.len() as u32 - 4).to_be_bytes());
    out.extend(block);
    out.extend((!crc).to_be_bytes());
    out.extend(&png[33..]);
    out
}

#[test]
fn turned_photos_and_those_of_16_bits_are_the_same_labels() {
    let world = World::new();
    done(&world.collect("plain", ""));
    for i in 0..COUNT {
        let name = format!("{i:03}.png");
        let photo = world.photo(&name);
        let png = if i % 2 == 0 {
            // Lying on its side: the mark says that a quarter turn clockwise puts it right.
            let stored = RgbPicture::from_fn(60, 80, |x, y| photo.get(79 - y, x).unwrap());
            with_exif(&stored.encode_png().unwrap(), 6)
        } else {
            let samples = photo.pixels().iter().flatten().map(|v| u16::from(*v) * 257).collect();
            let deep = Picture::new(80, 60, Channels::Rgb, Samples::Sixteen(samples)).unwrap();
            deep.encode_png().unwrap()
        };
        world.0.write(&format!("photos/{name}"), png);
    }
    has(&told(&world.collect("other", "")), &["3 photos", "turned by their Exif mark"]);
    assert_eq!(world.bits("other"), world.bits("plain"));
}

#[test]
fn poses_that_are_none_and_ids_without_a_feature_are_refused() {
    let world = World::new();
    done(&world.collect("out", ""));
    // A feature table that lost a row: the id that needs it is named.
    let file = world.0.path("out/frames/003_f.npy");
    let table = npy(&file);
    let &[rows, width] = table.shape() else { panic!("{:?}", table.shape()) };
    let short = table.read_f32().unwrap()[..(rows - 1) * width].to_vec();
    write_npy(&file, &[rows - 1, width], &short).unwrap();
    let [scene, cameras, frames, out] =
        ["room.ply", "cameras.json", "out/frames", "lifted"].map(|name| world.0.at(name));
    let lifted = run!("lift-labels {scene} --cameras {cameras} --segments {frames} --out {out}");
    refused(&lifted, 1, &["003_", &(rows - 1).to_string()]);
    assert!(!world.0.path("lifted/lang_feat.npy").exists());

    // Python writes NaN where JSON has none; a quaternion or matrix of NaN is as bad.
    with_number(&world, "\"rotation\"", "NaN");
    refused(&world.collect("nan", ""), 1, &["cameras.json"]);
    world.0.write("colmap/cameras.txt", "1 PINHOLE 80 60 70 70 40 30\n");
    world.0.write("colmap/images.txt", "1 nan 0 0 0 0 0 0 1 000.png\n\n");
    world.0.write("colmap/points3D.txt", "");
    let colmap = "--cameras @colmap --images @photos";
    refused(&world.collect("nan", colmap), 1, &["images.txt"]);
}

#[test]
fn weights_that_are_cut_short_are_named() {
    let world = World::new();
    let whole = zeros(&world, "whole.safetensors", (40, 30));
    // The head of a zip archive without its end, as a download that stopped leaves it.
    for (name, start, part) in [
        ("cut.safetensors", &b""[..], whole.len() / 2),
        ("cut.pt", b"PK\x03\x04", 40),
        ("none.pt", b"PK\x03\x04", 0),
    ] {
        world.0.write(name, [start, &whole[..part]].concat());
        let flags = format!("--segments sam2 --sam2-weights @{name}");
        refused(&world.collect("out", &flags), 1, &[name]);
    }
    world.0.write("siglip2/config.json", r#"{"model_type": "siglip"}"#);
    world.0.write("siglip2/model.safetensors", &whole[..whole.len() - 9]);
    let flags = "--features siglip2 --siglip2-weights @siglip2";
    refused(&world.collect("out", flags), 1, &["model.safetensors"]);
    assert!(!world.0.path("out/lang_feat.npy").exists());
}

#[test]
fn onnx_files_are_asked_for_by_their_flags() {
    let world = World::new();
    let cases = [
        ("--onnx-segments a", 2, "--onnx-segments is for --segments onnx"),
        ("--onnx-features a", 2, "--onnx-features is for --features onnx"),
        ("--onnx-runtime a", 2, "--onnx-runtime is for --segments onnx and --features onnx"),
    ];
    all_refused(cases, |more| world.collect("out", more));
    for (more, flag) in
        [("--segments onnx", "--onnx-segments"), ("--features onnx", "--onnx-features")]
    {
        let parts = match cfg!(feature = "onnx") {
            true => vec![more, flag],
            // How to build it.
            false => vec![more, "--features onnx", "cargo build", "scenesplat-cli"],
        };
        refused(&world.collect("out", more), 2, &parts);
    }
}

#[cfg(feature = "onnx")]
#[test]
fn onnx_files_segment_and_describe() {
    let Ok(library) = std::env::var("SCENESPLAT_ONNXRUNTIME") else {
        println!("NOT RUN: SCENESPLAT_ONNXRUNTIME does not name the library of ONNX Runtime");
        return;
    };
    let world = World::new();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/vision/tests/data/onnx");
    let data = data.display();
    let onnx = |library: &str, out: &str| {
        let segments = format!("--segments onnx --onnx-segments {data} --sam2-masks original");
        let features = format!("--features onnx --onnx-features {data}/features.onnx");
        world.collect(out, &format!("{segments} {features} --onnx-runtime {library}"))
    };
    done(&onnx(&library, "out"));
    let out = |name: &str| world.0.path("out").join(name);
    assert_eq!(npy(out("lang_feat.npy")).shape(), [6000, 5]);
    assert!(floats(out("valid_feat_mask.npy")).iter().filter(|v| **v == 1.0).count() > 2000);
    has(&world.receipt("out"), &["onnx_runtime", "ORT Build Info"]);
    let first = world.bits("out");
    has(&told(&onnx(&library, "out")), &["6 pictures were done before"]);
    assert_eq!(world.bits("out"), first);
    // A library that is not there, and a file that is none.
    let missing = ["--onnx-runtime", ".missing", "is no file", "libonnxruntime.so"];
    refused(&onnx(&format!("{library}.missing"), "none"), 1, &missing);
    let wrong = ["--onnx-runtime", "cameras.json", "could not be loaded"];
    refused(&onnx("@cameras.json", "none"), 1, &wrong);
}
