//! `objects`, `view` and `segment --instances`: what they write, agree on and refuse.

use crate::{asset, class_names, done, scenesplat, stderr, tiny};
use scenesplat::rooms::{CLASSES, SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{GaussianScene, ReadOptions, Similarity, open_scene};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A room with its labels and instances, and the names of its classes.
fn room(folder: &Path) -> (PathBuf, PathBuf, GaussianScene) {
    let (path, names) = (folder.join("room.ply"), folder.join("names.txt"));
    let scene = generate(&SyntheticRoomSettings::with_count(12_000, 9)).unwrap().scene;
    write_inria_ply(&scene, &[], &path).unwrap();
    let list: Vec<&str> = CLASSES.iter().map(|c| c.name).collect();
    std::fs::write(&names, list.join("\n")).unwrap();
    (path, names, scene)
}

fn read(path: &Path) -> GaussianScene {
    open_scene(path, &ReadOptions::default()).unwrap().scene
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn objects_are_listed_drawn_exported_and_taken_out() {
    let folder = tempfile::tempdir().unwrap();
    let (path, names, scene) = room(folder.path());
    let (out, table) = (folder.path().join("out"), folder.path().join("objects.json"));
    let run = |more: &[&str]| {
        let [path, names, out, table] = [&path, &names, &out, &table].map(|p| p.to_str().unwrap());
        let words = ["objects", path, "--label-names", names, "--out", out, "--json", table];
        scenesplat(&[&words[..], more].concat())
    };
    let output = run(&["--remove", "wall,ceiling", "--export", "parts", "--find", "wall"]);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let all = json(&table)["objects"].as_array().unwrap().clone();
    assert_eq!(json(&table), json(&out.join("objects.json")));
    // The room has instances: each of at least 20 Gaussians is an object.
    let ids = scene.instance.as_ref().unwrap();
    let count = |id: i32| ids.iter().filter(|i| **i == id).count();
    let large = (0..=*ids.iter().max().unwrap()).filter(|id| count(*id) >= 20).count();
    assert_eq!(all.len(), large);
    assert!(said.contains(&format!("{large} objects: ")) && said.contains("\"wall\": "), "{said}");
    for object in &all {
        for field in ["class", "count", "box", "position"] {
            assert!(!object[field].is_null(), "{field}: {object}");
        }
    }
    let instances = NpyFile::open(&out.join("instances.npy")).unwrap().read_i64().unwrap();
    let of = |place: usize| instances.iter().filter(|i| **i == place as i64).count();
    assert!(all.iter().enumerate().all(|(i, o)| o["count"] == of(i)));
    let lines = std::fs::read_to_string(out.join("objects.csv")).unwrap();
    assert_eq!(lines.lines().count(), large + 1);
    assert!(std::fs::read(out.join("objects.png")).unwrap().len() > 20_000);
    // Parts are the scene again, and what is removed is gone.
    let parts: Vec<_> = std::fs::read_dir(out.join("parts")).unwrap().collect();
    assert_eq!(parts.len(), large);
    let first = read(&out.join("parts/001-wall.ply"));
    assert_eq!((first.len(), all[0]["class"].as_str()), (of(0), Some("wall")));
    let edited = read(&out.join("edited.ply"));
    let gone: usize = (0..all.len())
        .filter(|i| ["wall", "ceiling"].contains(&all[*i]["class"].as_str().unwrap()))
        .map(of)
        .sum();
    assert_eq!(edited.len(), scene.len() - gone);
    assert!(edited.segment.unwrap().iter().all(|l| *l != 0));

    done(&run(&["--keep", "floor", "--pieces"]));
    assert!(read(&out.join("edited.ply")).segment.unwrap().iter().all(|l| *l == 1));
    for (more, part) in [
        (&["--remove", "piano"][..], "no object is a \"piano\"; there are: wall"),
        (&["--export", "../parts"], "one plain name"),
        (&["--remove", "wall", "--keep", "floor"], "cannot be used with"),
        (&["--weights", "seeded:0"], "leave out --weights"),
        (&["--gap", "0"], "above 0"),
        (&["--min-count", "0"], "min_count"),
    ] {
        let output = run(more);
        assert!(!output.status.success(), "{more:?}");
        assert!(stderr(&output).contains(part), "{more:?}: {}", stderr(&output));
    }
}

#[test]
fn boxes_are_level_in_a_room_that_is_not_and_heights_begin_at_a_given_floor() {
    let folder = tempfile::tempdir().unwrap();
    let (path, names, mut scene) = room(folder.path());
    let (s, c) = 7f64.to_radians().sin_cos();
    let rotation = [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]];
    scene.transform(&Similarity { rotation, ..Similarity::IDENTITY });
    let tilted = folder.path().join("tilted.ply");
    write_inria_ply(&scene, &[], &tilted).unwrap();
    let run = |path: &Path, name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let words = ["objects", path.to_str().unwrap(), "--label-names", names.to_str().unwrap()];
        let output = scenesplat(&[&words[..], &["--out", out.to_str().unwrap()], more].concat());
        done(&output);
        (json(&out.join("objects.json")), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (level, said) = run(&path, "level", &[]);
    // What has fewer than 20 Gaussians is no object, and said.
    let count = level["small_instances"].as_u64().unwrap();
    assert_eq!(
        said.contains("instances of the scene are none, having too few"),
        count > 0,
        "{said}"
    );
    let (other, _) = run(&tilted, "tilted", &[]);
    let (a, b) = (level["objects"].as_array().unwrap(), other["objects"].as_array().unwrap());
    assert_eq!(a.len(), b.len());
    // 7 degrees of tilt would make a floor of 4 m half a metre thick.
    for (a, b) in a.iter().zip(b) {
        let height = |o: &Value| o["box"]["size"][2].as_f64().unwrap();
        assert!((height(a) - height(b)).abs() < 0.06, "{a} {b}");
    }
    let (given, said) = run(&path, "given", &["--floor", "-1", "--unit", "cm"]);
    assert!(said.contains("heights are over the floor that was given"), "{said}");
    assert_eq!(
        (given["floor"]["height"].as_f64(), given["floor"]["given"].as_bool()),
        (Some(-0.01), Some(true))
    );
    let size = |v: &Value| v["objects"][0]["box"]["size"][0].as_f64().unwrap();
    assert!(
        (size(&given) * 100.0 - size(&level)).abs() < 0.02,
        "{} {}",
        size(&given),
        size(&level)
    );
}

/// A browser that asks, and Ctrl-C: `view --serve` says where, gives the page to who knows the address, and ends well.
#[cfg(unix)]
#[test]
fn a_served_page_ends_with_an_interrupt() {
    use std::io::{BufRead, Read, Write};
    use std::process::{Command, Stdio};
    let folder = tempfile::tempdir().unwrap();
    let (path, names, _) = room(folder.path());
    let receipt = folder.path().join("receipt.json");
    let before = std::fs::read_dir(folder.path()).unwrap().count();
    let mut child = Command::new(env!("CARGO_BIN_EXE_scenesplat"))
        .args(["view", path.to_str().unwrap(), "--label-names", names.to_str().unwrap(), "--serve"])
        .args(["--receipt", receipt.to_str().unwrap()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = std::io::BufReader::new(child.stdout.take().unwrap()).lines();
    let line =
        lines.by_ref().find(|l| l.as_ref().unwrap().starts_with("open http")).unwrap().unwrap();
    let url = line.split(' ').nth(1).unwrap();
    let (host, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    assert!(host.starts_with("127.0.0.1:"), "{url}");
    let ask = |path: &str, host_header: &str| {
        let mut stream = std::net::TcpStream::connect(host).unwrap();
        write!(stream, "GET /{path} HTTP/1.1\r\nHost: {host_header}\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    };
    assert!(ask(path, host).contains("<!doctype html>"));
    assert!(ask("", host).starts_with("HTTP/1.1 404"));
    assert!(ask(path, "attacker.example").starts_with("HTTP/1.1 403"));
    let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("a browser opened the page") && said.contains("got nothing (403)"),
        "{said}"
    );
    let last = lines.map(Result::unwrap).find(|l| l.starts_with("opened 1 times")).unwrap();
    assert!(last.contains("2 requests got nothing"), "{last}");
    assert!(json(&receipt).to_string().contains("opened 1 times"));
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        before + 1,
        "no file but the receipt"
    );
    for (more, part) in [
        (&["--serve", "--out", "x.html"][..], "cannot be used with"),
        (&["--port", "80"], "--serve"),
        (&["--plain", "--floor", "1"], "--plain leaves out"),
        (&["--plain", "--unit", "m", "--precision", "bf16"], "--plain leaves out"),
    ] {
        let path = folder.path().join("room.ply");
        let output = scenesplat(&[&["view", path.to_str().unwrap()], more].concat());
        assert_eq!(output.status.code(), Some(2), "{more:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{more:?}: {}", stderr(&output));
    }
}

#[test]
fn segment_and_objects_find_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let text = asset("classes.safetensors");
    let args = ["--text", text.to_str().unwrap()];
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    done(&tiny("segment", &asset("room.ply"), &one, &[&args[..], &["--instances"]].concat()));
    done(&tiny("objects", &asset("room.ply"), &two, &args));
    assert_eq!(json(&one.join("objects.json")), json(&two.join("objects.json")));
    let bytes = |folder: &Path| std::fs::read(folder.join("instances.npy")).unwrap();
    assert!(bytes(&one) == bytes(&two));
    assert!(!folder.path().join("one/objects.png").exists());
}

#[test]
fn a_page_is_one_file_that_loads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("room.html");
    let text = asset("classes.safetensors");
    let page = |more: &[&str]| {
        let scene = asset("room.ply");
        let words = ["view", scene.to_str().unwrap(), "--out", out.to_str().unwrap()];
        scenesplat(&[&words[..], more].concat())
    };
    let network = ["--config", "tiny", "--weights", "seeded:0", "--text", text.to_str().unwrap()];
    let output = page(&network);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("16000 Gaussians") && said.contains("24 code numbers"), "{said}");
    let whole = std::fs::read_to_string(&out).unwrap();
    assert!(whole.starts_with("<!doctype html>") && whole.contains("default-src 'none'"));
    assert!(whole.contains("id=\"block-codes\"") && whole.contains("id=\"block-program\""));
    assert!(!whole.contains("src=") && !whole.contains("import "));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "one file");

    let other = tempfile::tempdir().unwrap();
    let names = other.path().join("names.txt");
    std::fs::write(&names, class_names().join("\n")).unwrap();
    done(&page(&["--label-names", names.to_str().unwrap()]));
    let labels = std::fs::read_to_string(&out).unwrap();
    assert!(labels.contains("id=\"block-label\"") && !labels.contains("id=\"block-codes\""));
    done(&page(&["--plain", "--max-splats", "500"]));
    assert!(std::fs::metadata(&out).unwrap().len() < whole.len() as u64);
    for (more, part) in [
        (&["--max-splats", "0"][..], "--max-splats"),
        (&["--codes", "33"], "--codes"),
        (&["--plain", "--weights", "seeded:0"], "--plain runs no network"),
        (&["--plain", "--precision", "bf16"], "--plain leaves out"),
    ] {
        let output = page(more);
        assert_eq!(output.status.code(), Some(2), "{more:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{more:?}: {}", stderr(&output));
    }
}
