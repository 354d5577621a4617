//! `render`: pictures, depth, cameras by name and number, plans, messages.

use crate::support::*;
use scenesplat::scene::picture::{RgbPicture, Samples, read_picture};
use scenesplat::scene::{Camera, GaussianScene};
use std::process::Output;

struct Place(Folder);

impl Place {
    fn new(scene: &GaussianScene) -> Self {
        let folder = Folder::new();
        folder.scene("scene.ply", scene);
        Self(folder)
    }

    fn render(&self, out: &str, more: &str) -> Output {
        run!("render {} --out {} {more}", self.0.at("scene.ply"), self.0.at(out))
    }

    fn open(&self, name: &str) -> RgbPicture {
        read_picture(&self.0.path(name)).unwrap().to_rgb8()
    }

    /// Renders on one thread and on two, each with its flags, and gives the pictures, which have to be the same.
    fn twice(
        &self,
        more: [&str; 2],
        name: &str,
        count: usize,
        least_lit: usize,
    ) -> Vec<RgbPicture> {
        for (threads, more) in ["1", "2"].iter().zip(more) {
            done(&self.render(threads, &format!("{more} --size 64x48 --threads {threads}")));
        }
        let picture = |k| {
            let name = format!("{name}_{k:03}.png");
            let [one, two] = ["1", "2"].map(|out| bytes(self.0.path(out).join(&name)));
            assert_eq!(one, two, "{name}");
            let picture = self.open(&format!("1/{name}"));
            let lit = picture.pixels().iter().filter(|p| p.iter().any(|v| *v > 20)).count();
            assert!(lit > least_lit, "{name}: {lit} pixels");
            picture
        };
        (0..count).map(picture).collect()
    }
}

/// A red sphere at (0, 0, 2), 0.2 wide, nearly opaque; and one behind it that it hides.
fn sphere() -> GaussianScene {
    let sh_dc = vec![[1.6, -1.6, -1.6], [-1.6, 1.6, -1.6]];
    GaussianScene { sh_dc, ..balls(vec![[0.0, 0.0, 2.0], [0.0, 0.0, 4.0]], 0.2, 9.0) }
}

fn at_origin(name: &str) -> Camera {
    camera(name, [48, 32], [0.0; 3])
}

fn is_red([r, g, b]: [u8; 3]) {
    assert!(r > 220 && g < 30 && b < 20, "{r} {g} {b}");
}

#[test]
fn color_and_depth_of_a_sphere() {
    let place = Place::new(&sphere());
    let list = [at_origin("images/left.jpg"), at_origin("right.jpg")];
    let cameras = place.0.cameras("cameras.json", &list);
    done(&place.render("out", &format!("--cameras {cameras} --camera left --depth")));
    let picture = place.open("out/left.png");
    assert_eq!((picture.width(), picture.height()), (48, 32));
    is_red(picture.get(24, 16).unwrap());
    assert_eq!(picture.get(0, 0).unwrap(), [0; 3]);
    // The front one weighs 0.99, the one behind it what is left.
    let depth = read_picture(&place.0.path("out/depth/left.png")).unwrap().into_samples();
    let Samples::Sixteen(depth) = depth else { panic!("depth is 16-bit gray") };
    assert_eq!((depth.len(), depth[0]), (48 * 32, 0));
    assert!((2000..2030).contains(&depth[16 * 48 + 24]), "{:?}", depth[16 * 48 + 24]);
    assert!(place.0.path("out/depth_color/left.png").exists());
    assert!(!place.0.path("out/right.png").exists());
    has(&text(place.0.path("out/receipt.json")), &["plan: auto", "spheres"]);

    // By number, larger, on white, with everything computed: the same picture in the middle.
    let more = "--camera 1 --background 1,1,1 --plan full --size 96x64";
    done(&place.render("white", &format!("--cameras {cameras} {more}")));
    let white = place.open("white/right.png");
    assert_eq!((white.width(), white.height()), (96, 64));
    assert_eq!(white.get(0, 0).unwrap(), [255; 3]);
    is_red(white.get(48, 32).unwrap());

    let behind = Camera { translation: [0.0, 0.0, -9.0], ..at_origin("behind") };
    let cameras = place.0.cameras("cameras.json", &[at_origin("front"), behind]);
    let said = told(&place.render("out", &format!("--cameras {cameras}")));
    has(&said, &["1 of 2 pictures show no Gaussian, behind first"]);
}

#[test]
fn an_orbit_shows_the_scene_from_all_sides_whatever_the_threads() {
    let place = Place::new(&room(8_000, 3));
    // Without a number there are four.
    let pictures = place.twice(["", "--orbit 4"], "orbit", 4, 64 * 48 / 5);
    assert!(!place.0.path("1/orbit_004.png").exists());
    assert!((1..4).all(|k| pictures[k] != pictures[0]));
    for preset in ["gsplat-1.5", "inria"] {
        let more = format!("--size 64x48 --orbit 1 --preset {preset} --antialiased");
        done(&place.render(preset, &more));
    }
    let pictures = place.twice(["--inside 3"; 2], "inside", 3, 64 * 48 * 4 / 5);
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2]);
}

#[test]
fn the_mark_of_antialiased_training_is_followed_unless_a_flag_says_otherwise() {
    // Thinner than a pixel: the blur makes them wider, and the mark says that they are to be fainter for it.
    let thin = balls(vec![[0.0, 0.0, 2.0], [0.3, 0.1, 3.0]], 0.004, 9.0);
    let plain = Place::new(&thin);
    let marked = Place::new(&GaussianScene { antialiased: true, ..thin });
    let picture = |place: &Place, more: &str| {
        done(&place.render("out", &format!("--eye 0,0,0 --target 0,0,1 --size 48x32 {more}")));
        bytes(place.0.path("out/view.png"))
    };
    let (faint, full) = (picture(&marked, ""), picture(&plain, ""));
    assert_ne!(faint, full);
    assert_eq!(picture(&marked, "--antialiased=false"), full);
    assert_eq!(picture(&plain, "--antialiased"), faint);
    assert_eq!(picture(&marked, "--antialiased=true"), faint);
}

#[test]
fn a_camera_by_flags() {
    let place = Place::new(&sphere());
    // From behind, on the other side of the hidden green one.
    let look = "--eye 0,0,7 --target 0,0,0 --fov 30 --up -y --size 48x32";
    done(&place.render("out", look));
    let picture = place.open("out/view.png");
    let [r, g, b] = picture.get(24, 16).unwrap();
    assert!(g > 220 && r < 30 && b < 30, "{r} {g} {b}");
    // The angle is across the shorter side: at 30° ± 16 pixels show ± 0.8 at a distance of 3.
    let lit = (0..32).filter(|y| picture.get(24, *y).unwrap()[1] > 128).count();
    assert!((6..14).contains(&lit), "{lit} rows are lit");
}

#[test]
fn effects_happen_to_pictures_and_none_changes_no_bit() {
    let place = Place::new(&room(8_000, 3));
    let run = |out: &str, more: &str| {
        let said = told(&place.render(out, &format!("--inside 3 --size 64x48 --depth {more}")));
        let of = |k: usize| {
            let name = format!("inside_{k:03}.png");
            ["", "depth"].map(|d| bytes(place.0.path(out).join(d).join(&name)))
        };
        ([of(0), of(1), of(2)], said)
    };
    let (plain, _) = run("plain", "");
    for (out, effect) in [("none", "none"), ("zero", "blur=0,glass=0,light=0,noise=0,holes=0")] {
        assert_eq!(run(out, &format!("--effect {effect} --seed 9")).0, plain, "{effect}");
        assert!(!place.0.path(out).join("effects.json").exists());
    }
    let all = "--effect blur=5,light=3,noise=2,glass=4,floaters=2 --seed 2";
    let (damaged, said) = run("all", all);
    assert!((0..3).all(|k| damaged[k] != plain[k]));
    let parts = ["blur=5: motion of up to", "K = ", "glass=4: a pane in", "light=3", "noise=2"];
    has(&said, &parts);
    has(&said, &["floaters=2: 64 Gaussians added"]);
    let receipt = text(place.0.path("all/receipt.json"));
    has(&receipt, &["renders for 3 pictures", "motion of up to"]);
    let frames = json(place.0.path("all/effects.json"))["pictures"].as_array().unwrap().clone();
    assert_eq!(frames.len(), 3);
    for frame in &frames {
        let number = |field: &str| frame[field].as_f64().unwrap();
        assert_eq!(number("poses"), number("blur_pixels").ceil().clamp(1.0, 16.0));
        let glass = f64::from(u8::from(number("glass_share") > 0.0));
        assert_eq!(number("renders"), number("poses") + glass);
    }
    // Noise alone leaves depth as it was; the same seed makes the same pictures.
    let (noisy, _) = run("noise", "--effect noise=3");
    assert!((0..3).all(|k| noisy[k][0] != plain[k][0] && noisy[k][1] == plain[k][1]));
    assert_eq!(run("again", "--effect noise=3 --threads 1").0, noisy);
    assert_ne!(run("other", "--effect noise=3 --seed 1").0, noisy);
}

#[test]
fn names_keep_their_dots() {
    let place = Place::new(&sphere());
    let list = [at_origin("left/frame.0001"), at_origin("left/frame.0002.png")];
    let cameras = place.0.cameras("cameras.json", &list);
    let is_there = |name: &str| place.0.path(name).exists();
    done(&place.render("out", &format!("--cameras {cameras}")));
    assert!(is_there("out/frame.0001.png") && is_there("out/frame.0002.png"));
    done(&place.render("one", &format!("--cameras {cameras} --camera frame.0002")));
    assert!(!is_there("one/frame.0001.png") && is_there("one/frame.0002.png"));
}

#[test]
fn wrong_use_is_said() {
    let place = Place::new(&sphere());
    let fisheye = r#"{"camera_model": "OPENCV_FISHEYE", "w": 48, "h": 32, "fl_x": 40, "fl_y": 40,
        "cx": 24, "cy": 16, "k1": 0.1, "frames": [{"file_path": "wide.jpg", "transform_matrix":
        [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    let fisheye = place.0.write("transforms.json", fisheye);
    let cameras = place.0.cameras("cameras.json", &[at_origin("a.jpg")]);
    let cases = [
        ("--eye 0,0,7", 2, "--target"),
        ("--target 0,0,7", 2, "--eye"),
        ("--eye 1,2,3 --target 1,2,3", 2, "looks nowhere"),
        ("--eye 1,2 --target 1,2,3", 2, "three numbers"),
        ("--inside 2 --fov 200", 2, "170"),
        ("--orbit 2 --fov 60", 2, "--fov"),
        (&format!("--cameras {cameras} --camera b"), 2, "a.jpg"),
        (&format!("--cameras {cameras} --camera 1"), 2, "1 cameras"),
        ("--orbit 0", 2, "--orbit"),
        ("--size 12", 2, "640x480"),
        ("--background 1,2,3", 2, "0 to 1"),
        (&format!("--cameras {fisheye}"), 1, "fisheye"),
        ("--size 70000x4", 2, "65535"),
        ("--effect blurr=2", 2, "blur, glass, light, noise"),
        ("--effect blur=7", 2, "0 to 5"),
    ];
    all_refused(cases, |more| place.render("out", more));
    // Nothing to draw is a black picture, not an error.
    let place = Place::new(&GaussianScene { opacity_logit: vec![-20.0; 2], ..sphere() });
    done(&place.render("out", "--size 32x32 --orbit 1 --depth"));
    assert!(place.open("out/orbit_000.png").pixels().iter().all(|p| *p == [0; 3]));
}
