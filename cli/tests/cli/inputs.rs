//! Inputs that are no files, claim sizes, carry names for the terminal, or flags with wrong values.

use crate::stderr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Runs the program; what still runs after half a minute would wait forever.
fn run(args: &[&str], change: impl FnOnce(&mut Command)) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_scenesplat"));
    command.args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).stdin(Stdio::null());
    change(&mut command);
    let mut child = command.spawn().unwrap();
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > Duration::from_secs(30) {
            child.kill().unwrap();
            panic!("{args:?} does not end");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    let said = stderr(&output);
    assert!(!said.contains("panicked"), "{args:?}: {said}");
    output
}

/// Expects an exit code and words on standard error; gives all of it.
fn refused(args: &[&str], code: i32, words: &[&str]) -> String {
    let output = run(args, |_| {});
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{args:?}: {word:?} is not in: {said}");
    }
    said
}

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }
    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
    fn text(&self, name: &str, text: &str) -> String {
        std::fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        std::fs::write(self.path(name), text).unwrap();
        self.name(name)
    }
    fn name(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }
    /// One Gaussian.
    fn scene(&self) -> String {
        let mut text = "ply\nformat ascii 1.0\nelement vertex 1\n".to_owned();
        for name in ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"] {
            text += &format!("property float {name}\n");
        }
        self.text("scene.ply", &(text + "end_header\n0 0 0 0 0 0 1\n"))
    }
    /// A model folder with that configuration, whose weights are one number.
    fn model(&self, config: &str) -> String {
        let header = r#"{"w":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header.as_bytes());
        bytes.extend([0; 4]);
        self.text("model/config.json", config);
        std::fs::write(self.path("model/model.safetensors"), bytes).unwrap();
        self.name("model")
    }
}

#[test]
fn sizes_in_a_configuration_are_not_believed() {
    let place = Place::new();
    for (config, words) in [
        (r#"{"in_channels": 4611686018427387904}"#, "4611686018427387904"),
        (r#"{"in_channels": 1000000}"#, "1000000"),
        (r#"{"mlp_ratio": 1000000}"#, "mlp_ratio: 1000000"),
        (r#"{"enc_depths": [2, 2, 2, 1000000000]}"#, "enc_depths[3]: 1000000000"),
        (r#"{"num_classes": 18446744073709551615}"#, "num_classes: 18446744073709551615"),
        (r#"{"dec_channels": [16384, 16384, 16384]}"#, "values, at most"),
    ] {
        let model = place.model(config);
        let out = place.name("out");
        refused(&["weights", &model], 1, &["config.json", words]);
        refused(
            &["segment", &place.scene(), "--weights", &model, "--out", &out],
            1,
            &["config.json", words],
        );
    }
    // Possible sizes, but not those of the weights: nothing is built that they cannot fill.
    let model = place.model(r#"{"enc_depths": [2, 2, 2, 2], "enc_channels": [32, 64, 128, 3072]}"#);
    refused(
        &["segment", &place.scene(), "--weights", &model, "--out", &place.name("out")],
        1,
        &["the network has [3072, 3, 3, 3, 3072]"],
    );
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_refused_at_once() {
    let place = Place::new();
    let pipe = place.name("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let (scene, out) = (place.scene(), place.name("out"));
    let extends = place.text("extends.toml", "extends = \"/dev/zero\"\n");
    let extends_pipe = place.text("extends_pipe.toml", "extends = \"pipe\"\n");
    let named = "seeded:0";
    for args in [
        vec!["weights", &pipe],
        vec!["inspect", &pipe],
        vec!["segment", &scene, "--weights", &pipe, "--out", &out],
        vec![
            "segment",
            &scene,
            "--weights",
            named,
            "--config",
            "tiny",
            "--text",
            &pipe,
            "--out",
            &out,
        ],
        vec!["render", &scene, "--cameras", &pipe, "--out", &out],
        vec!["lift-labels", &scene, "--cameras", &pipe, "--segments", &out, "--out", &out],
        vec!["compare", &pipe, &pipe],
        vec!["convert", &pipe, "to.ply"],
        vec!["train", &pipe],
        vec!["train", &extends],
        vec!["train", &extends_pipe],
        vec!["weights", "/dev/zero"],
    ] {
        refused(&args, 1, &["error: "]);
    }
    std::os::unix::fs::symlink(&pipe, place.path("config.toml")).unwrap();
    let config = place.name("config.toml");
    let args = ["segment", &scene, "--weights", named, "--config", &config, "--out", &out];
    refused(&args, 1, &["pipe, socket or device"]);
}

#[test]
fn pointers_of_git_lfs_are_named() {
    let place = Place::new();
    let text = "version https://git-lfs.github.com/spec/v1\noid sha256:0123\nsize 5\n";
    let scene = place.scene();
    for name in ["room.ply", "model.pth", "text.safetensors", "cameras.json"] {
        place.text(name, text);
    }
    let [room, model, table, cameras] =
        ["room.ply", "model.pth", "text.safetensors", "cameras.json"].map(|n| place.name(n));
    let out = place.name("out");
    let run = ["--weights", "seeded:0", "--config", "tiny", "--out", &out];
    for args in [
        vec!["inspect", &room],
        vec!["weights", &model],
        [&["segment", &scene, "--text", &table][..], &run].concat(),
        vec!["render", &scene, "--cameras", &cameras, "--out", &out],
    ] {
        refused(&args, 1, &["git-lfs pointer", "git lfs pull"]);
    }
}

#[test]
fn wrong_values_are_wrong_use() {
    let place = Place::new();
    let (scene, to) = (place.scene(), place.name("to.ply"));
    let run = ["--weights", "seeded:0", "--config", "tiny"];
    let lift = ["lift-labels", "x.ply", "--cameras", "c", "--segments", "s"];
    for (args, words) in [
        (vec!["convert", &scene, &to, "--scale", "-1"], "above 0"),
        (vec!["convert", &scene, &to, "--scale", "nan"], "above 0"),
        ([&lift[..], &["--level", "4"]].concat(), "0 to 3"),
        (vec!["render", &scene, "--size", "20000x20000"], "65535 on a side"),
        (vec!["render", &scene, "--size", "70000x1"], "65535 on a side"),
        (vec!["render", &scene, "--depth", "--depth-scale", "0"], "above 0"),
        ([&["segment", &scene][..], &run, &["--grid-size", "-1"]].concat(), "above 0"),
        (
            [&["segment", &scene][..], &run, &["--text", "vocabulary:18446744073709551615"]]
                .concat(),
            "use 32 to 16384",
        ),
        (vec!["inspect", &scene, "--threads", "2000"], "--threads 2000: 1 to "),
        (vec!["inspect", &scene, "--threads", "0"], "--threads 0: 1 to "),
        (vec!["chunk", &scene, "--out", &to, "--threads", "2000"], "--threads 2000"),
        (vec!["convert", &scene, &to, "--threads", "2000"], "--threads 2000"),
        (vec!["segment", &scene, "--device", "gpu"], "cuda:0"),
    ] {
        refused(&args, 2, &[words]);
    }
    assert!(!Path::new(&to).exists());
}

/// Flags that a command would not use are not there; weights that are given are looked at.
#[test]
fn no_flag_is_without_effect() {
    let place = Place::new();
    let scene = place.scene();
    for args in [
        vec!["render", &scene, "--weights", "nope.pth"],
        vec!["render", &scene, "--config", "tiny"],
        vec!["lift-labels", &scene, "--cameras", "c", "--segments", "s", "--weights", "nope.pth"],
        vec!["weights", "x.pth", "--weights", "nope.pth"],
        vec!["inspect", &scene, "--seed", "1"],
    ] {
        refused(&args, 2, &["unexpected argument"]);
    }
    // Nothing of a plain picture is drawn by lot.
    refused(&["render", &scene, "--seed", "1"], 2, &["--effect"]);
    refused(&["inspect", &scene, "--weights", "/nonexistent"], 1, &["/nonexistent"]);
    let help = run(&["features", "--help"], |_| {});
    assert!(String::from_utf8_lossy(&help.stdout).contains("in any format"));
}

/// The signal that a mapped file has become shorter, sent by hand.
#[cfg(target_os = "linux")]
#[test]
fn a_file_that_is_cut_while_mapped_ends_with_words() {
    let place = Place::new();
    let child = Command::new(env!("CARGO_BIN_EXE_scenesplat"))
        .args(["demo", "--out", &place.name("out")])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The folder is made by the command itself: then the handler is there.
    let start = Instant::now();
    while !place.path("out").exists() {
        assert!(start.elapsed() < Duration::from_secs(30));
        std::thread::sleep(Duration::from_millis(5));
    }
    let id = child.id().to_string();
    assert!(Command::new("kill").args(["-BUS", &id]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(stderr(&output).contains("cut short by another program"), "{output:?}");
}

#[cfg(unix)]
#[test]
fn names_do_not_command_the_terminal() {
    let place = Place::new();
    let evil = "a\u{1b}]0;title\u{7}\u{9b}2J\u{202e}b.ply";
    let scene = place.scene();
    std::fs::copy(scene, place.path(evil)).unwrap();
    let name = place.name(evil);
    let property = place.text(
        "property.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float \u{1b}[31mx\nend_header\n0\n",
    );
    let (missing, out) = (place.name("\u{1b}[2Jmissing.ply"), place.name("out"));
    let cases = [
        vec!["inspect", &name, "--out", &out],
        vec!["inspect", &missing],
        vec!["inspect", &property],
        vec!["render", &name, "--orbit", "1", "--size", "32x24", "--out", &out],
        vec!["weights", &name],
    ];
    for args in cases {
        let output = run(&args, |_| {});
        let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
        assert!(!said.is_empty());
        let bad = said.chars().find(|c| c.is_control() && !matches!(c, '\n' | '\t'));
        assert!(bad.is_none() && !said.contains('\u{202e}'), "{args:?}: {bad:?} in {said:?}");
    }
}

#[test]
fn ordinary_errors_carry_no_backtrace() {
    let place = Place::new();
    let text = place.text("weights.pth", "no weights");
    for args in [vec!["weights", &text], vec!["inspect", "missing.ply"]] {
        let output = run(&args, |command| {
            command.env("RUST_BACKTRACE", "1");
        });
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{said}");
        let told: Vec<&str> = said.lines().filter(|l| !l.starts_with("reading ")).collect();
        assert_eq!(told.len(), 1, "{said}");
    }
}
