//! `render`: pictures, depth, cameras by name and number, plans, messages.

use crate::{done, scenesplat, stderr};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::picture::{RgbPicture, Samples, read_picture};
use scenesplat::scene::{Camera, Distortion, GaussianScene};
use std::path::{Path, PathBuf};
use std::process::Output;

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new(scene: &GaussianScene) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_inria_ply(scene, &[], &folder.path().join("scene.ply")).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn render(&self, out: &str, more: &[&str]) -> Output {
        let (scene, out) = (self.path("scene.ply"), self.path(out));
        let mut args = vec!["render", scene.to_str().unwrap(), "--out", out.to_str().unwrap()];
        args.extend(more);
        scenesplat(&args)
    }

    fn cameras(&self, cameras: &[Camera]) -> String {
        let path = self.path("cameras.json");
        write_cameras_json(cameras, &path).unwrap();
        path.to_str().unwrap().to_owned()
    }
}

/// A red sphere at (0, 0, 2), 0.2 wide, nearly opaque; and one behind it that it hides.
fn sphere() -> GaussianScene {
    GaussianScene {
        coord: vec![[0.0, 0.0, 2.0], [0.0, 0.0, 4.0]],
        log_scale: vec![[0.2f32.ln(); 3]; 2],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        opacity_logit: vec![9.0; 2],
        sh_dc: vec![[1.6, -1.6, -1.6], [-1.6, 1.6, -1.6]],
        ..GaussianScene::default()
    }
}

/// Looks along +z from the origin.
fn camera(name: &str) -> Camera {
    Camera {
        name: name.to_owned(),
        width: 48,
        height: 32,
        fx: 40.0,
        fy: 40.0,
        cx: 24.0,
        cy: 16.0,
        distortion: Distortion::None,
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    }
}

fn open(path: &Path) -> RgbPicture {
    read_picture(path).unwrap().to_rgb8()
}

#[test]
fn color_and_depth_of_a_sphere() {
    let place = Place::new(&sphere());
    let cameras = place.cameras(&[camera("images/left.jpg"), camera("right.jpg")]);
    let more = ["--cameras", &cameras, "--camera", "left", "--depth"];
    done(&place.render("out", &more));
    let picture = open(&place.path("out/left.png"));
    assert_eq!((picture.width(), picture.height()), (48, 32));
    let [r, g, b] = picture.get(24, 16).unwrap();
    assert!(r > 220 && g < 30 && b < 20, "{r} {g} {b}");
    assert_eq!(picture.get(0, 0).unwrap(), [0; 3]);
    // The front one weighs 0.99, the one behind it what is left.
    let depth = read_picture(&place.path("out/depth/left.png")).unwrap().into_samples();
    let Samples::Sixteen(depth) = depth else { panic!("depth is 16-bit grey") };
    assert_eq!(depth.len(), 48 * 32);
    assert!((2000..2030).contains(&depth[16 * 48 + 24]), "{:?}", depth[16 * 48 + 24]);
    assert_eq!(depth[0], 0);
    assert!(place.path("out/depth_color/left.png").exists());
    assert!(!place.path("out/right.png").exists());
    let receipt = std::fs::read_to_string(place.path("out/receipt.json")).unwrap();
    assert!(receipt.contains("plan: auto") && receipt.contains("spheres"), "{receipt}");

    // By number, larger, on white, with everything computed: the same picture in the middle.
    let more = ["--cameras", &cameras, "--camera", "1", "--background", "1,1,1", "--plan", "full"];
    done(&place.render("white", &[&more[..], &["--size", "96x64"]].concat()));
    let white = open(&place.path("white/right.png"));
    assert_eq!((white.width(), white.height()), (96, 64));
    assert_eq!(white.get(0, 0).unwrap(), [255; 3]);
    let [r, g, b] = white.get(48, 32).unwrap();
    assert!(r > 220 && g < 30 && b < 20, "{r} {g} {b}");
}

#[test]
fn pictures_that_show_nothing_are_said() {
    let place = Place::new(&sphere());
    let behind = Camera { translation: [0.0, 0.0, -9.0], ..camera("behind") };
    let cameras = place.cameras(&[camera("front"), behind]);
    let out = place.render("out", &["--cameras", &cameras]);
    done(&out);
    let said = stderr(&out);
    assert!(said.contains("1 of 2 pictures show no Gaussian, behind first"), "{said}");
}

#[test]
fn an_orbit_shows_the_scene_from_all_sides_whatever_the_threads() {
    let room = generate(&SyntheticRoomSettings::with_count(8_000, 3)).unwrap();
    let place = Place::new(&room.scene);
    done(&place.render("one", &["--size", "64x48", "--threads", "1"]));
    done(&place.render("two", &["--size", "64x48", "--threads", "2", "--orbit", "4"]));
    let mut pictures = Vec::new();
    for k in 0..4 {
        let name = format!("orbit_{k:03}.png");
        let [one, two] = ["one", "two"].map(|out| std::fs::read(place.path(out).join(&name)));
        assert_eq!(one.unwrap(), two.unwrap(), "{name}");
        let picture = open(&place.path("one").join(&name));
        let lit = picture.pixels().iter().filter(|p| p.iter().any(|v| *v > 20)).count();
        assert!(lit * 5 > 64 * 48, "{name}: {lit} pixels");
        pictures.push(picture);
    }
    assert!((1..4).all(|k| pictures[k] != pictures[0]));
    for preset in ["gsplat-1.5", "inria"] {
        let more = ["--size", "64x48", "--orbit", "1", "--preset", preset, "--antialiased"];
        done(&place.render(preset, &more));
    }
}

#[test]
fn a_camera_by_flags_and_views_from_inside() {
    let place = Place::new(&sphere());
    // From behind, on the other side of the hidden green one.
    let look = ["--eye", "0,0,7", "--target", "0,0,0", "--fov", "30", "--up", "-y"];
    done(&place.render("out", &[&look[..], &["--size", "48x32"]].concat()));
    let picture = open(&place.path("out/view.png"));
    let [r, g, b] = picture.get(24, 16).unwrap();
    assert!(g > 220 && r < 30 && b < 30, "{r} {g} {b}");
    // The angle is across the shorter side: at 30° ± 16 pixels show ± 0.8 at a distance of 3.
    let lit = (0..32).filter(|y| picture.get(24, *y).unwrap()[1] > 128).count();
    assert!((6..14).contains(&lit), "{lit} rows are lit");

    let room = generate(&SyntheticRoomSettings::with_count(8_000, 3)).unwrap();
    let place = Place::new(&room.scene);
    done(&place.render("in", &["--inside", "3", "--size", "64x48", "--threads", "1"]));
    done(&place.render("in2", &["--inside", "3", "--size", "64x48", "--threads", "2"]));
    let mut pictures = Vec::new();
    for k in 0..3 {
        let name = format!("inside_{k:03}.png");
        let [one, two] = ["in", "in2"].map(|out| std::fs::read(place.path(out).join(&name)));
        assert_eq!(one.unwrap(), two.unwrap(), "{name}");
        let picture = open(&place.path("in").join(&name));
        let lit = picture.pixels().iter().filter(|p| p.iter().any(|v| *v > 20)).count();
        assert!(lit * 5 > 64 * 48 * 4, "{name}: walls are all around, {lit} pixels");
        pictures.push(picture);
    }
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2]);
}

#[test]
fn effects_happen_to_pictures_and_none_changes_no_bit() {
    let room = generate(&SyntheticRoomSettings::with_count(8_000, 3)).unwrap();
    let place = Place::new(&room.scene);
    let look = ["--inside", "3", "--size", "64x48", "--depth"];
    let run = |out: &str, more: &[&str]| {
        let output = place.render(out, &[&look[..], more].concat());
        done(&output);
        let bytes = |k: usize| {
            let name = format!("inside_{k:03}.png");
            ["", "depth"].map(|d| std::fs::read(place.path(out).join(d).join(&name)).unwrap())
        };
        ([bytes(0), bytes(1), bytes(2)], stderr(&output))
    };
    let (plain, _) = run("plain", &[]);
    for (out, effect) in [("none", "none"), ("zero", "blur=0,glass=0,light=0,noise=0,holes=0")] {
        assert_eq!(run(out, &["--effect", effect, "--seed", "9"]).0, plain, "{effect}");
        assert!(!place.path(out).join("effects.json").exists());
    }
    let all = "blur=5,light=3,noise=2,glass=4,floaters=2";
    let (damaged, said) = run("all", &["--effect", all, "--seed", "2"]);
    assert!((0..3).all(|k| damaged[k] != plain[k]));
    for part in ["blur=5: motion of up to", "K = ", "glass=4: a pane in", "light=3", "noise=2"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(said.contains("floaters=2: 64 Gaussians added"), "{said}");
    let receipt = std::fs::read_to_string(place.path("all/receipt.json")).unwrap();
    assert!(receipt.contains("renders for 3 pictures") && receipt.contains("motion of up to"));
    let text = std::fs::read_to_string(place.path("all/effects.json")).unwrap();
    let frames: serde_json::Value = serde_json::from_str(&text).unwrap();
    let frames = frames["pictures"].as_array().unwrap().clone();
    assert_eq!(frames.len(), 3);
    for frame in &frames {
        let pixels = frame["blur_pixels"].as_f64().unwrap();
        assert_eq!(frame["poses"].as_f64().unwrap(), pixels.ceil().clamp(1.0, 16.0));
        let glass = f64::from(u8::from(frame["glass_share"].as_f64().unwrap() > 0.0));
        let renders = frame["renders"].as_f64().unwrap();
        assert_eq!(renders, frame["poses"].as_f64().unwrap() + glass);
    }
    // Noise alone leaves depth as it was; the same seed makes the same pictures.
    let (noisy, _) = run("noise", &["--effect", "noise=3"]);
    assert!((0..3).all(|k| noisy[k][0] != plain[k][0] && noisy[k][1] == plain[k][1]));
    assert_eq!(run("again", &["--effect", "noise=3", "--threads", "1"]).0, noisy);
    assert_ne!(run("other", &["--effect", "noise=3", "--seed", "1"]).0, noisy);
}

#[test]
fn names_keep_their_dots() {
    let place = Place::new(&sphere());
    let cameras = place.cameras(&[camera("left/frame.0001"), camera("left/frame.0002.png")]);
    done(&place.render("out", &["--cameras", &cameras]));
    for name in ["frame.0001.png", "frame.0002.png"] {
        assert!(place.path("out").join(name).exists(), "{name}");
    }
    let one = ["--cameras", &cameras, "--camera", "frame.0002"];
    done(&place.render("one", &one));
    assert!(!place.path("one/frame.0001.png").exists());
    assert!(place.path("one/frame.0002.png").exists());
}

#[test]
fn wrong_use_is_said() {
    let place = Place::new(&sphere());
    let transforms = place.path("transforms.json");
    let text = r#"{"camera_model": "OPENCV_FISHEYE", "w": 48, "h": 32, "fl_x": 40, "fl_y": 40,
        "cx": 24, "cy": 16, "k1": 0.1, "frames": [{"file_path": "wide.jpg", "transform_matrix":
        [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    std::fs::write(&transforms, text).unwrap();
    let cameras = place.cameras(&[camera("a.jpg")]);
    let cases: [(&[&str], i32, &str); 15] = [
        (&["--eye", "0,0,7"], 2, "--target"),
        (&["--target", "0,0,7"], 2, "--eye"),
        (&["--eye", "1,2,3", "--target", "1,2,3"], 2, "looks nowhere"),
        (&["--eye", "1,2", "--target", "1,2,3"], 2, "three numbers"),
        (&["--inside", "2", "--fov", "200"], 2, "170"),
        (&["--orbit", "2", "--fov", "60"], 2, "--fov"),
        (&["--cameras", &cameras, "--camera", "b"], 2, "a.jpg"),
        (&["--cameras", &cameras, "--camera", "1"], 2, "1 cameras"),
        (&["--orbit", "0"], 2, "--orbit"),
        (&["--size", "12"], 2, "640x480"),
        (&["--background", "1,2,3"], 2, "0 to 1"),
        (&["--cameras", transforms.to_str().unwrap()], 1, "fisheye"),
        (&["--size", "70000x4"], 2, "65535"),
        (&["--effect", "blurr=2"], 2, "blur, glass, light, noise"),
        (&["--effect", "blur=7"], 2, "0 to 5"),
    ];
    for (more, code, said) in cases {
        let output = place.render("out", more);
        assert_eq!(output.status.code(), Some(code), "{more:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(said), "{more:?}: {}", stderr(&output));
    }
    // Nothing to draw is a black picture, not an error.
    let place = Place::new(&GaussianScene { opacity_logit: vec![-20.0; 2], ..sphere() });
    done(&place.render("out", &["--size", "32x32", "--orbit", "1", "--depth"]));
    let picture = open(&place.path("out/orbit_000.png"));
    assert!(picture.pixels().iter().all(|p| *p == [0; 3]));
}
