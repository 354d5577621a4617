//! `lift-labels`: both layouts of segments, what is written, what is refused.

use crate::{done, scenesplat, stderr};
use half::f16;
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Channels, Picture, Samples};
use scenesplat::scene::{Camera, Distortion, GaussianScene};
use std::path::Path;
use tempfile::TempDir;

const W: usize = 64;
const H: usize = 48;

/// Two blobs left and right, and one behind all cameras.
fn scene() -> GaussianScene {
    let coord = vec![[-1.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 0.0, -5.0]];
    GaussianScene {
        log_scale: vec![[0.2f32.ln(); 3]; 3],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 3],
        opacity_logit: vec![2.0; 3],
        sh_dc: vec![[0.5; 3]; 3],
        coord,
        ..GaussianScene::default()
    }
}

fn camera(name: &str, x: f64) -> Camera {
    Camera {
        name: name.to_owned(),
        width: W as u32,
        height: H as u32,
        fx: 40.0,
        fy: 40.0,
        cx: 32.0,
        cy: 24.0,
        distortion: Distortion::None,
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [x, 0.0, 0.0],
    }
}

/// Scene, cameras and segments: the left half is segment 0, the right half segment 1, at level 1 all is
/// segment 2.
fn world() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    write_inria_ply(&scene(), &[], &at("room.ply")).unwrap();
    let cameras = [camera("a.png", 0.0), camera("b.png", 0.1), camera("lonely.png", 0.0)];
    write_cameras_json(&cameras, &at("cameras.json")).unwrap();
    std::fs::create_dir(at("segments")).unwrap();
    let halves: Vec<i32> = (0..W * H).map(|i| i32::from(i % W >= W / 2)).collect();
    let ids: Vec<i32> = halves.iter().copied().chain(vec![2; W * H]).collect();
    let features = [3.0f32, 0.0, 0.0, 4.0, 1.0, 1.0].map(f16::from_f32);
    for frame in ["a", "b"] {
        write_npy(&at(&format!("segments/{frame}_s.npy")), &[2, H, W], &ids).unwrap();
        write_npy(&at(&format!("segments/{frame}_f.npy")), &[3, 2], &features).unwrap();
    }
    dir
}

fn lift(dir: &Path, more: &[&str]) -> std::process::Output {
    let at = |name: &str| dir.join(name).to_str().unwrap().to_owned();
    let (scene, cameras, segments, out) =
        (at("room.ply"), at("cameras.json"), at("segments"), at("out"));
    let mut args = vec!["lift-labels", &scene, "--cameras", &cameras, "--segments", &segments];
    if !more.contains(&"--out") {
        args.extend(["--out", &out]);
    }
    args.extend(more);
    scenesplat(&args)
}

fn values(path: &Path) -> Vec<f32> {
    NpyFile::open(path).unwrap().read_f32().unwrap()
}

#[test]
fn labels_reach_their_gaussians() {
    let dir = world();
    let out = dir.path().join("out");
    let output = lift(dir.path(), &[]);
    done(&output);
    assert!(stderr(&output).contains("3 cameras, 2 frames, 2 with both"), "{}", stderr(&output));
    let file = NpyFile::open(&out.join("lang_feat.npy")).unwrap();
    assert_eq!((file.shape(), file.ty().size()), (&[3, 2][..], 2));
    assert_eq!(file.read_f32().unwrap(), [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    assert_eq!(values(&out.join("valid_feat_mask.npy")), [1.0, 1.0, 0.0]);
    assert_eq!(values(&out.join("views.npy")), [2.0, 2.0, 0.0]);
    let confidence = values(&out.join("confidence.npy"));
    assert!(confidence[0] > 0.999 && confidence[1] > 0.999 && confidence[2] == 0.0);
    let coverage = values(&out.join("coverage.npy"));
    assert!(coverage[0] > 10.0 && coverage[1] > 10.0 && coverage[2] == 0.0, "{coverage:?}");
    let receipt = std::fs::read_to_string(out.join("receipt.json")).unwrap();
    // Nothing hides anything: depth agreement stays off.
    for text in
        ["alpha-weighted", "disagreement[0]", "auto: off", "1 cameras have no segments (lonely.png"]
    {
        assert!(receipt.contains(text), "{text}: {receipt}");
    }
    assert!(out.join("preview.png").is_file());

    // A limit on coverage, the other rule, all guards and a tiny memory still give the same here.
    let guards = ["--robust", "on", "--depth", "render", "--erode", "1", "--max-memory", "50kB"];
    done(&lift(dir.path(), &guards));
    assert_eq!(values(&out.join("lang_feat.npy"))[..4], [1.0, 0.0, 0.0, 1.0]);
    done(&lift(dir.path(), &["--rule", "centre-pixel", "--unnormalised"]));
    assert_eq!(values(&out.join("lang_feat.npy"))[..4], [1.0, 0.0, 0.0, 1.0]);
    done(&lift(dir.path(), &["--coverage", "1e6"]));
    assert_eq!(values(&out.join("valid_feat_mask.npy")), [0.0; 3]);
    assert_eq!(values(&out.join("lang_feat.npy")), [0.0; 6]);
}

/// A blob right behind another one for two cameras, beside it for two others; all segments are true.
fn hidden_world() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let two = GaussianScene {
        coord: vec![[0.0, 0.0, 3.0], [0.0, 0.0, 6.0]],
        log_scale: vec![[0.4f32.ln(); 3], [0.1f32.ln(); 3]],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        opacity_logit: vec![4.0; 2],
        sh_dc: vec![[0.5; 3]; 2],
        ..GaussianScene::default()
    };
    write_inria_ply(&two, &[], &at("room.ply")).unwrap();
    // The near blob is left of column 12, right of column 51, or everywhere.
    let pictures = [("a", -2.0, 0..12), ("b", 2.0, 52..W), ("c", 0.0, 0..W), ("d", 0.02, 0..W)];
    let cameras: Vec<Camera> =
        pictures.iter().map(|(name, x, _)| camera(&format!("{name}.png"), *x)).collect();
    write_cameras_json(&cameras, &at("cameras.json")).unwrap();
    std::fs::create_dir(at("segments")).unwrap();
    for (frame, _, near) in pictures {
        let ids: Vec<i32> = (0..W * H).map(|i| i32::from(!near.contains(&(i % W)))).collect();
        write_npy(&at(&format!("segments/{frame}_s.npy")), &[H, W], &ids).unwrap();
        let features = [1.0f32, 0.0, 0.0, 1.0];
        write_npy(&at(&format!("segments/{frame}_f.npy")), &[2, 2], &features).unwrap();
    }
    dir
}

#[test]
fn what_shines_through_does_not_take_the_name_of_what_hides_it() {
    let dir = hidden_world();
    let feature = || values(&dir.path().join("out/lang_feat.npy"));
    let off = lift(dir.path(), &["--depth", "off", "--robust", "off"]);
    done(&off);
    assert!(!stderr(&off).contains("depth agreement"), "{}", stderr(&off));
    let mixed = feature();
    assert!(mixed[2] > 0.02, "{mixed:?}");

    // What the measurement finds is done, said and recorded.
    let auto = lift(dir.path(), &["--robust", "off"]);
    done(&auto);
    assert!(stderr(&auto).contains("depth agreement: render"), "{}", stderr(&auto));
    let agreeing = feature();
    assert_eq!(agreeing[2..], [0.0, 1.0]);
    let receipt = std::fs::read_to_string(dir.path().join("out/receipt.json")).unwrap();
    assert!(receipt.contains("auto: render") && receipt.contains("depth_kept"), "{receipt}");
    done(&lift(dir.path(), &["--depth", "render", "--robust", "off"]));
    assert_eq!(feature(), agreeing);
}

#[test]
fn levels_get_folders_of_their_own() {
    let dir = world();
    done(&lift(dir.path(), &["--level", "1,0"]));
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let all = values(&dir.path().join("out/level-1/lang_feat.npy"));
    assert!(all[..4].iter().all(|v| (v - half).abs() < 1e-3), "{all:?}");
    let halves = values(&dir.path().join("out/level-0/lang_feat.npy"));
    assert_eq!(halves, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
}

#[test]
fn rows_that_are_left_out_stay_in_the_files() {
    let dir = world();
    let mut scene = scene();
    scene.coord.insert(0, [f32::NAN, 0.0, 0.0]);
    scene.log_scale.insert(0, [0.0; 3]);
    scene.quat.insert(0, [1.0, 0.0, 0.0, 0.0]);
    scene.opacity_logit.insert(0, 0.0);
    scene.sh_dc.insert(0, [0.0; 3]);
    write_inria_ply(&scene, &[], &dir.path().join("room.ply")).unwrap();
    done(&lift(dir.path(), &[]));
    let features = values(&dir.path().join("out/lang_feat.npy"));
    assert_eq!(features, [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    assert_eq!(values(&dir.path().join("out/views.npy")), [0.0, 2.0, 2.0, 0.0]);
}

#[test]
fn pictures_of_ids_with_one_table() {
    let dir = world();
    let segments = dir.path().join("segments");
    std::fs::remove_dir_all(&segments).unwrap();
    std::fs::create_dir(&segments).unwrap();
    let ids = (0..W * H / 4).map(|i| u8::from(i % (W / 2) >= W / 4)).collect();
    let (w, h) = (W as u32 / 2, H as u32 / 2);
    let map = Picture::new(w, h, Channels::Gray, Samples::Eight(ids)).unwrap();
    std::fs::write(segments.join("b.png"), map.encode_png().unwrap()).unwrap();
    write_npy(&segments.join("features.npy"), &[2, 2], &[1.0f32, 0.0, 0.0, 1.0]).unwrap();
    done(&lift(dir.path(), &[]));
    let features = values(&dir.path().join("out/lang_feat.npy"));
    assert_eq!(features, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    // A measured depth: the left blob is where it says, the right one is not.
    let depth = dir.path().join("depth");
    std::fs::create_dir(&depth).unwrap();
    let far = |i: usize| if i % W < W / 2 { 3.0f32 } else { 9.0 };
    let metres: Vec<f32> = (0..W * H).map(far).collect();
    write_npy(&depth.join("b.npy"), &[H, W], &metres).unwrap();
    done(&lift(dir.path(), &["--depth", depth.to_str().unwrap()]));
    assert_eq!(values(&dir.path().join("out/valid_feat_mask.npy")), [1.0, 0.0, 0.0]);
    write_npy(&depth.join("b.npy"), &[2, W], &metres[..2 * W]).unwrap();
    let output = lift(dir.path(), &["--depth", depth.to_str().unwrap()]);
    assert!(stderr(&output).contains("b.npy") && stderr(&output).contains("[48, 64]"));
}

#[test]
fn what_does_not_fit_is_refused_before_anything_is_written() {
    let dir = world();
    let refused = |more: &[&str], code: i32, about: &[&str]| {
        let output = lift(dir.path(), more);
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{text}");
        assert!(about.iter().all(|about| text.contains(about)), "{text}");
        assert!(!dir.path().join("out/lang_feat.npy").exists());
    };
    refused(&["--view-exponent", "2"], 2, &["view exponent", "is 2"]);
    refused(&["--coverage", "nan"], 2, &["coverage"]);
    refused(&["--level", "7"], 2, &["--level", "\"7\"", "0 to 3"]);
    refused(&["--max-memory", "1kB"], 2, &["--max-memory 1.0 kB", "at least 49.2 kB"]);
    refused(&["--max-memory", "60kB", "--level", "0,1,2"], 2, &["at least 73.7 kB"]);
    refused(&["--level", "3"], 1, &["a_s.npy", "level 3"]);

    let cameras = [camera("x.png", 0.0)];
    write_cameras_json(&cameras, &dir.path().join("cameras.json")).unwrap();
    refused(&[], 1, &["segments", "x.png"]);
    let wide = Camera { width: 70, ..camera("a.png", 0.0) };
    write_cameras_json(&[wide], &dir.path().join("cameras.json")).unwrap();
    refused(&[], 1, &["a_s.npy", "is 64×48, its camera 70×48"]);
}

#[test]
fn photos_are_looked_at_and_change_nothing_unless_they_are_blurred() {
    let dir = world();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let render = |out: &str, more: &[&str]| {
        let (scene, cameras, out) = (at("room.ply"), at("cameras.json"), at(out));
        let words = ["render", &scene, "--cameras", &cameras, "--out", &out];
        done(&scenesplat(&[&words[..], more].concat()));
    };
    render("photos", &[]);
    let files = ["lang_feat.npy", "confidence.npy", "coverage.npy", "views.npy"];
    let read = || files.map(|f| std::fs::read(dir.path().join("out").join(f)).unwrap());
    done(&lift(dir.path(), &[]));
    let plain = read();
    let photos = at("photos");
    let output = lift(dir.path(), &["--photos", &photos, "--frame-weights", "auto"]);
    done(&output);
    let said = stderr(&output);
    for part in ["blur: ", "light: ", "coverage: ", "0 of 2 pictures count less"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert_eq!(read(), plain);
    let receipt = std::fs::read_to_string(dir.path().join("out/receipt.json")).unwrap();
    assert!(receipt.contains("photos/blur") && receipt.contains("frame_weights"), "{receipt}");
    // Wrong folders and sizes are named.
    render("large", &["--size", "128x96"]);
    for (folder, part) in [("segments", "no photo is named like a frame"), ("large", "[128, 96]")] {
        let output = lift(dir.path(), &["--photos", &at(folder)]);
        assert_eq!(output.status.code(), Some(1));
        assert!(stderr(&output).contains(part), "{}", stderr(&output));
    }
    let output = lift(dir.path(), &["--frame-weights", "auto"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("--photos"), "{}", stderr(&output));
}

#[test]
fn glass_is_looked_for_and_other_effects_are_refused_by_name() {
    let dir = world();
    let text = |name: &str| std::fs::read_to_string(dir.path().join("out").join(name)).unwrap();
    done(&lift(dir.path(), &[]));
    let plain = std::fs::read(dir.path().join("out/lang_feat.npy")).unwrap();
    assert!(text("receipt.json").contains("\"effect\": \"glass\""), "{}", text("receipt.json"));
    done(&lift(dir.path(), &["--effect", "glass=off"]));
    assert_eq!(std::fs::read(dir.path().join("out/lang_feat.npy")).unwrap(), plain);
    assert!(text("receipt.json").contains("off by choice"));
    // Three blobs are no room: a wish that cannot be fulfilled is said.
    let output = lift(dir.path(), &["--effect", "glass=on"]);
    done(&output);
    assert!(text("receipt.json").contains("no pane was found"), "{}", text("receipt.json"));
    assert_eq!(std::fs::read(dir.path().join("out/lang_feat.npy")).unwrap(), plain);
    // An earlier run is looked at, if there is one.
    let receipt = dir.path().join("before.json");
    std::fs::copy(dir.path().join("out/receipt.json"), &receipt).unwrap();
    done(&lift(dir.path(), &["--effect-before", receipt.to_str().unwrap()]));
    assert!(text("receipt.json").contains("effects before"), "{}", text("receipt.json"));
    std::fs::write(&receipt, "{}").unwrap();
    let output = lift(dir.path(), &["--effect-before", receipt.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let output = lift(dir.path(), &["--effect", "holes=on"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("acted on here: glass"), "{}", stderr(&output));
}
