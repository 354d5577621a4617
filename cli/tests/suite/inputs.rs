//! Inputs that are no files, claim sizes, carry names for the terminal, or flags with wrong values.

use crate::support::*;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Runs the program as a process; what still runs after half a minute would wait forever.
fn in_time(command: &mut Command) -> Output {
    let command = command.stdout(Stdio::piped()).stderr(Stdio::piped()).stdin(Stdio::null());
    let mut child = command.spawn().unwrap();
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > Duration::from_secs(30) {
            child.kill().unwrap();
            panic!("{command:?} does not end");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.wait_with_output().unwrap()
}

/// A scene of one Gaussian.
fn scene(folder: &Folder) -> String {
    let mut text = "ply\nformat ascii 1.0\nelement vertex 1\n".to_owned();
    for name in ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"] {
        text += &format!("property float {name}\n");
    }
    folder.write("scene.ply", text + "end_header\n0 0 0 0 0 0 1\n")
}

/// A model folder with that configuration, whose weights are one number.
fn model(folder: &Folder, config: &str) -> String {
    let header = r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    bytes.extend([0; 4]);
    folder.write("model/config.json", config);
    folder.write("model/model.safetensors", bytes);
    folder.at("model")
}

#[test]
fn sizes_in_a_configuration_are_not_believed() {
    let folder = Folder::new();
    let (scene, out) = (scene(&folder), folder.at("out"));
    let segment = |model: &str| run!("segment {scene} --weights {model} --out {out}");
    for (config, part) in [
        (r#"{"in_channels": 4611686018427387904}"#, "4611686018427387904"),
        (r#"{"in_channels": 1000000}"#, "1000000"),
        (r#"{"mlp_ratio": 1000000}"#, "mlp_ratio: 1000000"),
        (r#"{"enc_depths": [2, 2, 2, 1000000000]}"#, "enc_depths[3]: 1000000000"),
        (r#"{"num_classes": 18446744073709551615}"#, "num_classes: 18446744073709551615"),
        (r#"{"dec_channels": [16384, 16384, 16384]}"#, "values, at most"),
    ] {
        let model = model(&folder, config);
        refused(&run!("weights {model}"), 1, &["config.json", part]);
        refused(&segment(&model), 1, &["config.json", part]);
    }
    // Possible sizes, but not those of the weights: nothing is built that they cannot fill.
    let large = r#"{"enc_depths": [2, 2, 2, 2], "enc_channels": [32, 64, 128, 3072]}"#;
    refused(&segment(&model(&folder, large)), 1, &["the network has [3072, 3, 3, 3, 3072]"]);
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_refused_at_once() {
    let folder = Folder::new();
    let (pipe, scene, out) = (folder.at("pipe"), scene(&folder), folder.at("out"));
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let extends = folder.write("extends.toml", "extends = \"/dev/zero\"\n");
    let extends_pipe = folder.write("extends_pipe.toml", "extends = \"pipe\"\n");
    std::os::unix::fs::symlink(&pipe, folder.path("config.toml")).unwrap();
    let config = folder.at("config.toml");
    for (line, part) in [
        (format!("weights {pipe}"), ""),
        (format!("inspect {pipe}"), ""),
        (format!("segment {scene} --weights {pipe} --out {out}"), ""),
        (format!("segment {scene} {TINY} --text {pipe} --out {out}"), ""),
        (format!("render {scene} --cameras {pipe} --out {out}"), ""),
        (format!("lift-labels {scene} --cameras {pipe} --segments {out} --out {out}"), ""),
        (format!("compare {pipe} {pipe}"), ""),
        (format!("convert {pipe} to.ply"), ""),
        (format!("train {pipe}"), ""),
        (format!("train {extends}"), ""),
        (format!("train {extends_pipe}"), ""),
        ("weights /dev/zero".to_owned(), ""),
        (
            format!("segment {scene} --weights seeded:0 --config {config} --out {out}"),
            "pipe, socket or device",
        ),
    ] {
        refused(&in_time(program().args(words(&line))), 1, &["error: ", part]);
    }
}

#[test]
fn pointers_of_git_lfs_are_named() {
    let folder = Folder::new();
    let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0123\nsize 5\n";
    let [room, model, table, cameras] =
        ["room.ply", "model.pth", "text.safetensors", "cameras.json"]
            .map(|name| folder.write(name, pointer));
    let (scene, out) = (scene(&folder), folder.at("out"));
    for line in [
        format!("inspect {room}"),
        format!("weights {model}"),
        format!("segment {scene} --text {table} {TINY} --out {out}"),
        format!("render {scene} --cameras {cameras} --out {out}"),
    ] {
        refused(&run!("{line}"), 1, &["git-lfs pointer", "git lfs pull"]);
    }
}

#[test]
fn wrong_values_and_flags_without_effect_are_wrong_use() {
    let folder = Folder::new();
    let (scene, to) = (&scene(&folder), folder.at("to.ply"));
    let lift = "lift-labels x.ply --cameras c --segments s";
    let unknown = "unexpected argument";
    for (line, part) in [
        (format!("convert {scene} {to} --scale -1"), "above 0"),
        (format!("convert {scene} {to} --scale nan"), "above 0"),
        (format!("{lift} --level 4"), "0 to 3"),
        (format!("render {scene} --size 20000x20000"), "65535 on a side"),
        (format!("render {scene} --size 70000x1"), "65535 on a side"),
        (format!("render {scene} --depth --depth-scale 0"), "above 0"),
        (format!("segment {scene} {TINY} --grid-size -1"), "above 0"),
        (
            format!("segment {scene} {TINY} --text vocabulary:18446744073709551615"),
            "use 32 to 16384",
        ),
        (format!("inspect {scene} --threads 2000"), "--threads 2000: 1 to "),
        (format!("inspect {scene} --threads 0"), "--threads 0: 1 to "),
        (format!("chunk {scene} --out {to} --threads 2000"), "--threads 2000"),
        (format!("convert {scene} {to} --threads 2000"), "--threads 2000"),
        (format!("segment {scene} --device metal:0"), "gpu:NAME"),
        // Flags that a command would not use are not there.
        (format!("render {scene} --weights nope.pth"), unknown),
        (format!("render {scene} --config tiny"), unknown),
        (format!("{lift} --weights nope.pth"), unknown),
        ("weights x.pth --weights nope.pth".to_owned(), unknown),
        (format!("inspect {scene} --seed 1"), unknown),
        // Nothing of a plain picture is drawn by lot.
        (format!("render {scene} --seed 1"), "--effect"),
    ] {
        refused(&run!("{line}"), 2, &[part]);
    }
    assert!(!Path::new(&to).exists());
    // Weights that are given are read.
    refused(&run!("inspect {scene} --weights /nonexistent"), 1, &["/nonexistent"]);
    has(&printed(&run!("features --help")), &["in any format"]);
}

/// The signal that a mapped file has become shorter, sent by hand.
#[cfg(target_os = "linux")]
#[test]
fn a_file_that_is_cut_while_mapped_ends_with_words() {
    let folder = Folder::new();
    let mut child = program();
    child.args(["demo", "--out", &folder.at("out")]).stdout(Stdio::null());
    let child = child.stderr(Stdio::piped()).spawn().unwrap();
    // The folder is made by the command itself: then the handler is there.
    let start = Instant::now();
    while !folder.path("out").exists() {
        assert!(start.elapsed() < Duration::from_secs(30));
        std::thread::sleep(Duration::from_millis(5));
    }
    let id = child.id().to_string();
    assert!(Command::new("kill").args(["-BUS", &id]).status().unwrap().success());
    refused(&child.wait_with_output().unwrap(), 1, &["cut short by another program"]);
}

#[cfg(unix)]
#[test]
fn names_do_not_command_the_terminal() {
    let folder = Folder::new();
    let evil = "a\u{1b}]0;title\u{7}\u{9b}2J\u{202e}b.ply";
    std::fs::copy(scene(&folder), folder.path(evil)).unwrap();
    let (name, missing) = (folder.at(evil), folder.at("\u{1b}[2Jmissing.ply"));
    let property =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float \u{1b}[31mx\nend_header\n0\n";
    let (property, out) = (folder.write("property.ply", property), folder.at("out"));
    for line in [
        format!("inspect {name} --out {out}"),
        format!("inspect {missing}"),
        format!("inspect {property}"),
        format!("render {name} --orbit 1 --size 32x24 --out {out}"),
        format!("weights {name}"),
    ] {
        let output = run!("{line}");
        let said = stdout(&output) + &stderr(&output);
        assert!(!said.is_empty());
        let bad = said.chars().find(|c| c.is_control() && !matches!(c, '\n' | '\t'));
        assert!(bad.is_none() && !said.contains('\u{202e}'), "{line:?}: {bad:?} in {said:?}");
    }
}

#[test]
fn ordinary_errors_carry_no_backtrace() {
    let folder = Folder::new();
    let weights = folder.write("weights.pth", "no weights");
    for line in [format!("weights {weights}"), "inspect missing.ply".to_owned()] {
        let mut command = program();
        command.args(words(&line)).env("RUST_BACKTRACE", "1");
        let said = refused(&in_time(&mut command), 1, &[]);
        let told = said.lines().filter(|l| !l.starts_with("reading "));
        assert_eq!(told.count(), 1, "{said}");
    }
}
