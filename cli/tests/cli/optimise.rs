//! `optimise` and `curate`: from pictures to a scene and what it is worth, and what captures may be like.

use crate::{done, scenesplat, stderr};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Channels, Picture, RgbPicture, Samples};
use scenesplat::scene::{Camera, Distortion, ReadOptions, open_cameras, open_scene};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Pictures and depths of a small room, by `render`.
struct Capture {
    folder: tempfile::TempDir,
}

impl Capture {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let room = generate(&SyntheticRoomSettings::with_count(3000, 3)).unwrap();
        write_inria_ply(&room.scene, &[], &folder.path().join("room.ply")).unwrap();
        let this = Self { folder };
        let words = ["render", "room.ply", "--inside", "8", "--depth", "--size", "64x48"];
        done(&this.run(&words, "shots"));
        this
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs a command; words that name a file of the folder become its path.
    fn run(&self, words: &[&str], out: &str) -> Output {
        let path = |word: &&str| match self.path(word) {
            path if path.exists() || word.ends_with(".json") => path.to_str().unwrap().to_owned(),
            _ => (*word).to_owned(),
        };
        let mut words: Vec<String> = words.iter().map(path).collect();
        words.extend(["--out".to_owned(), self.path(out).to_str().unwrap().to_owned()]);
        scenesplat(&words.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn optimise(&self, more: &[&str], out: &str) -> Output {
        let words = ["optimise", "--cameras", "shots/cameras.json", "--images", "shots"];
        let depth =
            ["--depth", "shots/depth", "--initial", "400", "--cap", "600", "--test-every", "4"];
        self.run(&[&words[..], &depth, more].concat(), out)
    }
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn pictures_become_a_scene() {
    let capture = Capture::new();
    let cameras = open_cameras(&capture.path("shots/cameras.json")).unwrap().cameras;
    assert_eq!(cameras.len(), 8, "render writes the cameras of its pictures");
    for camera in &cameras {
        assert!(capture.path(&format!("shots/{}.png", camera.name)).is_file(), "{}", camera.name);
    }
    done(&capture.optimise(&["--steps", "40", "--json", "a.json"], "made"));
    let figures = json(&capture.path("a.json"));
    assert_eq!(figures, json(&capture.path("made/optimise.json")));
    assert!(figures["test_psnr"].as_f64().unwrap() > 10.0, "{figures}");
    assert!(figures["depth_l1"].as_f64().unwrap() < 2.0 && figures["steps"] == 40, "{figures}");
    assert!(figures["seconds_per_step"].as_f64().unwrap() > 0.0);
    assert_eq!(figures["frames"], serde_json::json!({ "train": 6, "test": 2 }));
    let scene = open_scene(&capture.path("made/scene.ply"), &ReadOptions::default()).unwrap().scene;
    assert_eq!(figures["gaussians"].as_u64().unwrap() as usize, scene.len());
    assert!(capture.path("made/previews/step-000000040.png").is_file());
    assert!(std::fs::read_dir(capture.path("made/test")).unwrap().count() == 2);
    let lines = std::fs::read_to_string(capture.path("made/progress.jsonl")).unwrap();
    assert!(lines.lines().count() == 1 && lines.contains("\"step\":40"), "{lines}");

    // The same bits for one thread, and when it was done in two parts.
    done(
        &capture.optimise(&["--steps", "40", "--threads", "1", "--checkpoint-every", "13"], "one"),
    );
    let bytes = |out: &str| std::fs::read(capture.path(out).join("scene.ply")).unwrap();
    assert!(bytes("made") == bytes("one"), "threads changed the result");
    let output = capture.optimise(&["--steps", "40", "--checkpoint-every", "13"], "one");
    assert!(
        output.status.code() == Some(2) && stderr(&output).contains("--resume"),
        "{}",
        stderr(&output)
    );
    let again = ["--steps", "40", "--checkpoint-every", "13", "--resume"];
    let output = capture.optimise(&again, "one");
    done(&output);
    assert!(stderr(&output).contains("going on at step 39 of 40"), "{}", stderr(&output));
    assert!(bytes("made") == bytes("one"), "a resume changed the result");

    // What it is worth.
    let words = [
        "curate",
        "--cameras",
        "shots/cameras.json",
        "--images",
        "shots",
        "--depth",
        "shots/depth",
    ];
    let scene = ["--scene", "made/scene.ply", "--antialiased", "--name", "room"];
    let output = capture.run(&[&words[..], &scene].concat(), "all/room");
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("reject") && said.contains("LPIPS skipped: weights not found"), "{said}");
    let quality = json(&capture.path("all/room/scene_quality.json"));
    let gates: Vec<&str> = quality["reasons"]
        .as_array()
        .unwrap()
        .iter()
        .map(|r| r["gate"].as_str().unwrap())
        .collect();
    assert!(gates.contains(&"frames") && gates.contains(&"gaussians"), "{gates:?}");
    assert!(quality["psnr"].as_f64().unwrap() > 10.0 && quality["lpips"].is_null());
    assert!(quality["floater_mass"].as_f64().is_some() && quality["holes"].as_f64().is_some());
    done(&capture.run(&["curate", "--scenes", "all"], "table"));
    let table = std::fs::read_to_string(capture.path("table/scenes.md")).unwrap();
    assert!(table.contains("| room | 8 |") && table.contains("0 of 1"), "{table}");
}

/// Flags about a depth loss that is not there are refused; a preset without one says what depths are for.
#[test]
fn flags_of_the_depth_loss_have_an_effect_or_are_refused() {
    let capture = Capture::new();
    let base = ["optimise", "--cameras", "shots/cameras.json", "--images", "shots", "--steps", "2"];
    let small = ["--initial", "100", "--cap", "100"];
    let run = |more: &[&str], out: &str| capture.run(&[&base[..], &small, more].concat(), out);
    let depth = ["--depth", "shots/depth"];
    let refused: [(&[&str], &str); 5] = [
        (&["--depth-scale", "5000"], "--depth <DIR>"),
        (&["--depth-weight", "0.5"], "--depth-weight has no effect without --depth"),
        (&["--depth-kind", "expected"], "--depth-kind has no effect without --depth"),
        (&["--depth-kind", "expected", "--preset", "gsplat-mcmc"], "without --depth"),
        (
            &[&depth[..], &["--depth-kind", "expected", "--preset", "gsplat-mcmc"]].concat(),
            "without a depth loss: give --depth-weight",
        ),
    ];
    for (i, (more, said)) in refused.into_iter().enumerate() {
        let output = run(more, &format!("refused{i}"));
        let text = stderr(&output);
        assert!(output.status.code() == Some(2) && text.contains(said), "{more:?}: {text}");
    }
    let output = run(&[&depth[..], &["--preset", "gsplat-mcmc"]].concat(), "without");
    done(&output);
    assert!(stderr(&output).contains("no depth loss: depths give"), "{}", stderr(&output));
    let kind = ["--preset", "gsplat-mcmc", "--depth-kind", "expected", "--depth-weight", "0.1"];
    let output = run(&[&depth[..], &kind].concat(), "with");
    done(&output);
    assert!(!stderr(&output).contains("no depth loss"), "{}", stderr(&output));
    let made = json(&capture.path("with/optimise.json"));
    assert_eq!(made["settings"]["depth"]["kind"], "expected", "{made}");
    done(&run(&["--depth-weight", "0"], "none"));
}

/// Exposure is learned where the pictures show that it drifts, and what was decided is in the receipt.
#[test]
fn drifting_exposure_is_learned() {
    let capture = Capture::new();
    let shots = ["render", "room.ply", "--inside", "16", "--depth", "--size", "64x48"];
    done(&capture.run(&[&shots[..], &["--effect", "light=5"]].concat(), "drift"));
    done(&capture.run(&shots, "steady"));
    let run = |shots: &str, more: &[&str]| {
        let (cameras, depth) = (format!("{shots}/cameras.json"), format!("{shots}/depth"));
        let out = format!("of-{shots}-{}", more.join(""));
        let words = ["optimise", "--cameras", &cameras, "--images", shots, "--depth", &depth];
        let small = ["--initial", "300", "--cap", "300", "--steps", "4", "--test-every", "5"];
        let receipt = ["--receipt", "receipt.json"];
        done(&capture.run(&[&words[..], &small, &receipt, more].concat(), &out));
        let plan = json(&capture.path("receipt.json"))["effect_plan"]["sections"][0].clone();
        assert_eq!(plan["name"], "optimisation", "{plan}");
        let figures = json(&capture.path(&out).join("optimise.json"));
        let decision = plan["decisions"][0].clone();
        assert_eq!(figures["settings"]["exposure"], decision["on"]);
        assert_eq!(figures["test_psnr_corrected"].is_null(), decision["on"] == false, "{figures}");
        decision
    };
    let drift = run("drift", &[]);
    assert!(drift["effect"] == "light" && drift["on"] == true, "{drift}");
    assert!(drift["measure"].as_f64().unwrap() > 1.0, "{drift}");
    let steady = run("steady", &[]);
    assert!(steady["on"] == false && steady["measure"].as_f64().unwrap() < 0.75, "{steady}");
    assert_eq!(run("steady", &["--exposure"])["on"], true);
    assert_eq!(run("drift", &["--exposure", "off"])["on"], false);
}

/// A camera at the origin that looks along +z, and its grey picture with a white square.
fn shot(folder: &Path, name: &str, [width, height]: [u32; 2], x: f64, color: u8) -> Camera {
    let picture = RgbPicture::from_fn(width, height, |x, y| {
        if x > width / 4 && x < width / 2 && y > height / 4 { [color; 3] } else { [color / 2; 3] }
    });
    std::fs::write(folder.join(format!("{name}.png")), picture.encode_png().unwrap()).unwrap();
    Camera {
        name: name.to_owned(),
        width,
        height,
        fx: 40.0,
        fy: 40.0,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        distortion: Distortion::None,
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [x, 0.0, 0.0],
    }
}

/// What captures may be like: each ends well, or with a message that says what to do.
#[test]
fn hostile_captures() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let cases: [(&str, Vec<Camera>, &str); 4] = [
        ("one", vec![shot(at, "a", [40, 30], 0.0, 200)], "there is one frame"),
        (
            "same",
            (0..4).map(|i| shot(at, &format!("s{i}"), [40, 30], 0.0, 200)).collect(),
            "at one place",
        ),
        (
            "black",
            (0..4).map(|i| shot(at, &format!("b{i}"), [40, 30], 0.1 * f64::from(i), 0)).collect(),
            "are black",
        ),
        (
            "sizes",
            (0..4)
                .map(|i| shot(at, &format!("z{i}"), [40 + 8 * i, 30 + i], 0.1 * f64::from(i), 200))
                .collect(),
            "",
        ),
    ];
    for (name, cameras, said) in cases {
        let list = at.join(format!("{name}.json"));
        write_cameras_json(&cameras, &list).unwrap();
        let out = at.join(name);
        let output = scenesplat(&[
            "optimise",
            "--cameras",
            list.to_str().unwrap(),
            "--images",
            at.to_str().unwrap(),
            "--initial",
            "200",
            "--cap",
            "300",
            "--steps",
            "12",
            "--out",
            out.to_str().unwrap(),
        ]);
        done(&output);
        assert!(stderr(&output).contains(said), "{name}: {}", stderr(&output));
        assert!(out.join("scene.ply").is_file(), "{name}");
    }
    // Depth that holds nothing: NaN, 0, ∞; and points behind all cameras.
    let cameras: Vec<Camera> =
        (0..3).map(|i| shot(at, &format!("d{i}"), [40, 30], 0.1 * f64::from(i), 200)).collect();
    let list = at.join("depth.json");
    write_cameras_json(&cameras, &list).unwrap();
    let values: Vec<f32> = (0..1200).map(|i| [f32::NAN, 0.0, f32::INFINITY][i % 3]).collect();
    std::fs::create_dir(at.join("nan")).unwrap();
    for i in 0..3 {
        write_npy(&at.join(format!("nan/d{i}.npy")), &[30, 40], &values).unwrap();
    }
    let behind = scenesplat::scene::GaussianScene {
        coord: (0..50).map(|i| [i as f32 * 0.1, 0.0, -5.0]).collect(),
        log_scale: vec![[-3.0; 3]; 50],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 50],
        opacity_logit: vec![1.0; 50],
        sh_dc: vec![[0.0; 3]; 50],
        ..scenesplat::scene::GaussianScene::default()
    };
    write_inria_ply(&behind, &[], &at.join("behind.ply")).unwrap();
    let run = |more: &[&str], out: &str| {
        let (list, images, out) = (list.to_str().unwrap(), at.to_str().unwrap(), at.join(out));
        let words = [
            "optimise",
            "--cameras",
            list,
            "--images",
            images,
            "--steps",
            "12",
            "--initial",
            "200",
        ];
        scenesplat(&[&words[..], &["--out", out.to_str().unwrap()], more].concat())
    };
    let nan = at.join("nan");
    done(&run(&["--depth", nan.to_str().unwrap()], "with_nan"));
    done(&run(&["--points", at.join("behind.ply").to_str().unwrap()], "with_behind"));
    // Refusals name the file and say what to do.
    let picture = Picture::new(40, 30, Channels::Gray, Samples::Sixteen(vec![900; 1200])).unwrap();
    let colors = std::fs::read(at.join("d1.png")).unwrap();
    std::fs::write(at.join("d1.png"), picture.encode_png().unwrap()).unwrap();
    let output = run(&[], "depth_as_pictures");
    let text = stderr(&output);
    assert!(
        output.status.code() == Some(1) && text.contains("d1.png") && text.contains("--images"),
        "{text}"
    );
    std::fs::write(at.join("d1.png"), colors).unwrap();
    write_npy(&nan.join("d0.npy"), &[40, 30], &values).unwrap();
    let output = run(&["--depth", nan.to_str().unwrap()], "wrong_depth");
    let text = stderr(&output);
    assert!(
        output.status.code() == Some(1) && text.contains("d0.npy") && text.contains("size"),
        "{text}"
    );
    std::fs::remove_file(at.join("d0.png")).unwrap();
    std::fs::remove_file(at.join("d1.png")).unwrap();
    std::fs::remove_file(at.join("d2.png")).unwrap();
    let output = run(&[], "no_pictures");
    let text = stderr(&output);
    assert!(output.status.code() == Some(1) && text.contains("no picture of any"), "{text}");
}
