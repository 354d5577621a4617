//! `optimise` and `curate`: from pictures to a scene and what it is worth, and what captures may be like.

use crate::support::*;
use scenesplat::preview::LookAt;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Channels, Picture, RgbPicture, Samples, read_picture};
use scenesplat::scene::{Camera, Up, open_cameras};
use std::process::Output;

/// Pictures and depths of a small room, by `render`, in the folder `shots`.
struct Capture(Folder);

impl Capture {
    fn new() -> Self {
        let this = Self(Folder::new());
        this.0.room("room.ply", 3000, 3);
        done(&this.run("render @room.ply --inside 8 --depth --size 64x48", "shots"));
        this
    }

    /// Runs a command with results in the folder `out`; `@` stands for the folder.
    fn run(&self, words: &str, out: &str) -> Output {
        let at = self.0.at("");
        line(&format!("{words} --out @{out}").replace("@", &at))
    }

    fn optimise(&self, more: &str, out: &str) -> Output {
        let small = "--depth @shots/depth --initial 400 --cap 600 --test-every 4";
        self.run(&format!("optimise {SHOTS} {small} {more}"), out)
    }

    fn json(&self, name: &str) -> serde_json::Value {
        json(self.0.path(name))
    }
}

const SHOTS: &str = "--cameras @shots/cameras.json --images @shots";

#[test]
fn pictures_become_a_scene() {
    let capture = Capture::new();
    let at = |name: &str| capture.0.path(name);
    let cameras = open_cameras(&at("shots/cameras.json")).unwrap().cameras;
    assert_eq!(cameras.len(), 8, "render writes the cameras of its pictures");
    for camera in &cameras {
        assert!(at(&format!("shots/{}.png", camera.name)).is_file(), "{}", camera.name);
    }
    done(&capture.optimise("--steps 40 --json @a.json", "made"));
    let figures = capture.json("a.json");
    assert_eq!(figures, capture.json("made/optimise.json"));
    let number = |name: &str| figures[name].as_f64().unwrap();
    assert!(number("test_psnr") > 10.0 && number("depth_l1") < 2.0, "{figures}");
    assert!(number("steps") == 40.0 && number("seconds_per_step") > 0.0, "{figures}");
    assert_eq!(figures["frames"], serde_json::json!({ "train": 6, "test": 2 }));
    assert_eq!(number("gaussians") as usize, read(at("made/scene.ply")).len());
    assert!(at("made/previews/step-000000040.png").is_file());
    assert_eq!(std::fs::read_dir(at("made/test")).unwrap().count(), 2);
    let lines = text(at("made/progress.jsonl"));
    assert!(lines.lines().count() == 1 && lines.contains("\"step\":40"), "{lines}");

    // The same bits for one thread, and when it was done in two parts.
    let parts = "--steps 40 --checkpoint-every 13";
    done(&capture.optimise(&format!("{parts} --threads 1"), "one"));
    let same = || bytes(at("made/scene.ply")) == bytes(at("one/scene.ply"));
    assert!(same(), "threads changed the result");
    refused(&capture.optimise(parts, "one"), 2, &["--resume"]);
    let said = told(&capture.optimise(&format!("{parts} --resume"), "one"));
    has(&said, &["going on at step 39 of 40"]);
    assert!(same(), "a resume changed the result");

    // What it is worth.
    let scene = "--depth @shots/depth --scene @made/scene.ply --antialiased --name room";
    let said = printed(&capture.run(&format!("curate {SHOTS} {scene}"), "all/room"));
    has(&said, &["reject", "LPIPS skipped: weights not found"]);
    let quality = capture.json("all/room/scene_quality.json");
    let reasons = quality["reasons"].as_array().unwrap();
    let gates: Vec<&str> = reasons.iter().map(|r| r["gate"].as_str().unwrap()).collect();
    assert!(gates.contains(&"frames") && gates.contains(&"gaussians"), "{gates:?}");
    assert!(quality["psnr"].as_f64().unwrap() > 10.0 && quality["lpips"].is_null());
    assert!(quality["floater_mass"].is_number() && quality["holes"].is_number());
    done(&capture.run("curate --scenes @all", "table"));
    has(&text(at("table/scenes.md")), &["| room | 8 |", "0 of 1"]);
}

/// Flags about a depth loss that is not there are refused; a preset without one says what depths are for.
#[test]
fn flags_of_the_depth_loss_have_an_effect_or_are_refused() {
    let capture = Capture::new();
    let run = |more: &str| {
        let small = "--steps 2 --initial 100 --cap 100";
        capture.run(&format!("optimise {SHOTS} {small} {more}"), "out")
    };
    let depth = "--depth @shots/depth --preset gsplat-mcmc";
    let cases = [
        ("--depth-scale 5000", 2, "--depth <DIR>"),
        ("--depth-weight 0.5", 2, "--depth-weight has no effect without --depth"),
        ("--depth-kind expected", 2, "--depth-kind has no effect without --depth"),
        ("--depth-kind expected --preset gsplat-mcmc", 2, "without --depth"),
        (&format!("{depth} --depth-kind expected"), 2, "without a depth loss: give --depth-weight"),
    ];
    all_refused(cases, run);
    has(&told(&run(depth)), &["no depth loss: depths give"]);
    let said = told(&run(&format!("{depth} --depth-kind expected --depth-weight 0.1")));
    assert!(!said.contains("no depth loss"), "{said}");
    assert_eq!(capture.json("out/optimise.json")["settings"]["depth"]["kind"], "expected");
    done(&run("--depth-weight 0"));
    // Without depth the mean opacity is held down instead, unless a flag says otherwise.
    for (more, want) in [
        ("", 0.01),
        ("--opacity-reg 0", 0.0),
        ("--depth @shots/depth", 0.0),
        ("--opacity-reg 0.5", 0.5),
    ] {
        done(&run(more));
        let found = capture.json("out/optimise.json")["settings"]["opacity_reg"].as_f64().unwrap();
        assert!((found - want).abs() < 1e-6, "{more}: {found}");
    }
}

/// Flat Gaussians are laid on depths: without these, or beside other first points, that is refused.
#[test]
fn first_gaussians_on_depths_need_depths_and_no_other_points() {
    let capture = Capture::new();
    let run = |more: &str| {
        let small = "--steps 2 --initial 100 --cap 100 --init depth";
        capture.run(&format!("optimise {SHOTS} {small} {more}"), "out")
    };
    let cases = [
        ("", 2, "--init depth: no frame has depths to make Gaussians of; give them with --depth"),
        ("--depth @shots/depth --points @room.ply", 2, "leave out --points, or --init"),
        ("--points @room.ply", 2, "leave out --points, or --init"),
    ];
    all_refused(cases, run);
    assert!(!capture.0.path("out/scene.ply").exists());
    has(&told(&run("--depth @shots/depth")), &["from the measured depths: flat Gaussians"]);
}

/// Exposure is learned where the pictures show that it drifts, and what was decided is in the receipt.
#[test]
fn drifting_exposure_is_learned() {
    let capture = Capture::new();
    let shots = "render @room.ply --inside 16 --depth --size 64x48";
    done(&capture.run(&format!("{shots} --effect light=5"), "drift"));
    done(&capture.run(shots, "steady"));
    let run = |shots: &str, more: &str| {
        let words = format!("--cameras @{shots}/cameras.json --images @{shots}");
        let small = "--initial 300 --cap 300 --steps 4 --test-every 5";
        let depth = format!("--depth @{shots}/depth --receipt @receipt.json");
        done(&capture.run(&format!("optimise {words} {small} {depth} {more}"), "out"));
        let plan = capture.json("receipt.json")["effect_plan"]["sections"][0].clone();
        assert_eq!(plan["name"], "optimisation", "{plan}");
        let figures = capture.json("out/optimise.json");
        let decision = plan["decisions"][0].clone();
        assert_eq!(figures["settings"]["exposure"], decision["on"]);
        assert_eq!(figures["test_psnr_corrected"].is_null(), decision["on"] == false, "{figures}");
        decision
    };
    let drift = run("drift", "");
    assert!(drift["effect"] == "light" && drift["on"] == true, "{drift}");
    assert!(drift["measure"].as_f64().unwrap() > 1.0, "{drift}");
    let steady = run("steady", "");
    assert!(steady["on"] == false && steady["measure"].as_f64().unwrap() < 0.75, "{steady}");
    assert_eq!(run("steady", "--exposure")["on"], true);
    assert_eq!(run("drift", "--exposure off")["on"], false);
}

/// Cameras side by side that look along +z, and their gray pictures with a white square.
fn shots(folder: &Folder, name: &str, count: u32, step: f64, grow: [u32; 2], color: u8) -> String {
    let shot = |i: u32| {
        let [width, height] = [40 + grow[0] * i, 30 + grow[1] * i];
        let picture = RgbPicture::from_fn(width, height, |x, y| {
            let is_square = x > width / 4 && x < width / 2 && y > height / 4;
            [if is_square { color } else { color / 2 }; 3]
        });
        folder.write(&format!("{name}{i}.png"), picture.encode_png().unwrap());
        camera(&format!("{name}{i}"), [width, height], [step * f64::from(i), 0.0, 0.0])
    };
    let cameras: Vec<Camera> = (0..count).map(shot).collect();
    folder.cameras(&format!("{name}.json"), &cameras)
}

/// Lenses of a rig number their pictures alike; masks and depths of other sizes are taken by nearest pixel.
#[test]
fn files_of_a_rig_are_told_apart_and_counted() {
    let folder = Folder::new();
    let at = folder.at("");
    let mut cameras = Vec::new();
    for (k, lens) in ["left", "right"].into_iter().enumerate() {
        for i in 0..3u8 {
            let value = 60 + 120 * k as u8 + i;
            let png = RgbPicture::filled(40, 30, [value; 3]).encode_png().unwrap();
            folder.write(&format!("photos/{lens}/{i}.png"), png);
            let mask = RgbPicture::from_fn(20, 15, |x, _| [if x < 10 { 255 } else { 0 }; 3]);
            folder.write(&format!("masks/{lens}/{i}.jpg.png"), mask.encode_png().unwrap());
            let depth = Samples::Sixteen(vec![800 + 400 * k as u16; 80]);
            let depth = Picture::new(10, 8, Channels::Gray, depth).unwrap();
            folder.write(&format!("depth/{lens}/{i}.png"), depth.encode_png().unwrap());
            let shift = 0.1 * f64::from(i) + k as f64;
            cameras.push(camera(&format!("./images/{lens}/{i}.jpg"), [40, 30], [shift, 0.0, 0.0]));
        }
    }
    std::fs::remove_file(folder.path("masks/right/2.jpg.png")).unwrap();
    let list = folder.cameras("rig.json", &cameras);
    let optimise = |more: &str| {
        let words = "--initial 100 --cap 100 --steps 6 --test-every 2 --preview-every 0";
        run!(
            "optimise --cameras {list} --images {at}photos --depth {at}depth {words} --out {at}out {more}"
        )
    };
    let said = told(&optimise(&format!("--masks {at}masks --depth-scale 400")));
    has(
        &said,
        &[
            "6 of 6 cameras have a picture; missing: 0",
            "6 of 6 cameras have a depth; missing: 0",
            "5 of 6 cameras have a mask; missing: 1 (./images/right/2.jpg)",
        ],
    );
    // Frames 0, 2 and 4: the last is the right lens's picture 1, whose name has another number.
    let mut pictures: Vec<_> = std::fs::read_dir(folder.path("out/test"))
        .unwrap()
        .flatten()
        .map(|entry| entry.file_name().into_string().unwrap())
        .collect();
    pictures.sort_unstable();
    assert_eq!(pictures, ["0.png", "1_00004.png", "2.png"]);
    let figures = json(folder.path("out/optimise.json"));
    assert!(
        figures["test_psnr"].is_number() && figures["test_psnr_masked"].is_number(),
        "{figures}"
    );
    assert_ne!(figures["test_psnr"], figures["test_psnr_masked"]);
    // Curate keeps the cameras of the frames that it keeps.
    let curated = format!(
        "curate --cameras {list} --images {at}photos/left --out {at}kept --blur-share 0.001"
    );
    let said = told(&line(&curated));
    has(&said, &["3 of 6 cameras have a picture; missing: 3 (./images/right/0.jpg, …)"]);
    for camera in &open_cameras(&folder.path("kept/cameras.json")).unwrap().cameras {
        assert!(camera.name.starts_with("./images/left/"), "{}", camera.name);
    }
    // Another shape, and a folder of other things.
    let square = Picture::new(8, 8, Channels::Gray, Samples::Sixteen(vec![9; 64])).unwrap();
    folder.write("depth/left/1.png", square.encode_png().unwrap());
    refused(&optimise(""), 1, &["1.png", "is 8 × 8, its picture 40 × 30", "shape"]);
    refused(
        &optimise(&format!("--masks {at}kept")),
        1,
        &["kept has no mask of any of the 6 cameras"],
    );
}

/// An object on a transparent background, without points: the default preset learns it, and nothing else.
#[test]
fn an_object_is_learned_from_random_points() {
    let folder = Folder::new();
    let at = folder.at("");
    let scale = 30.0f32;
    let grid = |i: usize| [i % 4, i / 4 % 4, i / 16].map(|k| scale * (0.2 * k as f32 - 0.3));
    let mut object = balls((0..64).map(grid).collect(), 0.08 * scale, 4.0);
    for (i, dc) in object.sh_dc.iter_mut().enumerate() {
        *dc = [0, 1, 2].map(|c| if (i >> c) & 1 == 1 { 1.5 } else { -1.5 });
    }
    let scene = folder.scene("object.ply", &object);
    let cameras: Vec<Camera> = (0..24)
        .map(|i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 24.0).sin_cos();
            let height = 1.2 * f64::from(i % 3) - 0.8;
            let eye = [cos * 2.0, sin * 2.0, height].map(|v| f64::from(scale) * v);
            let look = LookAt { eye, target: [0.0; 3], fov: 40.0 };
            look.camera(&format!("train/r_{i}"), Up::PLUS_Z, [48, 48]).unwrap()
        })
        .collect();
    let list = folder.cameras("cameras.json", &cameras);
    done(&run!("render {scene} --cameras {list} --out {at}black"));
    done(&run!("render {scene} --cameras {list} --background 1,1,1 --out {at}white"));
    for i in 0..24 {
        // What lets the background through is 255 · (1 − alpha) brighter on white.
        let name = format!("r_{i}.png");
        let [black, white] = ["black", "white"]
            .map(|side| read_picture(&folder.path(side).join(&name)).unwrap().to_rgb8());
        let pixel = |(b, w): (&[u8; 3], &[u8; 3])| {
            let alpha = 255 - (w[0].saturating_sub(b[0]));
            let straight = |v: u8| (u32::from(v) * 255 / u32::from(alpha.max(1))).min(255) as u8;
            let hidden = alpha == 0;
            let [r, g, b] = if hidden { [90, 200, 10] } else { b.map(straight) };
            [r, g, b, alpha]
        };
        let rgba = black.pixels().iter().zip(white.pixels()).flat_map(pixel).collect();
        let rgba = Picture::new(48, 48, Channels::Rgba, Samples::Eight(rgba)).unwrap();
        folder.write(&format!("rgba/{name}"), rgba.encode_png().unwrap());
    }
    let words = "--initial 600 --cap 1200 --steps 500 --preview-every 0";
    let said = told(&run!("optimise --cameras {list} --images {at}rgba {words} --out {at}made"));
    has(
        &said,
        &["RANDOM POINTS in the cube", "units are taken for 1", "24 of 24 cameras have a picture"],
    );
    let psnr = json(folder.path("made/optimise.json"))["test_psnr"].as_f64().unwrap();
    println!("{psnr} dB");
    // From points that fill the room between the cameras it stays at 10 dB.
    assert!(psnr > 20.0, "{psnr} dB");
    // In the coordinates of the cameras, and no fog around it.
    let extent = read(folder.path("made/scene.ply"))
        .coord
        .iter()
        .flatten()
        .fold(0.0f32, |a, v| a.max(v.abs()));
    assert!((0.3 * scale..1.3 * scale).contains(&extent), "{extent}");
}

/// What captures may be like: each ends well, or with a message that says what to do.
/// Out of memory a process ends without a word: so it is asked for before.
#[cfg(target_os = "linux")]
#[test]
fn memory_that_is_not_given_is_refused_by_name() {
    let capture = Capture::new();
    let run = |gaussians: u32, more: &str| {
        let folder = &capture.0;
        let line = format!(
            "optimise {SHOTS} --preset gsplat-default --steps 2 --initial {gaussians} {more}"
        );
        let line = line.replace('@', &folder.at(""));
        let program = env!("CARGO_BIN_EXE_scenesplat");
        let line = format!("ulimit -v 1500000; '{program}' {line} --out '{}'", folder.at("out"));
        std::process::Command::new("sh").args(["-c", &line]).output().unwrap()
    };
    refused(&run(2_000_000, ""), 1, &["--initial 2000000", "does not give this process"]);
    // There is room for these, not for three times as many.
    refused(&run(200_000, "--cap 600000"), 1, &["600000 Gaussians", "smaller --initial or --cap"]);
    assert!(!capture.0.path("out/scene.ply").exists());
    done(&run(200_000, "--cap 200000"));
}

#[test]
fn hostile_captures() {
    let folder = Folder::new();
    let at = folder.at("");
    let optimise = |list: &str, more: &str| {
        let words = "--initial 200 --cap 300 --steps 12";
        run!("optimise --cameras {list} --images {at} {words} --out {at}out {more}")
    };
    for (list, said) in [
        (shots(&folder, "one", 1, 0.0, [0, 0], 200), "there is one frame"),
        (shots(&folder, "same", 4, 0.0, [0, 0], 200), "at one place"),
        (shots(&folder, "black", 4, 0.1, [0, 0], 0), "are black"),
        (shots(&folder, "sizes", 4, 0.1, [8, 1], 200), ""),
    ] {
        has(&told(&optimise(&list, "")), &[said]);
        std::fs::remove_file(folder.path("out/scene.ply")).unwrap();
    }
    // Depth that holds nothing: NaN, 0, ∞; and points behind all cameras.
    let list = shots(&folder, "d", 3, 0.1, [0, 0], 200);
    let values: Vec<f32> = (0..1200).map(|i| [f32::NAN, 0.0, f32::INFINITY][i % 3]).collect();
    std::fs::create_dir(folder.path("nan")).unwrap();
    for i in 0..3 {
        write_npy(&folder.path(&format!("nan/d{i}.npy")), &[30, 40], &values).unwrap();
    }
    let behind = balls((0..50).map(|i| [i as f32 * 0.1, 0.0, -5.0]).collect(), 0.05, 1.0);
    folder.scene("behind.ply", &behind);
    let nan = format!("--depth {at}nan");
    done(&optimise(&list, &nan));
    done(&optimise(&list, &format!("--points {at}behind.ply")));
    // Refusals name the file and say what to do.
    let colors = bytes(folder.path("d1.png"));
    let depth = Picture::new(40, 30, Channels::Gray, Samples::Sixteen(vec![900; 1200])).unwrap();
    folder.write("d1.png", depth.encode_png().unwrap());
    refused(&optimise(&list, ""), 1, &["d1.png", "--images"]);
    folder.write("d1.png", colors);
    write_npy(&folder.path("nan/d0.npy"), &[40, 30], &values).unwrap();
    refused(&optimise(&list, &nan), 1, &["d0.npy", "is 30 × 40, its picture 40 × 30"]);
    for i in 0..3 {
        std::fs::remove_file(folder.path(&format!("d{i}.png"))).unwrap();
    }
    // Its test pictures have the same names.
    std::fs::remove_dir_all(folder.path("out")).unwrap();
    refused(&optimise(&list, ""), 1, &["no picture of any"]);
}
