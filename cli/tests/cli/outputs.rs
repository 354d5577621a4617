//! What may be written where: inputs, devices and links survive, outputs appear together, a full
//! disk is an error, and two runs do not share a folder.

#![cfg(unix)]

use crate::{asset, done, scenesplat, stderr, tiny};
use scenesplat::scene::FolderLock;
use std::fs::{self, File};
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_scenesplat"))
}

/// A folder with a copy of the room.
fn folder_with_room(name: &str) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join(name);
    fs::copy(asset("room.ply"), &scene).unwrap();
    (dir, scene)
}

fn inspect(scene: &Path, more: &[&str]) -> Output {
    let mut args = vec!["inspect", scene.to_str().unwrap(), "--quiet"];
    args.extend(more);
    scenesplat(&args)
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

fn refused(output: &Output, words: &[&str]) {
    let text = stderr(output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(words.iter().all(|word| text.contains(word)), "{text}");
}

#[test]
fn devices_and_pipes_are_not_replaced() {
    let (dir, scene) = folder_with_room("in.ply");
    let pipe = dir.path().join("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let link = dir.path().join("link.json");
    symlink(&pipe, &link).unwrap();
    let before = fs::read_dir(dir.path()).unwrap().count();
    let sheet: &[&str] = &[];
    for (flag, more) in
        [("--json", &["--no-sheet"] as &[&str]), ("--receipt", &["--no-sheet"]), ("--sheet", sheet)]
    {
        for (path, kind) in [
            (&pipe, "a named pipe"),
            (&link, "a named pipe"),
            (&PathBuf::from("/dev/null"), "a character device"),
            (&dir.path().to_owned(), "a folder"),
        ] {
            let path = path.to_str().unwrap();
            let output = inspect(&scene, &[more, &[flag, path]].concat());
            refused(&output, &[flag, kind, "only regular files"]);
            assert!(output.stdout.is_empty(), "it was refused before the work");
        }
    }
    assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo() && link.is_symlink());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), before);
}

#[test]
fn inputs_are_not_replaced_under_any_name() {
    let (dir, scene) = folder_with_room("in.ply");
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    symlink("in.ply", at("soft")).unwrap();
    fs::hard_link(&scene, at("hard")).unwrap();
    let before = contents(dir.path());
    for name in ["in.ply", "soft", "hard"] {
        let path = at(name);
        for flags in [["--json", &path, "--no-sheet"], ["--receipt", &path, "--no-sheet"]] {
            refused(&inspect(&scene, &flags), &["which this command reads", &path]);
        }
        refused(&inspect(&scene, &["--sheet", &path]), &["which this command reads"]);
        let output = tiny("features", &scene, &dir.path().join("out"), &["--receipt", &path]);
        refused(&output, &["--receipt", "which this command reads"]);
        let to = at("new.spz");
        let output = scenesplat(&["convert", &at("in.ply"), &to, "--json", &path]);
        refused(&output, &["--json", "which this command reads"]);
    }
    assert!(contents(dir.path()) == before);
    // Two outputs of one command.
    let (json, other) = (at("a.json"), at("./a.json"));
    let output = inspect(&scene, &["--no-sheet", "--json", &json, "--receipt", &other]);
    refused(&output, &["is also"]);
}

#[test]
fn a_checkpoint_in_use_is_not_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let model = dir.path().join("model");
    fs::create_dir(&model).unwrap();
    for name in ["model.safetensors", "config.json"] {
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/embedded").join(name);
        fs::copy(from, model.join(name)).unwrap();
    }
    let before = contents(dir.path());
    let weights = model.join("model.safetensors");
    let weights = weights.to_str().unwrap();
    refused(&scenesplat(&["weights", weights, "--receipt", weights]), &["--receipt"]);
    // As a file of the folder that is read, too.
    let model = model.to_str().unwrap();
    let config = format!("{model}/config.json");
    refused(&scenesplat(&["weights", model, "--json", &config]), &["--json"]);
    let room = asset("room.ply");
    let room = room.to_str().unwrap();
    let out = dir.path().join("out");
    let flags = ["--weights", model, "--receipt", weights, "--out", out.to_str().unwrap()];
    refused(&scenesplat(&[&["segment", room], &flags[..]].concat()), &["--receipt"]);
    assert!(contents(dir.path()) == before);
}

#[test]
fn an_output_folder_with_the_input_in_it() {
    let (dir, scene) = folder_with_room("features.ply");
    let before = contents(dir.path());
    let output = tiny("features", &scene, dir.path(), &[]);
    refused(&output, &["features.ply", "which this command reads", "give another --out"]);
    assert!(contents(dir.path()) == before);
    // Under another name it may lie there.
    let (dir, scene) = folder_with_room("room.ply");
    done(&tiny("features", &scene, dir.path(), &["--quiet"]));
    assert!(dir.path().join("features.npy").is_file());
    assert!(fs::read(&scene).unwrap() == fs::read(asset("room.ply")).unwrap());
}

#[test]
fn planted_links_lead_nowhere() {
    let (dir, scene) = folder_with_room("in.ply");
    let victim = dir.path().join("victim");
    fs::write(&victim, "precious").unwrap();
    let out = dir.path().join("out");
    fs::create_dir(&out).unwrap();
    for name in ["features.safetensors.partial", "features.ply.partial", "features.ply"] {
        symlink(&victim, out.join(name)).unwrap();
    }
    done(&tiny("features", &scene, &out, &["--format", "safetensors", "--quiet"]));
    let json = dir.path().join("j.json");
    symlink(&victim, dir.path().join("j.json.partial")).unwrap();
    done(&inspect(&scene, &["--no-sheet", "--json", json.to_str().unwrap()]));
    assert_eq!(fs::read_to_string(&victim).unwrap(), "precious");
    for path in [json, out.join("features.safetensors"), out.join("features.ply")] {
        assert!(path.symlink_metadata().unwrap().is_file(), "{}", path.display());
    }
}

#[test]
fn results_that_do_not_get_out_are_an_error() {
    let scene = asset("room.ply");
    let run = |args: &[&str], out: Stdio| {
        program().args(args).stdout(out).stderr(Stdio::piped()).output().unwrap()
    };
    let look = ["inspect", scene.to_str().unwrap(), "--no-sheet", "--quiet"];
    for args in [&look[..], &["--help"], &["segment", "--help"]] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = run(args, full.into());
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        let text = stderr(&output);
        assert!(text.contains("standard output") && text.contains("No space left"), "{text}");
    }
    // Whoever reads no further has what it wants.
    let mut head =
        program().args(look).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(head.stdout.take());
    assert_eq!(head.wait().unwrap().code(), Some(0));
}

#[test]
fn missing_folders_are_found_before_the_work() {
    let (dir, scene) = folder_with_room("in.ply");
    let missing = dir.path().join("none/file");
    let missing = missing.to_str().unwrap();
    for flags in [
        ["--sheet", missing].as_slice(),
        &["--json", missing, "--no-sheet"],
        &["--receipt", missing, "--no-sheet"],
    ] {
        let output = inspect(&scene, flags);
        assert_eq!(output.status.code(), Some(1));
        assert!(stderr(&output).contains(missing), "{}", stderr(&output));
        assert!(output.stdout.is_empty(), "nothing was done yet");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn one_run_at_a_time_in_a_folder() {
    let (dir, scene) = folder_with_room("in.ply");
    let out = dir.path().join("out");
    fs::create_dir(&out).unwrap();
    let lock = FolderLock::acquire(&out).unwrap();
    let busy = |output: &Output| {
        let text = stderr(output);
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains("another run is writing") && text.contains("out"), "{text}");
    };
    busy(&tiny("features", &scene, &out, &[]));
    busy(&scenesplat(&["demo", "--out", out.to_str().unwrap()]));
    let config = dir.path().join("experiment.toml");
    fs::write(&config, crate::training::EXPERIMENT).unwrap();
    let train = ["train", config.to_str().unwrap(), "--out", out.to_str().unwrap()];
    busy(&scenesplat(&train));
    assert_eq!(fs::read_dir(&out).unwrap().count(), 0, "nothing was left in it");
    drop(lock);
    done(&tiny("features", &scene, &out, &["--quiet"]));
}

#[test]
fn a_failed_run_leaves_the_results_of_the_last_one() {
    let (dir, scene) = folder_with_room("in.ply");
    let out = dir.path().join("out");
    done(&tiny("features", &scene, &out, &["--quiet"]));
    let before = contents(&out);
    // A row in the middle that the second run refuses.
    fs::write(&scene, "ply\nnonsense").unwrap();
    assert!(!tiny("features", &scene, &out, &["--quiet"]).status.success());
    assert!(contents(&out) == before);
    // A place that is taken is found before the work.
    fs::copy(asset("room.ply"), &scene).unwrap();
    fs::remove_file(out.join("features.npy")).unwrap();
    fs::create_dir(out.join("features.npy")).unwrap();
    let before = contents(&out);
    refused(&tiny("features", &scene, &out, &["--quiet"]), &["features.npy", "is a folder"]);
    assert!(contents(&out) == before);
    // And a folder that only a failed run needed is not left.
    let new = dir.path().join("new/folder");
    assert!(!tiny("features", &dir.path().join("none.ply"), &new, &[]).status.success());
    assert!(!dir.path().join("new").exists());
}

/// Starts the program, waits until `ready`, and ends it as schedulers and containers do.
fn terminated(args: &[&str], ready: impl Fn() -> bool) -> Output {
    let mut child = program();
    let child = child.args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
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
    let (dir, scene) = folder_with_room("in.ply");
    let out = dir.path().join("out");
    done(&tiny("features", &scene, &out, &["--quiet"]));
    let before = contents(&out);
    let args = ["features", scene.to_str().unwrap(), "--config", "tiny", "--weights", "seeded:0"];
    let args = [&args[..], &["--exact", "--out", out.to_str().unwrap()]].concat();
    let waiting = || {
        let mut names = fs::read_dir(&out).unwrap().flatten();
        names.any(|e| e.file_name().to_string_lossy().starts_with(".new."))
    };
    let output = terminated(&args, waiting);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("nothing was written"), "{}", stderr(&output));
    assert!(contents(&out) == before);
}

#[test]
fn termination_of_a_training_saves_it() {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("experiment.toml");
    let long = crate::training::EXPERIMENT.replace("epochs = 2", "epochs = 500");
    fs::write(&config, &long).unwrap();
    let out = dir.path().join("run");
    let args = ["train", config.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let log = out.join("metrics.jsonl");
    let output = terminated(&args, || fs::metadata(&log).is_ok_and(|about| about.len() > 0));
    done(&output);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("stopped at step") && text.contains("--resume"), "{text}");
    let checkpoints = fs::read_dir(out.join("checkpoints")).unwrap().flatten();
    assert!(checkpoints.count() > 0);
}
