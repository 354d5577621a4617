//! What may be written where: inputs, devices and links survive, outputs appear together, a full
//! disk is an error, and two runs do not share a folder.

#![cfg(unix)]

use crate::support::*;
use scenesplat::scene::FolderLock;
use std::fs::{self, File};
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// A folder with a copy of the room.
fn folder_with_room(name: &str) -> (Folder, String) {
    let folder = Folder::new();
    let scene = folder.write(name, bytes(asset("room.ply")));
    (folder, scene)
}

fn features(scene: &str, out: &str, more: &str) -> Output {
    run!("features {scene} {TINY} --out {out} --quiet {more}")
}

fn inspect(scene: &str, more: &str) -> Output {
    run!("inspect {scene} --quiet {more}")
}

/// Every file below a folder with its bytes.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.extend(contents(&path));
        }
        all.push((path.clone(), fs::read(&path).unwrap_or_default()));
    }
    all.sort();
    all
}

#[test]
fn devices_and_pipes_are_not_replaced() {
    let (folder, scene) = folder_with_room("in.ply");
    let (pipe, link, root) = (folder.at("pipe"), folder.at("link.json"), folder.at(""));
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    symlink(&pipe, &link).unwrap();
    let before = folder.count();
    for (flag, more) in [("--json", "--no-sheet"), ("--receipt", "--no-sheet"), ("--sheet", "")] {
        for (path, kind) in [
            (&*pipe, "a named pipe"),
            (&link, "a named pipe"),
            ("/dev/null", "a character device"),
            (&root, "a folder"),
        ] {
            let output = inspect(&scene, &format!("{more} {flag} {path}"));
            refused(&output, 2, &[flag, kind, "only regular files"]);
            assert!(output.stdout.is_empty(), "it was refused before the work");
        }
    }
    assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
    assert!(Path::new(&link).is_symlink());
    assert_eq!(folder.count(), before);
}

#[test]
fn inputs_are_not_replaced_under_any_name() {
    let (folder, scene) = folder_with_room("in.ply");
    let at = |name: &str| folder.at(name);
    symlink("in.ply", at("soft")).unwrap();
    fs::hard_link(&scene, at("hard")).unwrap();
    let before = contents(folder.root());
    let taken = "which this command reads";
    for name in ["in.ply", "soft", "hard"] {
        let path = at(name);
        for flag in ["--no-sheet --json", "--no-sheet --receipt", "--sheet"] {
            refused(&inspect(&scene, &format!("{flag} {path}")), 2, &[taken, &path]);
        }
        let receipt = features(&scene, &at("out"), &format!("--receipt {path}"));
        refused(&receipt, 2, &["--receipt", taken]);
        let to = at("new.spz");
        refused(&run!("convert {scene} {to} --json {path}"), 2, &["--json", taken]);
    }
    assert!(contents(folder.root()) == before);
    // Two outputs of one command.
    let (json, other) = (at("a.json"), at("./a.json"));
    let twice = inspect(&scene, &format!("--no-sheet --json {json} --receipt {other}"));
    refused(&twice, 2, &["is also"]);
}

#[test]
fn a_checkpoint_in_use_is_not_replaced() {
    let folder = Folder::new();
    for name in ["model.safetensors", "config.json"] {
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/embedded").join(name);
        folder.write(&format!("model/{name}"), bytes(from));
    }
    let before = contents(folder.root());
    let (model, weights) = (folder.at("model"), folder.at("model/model.safetensors"));
    refused(&run!("weights {weights} --receipt {weights}"), 2, &["--receipt"]);
    // As a file of the folder that is read, too.
    refused(&run!("weights {model} --json {model}/config.json"), 2, &["--json"]);
    let (room, out) = (asset_at("room.ply"), folder.at("out"));
    let flags = format!("--weights {model} --receipt {weights} --out {out}");
    refused(&run!("segment {room} {flags}"), 2, &["--receipt"]);
    assert!(contents(folder.root()) == before);
}

#[test]
fn an_output_folder_with_the_input_in_it() {
    let (folder, scene) = folder_with_room("features.ply");
    let before = contents(folder.root());
    let parts = ["features.ply", "which this command reads", "give another --out"];
    refused(&features(&scene, &folder.at(""), ""), 2, &parts);
    assert!(contents(folder.root()) == before);
    // Under another name it may lie there.
    let (folder, scene) = folder_with_room("room.ply");
    done(&features(&scene, &folder.at(""), ""));
    assert!(folder.path("features.npy").is_file());
    assert!(bytes(&scene) == bytes(asset("room.ply")));
}

#[test]
fn planted_links_lead_nowhere() {
    let (folder, scene) = folder_with_room("in.ply");
    let victim = folder.write("victim", "precious");
    fs::create_dir(folder.path("out")).unwrap();
    for name in ["features.safetensors.partial", "features.ply.partial", "features.ply"] {
        symlink(&victim, folder.path("out").join(name)).unwrap();
    }
    done(&features(&scene, &folder.at("out"), "--format safetensors"));
    symlink(&victim, folder.path("j.json.partial")).unwrap();
    done(&inspect(&scene, &format!("--no-sheet --json {}", folder.at("j.json"))));
    assert_eq!(text(&victim), "precious");
    for name in ["j.json", "out/features.safetensors", "out/features.ply"] {
        assert!(folder.path(name).symlink_metadata().unwrap().is_file(), "{name}");
    }
}

#[test]
fn results_that_do_not_get_out_are_an_error() {
    let look = format!("inspect {} --no-sheet --quiet", asset_at("room.ply"));
    for line in [&*look, "--help", "segment --help"] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let mut command = program();
        let command = command.args(words(line)).stdout(full).stderr(Stdio::piped());
        let parts = ["standard output", "No space left"];
        refused(&command.output().unwrap(), 1, &parts);
    }
    // Nor do they get to a reader that stops early.
    let mut command = program();
    let command = command.args(words(&look)).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut head = command.spawn().unwrap();
    drop(head.stdout.take());
    refused(&head.wait_with_output().unwrap(), 1, &["standard output", "Broken pipe"]);
}

#[test]
fn missing_folders_are_found_before_the_work() {
    let (folder, scene) = folder_with_room("in.ply");
    let missing = folder.at("none/file");
    for flag in ["--sheet", "--no-sheet --json", "--no-sheet --receipt"] {
        let output = inspect(&scene, &format!("{flag} {missing}"));
        refused(&output, 1, &[&missing]);
        assert!(output.stdout.is_empty(), "nothing was done yet");
    }
    assert_eq!(folder.count(), 1);
}

#[test]
fn one_run_at_a_time_in_a_folder() {
    let (folder, scene) = folder_with_room("in.ply");
    let out = folder.at("out");
    fs::create_dir(&out).unwrap();
    let lock = FolderLock::acquire(Path::new(&out)).unwrap();
    let config = folder.write("experiment.toml", small_segmentation());
    for output in
        [features(&scene, &out, ""), run!("demo --out {out}"), run!("train {config} --out {out}")]
    {
        refused(&output, 1, &["another run is writing", "out"]);
    }
    assert_eq!(fs::read_dir(&out).unwrap().count(), 0, "nothing was left in it");
    drop(lock);
    done(&features(&scene, &out, ""));
}

#[test]
fn a_failed_run_leaves_the_results_of_the_last_one() {
    let (folder, scene) = folder_with_room("in.ply");
    let (out, path) = (folder.at("out"), folder.path("out"));
    done(&features(&scene, &out, ""));
    let before = contents(&path);
    // A row in the middle that the second run refuses.
    fs::write(&scene, "ply\nnonsense").unwrap();
    refused(&features(&scene, &out, ""), 1, &[]);
    assert!(contents(&path) == before);
    // A place that is taken is found before the work.
    fs::copy(asset("room.ply"), &scene).unwrap();
    fs::remove_file(path.join("features.npy")).unwrap();
    fs::create_dir(path.join("features.npy")).unwrap();
    let before = contents(&path);
    refused(&features(&scene, &out, ""), 2, &["features.npy", "is a folder"]);
    assert!(contents(&path) == before);
    // And a folder that only a failed run needed is not left.
    refused(&features(&folder.at("none.ply"), &folder.at("new/folder"), ""), 1, &[]);
    assert!(!folder.path("new").exists());
}

/// Starts the program, waits until `ready`, and ends it as schedulers and containers do.
fn terminated(line: &str, ready: impl Fn() -> bool) -> Output {
    let mut child = program();
    let child = child.args(words(line)).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = child.spawn().unwrap();
    let began = Instant::now();
    while !ready() {
        assert!(began.elapsed() < Duration::from_secs(120), "it never got so far");
        std::thread::sleep(Duration::from_millis(5));
    }
    let signal = format!("kill -TERM {}", child.id());
    assert!(Command::new("sh").args(["-c", &signal]).status().unwrap().success());
    child.wait_with_output().unwrap()
}

#[test]
fn termination_changes_nothing_and_says_so() {
    let (folder, scene) = folder_with_room("in.ply");
    let (out, path) = (folder.at("out"), folder.path("out"));
    done(&features(&scene, &out, ""));
    let before = contents(&path);
    let waiting = || {
        let mut names = fs::read_dir(&path).unwrap().flatten();
        names.any(|e| e.file_name().to_string_lossy().starts_with(".new."))
    };
    let output = terminated(&format!("features {scene} {TINY} --exact --out {out}"), waiting);
    refused(&output, 1, &["nothing was written"]);
    assert!(contents(&path) == before);
}

#[test]
fn termination_of_a_training_saves_it() {
    let folder = Folder::new();
    let long = small_segmentation().replace("epochs = 2", "epochs = 500");
    let config = folder.write("experiment.toml", long);
    let log = folder.path("run/metrics.jsonl");
    let line = format!("train {config} --out {}", folder.at("run"));
    let output = terminated(&line, || fs::metadata(&log).is_ok_and(|about| about.len() > 0));
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    has(&stdout(&output), &["stopped at step", "--resume"]);
    assert!(!stderr(&output).contains("error"), "{}", stderr(&output));
    assert!(fs::read_dir(folder.path("run/checkpoints")).unwrap().count() > 0);
}

#[test]
fn warnings_are_never_quiet_and_may_be_errors() {
    let (folder, scene) = folder_with_room("in.ply");
    let (out, path) = (folder.at("out"), folder.path("out"));
    let warning = "SEEDED WEIGHTS";
    let said = told(&features(&scene, &out, ""));
    assert_eq!(said.matches(warning).count(), 1, "{said}");
    assert!(said.lines().all(|line| line.starts_with("warning: ")), "{said}");
    // Once in all, and counted in the receipt that is printed.
    let loud = run!("features {scene} {TINY} --out {out}");
    assert_eq!(stderr(&loud).matches(warning).count(), 1, "{}", stderr(&loud));
    assert!(!stdout(&loud).contains(warning), "{}", stdout(&loud));
    has(&stdout(&loud), &["told above"]);
    let receipt = json(path.join("receipt.json"));
    assert_eq!(receipt["warnings"].to_string().matches(warning).count(), 1);
    fs::remove_dir_all(&path).unwrap();
    let strict = features(&scene, &out, "--warnings-as-errors");
    refused(&strict, 1, &["error: --warnings-as-errors: ", warning]);
    assert!(!path.join("features.npy").exists(), "nothing is written");
    // Before the command, too, and of one that warns of nothing.
    let copy = folder.at("copy.ply");
    done(&run!("--warnings-as-errors convert {scene} {copy} --quiet"));
}
