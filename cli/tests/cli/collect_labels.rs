//! `collect-labels`: what is written, that a stopped run goes on to the same bits, what is refused.

use crate::{done, scenesplat, stderr};
use scenesplat::preview::LookAt;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::picture::{Channels, Picture, Samples, read_picture};
use scenesplat::scene::{Camera, UpAxis};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const SIZE: [u32; 2] = [80, 60];
const COUNT: usize = 6;

/// A room, cameras in its middle, and their photos.
fn world() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let settings = SyntheticRoomSettings {
        num_gaussians: Some(6000),
        points_share: 0.0,
        ..SyntheticRoomSettings::default()
    };
    let room = generate(&settings).unwrap();
    write_inria_ply(&room.scene, &[], &at("room.ply")).unwrap();
    let eye = [0.5, 0.5, 0.6].map(f64::from);
    let eye = [0, 1, 2].map(|k| eye[k] * f64::from(room.size[k]));
    let camera = |i: usize| {
        let turn = std::f64::consts::TAU * i as f64 / COUNT as f64;
        let target = [eye[0] + turn.cos(), eye[1] + turn.sin(), eye[2] - 0.3];
        LookAt { eye, target, fov: 60.0 }
            .camera(&format!("{i:03}.png"), UpAxis::PlusZ, SIZE)
            .unwrap()
    };
    let cameras: Vec<Camera> = (0..COUNT).map(camera).collect();
    write_cameras_json(&cameras, &at("cameras.json")).unwrap();
    let path = |name: &str| at(name).to_str().unwrap().to_owned();
    let (scene, file, photos) = (path("room.ply"), path("cameras.json"), path("photos"));
    done(&scenesplat(&["render", &scene, "--cameras", &file, "--out", &photos]));
    dir
}

fn words(dir: &Path, out: &str, more: &[&str]) -> Vec<String> {
    let at = |name: &str| dir.join(name).to_str().unwrap().to_owned();
    let mut words = vec!["collect-labels".to_owned(), at("room.ply")];
    if !more.contains(&"--cameras") && !more.contains(&"--render") {
        words.extend(["--cameras".to_owned(), at("cameras.json")]);
    }
    if !more.contains(&"--images") && !more.contains(&"--render") {
        words.extend(["--images".to_owned(), at("photos")]);
    }
    words.extend(["--out".to_owned(), at(out)]);
    words.extend(more.iter().map(|word| (*word).to_owned()));
    words
}

fn collect(dir: &Path, out: &str, more: &[&str]) -> Output {
    let words = words(dir, out, more);
    scenesplat(&words.iter().map(String::as_str).collect::<Vec<_>>())
}

const FILES: [&str; 5] =
    ["lang_feat.npy", "valid_feat_mask.npy", "confidence.npy", "views.npy", "coverage.npy"];

fn bits(dir: &Path, out: &str) -> Vec<Vec<u8>> {
    FILES.map(|name| std::fs::read(dir.join(out).join(name)).unwrap()).to_vec()
}

fn refused(output: &Output, code: i32, parts: &[&str]) {
    let text = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(parts.iter().all(|part| text.contains(part)), "{parts:?}: {text}");
    assert!(!text.contains("panicked"), "{text}");
}

#[test]
fn photos_become_features_and_what_is_done_is_not_done_again() {
    let dir = world();
    let output = collect(dir.path(), "out", &[]);
    done(&output);
    let out = dir.path().join("out");
    let file = NpyFile::open(&out.join("lang_feat.npy")).unwrap();
    assert_eq!(file.shape(), [6000, 487]);
    let mask = NpyFile::open(&out.join("valid_feat_mask.npy")).unwrap().read_f32().unwrap();
    let labelled = mask.iter().filter(|v| **v == 1.0).count();
    assert!(labelled > 2000, "{labelled}");
    for (row, valid) in file.read_f32().unwrap().chunks_exact(487).zip(&mask) {
        let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((norm - valid).abs() < 2e-3, "{norm}");
    }
    let receipt = std::fs::read_to_string(out.join("receipt.json")).unwrap();
    for stage in ["\"segments\"", "\"features\"", "\"lifting\"", "\"lifting/features\""] {
        assert!(receipt.contains(&format!("\"name\": {stage}")), "{stage}: {receipt}");
    }
    // The frames are a folder of segments as lift-labels reads them.
    let map = NpyFile::open(&out.join("frames/000_s.npy")).unwrap();
    assert_eq!(map.shape(), [1, 60, 80]);

    let first = bits(dir.path(), "out");
    let output = collect(dir.path(), "out", &["--threads", "1"]);
    done(&output);
    assert!(stderr(&output).contains("6 pictures were done before"), "{}", stderr(&output));
    assert_eq!(bits(dir.path(), "out"), first);
    // From nothing, on one thread: the same bits.
    done(&collect(dir.path(), "other", &["--threads", "1"]));
    assert_eq!(bits(dir.path(), "other"), first);

    // Other settings, another photo, a damaged file: made anew, and said.
    let output = collect(dir.path(), "out", &["--compat", "original"]);
    done(&output);
    assert!(
        stderr(&output).contains("6 pictures in frames were made from other"),
        "{}",
        stderr(&output)
    );
    assert_ne!(bits(dir.path(), "out"), first);
    done(&collect(dir.path(), "out", &[]));
    std::fs::write(out.join("frames/002_f.npy"), b"damaged").unwrap();
    let photo = dir.path().join("photos/004.png");
    let brighter = read_picture(&photo).unwrap().to_rgb8();
    let brighter = scenesplat::scene::picture::RgbPicture::from_fn(80, 60, |x, y| {
        brighter.get(x, y).unwrap().map(|v| v.saturating_add(9))
    });
    std::fs::write(&photo, brighter.encode_png().unwrap()).unwrap();
    let output = collect(dir.path(), "out", &[]);
    done(&output);
    let text = stderr(&output);
    assert!(text.contains("4 pictures were done before"), "{text}");
    assert!(text.contains("2 pictures in frames were made from other"), "{text}");
}

/// Starts, and kills the process as soon as `enough` of the frames folder is there.
fn killed(dir: &Path, out: &str, enough: impl Fn(&Path) -> bool) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_scenesplat"))
        .args(words(dir, out, &["--threads", "1"]))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let folder = dir.join(out);
    while !enough(&folder) && began.elapsed() < Duration::from_secs(120) {
        if child.try_wait().unwrap().is_some() {
            break;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let _ = child.kill();
    child.wait().unwrap();
}

fn count(out: &Path, ending: &str) -> usize {
    let entries =
        std::fs::read_dir(out.join("frames")).map(|list| list.flatten().collect::<Vec<_>>());
    let names =
        entries.unwrap_or_default().into_iter().map(|e| e.file_name().into_string().unwrap());
    names.filter(|name| name.ends_with(ending)).count()
}

#[test]
fn a_run_that_was_killed_anywhere_goes_on_to_the_same_bits() {
    let dir = world();
    done(&collect(dir.path(), "whole", &[]));
    let whole = bits(dir.path(), "whole");
    // While the first frames are made, in the middle of one, and while labels are lifted.
    killed(dir.path(), "a", |out| count(out, ".json") >= 1);
    killed(dir.path(), "b", |out| {
        count(out, "_s.npy") > count(out, ".json") + 1 || count(out, "_s.npy") >= 4
    });
    killed(dir.path(), "c", |out| count(out, ".json") == COUNT);
    for out in ["a", "b", "c"] {
        assert!(
            !dir.path().join(out).join("lang_feat.npy").exists(),
            "{out} was not killed in time"
        );
        let output = collect(dir.path(), out, &[]);
        done(&output);
        assert!(
            !stderr(&output).contains("; 0 pictures were done before"),
            "{out}: {}",
            stderr(&output)
        );
        assert_eq!(bits(dir.path(), out), whole, "{out}");
    }
}

/// Grey maps of the left and the right half.
fn masks(dir: &Path, name: &str, samples: impl Fn(Vec<u16>) -> Samples) -> PathBuf {
    let folder = dir.join(name);
    std::fs::create_dir(&folder).unwrap();
    for i in 0..COUNT {
        let ids = (0..80 * 60).map(|at| if at % 80 < 40 { 7 } else { 200 }).collect();
        let map = Picture::new(80, 60, Channels::Gray, samples(ids)).unwrap();
        std::fs::write(folder.join(format!("{i:03}.png")), map.encode_png().unwrap()).unwrap();
    }
    folder
}

#[test]
fn masks_of_8_and_16_bits_are_the_same_segments() {
    let dir = world();
    let eight =
        masks(dir.path(), "eight", |ids| Samples::Eight(ids.iter().map(|v| *v as u8).collect()));
    let sixteen = masks(dir.path(), "sixteen", Samples::Sixteen);
    done(&collect(dir.path(), "a", &["--segments", eight.to_str().unwrap()]));
    done(&collect(dir.path(), "b", &["--segments", sixteen.to_str().unwrap()]));
    assert_eq!(bits(dir.path(), "a"), bits(dir.path(), "b"));
    let receipt = std::fs::read_to_string(dir.path().join("a/receipt.json")).unwrap();
    assert!(receipt.contains("picture_segments") && receipt.contains("\"12\""), "{receipt}");
    // One of the two is none: each picture has a single segment, and that is said.
    done(&collect(
        dir.path(),
        "c",
        &["--segments", eight.to_str().unwrap(), "--no-segment", "200"],
    ));
    let receipt = std::fs::read_to_string(dir.path().join("c/receipt.json")).unwrap();
    assert!(receipt.contains("6 pictures have a single segment"), "{receipt}");
    std::fs::remove_file(eight.join("003.png")).unwrap();
    let output = collect(dir.path(), "d", &["--segments", eight.to_str().unwrap()]);
    refused(&output, 1, &["frame 003", "003.png", "is missing"]);
    let empty = dir.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    let output = collect(dir.path(), "d", &["--segments", empty.to_str().unwrap()]);
    refused(&output, 1, &["empty", "holds no .png"]);
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let dir = world();
    for (more, parts) in [
        (&["--segments", "sam2"][..], &["--segments sam2", "superpixels"][..]),
        (&["--features", "siglip2"], &["--features siglip2", "colour"]),
        (&["--sam2-weights", "a.pt"], &["--sam2-weights is for --segments sam2"]),
        (&["--sam2-masks", "original"], &["--sam2-masks is for --segments sam2"]),
        (&["--siglip2-weights", "a"], &["--siglip2-weights is for --features siglip2"]),
        (&["--picture-precision", "bf16"], &["--picture-precision is for"]),
        (&["--no-segment", "3"], &["--no-segment", "id maps"]),
        (&["--max-memory", "1kB"], &["at least 49.2 kB"]),
    ] {
        refused(&collect(dir.path(), "out", more), 2, parts);
    }
    // Weights that are cut, and those of another network.
    let weights = dir.path().join("sam2.safetensors");
    std::fs::write(&weights, [9, 0, 0, 0, 0, 0]).unwrap();
    let sam2 = ["--segments", "sam2", "--sam2-weights", weights.to_str().unwrap()];
    refused(&collect(dir.path(), "out", &sam2), 1, &["sam2.safetensors"]);
    let tensor =
        candle_core::Tensor::zeros((2, 3), candle_core::DType::F32, &candle_core::Device::Cpu);
    let tensors = std::collections::HashMap::from([("a", tensor.unwrap())]);
    candle_core::safetensors::save(&tensors, &weights).unwrap();
    refused(&collect(dir.path(), "out", &sam2), 1, &["sam2.safetensors", "none of SAM 2 tiny"]);
    let siglip2 = ["--features", "siglip2", "--siglip2-weights", dir.path().to_str().unwrap()];
    refused(&collect(dir.path(), "out", &siglip2), 1, &["config.json"]);
    let scene = dir.path().join("room.ply");
    refused(
        &scenesplat(&["collect-labels", scene.to_str().unwrap()]),
        2,
        &["--cameras", "--images"],
    );
    // A photo that is cut, one that is missing, and a pose that is none.
    let photos = dir.path().join("photos");
    let cut = scenesplat::scene::picture::RgbPicture::filled(80, 50, [9; 3]);
    std::fs::write(photos.join("001.png"), cut.encode_png().unwrap()).unwrap();
    refused(&collect(dir.path(), "out", &[]), 1, &["001.png", "is 80×50", "is 80×60"]);
    std::fs::remove_file(photos.join("001.png")).unwrap();
    let output = collect(dir.path(), "out", &[]);
    done(&output);
    assert!(
        stderr(&output).contains("1 of 6 cameras have no photo (001.png"),
        "{}",
        stderr(&output)
    );
    let cameras = dir.path().join("cameras.json");
    let text = std::fs::read_to_string(&cameras).unwrap();
    let at = text.find("\"position\"").unwrap();
    let open = at + text[at..].find('[').unwrap() + 1;
    let end = open + text[open..].find([',', ']']).unwrap();
    let broken = format!("{}1e999{}", &text[..open], &text[end..]);
    std::fs::write(&cameras, broken).unwrap();
    refused(&collect(dir.path(), "out", &[]), 1, &["cameras.json"]);
}

#[test]
fn without_photos_the_scene_is_rendered_from_planned_views() {
    let dir = world();
    let more = ["--render", "5", "--size", "80x60", "--up", "+z"];
    let output = collect(dir.path(), "out", &more);
    done(&output);
    assert!(stderr(&output).contains("5 views inside the scene show"), "{}", stderr(&output));
    let first = bits(dir.path(), "out");
    let output = collect(dir.path(), "out", &[&more[..], &["--threads", "1"]].concat());
    done(&output);
    assert!(stderr(&output).contains("5 pictures were done before"), "{}", stderr(&output));
    assert_eq!(bits(dir.path(), "out"), first);
    // Fewer views: what is left in frames of others labels nothing.
    done(&collect(dir.path(), "out", &["--render", "2", "--size", "80x60", "--up", "+z"]));
    done(&collect(dir.path(), "two", &["--render", "2", "--size", "80x60", "--up", "+z"]));
    assert_eq!(bits(dir.path(), "out"), bits(dir.path(), "two"));
    let photos = dir.path().join("photos");
    let output = collect(dir.path(), "x", &["--render", "2", "--images", photos.to_str().unwrap()]);
    refused(&output, 2, &["--render", "--images"]);
    refused(&collect(dir.path(), "x", &["--render", "0"]), 2, &["--render", "0"]);
}

#[test]
fn of_many_photos_those_are_taken_that_show_most() {
    let dir = world();
    // A blurred copy beside each photo, of the same camera: none of them is needed.
    let cameras = dir.path().join("cameras.json");
    let mut all = scenesplat::scene::open_cameras(&cameras).unwrap().cameras;
    for i in 0..COUNT {
        let sharp = read_picture(&dir.path().join(format!("photos/{i:03}.png"))).unwrap().to_rgb8();
        let blurred = scenesplat::scene::picture::RgbPicture::from_fn(80, 60, |x, y| {
            let at = |dx: u32| sharp.get((x + dx).min(79), y).unwrap();
            [0, 1, 2].map(|c| ((0..6).map(|dx| u32::from(at(dx)[c])).sum::<u32>() / 6) as u8)
        });
        let name = format!("{i:03}b.png");
        std::fs::write(dir.path().join("photos").join(&name), blurred.encode_png().unwrap())
            .unwrap();
        let twin = all.iter().find(|c| c.name.starts_with(&format!("{i:03}"))).unwrap().clone();
        all.push(Camera { name, ..twin });
    }
    all.sort_by(|a, b| a.name.cmp(&b.name));
    write_cameras_json(&all, &cameras).unwrap();
    let output = collect(dir.path(), "out", &["--max-frames", "6"]);
    done(&output);
    assert!(stderr(&output).contains("6 of 12 pictures"), "{}", stderr(&output));
    let out = dir.path().join("out");
    for i in 0..COUNT {
        assert!(out.join(format!("frames/{i:03}.json")).exists(), "{i}");
        assert!(!out.join(format!("frames/{i:03}b.json")).exists(), "{i}");
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
    let dir = world();
    done(&collect(dir.path(), "plain", &[]));
    let plain = bits(dir.path(), "plain");
    for i in 0..COUNT {
        let path = dir.path().join(format!("photos/{i:03}.png"));
        let photo = read_picture(&path).unwrap().to_rgb8();
        let png = if i % 2 == 0 {
            // Lying on its side: the mark says that a quarter turn clockwise puts it right.
            let stored = scenesplat::scene::picture::RgbPicture::from_fn(60, 80, |x, y| {
                photo.get(79 - y, x).unwrap()
            });
            with_exif(&stored.encode_png().unwrap(), 6)
        } else {
            let samples = photo.pixels().iter().flatten().map(|v| u16::from(*v) * 257).collect();
            let deep = Picture::new(80, 60, Channels::Rgb, Samples::Sixteen(samples)).unwrap();
            deep.encode_png().unwrap()
        };
        std::fs::write(&path, png).unwrap();
    }
    let output = collect(dir.path(), "other", &[]);
    done(&output);
    let text = stderr(&output);
    assert!(text.contains("3 photos") && text.contains("turned by their Exif mark"), "{text}");
    assert_eq!(bits(dir.path(), "other"), plain);
}

#[test]
fn poses_that_are_none_and_ids_without_a_feature_are_refused() {
    let dir = world();
    done(&collect(dir.path(), "out", &[]));
    // A feature table that lost a row: the id that needs it is named.
    let frames = dir.path().join("out/frames");
    let table = NpyFile::open(&frames.join("003_f.npy")).unwrap();
    let &[rows, width] = table.shape() else { panic!("{:?}", table.shape()) };
    let short = table.read_f32().unwrap()[..(rows - 1) * width].to_vec();
    scenesplat::scene::formats::npy_writer::write_npy(
        &frames.join("003_f.npy"),
        &[rows - 1, width],
        &short,
    )
    .unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (scene, cameras, folder, out) =
        (at("room.ply"), at("cameras.json"), at("out/frames"), at("lifted"));
    let words =
        ["lift-labels", &scene, "--cameras", &cameras, "--segments", &folder, "--out", &out];
    refused(&scenesplat(&words), 1, &["003_", &format!("{}", rows - 1)]);
    assert!(!dir.path().join("lifted/lang_feat.npy").exists());

    // Python writes NaN where JSON has none; a quaternion or matrix of NaN is as bad.
    let text = std::fs::read_to_string(dir.path().join("cameras.json")).unwrap();
    let at = text.find("\"rotation\"").unwrap();
    let open = at + text[at..].find("[[").or_else(|| text[at..].find('[')).unwrap();
    let first = open + text[open..].find(|c: char| c.is_ascii_digit() || c == '-').unwrap();
    let end = first + text[first..].find([',', ']', '\n']).unwrap();
    std::fs::write(
        dir.path().join("cameras.json"),
        format!("{}NaN{}", &text[..first], &text[end..]),
    )
    .unwrap();
    refused(&collect(dir.path(), "nan", &[]), 1, &["cameras.json"]);
    let colmap = dir.path().join("colmap");
    std::fs::create_dir(&colmap).unwrap();
    std::fs::write(colmap.join("cameras.txt"), "1 PINHOLE 80 60 70 70 40 30\n").unwrap();
    std::fs::write(colmap.join("images.txt"), "1 nan 0 0 0 0 0 0 1 000.png\n\n").unwrap();
    std::fs::write(colmap.join("points3D.txt"), "").unwrap();
    let path = colmap.to_str().unwrap();
    refused(&collect(dir.path(), "nan", &["--cameras", path]), 1, &["images.txt"]);
}

#[test]
fn weights_that_are_cut_short_are_named() {
    let dir = world();
    let device = candle_core::Device::Cpu;
    let tensor = candle_core::Tensor::zeros((40, 30), candle_core::DType::F32, &device).unwrap();
    let tensors = std::collections::HashMap::from([("a", tensor)]);
    let whole = dir.path().join("whole.safetensors");
    candle_core::safetensors::save(&tensors, &whole).unwrap();
    let bytes = std::fs::read(&whole).unwrap();
    for (name, part) in [("cut.safetensors", bytes.len() / 2), ("cut.pt", 40), ("none.pt", 0)] {
        let path = dir.path().join(name);
        // The head of a zip archive without its end, as a download that stopped leaves it.
        let start: &[u8] = if name.ends_with(".pt") { b"PK\x03\x04" } else { b"" };
        std::fs::write(&path, [start, &bytes[..part]].concat()).unwrap();
        let flags = ["--segments", "sam2", "--sam2-weights", path.to_str().unwrap()];
        refused(&collect(dir.path(), "out", &flags), 1, &[name]);
    }
    let folder = dir.path().join("siglip2");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("config.json"), r#"{"model_type": "siglip"}"#).unwrap();
    std::fs::write(folder.join("model.safetensors"), &bytes[..bytes.len() - 9]).unwrap();
    let flags = ["--features", "siglip2", "--siglip2-weights", folder.to_str().unwrap()];
    refused(&collect(dir.path(), "out", &flags), 1, &["model.safetensors"]);
    assert!(!dir.path().join("out/lang_feat.npy").exists());
}

#[test]
fn onnx_files_are_asked_for_by_their_flags() {
    let dir = world();
    for (more, parts) in [
        (&["--onnx-segments", "a"][..], &["--onnx-segments is for --segments onnx"][..]),
        (&["--onnx-features", "a"], &["--onnx-features is for --features onnx"]),
        (&["--onnx-runtime", "a"], &["--onnx-runtime is for --segments onnx and --features onnx"]),
    ] {
        refused(&collect(dir.path(), "out", more), 2, parts);
    }
    for (more, flag) in
        [(["--segments", "onnx"], "--onnx-segments"), (["--features", "onnx"], "--onnx-features")]
    {
        let parts = match cfg!(feature = "onnx") {
            true => vec![more[0], flag],
            // How to build it.
            false => vec![more[0], "--features onnx", "cargo build", "scenesplat-cli"],
        };
        refused(&collect(dir.path(), "out", &more), 2, &parts);
    }
}

#[cfg(feature = "onnx")]
#[test]
fn onnx_files_segment_and_describe() {
    let Ok(library) = std::env::var("SCENESPLAT_ONNXRUNTIME") else {
        println!("NOT RUN: SCENESPLAT_ONNXRUNTIME does not name the library of ONNX Runtime");
        return;
    };
    let dir = world();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../vision/tests/data/onnx");
    let features = data.join("features.onnx");
    let (data, features) = (data.to_str().unwrap(), features.to_str().unwrap());
    let onnx = |library: &str, out: &str| {
        let more = [
            "--segments",
            "onnx",
            "--onnx-segments",
            data,
            "--sam2-masks",
            "original",
            "--features",
            "onnx",
            "--onnx-features",
            features,
            "--onnx-runtime",
            library,
        ];
        collect(dir.path(), out, &more)
    };
    let output = onnx(&library, "out");
    done(&output);
    let out = dir.path().join("out");
    assert_eq!(NpyFile::open(&out.join("lang_feat.npy")).unwrap().shape(), [6000, 5]);
    let mask = NpyFile::open(&out.join("valid_feat_mask.npy")).unwrap().read_f32().unwrap();
    assert!(mask.iter().filter(|v| **v == 1.0).count() > 2000);
    let receipt = std::fs::read_to_string(out.join("receipt.json")).unwrap();
    assert!(receipt.contains("onnx_runtime") && receipt.contains("ORT Build Info"), "{receipt}");
    let first = bits(dir.path(), "out");
    let output = onnx(&library, "out");
    done(&output);
    assert!(stderr(&output).contains("6 pictures were done before"), "{}", stderr(&output));
    assert_eq!(bits(dir.path(), "out"), first);
    // A library that is not there, and a file that is none.
    let missing = onnx(&format!("{library}.missing"), "none");
    refused(&missing, 1, &["--onnx-runtime", ".missing", "is no file", "libonnxruntime.so"]);
    let text = dir.path().join("cameras.json");
    let wrong = onnx(text.to_str().unwrap(), "none");
    refused(&wrong, 1, &["--onnx-runtime", "cameras.json", "could not be loaded"]);
}
