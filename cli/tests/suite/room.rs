//! `room`: from the frames of a scan to labels, objects and a page, in one command that can be stopped.

use crate::prepare_frames::{Shot, film, rgbd};
use crate::support::*;
use half::f16;
use scenesplat::scene::TextTable;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::RgbPicture;
use scenesplat_test_support::graph_file::miniature_detector;
use std::process::Output;

const RESULTS: [&str; 4] = ["scene.ply", "labels.npy", "objects.json", "room.html"];

fn room(folder: &Folder, more: &str) -> Output {
    let words = "room @scan --out @room --steps 5 --gaussians 2000 --threads 2 ";
    line(&(words.to_owned() + more).replace('@', &folder.at("")))
}

/// The command of a stage, as the receipt has it.
fn command(folder: &Folder, stage: &str) -> String {
    let receipt = json(folder.path("room/receipt.json"));
    let name = format!("stage/{stage}");
    let settings = receipt["settings"].as_array().unwrap();
    let found = settings.iter().find(|setting| setting["name"] == *name);
    found.unwrap()["why"].as_str().unwrap().to_owned()
}

fn results(folder: &Folder) -> [Vec<u8>; 4] {
    RESULTS.map(|name| bytes(folder.path("room").join(name)))
}

#[test]
fn a_scan_becomes_a_room_and_what_was_done_before_is_kept() {
    let folder = Folder::new();
    let mut shots = film(&folder);
    rgbd(&folder, &shots);
    let output = room(&folder, "");
    has(&told(&output), &["1 of 5: frames\n", "2 of 5: scene\n", "5 of 5: page\n"]);
    has(&stdout(&output), &["room/room.html in a browser", "objects", "--find"]);
    let first = results(&folder);
    let labels = NpyFile::open(&folder.path("room/labels.npy")).unwrap();
    assert!(labels.shape()[0] > 100);
    // These frames have depth.
    assert!(folder.path("room/frames/depth").is_dir());
    has(&command(&folder, "scene"), &["optimise ", "frames/images", "--depth", "frames/depth"]);
    assert!(!command(&folder, "objects").contains("--taught"));

    // Nothing is made again, and the results are the same.
    let said = told(&room(&folder, ""));
    has(&said, &["1 of 5: frames, done before", "5 of 5: page, done before"]);
    assert!(results(&folder) == first);
    // As after a stop while the labels were made: what comes after them is made anew, too.
    for stage in ["labels", "page"] {
        std::fs::remove_dir_all(folder.path("room").join(stage)).unwrap();
    }
    let said = told(&room(&folder, ""));
    has(&said, &["2 of 5: scene, done before", "3 of 5: labels\n", "4 of 5: objects\n"]);
    assert!(results(&folder)[..3] == first[..3]);
    // Other settings, and other frames.
    let said = told(&room(&folder, "--max-frames 7"));
    has(&said, &["1 of 5: frames\n", "7 frames", "2 of 5: scene\n"]);
    shots.pop();
    std::fs::remove_dir_all(folder.path("scan")).unwrap();
    rgbd(&folder, &shots);
    let said = told(&room(&folder, "--max-frames 7"));
    has(&said, &["1 of 5: frames\n", "2 of 5: scene\n"]);
    assert!(results(&folder)[0] != first[0]);

    // A posed folder needs no first stage.
    let posed = folder.at("room/frames");
    let out = folder.at("posed");
    let said =
        told(&line(&format!("room {posed} --out {out} --steps 5 --gaussians 2000 --threads 2")));
    has(&said, &["1 of 4: scene", "4 of 4: page"]);
    assert!(bytes(folder.path("posed/scene.ply")) == results(&folder)[0]);
    folder.write("none/a.txt", "");
    all_refused(
        [
            ("@none --out @out", 2, "is no scan in a layout that is read (scannet, scannetpp"),
            ("@room/frames --layout rgbd --out @out", 2, "has cameras.json"),
            ("@scan --layout replica --out @out", 1, "cam_params.json"),
        ],
        |words: &str| line(&format!("room {words}").replace('@', &folder.at(""))),
    );
}

#[test]
fn what_a_detector_finds_overrules_the_network() {
    let folder = Folder::new();
    let mut shots: Vec<Shot> = film(&folder);
    // All that the detector of tests takes for a chair is red: a place of its grid in the middle of each photo.
    let photo = RgbPicture::from_fn(64, 48, |x, y| {
        if (29..35).contains(&x) && (22..27).contains(&y) { [250, 0, 0] } else { [0; 3] }
    });
    shots.iter_mut().for_each(|shot| shot.color = photo.encode_png().unwrap());
    rgbd(&folder, &shots);
    let detector = miniature_detector().write(folder.root());
    let output = room(&folder, &format!("--detector {}", detector.display()));
    has(
        &told(&output),
        &["3 of 6: taught", "Gaussians that the teacher names", "names none of the classes"],
    );
    has(&stdout(&output), &["--taught"]);
    for stage in ["labels", "objects", "page"] {
        has(&command(&folder, stage), &["--taught", "room/taught"]);
    }
    // In pictures this small no superpixel fits into a box: every third Gaussian is named by hand instead.
    let texts = TextTable::read(&folder.path("room/taught/classes.safetensors"), None).unwrap();
    let chair = texts.names.iter().position(|name| name == "chair").unwrap();
    let features = folder.path("room/taught/lang_feat.npy");
    let rows = NpyFile::open(&features).unwrap().shape()[0];
    let row = |i: usize| match i % 3 {
        0 => texts.row(chair).unwrap().iter().map(|v| f16::from_f32(*v)).collect(),
        _ => vec![f16::ZERO; texts.dim],
    };
    let values: Vec<f16> = (0..rows).flat_map(row).collect();
    write_npy(&features, &[rows, texts.dim], &values).unwrap();
    let run = |words: &str| line(&words.replace('@', &folder.at("room/")));
    let said = told(&run("segment @scene/scene.ply --taught @taught --out @named"));
    has(&said, &[&format!("of {} Gaussians that the teacher names", rows.div_ceil(3))]);
    done(&run("segment @scene/scene.ply --out @plain"));
    let labels = |name: &str| NpyFile::open(&folder.path(name)).unwrap().read_i64().unwrap();
    let (named, plain) = (labels("room/named/labels.npy"), labels("room/plain/labels.npy"));
    let names = json(folder.path("room/named/classes.json"));
    let chair = names.as_array().unwrap().iter().position(|name| name == "chair").unwrap() as i64;
    assert!(plain.iter().any(|label| *label != chair));
    for (i, (named, plain)) in named.iter().zip(&plain).enumerate() {
        assert_eq!(*named, if i % 3 == 0 { chair } else { *plain }, "{i}");
    }

    // A teacher of another scene, and one beside the scene's own labels.
    let scene = folder.at("scene");
    all_refused(
        [
            ("segment @scene.ply --taught @room/taught --out @out", 1, "rows, the scene"),
            ("segment @scene.ply --taught @scan --out @out", 1, "classes.safetensors"),
            ("collect-labels @scene.ply --render 2 --teacher detector --out @out", 2, "--detector"),
            ("collect-labels @scene.ply --render 2 --detector x.json --out @out", 2, "--teacher"),
            (
                "collect-labels @scene.ply --render 2 --teacher detector --detector @none.json --out @out",
                1,
                "none.json",
            ),
            (
                "collect-labels @scene.ply --render 2 --teacher detector --detector @made.json --detector-score 2 --out @out",
                1,
                "score of a detector is 2",
            ),
        ],
        |words: &str| line(&words.replace("@scene.ply", &scene).replace('@', &folder.at(""))),
    );
}

#[test]
fn a_teacher_names_the_rows_of_the_file_where_some_are_left_out() {
    let folder = Folder::new();
    let mut scene = crate::support::room(2000, 5);
    scene.coord[5] = [f32::NAN; 3];
    folder.scene("broken.ply", &scene);
    // One row behind the broken one is named, and the broken one.
    let texts = TextTable { names: vec!["chair".to_owned()], dim: 2, values: vec![1.0, 0.0] };
    folder.write("taught/classes.safetensors", texts.to_safetensors().unwrap());
    let row = |i: usize| [if i == 5 || i == 9 { f16::ONE } else { f16::ZERO }, f16::ZERO];
    let values: Vec<f16> = (0..2000).flat_map(row).collect();
    write_npy(&folder.path("taught/lang_feat.npy"), &[2000, 2], &values).unwrap();
    write_npy(&folder.path("taught/confidence.npy"), &[2000], &[0.75f32; 2000]).unwrap();
    let run = |words: &str| line(&words.replace('@', &folder.at("")));
    done(&run("segment @broken.ply --out @plain"));
    let said = told(&run("segment @broken.ply --taught @taught --out @named"));
    has(&said, &["of 2 Gaussians that the teacher names"]);
    let names = json(folder.path("named/classes.json"));
    let chair = names.as_array().unwrap().iter().position(|name| name == "chair").unwrap() as i64;
    let (mut want, found) =
        (labels(folder.path("plain/labels.npy")), labels(folder.path("named/labels.npy")));
    assert!(want.len() == 2000 && want[5] == -1 && want[9] != chair, "{:?}", &want[..12]);
    want[9] = chair;
    assert!(found == want, "{:?}, not {:?}", &found[..12], &want[..12]);
    let scores = floats(folder.path("named/scores.npy"));
    assert!(scores[9] == 0.75 && scores[5] == 0.0, "{:?}", &scores[..12]);
}
