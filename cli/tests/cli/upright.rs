//! A room that lies on its side, or is in millimetres, gets the labels of the upright one, in every
//! command that runs a network.

use crate::{done, scenesplat, stderr};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Samples, read_picture};
use scenesplat::scene::{Camera, Distortion, GaussianScene, Similarity, UpAxis};
use std::path::{Path, PathBuf};

fn room() -> GaussianScene {
    let settings = SyntheticRoomSettings {
        seed: 0x5EED,
        num_gaussians: Some(20_000),
        ..SyntheticRoomSettings::default()
    };
    generate(&settings).unwrap().scene
}

/// Writes the room with another direction up, and another unit.
fn lying(folder: &Path, name: &str, up: UpAxis, scale: f64) -> PathBuf {
    let m = up.upright();
    let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
    let mut scene = room();
    scene.transform(&Similarity { rotation, scale, translation: [0.0; 3] });
    let path = folder.join(name);
    write_inria_ply(&scene, &[], &path).unwrap();
    path
}

fn run(command: &str, scene: &Path, out: &Path, more: &[&str]) -> String {
    let mut args = vec![command, scene.to_str().unwrap()];
    args.extend(more);
    args.extend(["--out", out.to_str().unwrap()]);
    let output = scenesplat(&args);
    done(&output);
    stderr(&output)
}

fn values(path: &Path) -> Vec<f32> {
    NpyFile::open(path).unwrap().read_f32().unwrap()
}

/// Share of the rows that are the same within `within`.
fn alike(a: &[f32], b: &[f32], within: f32) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() <= within).count() as f64 / a.len() as f64
}

#[test]
fn segment_labels_a_lying_room_as_the_upright_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let upright = lying(folder.path(), "upright.ply", UpAxis::PlusZ, 1.0);
    let said = run("segment", &upright, &at("upright"), &[]);
    assert!(!said.contains("turned") && !said.contains("UNCLEAR"), "{said}");
    let due = values(&at("upright/labels.npy"));
    for (up, scale) in [
        (UpAxis::MinusY, 1.0),
        (UpAxis::PlusY, 1.0),
        (UpAxis::PlusX, 1.0),
        (UpAxis::MinusX, 1.0),
        (UpAxis::MinusY, 1000.0),
    ] {
        let name = format!("{}-{scale}", up.name());
        let scene = lying(folder.path(), &format!("{name}.ply"), up, scale);
        let said = run("segment", &scene, &at(&name), &[]);
        assert!(said.contains(&format!("up is {up}")) && said.contains("turned to +z"), "{said}");
        let labels = values(&at(&format!("{name}/labels.npy")));
        let same = alike(&labels, &due, 0.0);
        assert!(same > 0.995, "{name}: {same} of the labels are those of the upright room");
        let receipt = std::fs::read_to_string(at(&format!("{name}/receipt.json"))).unwrap();
        assert!(receipt.contains("\"turned\""), "{receipt}");
        assert_eq!(receipt.contains("\"unit\""), scale != 1.0, "{receipt}");
    }
    // What the step is for: without it most labels are lost.
    let scene = at("-y-1.ply");
    run("segment", &scene, &at("as_is"), &["--as-is"]);
    let same = alike(&values(&at("as_is/labels.npy")), &due, 0.0);
    assert!(same < 0.7, "{same}");
    // And the user's word counts.
    let said = run("segment", &scene, &at("given"), &["--up", "-y", "--unit", "m"]);
    assert!(said.contains("up is -y:"), "{said}");
    assert!(alike(&values(&at("given/labels.npy")), &due, 0.0) > 0.995);
}

#[test]
fn features_queries_and_scores_are_those_of_the_upright_room() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let upright = lying(folder.path(), "upright.ply", UpAxis::PlusZ, 1.0);
    let lying = lying(folder.path(), "lying.ply", UpAxis::MinusY, 1.0);
    let both = |command: &str, more: &[&str], file: &str| {
        let of = |scene: &Path, name: &str| {
            let out = at(&format!("{command}-{name}"));
            run(command, scene, &out, more);
            out.join(file)
        };
        (of(&upright, "upright"), of(&lying, "lying"))
    };
    let (a, b) = both("features", &[], "features.npy");
    let same = alike(&values(&a), &values(&b), 0.02);
    assert!(same > 0.99, "{same} of the features");
    let (a, b) = both("query", &["floor"], "scores.npy");
    let same = alike(&values(&a), &values(&b), 0.02);
    assert!(same > 0.99, "{same} of the scores");
    let names: Vec<&str> = scenesplat::rooms::CLASSES.iter().map(|c| c.name).collect();
    std::fs::write(at("names.txt"), names.join("\n")).unwrap();
    let labels = at("names.txt");
    let more = ["--label-names", labels.to_str().unwrap()];
    let (a, b) = both("evaluate", &more, "evaluation.json");
    let right = |path: &Path| {
        let text = std::fs::read_to_string(path).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        json["all_acc"].as_f64().unwrap()
    };
    let (due, got) = (right(&a), right(&b));
    assert!(due > 0.6 && (due - got).abs() < 0.005, "{got} right, {due} upright");
}

#[test]
fn what_cannot_be_told_is_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    // A sphere: no side differs from another.
    let n = 3000;
    let mut scene = GaussianScene::default();
    for i in 0..n {
        let z = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
        let (r, phi) = ((1.0 - z * z).sqrt(), 2.4 * i as f32);
        scene.coord.push([r * phi.cos(), r * phi.sin(), z]);
    }
    scene.log_scale = vec![[-4.0; 3]; n];
    scene.quat = vec![[1.0, 0.0, 0.0, 0.0]; n];
    scene.opacity_logit = vec![2.0; n];
    scene.sh_dc = vec![[0.0; 3]; n];
    let path = folder.path().join("ball.ply");
    write_inria_ply(&scene, &[], &path).unwrap();
    let out = folder.path().join("out");
    let said = run("segment", &path, &out, &["--vote-k", "1"]);
    assert!(said.contains("UP IS UNCLEAR") && said.contains("--up"), "{said}");
    let receipt = std::fs::read_to_string(out.join("receipt.json")).unwrap();
    assert!(receipt.contains("UP IS UNCLEAR"), "{receipt}");
    let looked = scenesplat(&["inspect", &path.display().to_string(), "--no-sheet"]);
    let said =
        String::from_utf8_lossy(&looked.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("up is unclear") && said.contains("--up AXIS"), "{said}");
    let said = run("segment", &path, &out, &["--vote-k", "1", "--up", "+z"]);
    assert!(!said.contains("UNCLEAR"), "{said}");
    for wrong in [["--unit", "furlong"], ["--unit", "-1"], ["--unit", "nan"]] {
        let args = ["segment", path.to_str().unwrap(), wrong[0], wrong[1]];
        assert_eq!(scenesplat(&args).status.code(), Some(2), "{wrong:?}");
    }
}

/// Mean difference of two pictures, of 255.
fn apart(a: &Path, b: &Path) -> f64 {
    let read = |path: &Path| -> Vec<u8> {
        match read_picture(path).unwrap().into_samples() {
            Samples::Eight(values) => values,
            Samples::Sixteen(_) => panic!("{}: 8 bits are expected", path.display()),
        }
    };
    let (a, b) = (read(a), read(b));
    assert_eq!(a.len(), b.len());
    let sum: f64 = a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / a.len() as f64
}

#[test]
fn every_direction_is_found_and_drawn_upright() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let upright = lying(folder.path(), "upright.ply", UpAxis::PlusZ, 1.0);
    let orbit = |scene: &Path, name: &str, more: &[&str]| {
        let args = [&["--orbit", "2", "--size", "96x72"], more].concat();
        run("render", scene, &at(name), &args);
        at(name).join("orbit_001.png")
    };
    let due = orbit(&upright, "upright", &[]);
    for up in [UpAxis::MinusZ, UpAxis::PlusY, UpAxis::MinusY, UpAxis::PlusX, UpAxis::MinusX] {
        let scene = lying(folder.path(), &format!("{}.ply", up.name()), up, 1.0);
        let json = at("seen.json");
        let args = ["inspect", scene.to_str().unwrap(), "--no-sheet", "--json"];
        done(&scenesplat(&[&args[..], &[json.to_str().unwrap()]].concat()));
        let seen: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        assert_eq!(seen["up"]["axis"], up.name(), "{}", seen["up"]);
        let got = apart(&orbit(&scene, &format!("orbit {}", up.name()), &[]), &due);
        assert!(got < 2.0, "{}: {got}", up.name());
    }
    // It takes the turn: as it lies, the picture is another.
    let scene = at("-y.ply");
    assert!(apart(&orbit(&scene, "as it lies", &["--up", "+z"]), &due) > 8.0);
}

#[test]
fn lifted_labels_are_drawn_upright() {
    let folder = tempfile::tempdir().unwrap();
    let preview = |place: &str, up: UpAxis| {
        let dir = folder.path().join(place);
        std::fs::create_dir(&dir).unwrap();
        let scene = lying(&dir, "room.ply", up, 1.0);
        // Looks down into the room from above, wherever that is.
        let m = up.upright();
        let down = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];
        let rotation = std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..3).map(|k| down[i][k] * m[k][j]).sum())
        });
        let (width, height) = (64, 48);
        let camera = Camera {
            name: "a.png".to_owned(),
            width,
            height,
            fx: 30.0,
            fy: 30.0,
            cx: 32.0,
            cy: 24.0,
            distortion: Distortion::None,
            rotation,
            translation: [-2.0, 2.0, 8.0],
        };
        write_cameras_json(&[camera], &dir.join("cameras.json")).unwrap();
        std::fs::create_dir(dir.join("segments")).unwrap();
        let ids: Vec<i32> = (0..width * height).map(|i| i32::from(i % width >= 32)).collect();
        let shape = [height as usize, width as usize];
        write_npy(&dir.join("segments/a_s.npy"), &shape, &ids).unwrap();
        write_npy(&dir.join("segments/a_f.npy"), &[2, 2], &[1.0f32, 0.0, 0.0, 1.0]).unwrap();
        let [cameras, segments] = ["cameras.json", "segments"].map(|n| dir.join(n));
        let more =
            ["--cameras", cameras.to_str().unwrap(), "--segments", segments.to_str().unwrap()];
        let out = dir.join("out");
        run("lift-labels", &scene, &out, &[&more[..], &["--depth", "off"]].concat());
        let given = dir.join("given");
        run(
            "lift-labels",
            &scene,
            &given,
            &[&more[..], &["--depth", "off", "--up", "+z"]].concat(),
        );
        (out.join("preview.png"), given.join("preview.png"))
    };
    let (due, _) = preview("upright", UpAxis::PlusZ);
    let (lying, as_it_lies) = preview("lying", UpAxis::MinusY);
    assert!(apart(&lying, &due) < 2.0, "{}", apart(&lying, &due));
    assert!(apart(&as_it_lies, &due) > 5.0, "{}", apart(&as_it_lies, &due));
}
