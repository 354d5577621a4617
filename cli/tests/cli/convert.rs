//! `scenesplat convert`, and what other commands make of its files.

use crate::{asset, done, scenesplat, stderr, tiny};
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{GaussianScene, ReadOptions, open_scene};
use std::path::Path;

fn convert(from: &Path, to: &Path, more: &[&str]) -> std::process::Output {
    let mut args = vec!["convert", from.to_str().unwrap(), to.to_str().unwrap()];
    args.extend(more);
    scenesplat(&args)
}

fn read(path: &Path) -> GaussianScene {
    open_scene(path, &ReadOptions::default()).unwrap().scene
}

/// Every format that can be written, by the name of its file.
const TARGETS: [&str; 8] =
    ["a.ply", "a.compressed.ply", "a.spz", "a.splat", "a.glb", "a.sog", "sog/meta.json", "folder"];

#[test]
fn labels_go_through_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let room = read(&asset("room.ply"));
    let centres = |scene: &GaussianScene| {
        // Formats may reorder rows, so the labels are compared by the centre of each class.
        let mut sums = std::collections::BTreeMap::<i32, (usize, [f64; 3])>::new();
        for (p, &label) in scene.coord.iter().zip(scene.segment.as_ref().unwrap()) {
            let entry = sums.entry(label).or_default();
            entry.0 += 1;
            (0..3).for_each(|i| entry.1[i] += f64::from(p[i]));
        }
        sums
    };
    let due = centres(&room);
    for name in TARGETS {
        let to = folder.path().join(name);
        let json = folder.path().join("report.json");
        done(&convert(&asset("room.ply"), &to, &["--json", json.to_str().unwrap()]));
        let scene = read(&to);
        assert_eq!(scene.len(), room.len(), "{name}");
        let got = centres(&scene);
        assert_eq!(got.keys().collect::<Vec<_>>(), due.keys().collect::<Vec<_>>(), "{name}");
        for (label, (count, sum)) in &due {
            let (n, s) = got[label];
            assert_eq!(n, *count, "{name}, class {label}");
            let far = (0..3).map(|i| (s[i] - sum[i]).abs() / n as f64).fold(0.0, f64::max);
            assert!(far < 2e-3, "{name}, class {label}: {far} m");
        }
        let report: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        assert_eq!(report["from"]["gaussians"], room.len(), "{name}");
        assert_eq!(report["to"]["gaussians"], room.len(), "{name}");
        // And back to the format that loses nothing more.
        let back = folder.path().join("back.ply");
        done(&convert(&to, &back, &["--overwrite"]));
        assert_eq!(read(&back), scene, "{name}");
    }
}

#[test]
fn scenes_are_cut_thinned_turned_and_resized() {
    let folder = tempfile::tempdir().unwrap();
    let room = read(&asset("room.ply"));
    let to = folder.path().join("part.ply");
    done(&convert(&asset("room.ply"), &to, &["--sample", "25%", "--seed", "3"]));
    assert_eq!(read(&to).len(), room.len() / 4);
    let again = folder.path().join("again.ply");
    done(&convert(
        &asset("room.ply"),
        &again,
        &["--sample", "25%", "--seed", "3", "--threads", "1"],
    ));
    assert!(std::fs::read(&to).unwrap() == std::fs::read(&again).unwrap());
    done(&convert(
        &asset("room.ply"),
        &to,
        &["--overwrite", "--crop", "-1,-1,-1,1,1,1", "--frame", "RUB", "--scale", "1000"],
    ));
    let cut = read(&to);
    let inside: Vec<_> =
        room.coord.iter().filter(|p| p.iter().all(|v| (-1.0..=1.0).contains(v))).collect();
    assert_eq!(cut.len(), inside.len());
    for (new, old) in cut.coord.iter().zip(inside) {
        let due = [old[0] * 1000.0, -old[1] * 1000.0, -old[2] * 1000.0];
        assert!((0..3).all(|i| (new[i] - due[i]).abs() < 1e-3), "{new:?} {due:?}");
    }
}

#[test]
fn targets_are_not_replaced_by_accident() {
    let folder = tempfile::tempdir().unwrap();
    for name in TARGETS {
        let to = folder.path().join(name);
        done(&convert(&asset("room.ply"), &to, &["--sample", "100"]));
        let output = convert(&asset("room.ply"), &to, &["--sample", "200"]);
        assert_eq!(output.status.code(), Some(1), "{name}: {}", stderr(&output));
        assert_eq!(read(&to).len(), 100, "{name}");
        done(&convert(&asset("room.ply"), &to, &["--sample", "200", "--overwrite"]));
        assert_eq!(read(&to).len(), 200, "{name}");
    }
    let leftovers = walk(folder.path()).into_iter().filter(|n| n.contains(".part"));
    assert_eq!(leftovers.collect::<Vec<_>>(), Vec::<String>::new());
}

fn walk(folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            names.extend(walk(&path));
        }
        names.push(path.display().to_string());
    }
    names
}

#[test]
fn wrong_use_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let to = |name: &str| folder.path().join(name);
    let cases: [(&str, &[&str], &str); 14] = [
        ("a.obj", &[], "--format"),
        ("a.obj", &[], ".compressed.ply (compressed-ply), .ply (ply), .spz (spz), .glb (glb)"),
        ("a.ksplat", &[], "ksplat files are read, not written; what can be written: "),
        ("a.ply", &["--format", "ksplat"], "[possible values: compressed-ply, ply, "),
        ("a.spz", &["--frame", "RDF:RUB"], "--to-spz-frame raw"),
        ("a.glb", &["--frame", "LUF"], "converted to it when it is written"),
        ("a.ply", &["--scale", "-1"], "above 0"),
        ("a.ply", &["--rotate", "1,2"], "three angles"),
        ("a.ply", &["--up", "z+"], "no axis"),
        ("a.ply", &["--crop", "1,2,3"], "X0,Y0,Z0,X1,Y1,Z1"),
        ("a.ply", &["--sample", "0"], "100000"),
        ("a.ply", &["--frame", "XYZ"], "RDF"),
        ("a.ply", &["--language-code", "8"], "--features"),
        ("a.ply", &["--sh", "5"], "5"),
    ];
    for (name, flags, hint) in cases {
        let output = convert(&asset("room.ply"), &to(name), flags);
        assert_eq!(output.status.code(), Some(2), "{flags:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(hint), "{flags:?}: {}", stderr(&output));
    }
    let output = convert(&asset("room.ply"), &to("a.ply"), &["--crop", "90,90,90,91,91,91"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("the scene lies in"), "{}", stderr(&output));
    let output = convert(&to("none.ply"), &to("a.ply"), &[]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn language_codes_answer_queries_without_a_network() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    done(&tiny("features", &asset("room.ply"), &out("features"), &[]));
    let features = out("features/features.npy");
    let flags = ["--language-code", "32", "--features", features.to_str().unwrap()];
    let spz = out("room.spz");
    let output = convert(&asset("room.ply"), &spz, &flags);
    done(&output);
    assert!(stderr(&output).contains("mean cosine"), "{}", stderr(&output));
    let text = asset("classes.safetensors");
    let text = text.to_str().unwrap();
    done(&tiny("segment", &asset("room.ply"), &out("network"), &["--text", text]));
    let stored = out("stored");
    let args = ["segment", spz.to_str().unwrap(), "--text", text, "--out"];
    let output = scenesplat(&[&args[..], &[stored.to_str().unwrap()]].concat());
    done(&output);
    assert!(stderr(&output).contains("language codes"), "{}", stderr(&output));
    let labels =
        |name: &str| NpyFile::open(&out(name).join("labels.npy")).unwrap().read_i64().unwrap();
    let (a, b) = (labels("network"), labels("stored"));
    let same = a.iter().zip(&b).filter(|(a, b)| a == b).count();
    assert!(same * 100 >= a.len() * 95, "{same} of {} labels agree", a.len());
    let query = out("query");
    let args = ["query", spz.to_str().unwrap(), "chair", "--text", text, "--out"];
    done(&scenesplat(&[&args[..], &[query.to_str().unwrap()]].concat()));
    // A scene without codes goes to the network inside the program, whose texts these are not.
    let room = asset("room.ply");
    let args = ["query", room.to_str().unwrap(), "chair", "--text", text, "--out"];
    let output = scenesplat(&[&args[..], &[query.to_str().unwrap()]].concat());
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("--weights"), "{}", stderr(&output));
}

/// A room of flat Gaussians, 4 × 3 × 2.5 m: floor at 0.7, two walls.
fn room_of_discs() -> GaussianScene {
    let mut scene = GaussianScene::default();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    for i in 0..50 {
        for j in 0..50 {
            let (a, b) = (i as f32 / 49.0, j as f32 / 49.0);
            scene.coord.push([4.0 * a, 3.0 * b, 0.7]);
            scene.quat.push([1.0, 0.0, 0.0, 0.0]);
            scene.coord.push([4.0 * a, 0.0, 0.7 + 2.5 * b]);
            scene.quat.push([half, half, 0.0, 0.0]);
            scene.coord.push([0.0, 3.0 * a, 0.7 + 2.5 * b]);
            scene.quat.push([half, 0.0, half, 0.0]);
        }
    }
    let n = scene.coord.len();
    scene.log_scale = vec![[0.04f32.ln(), 0.04f32.ln(), 0.002f32.ln()]; n];
    scene.opacity_logit = vec![3.0; n];
    scene.sh_dc = vec![[0.2; 3]; n];
    scene
}

fn write(scene: &GaussianScene, path: &Path) {
    scenesplat::scene::formats::inria_ply::write_inria_ply(scene, &[], path).unwrap();
}

fn report(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn scenes_are_made_level_turned_and_moved() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let room = room_of_discs();
    write(&room, &at("room.ply"));
    done(&convert(&at("room.ply"), &at("tilted.ply"), &["--rotate", "8,-5,30"]));
    let json = at("report.json");
    let flags = ["--level", "--up", "+z", "--json", json.to_str().unwrap()];
    let output = convert(&at("tilted.ply"), &at("level.ply"), &flags);
    done(&output);
    assert!(stderr(&output).contains("level: turned by"), "{}", stderr(&output));
    let level = read(&at("level.ply"));
    let off = level.coord.iter().step_by(3).map(|p| p[2].abs()).fold(0.0, f32::max);
    assert!(off < 2e-3, "the floor is off by {off}");
    let tilt = report(&json)["edit"]["level"]["tilt"].as_f64().unwrap();
    let due = (8f64.to_radians().cos() * 5f64.to_radians().cos()).acos().to_degrees();
    assert!((tilt - due).abs() < 0.05, "{tilt} {due}");

    // Quarter turns, and up as found.
    done(&convert(&at("room.ply"), &at("side.ply"), &["--rotate", "90,0,0"]));
    done(&convert(&at("side.ply"), &at("up.ply"), &["--up", "-y"]));
    for (new, old) in read(&at("up.ply")).coord.iter().zip(&room.coord) {
        assert!((new[2] - old[2]).abs() < 1e-6, "{new:?} {old:?}");
    }
    done(&convert(&at("room.ply"), &at("moved.ply"), &["--translate", "1,-2,-0.7"]));
    for (new, old) in read(&at("moved.ply")).coord.iter().zip(&room.coord) {
        let due = [old[0] + 1.0, old[1] - 2.0, old[2] - 0.7];
        assert!((0..3).all(|a| (new[a] - due[a]).abs() < 1e-6), "{new:?} {due:?}");
    }
    // Where nothing is level, that is said, and nothing is turned.
    let balls = GaussianScene { log_scale: vec![[-3.0; 3]; room.len()], ..room };
    write(&balls, &at("balls.ply"));
    let output = convert(&at("balls.ply"), &at("still.ply"), &["--level", "--up", "+z"]);
    done(&output);
    assert!(stderr(&output).contains("no level surface was found"), "{}", stderr(&output));
    assert_eq!(read(&at("still.ply")).quat, balls.quat);
}

#[test]
fn a_frame_of_the_format_is_not_applied_twice() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let room = room_of_discs();
    write(&room, &at("room.ply"));
    for name in ["a.spz", "a.glb"] {
        done(&convert(&at("room.ply"), &at(name), &[]));
        for (new, old) in read(&at(name)).coord.iter().zip(&room.coord) {
            assert!((0..3).all(|a| (new[a] - old[a]).abs() < 1e-3), "{name}: {new:?} {old:?}");
        }
    }
    for (name, frame) in [("a.spz", "RUB:RDF"), ("a.glb", "LUF:RDF")] {
        let output = convert(&at(name), &at("b.ply"), &["--frame", frame]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains("was converted to RDF"), "{}", stderr(&output));
    }
    // As it is in the file, it can be turned.
    done(&convert(&at("room.ply"), &at("raw.spz"), &["--frame", "RUB", "--to-spz-frame", "raw"]));
    let raw = ["--spz-frame", "raw", "--frame", "RUB:RDF"];
    done(&convert(&at("raw.spz"), &at("b.ply"), &raw));
    for (new, old) in read(&at("b.ply")).coord.iter().zip(&room.coord) {
        assert!((0..3).all(|a| (new[a] - old[a]).abs() < 1e-3), "{new:?} {old:?}");
    }
}

#[test]
fn scenes_are_merged_and_floaters_removed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut room = room_of_discs();
    write(&room, &at("a.ply"));
    room.segment = Some(vec![3; room.len()]);
    room.coord[10] = [2.0, 1.5, 9.0];
    room.log_scale[20] = [9f32.ln(); 3];
    write(&room, &at("b.ply"));
    let (a, b, both) = (at("a.ply"), at("b.ply"), at("both.ply"));
    let json = at("report.json");
    let args = ["convert", a.to_str().unwrap(), b.to_str().unwrap(), both.to_str().unwrap()];
    let flags = ["--json", json.to_str().unwrap()];
    let output = scenesplat(&[&args[..], &flags].concat());
    done(&output);
    assert!(stderr(&output).contains("no label (scene 1)"), "{}", stderr(&output));
    let scene = read(&both);
    let n = room.len();
    assert_eq!(scene.coord[n..], room.coord);
    let labels = scene.segment.unwrap();
    assert_eq!((labels[n - 1], labels[n]), (-1, 3));
    assert_eq!(report(&json)["from"]["scenes"].as_array().unwrap().len(), 2);
    assert_eq!(report(&json)["from"]["gaussians"], 2 * n);

    let flags = ["--remove-floaters", "--overwrite", "--json", json.to_str().unwrap()];
    let output = convert(&b, &both, &flags);
    done(&output);
    let said = format!("floaters: 1 isolated and 1 giant Gaussians of {n}");
    assert!(stderr(&output).contains(&said), "{}", stderr(&output));
    let rows: Vec<usize> = (0..n).filter(|row| ![10, 20].contains(row)).collect();
    assert_eq!(read(&both).coord, room.select_rows(&rows).unwrap().coord);
    assert_eq!(report(&json)["floaters"]["giants"], 1);
    // The source is never its own target.
    let output = scenesplat(&["convert", a.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
}
