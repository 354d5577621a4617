//! Commands over many scenes, their parts, and `merge`.

use crate::{done, scenesplat, stderr};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use serde_json::Value;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

const NETWORK: [&str; 4] = ["--config", "tiny", "--weights", "seeded:0"];

/// A folder with so many small scenes, `a.ply`, `b.ply`, ….
fn scenes(folder: &Path, count: u8) -> PathBuf {
    let scenes = folder.join("scenes");
    std::fs::create_dir_all(&scenes).unwrap();
    for i in 0..count {
        let room = generate(&SyntheticRoomSettings::with_count(400, u64::from(i))).unwrap();
        let name = format!("{}.ply", char::from(b'a' + i));
        write_inria_ply(&room.scene, &[], &scenes.join(name)).unwrap();
    }
    scenes
}

/// The command over the scenes of a folder or list.
fn many(command: &str, manifest: &Path, out: &Path, more: &[&str]) -> Output {
    let mut words = vec![command, "--manifest", manifest.to_str().unwrap()];
    words.extend(NETWORK);
    words.extend(["--out", out.to_str().unwrap()]);
    words.extend(more);
    scenesplat(&words)
}

fn merge(out: &Path) -> Output {
    scenesplat(&["merge", out.to_str().unwrap(), "--verify"])
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn record(out: &Path, name: &str) -> Value {
    json(&out.join("records").join(name).join("record.json"))
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn parts_give_the_bytes_of_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let scenes = scenes(dir.path(), 5);
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    let output = many("features", &scenes, &whole, &[]);
    done(&output);
    assert!(said(&output).contains("5 scenes, 5 done now, 0 done before, 0 failed"));
    for part in ["0/3", "1/3", "2/3"] {
        let refused = merge(&parts);
        assert!(!refused.status.success(), "{part}: parts are missing");
        let output = many("features", &scenes, &parts, &["--shard", part, "--threads", "2"]);
        done(&output);
        let own = if part == "2/3" { "1 scenes, 1 done" } else { "2 scenes, 2 done" };
        assert!(said(&output).contains(own), "{}", said(&output));
    }
    done(&merge(&whole));
    done(&merge(&parts));
    let read = |out: &Path, name: &str| std::fs::read(out.join(name)).unwrap();
    for name in ["merged.json", "merged.md"] {
        assert_eq!(read(&whole, name), read(&parts, name), "{name}");
    }
    for scene in ["a", "b", "c", "d", "e"] {
        let name = format!("{scene}/features.npy");
        assert_eq!(read(&whole, &name), read(&parts, &name), "{name}");
    }
    let merged = json(&whole.join("merged.json"));
    assert_eq!(merged["scenes"].as_array().unwrap().len(), 5);
    assert!(merged["rows_in"].as_u64().unwrap() > 1500);
    assert!(json(&whole.join("costs.json"))["stages"]["network"].as_f64().unwrap() > 0.0);
    // The same as the command on one scene, without all this.
    let alone = dir.path().join("alone");
    let scene = scenes.join("c.ply");
    let words = ["features", scene.to_str().unwrap(), "--out", alone.to_str().unwrap()];
    done(&scenesplat(&[&words[..], &NETWORK].concat()));
    assert_eq!(read(&alone, "features.npy"), read(&parts, "c/features.npy"));
}

#[test]
fn evaluations_of_parts_are_that_of_all() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    let run = |out: &Path, more: &[&str]| {
        let words =
            ["evaluate", "synthetic:3:11", "--features", "oracle", "--out", out.to_str().unwrap()];
        scenesplat(&[&words[..], more].concat())
    };
    done(&run(&whole, &[]));
    for part in ["1/2", "0/2"] {
        done(&run(&parts, &["--shard", part]));
    }
    let output = merge(&parts);
    done(&output);
    assert!(said(&output).contains("random labels"), "{}", said(&output));
    let (whole, merged) =
        (json(&whole.join("evaluation.json")), json(&parts.join("evaluation.json")));
    assert_eq!(whole, merged);
    // Nothing of a scene depends on when, or beside what, it was done.
    let once = dir.path().join("once");
    done(&run(&once, &["--shard", "0/1"]));
    done(&merge(&once));
    for name in ["merged.json", "merged.md", "evaluation.json"] {
        let read = |out: &Path| std::fs::read(out.join(name)).unwrap();
        assert_eq!(read(&once), read(&parts), "{name}");
    }
    assert_eq!(merged["scenes"], 3);
    let one = json(&parts.join("synthetic_1_11_1").join("evaluation.json"));
    assert_ne!(one["counts"]["random"], merged["counts"]["random"]);
}

#[test]
fn a_broken_scene_stops_no_other_and_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let (scenes, out) = (scenes(dir.path(), 3), dir.path().join("out"));
    let good = std::fs::read(scenes.join("b.ply")).unwrap();
    std::fs::write(scenes.join("b.ply"), &good[..good.len() / 2]).unwrap();
    let output = many("features", &scenes, &out, &["--quiet"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stderr(&output).contains("1 of 3 scenes failed"), "{}", stderr(&output));
    assert!(said(&output).contains("2 done now, 0 done before, 1 failed"), "{}", said(&output));
    let reason = record(&out, "b")["reason"].as_str().unwrap().to_owned();
    assert!(reason.contains("b.ply") && said(&output).contains(&reason), "{reason}");
    assert!(!out.join("b").join("features.npy").exists());
    let refused = merge(&out);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        stderr(&refused).contains("1 of 3 scenes are missing")
            && stderr(&refused).contains(&reason)
    );
    assert!(!out.join("merged.json").exists());
    // As broken as before it is tried again: what failed is not done.
    let again = many("features", &scenes, &out, &["--quiet"]);
    assert_eq!(again.status.code(), Some(3), "{}", stderr(&again));
    assert!(said(&again).contains("0 done now, 2 done before, 1 failed"), "{}", said(&again));
    // Mended, the one scene is done and nothing else.
    std::fs::write(scenes.join("b.ply"), &good).unwrap();
    let before = std::fs::metadata(out.join("a/features.npy")).unwrap().modified().unwrap();
    let output = many("features", &scenes, &out, &[]);
    done(&output);
    assert!(said(&output).contains("1 done now, 2 done before, 0 failed"), "{}", said(&output));
    let after = std::fs::metadata(out.join("a/features.npy")).unwrap().modified().unwrap();
    assert_eq!(before, after);
    done(&merge(&out));
}

#[test]
fn what_is_done_is_known_by_content_and_settings() {
    let dir = tempfile::tempdir().unwrap();
    let (scenes, out) = (scenes(dir.path(), 2), dir.path().join("out"));
    done(&many("features", &scenes, &out, &[]));
    // Neither threads nor the path of a file change a result.
    done(&many("features", &scenes, &out, &["--threads", "1"]));
    let refused = many("features", &scenes, &out, &["--dtype", "f16"]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("--dtype left out, now f16"), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("--again"), "{}", stderr(&refused));
    let output = many("features", &scenes, &out, &["--dtype", "f16", "--again"]);
    done(&output);
    assert!(said(&output).contains("2 done now"), "{}", said(&output));
    // A scene that is another now.
    let room = generate(&SyntheticRoomSettings::with_count(300, 77)).unwrap();
    write_inria_ply(&room.scene, &[], &scenes.join("a.ply")).unwrap();
    let output = many("features", &scenes, &out, &["--dtype", "f16"]);
    assert!(said(&output).contains("1 done now, 1 done before"), "{}", said(&output));
    assert!(stderr(&output).contains("a.ply has changed since"), "{}", stderr(&output));
    // A result that is gone, and one that was changed.
    std::fs::remove_file(out.join("b/features.npy")).unwrap();
    let refused = merge(&out);
    assert!(stderr(&refused).contains("features.npy is missing"), "{}", stderr(&refused));
    done(&many("features", &scenes, &out, &["--dtype", "f16"]));
    done(&merge(&out));
    let path = out.join("b/features.npy");
    let mut bytes = std::fs::read(&path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&path, bytes).unwrap();
    assert!(stderr(&merge(&out)).contains("features.npy was changed"));
    // Another command needs another folder; a list may grow, but not shrink.
    let words = ["segment", "--manifest", scenes.to_str().unwrap(), "--out", out.to_str().unwrap()];
    assert!(stderr(&scenesplat(&words)).contains("here are results of `features`"));
    std::fs::rename(scenes.join("b.ply"), dir.path().join("b.ply")).unwrap();
    let refused = many("features", &scenes, &out, &["--dtype", "f16"]);
    assert!(
        stderr(&refused).contains("b (") && stderr(&refused).contains("is no part of"),
        "{}",
        stderr(&refused)
    );
    std::fs::rename(dir.path().join("b.ply"), scenes.join("b.ply")).unwrap();
    std::fs::copy(scenes.join("b.ply"), scenes.join("c.ply")).unwrap();
    let output = many("features", &scenes, &out, &["--dtype", "f16"]);
    assert!(
        said(&output).contains("1 done now, 2 done before"),
        "{}{}",
        said(&output),
        stderr(&output)
    );
}

/// Runs a part and ends it without warning when so many scenes are done; gives whether it was still running.
fn killed(manifest: &Path, out: &Path, part: &str, after: usize) -> bool {
    let mut child = Command::new(env!("CARGO_BIN_EXE_scenesplat"))
        .args(["features", "--manifest", manifest.to_str().unwrap(), "--shard", part])
        .args(NETWORK)
        .args(["--out", out.to_str().unwrap(), "--threads", "1"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let count = || {
        let folders = std::fs::read_dir(out.join("records")).into_iter().flatten().flatten();
        folders.filter(|folder| folder.path().join("record.json").exists()).count()
    };
    while count() < after && child.try_wait().unwrap().is_none() {
        assert!(began.elapsed() < Duration::from_secs(100), "nothing gets done");
        std::thread::sleep(Duration::from_millis(2));
    }
    let running = child.try_wait().unwrap().is_none();
    let _ = child.kill();
    child.wait().unwrap();
    running
}

#[test]
fn a_part_that_was_killed_goes_on_and_two_on_one_part_agree() {
    let dir = tempfile::tempdir().unwrap();
    let scenes = scenes(dir.path(), 6);
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    done(&many("features", &scenes, &whole, &[]));
    assert!(killed(&scenes, &parts, "0/2", 1), "it was done too soon");
    let refused = merge(&parts);
    assert!(stderr(&refused).contains("not done"), "{}", stderr(&refused));
    // Two on the same part, at the same time.
    std::thread::scope(|scope| {
        let twice = ["0/2", "0/2", "1/2"].map(|part| {
            scope.spawn({
                let (scenes, parts) = (&scenes, &parts);
                move || done(&many("features", scenes, parts, &["--shard", part]))
            })
        });
        twice.into_iter().for_each(|thread| thread.join().unwrap());
    });
    done(&merge(&whole));
    done(&merge(&parts));
    let read = |out: &Path| std::fs::read(out.join("merged.json")).unwrap();
    assert_eq!(read(&whole), read(&parts));
    for name in names(&whole) {
        let left = |out: &Path| names(&out.join(&name));
        assert_eq!(
            left(&parts),
            left(&whole),
            "{name:?}: nothing is left of the run that was killed"
        );
    }
}

/// Names in a folder; none of what is a file.
fn names(folder: &Path) -> BTreeSet<OsString> {
    let found = std::fs::read_dir(folder).into_iter().flatten().flatten();
    found.map(|entry| entry.file_name()).collect()
}

#[test]
fn lists_give_scenes_flags_of_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let scenes = scenes(dir.path(), 3);
    let list = dir.path().join("list.json");
    let run = |text: &str, more: &[&str]| {
        std::fs::write(&list, text).unwrap();
        many("features", &list, &dir.path().join("out"), more)
    };
    let text = r#"["scenes/a.ply", {"scene": "scenes/c.ply", "dtype": "f16", "exact": true}]"#;
    done(&run(text, &[]));
    let out = dir.path().join("out");
    let size =
        |name: &str| std::fs::metadata(out.join(name).join("features.npy")).unwrap().len() as f64;
    assert!((size("a") / size("c") - 2.0).abs() < 0.05, "f16 is half of f32");
    assert_eq!(record(&out, "c")["job"]["settings"]["exact"], Value::Array(Vec::new()));
    assert!(!out.join("b").exists());
    let refusals = [
        (r#"["scenes/a.ply", {"scene": "scenes/c.ply", "dtpye": "f16"}]"#, "\"dtpye\" is no flag"),
        (r#"[{"dtype": "f16"}]"#, "entry 0 of the list: \"scene\""),
        (r#"[{"scene": "a.ply", "exact": 3}]"#, "exact: 3; write true"),
        (r#"[{"scene": "a.ply", "json": "x.json"}]"#, "\"json\" is no flag"),
        (r#"["a.ply", 7]"#, "entry 1 of the list: 7 is neither"),
        (r#"["a.ply""#, "no JSON list of scenes"),
        ("[]", "there is no scene"),
        ("# nothing\n\n", "there is no scene"),
        ("scenes/a.ply\nscenes/a.ply\n", "given twice"),
    ];
    for (text, problem) in refusals {
        let output = run(text, &[]);
        assert!(!output.status.success());
        assert!(stderr(&output).contains(problem), "{text}: {}", stderr(&output));
    }
    // Lines, and what is filled in for each scene.
    std::fs::write(&list, "# two\nscenes/b.ply\nscenes/c.ply\n").unwrap();
    let names = dir.path().join("{name}.txt");
    let second = dir.path().join("second");
    for name in ["b", "c"] {
        let classes: Vec<String> = (0..8).map(|i| format!("{name} {i}")).collect();
        std::fs::write(dir.path().join(format!("{name}.txt")), classes.join("\n")).unwrap();
    }
    let output = many("segment", &list, &second, &["--text-names", names.to_str().unwrap()]);
    let texts =
        ["b", "c"].map(|name| record(&second, name)["job"]["settings"]["text-names"].clone());
    assert!(
        texts[0] != texts[1] && texts[0].to_string().contains("sha256:"),
        "{texts:?} {}",
        stderr(&output)
    );
    assert!(scenes.exists());
}

#[test]
fn schedulers_say_the_part_and_wrong_use_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let (scenes, out) = (scenes(dir.path(), 3), dir.path().join("out"));
    let [a, b] = ["a.ply", "b.ply"].map(|name| scenes.join(name).to_str().unwrap().to_owned());
    let run = |variables: &[(&str, &str)], more: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_scenesplat"))
            .args(["features", &a, &b])
            .args(NETWORK)
            .args(["--out", out.to_str().unwrap()])
            .args(more)
            .envs(variables.iter().copied())
            .output()
            .unwrap()
    };
    let slurm = [
        ("SLURM_ARRAY_TASK_ID", "3"),
        ("SLURM_ARRAY_TASK_MIN", "2"),
        ("SLURM_ARRAY_TASK_COUNT", "2"),
    ];
    let output = run(&slurm, &[]);
    done(&output);
    assert!(
        said(&output).contains("part 1/2 by SLURM_ARRAY_TASK_ID: 1 scenes"),
        "{}",
        said(&output)
    );
    assert!(out.join("b/features.npy").exists() && !out.join("a").exists());
    let output = run(&[("RANK", "0"), ("WORLD_SIZE", "2")], &["--shard", "auto"]);
    assert!(said(&output).contains("part 0/2 by RANK: 1 scenes, 1 done now"), "{}", said(&output));
    // What is said by hand counts.
    let output = run(&slurm, &["--shard", "0/1"]);
    assert!(
        said(&output).contains("--shard 0/1: 2 scenes, 0 done now, 2 done before"),
        "{}",
        said(&output)
    );
    type Case<'c> = (&'c [(&'c str, &'c str)], &'c [&'c str], &'c str);
    let refusals: [Case<'_>; 6] = [
        (&[("RANK", "0")], &[], "WORLD_SIZE is missing"),
        (&[], &["--shard", "2/2"], "0/2 to 1/2"),
        (&[], &["--shard", "half"], "write i/n"),
        (&[], &["--json", "x.json"], "unexpected argument"),
        (&[], &["--receipt", "x.json"], "--receipt names one file"),
        (&[], &[&a], "given twice"),
    ];
    for (variables, more, problem) in refusals {
        let output = run(variables, more);
        assert_eq!(output.status.code(), Some(2), "{more:?}");
        assert!(stderr(&output).contains(problem), "{more:?}: {}", stderr(&output));
    }
    let none = scenesplat(&["features", "--out", out.to_str().unwrap()]);
    assert_eq!(none.status.code(), Some(2));
    assert!(stderr(&none).contains("required"), "{}", stderr(&none));
    let refused = scenesplat(&["merge", scenes.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("no manifest.json"), "{}", stderr(&refused));
    std::fs::write(out.join("records/a/record.json"), "{").unwrap();
    let refused = merge(&out);
    assert!(stderr(&refused).contains("no record of this program"), "{}", stderr(&refused));
}
