//! `doctor`: cases run, verdicts are told, wrong names are refused, and it stops when asked to.

use crate::{done, scenesplat, stderr};
use serde_json::Value;
use std::path::Path;

fn report(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// One level, to be quick: the whole catalogue runs in the library's tests.
#[test]
fn the_quick_operators_pass_and_are_told_as_json() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("doctor.json");
    let output = scenesplat(&["doctor", "--level", "operators", "--json", json.to_str().unwrap()]);
    let table = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{table}\n{}", stderr(&output));
    let report = report(&json);
    let number = |field: &str| report[field].as_u64().unwrap();
    assert!(number("cases") > 80, "{}", number("cases"));
    assert_eq!((number("passed"), number("failed")), (number("cases"), 0));
    assert!(report["seconds"].as_f64().unwrap() > 0.0);
    let verdicts = report["verdicts"].as_array().unwrap();
    assert_eq!(verdicts.len() as u64, number("cases"));
    for verdict in verdicts {
        let name = verdict["name"].as_str().unwrap();
        assert!(table.contains(name), "{name} is not in the table");
        assert_eq!((&verdict["passed"], &verdict["level"]), (&true.into(), &"operators".into()));
        for field in ["origin", "reason", "area"] {
            assert!(!verdict[field].as_str().unwrap().is_empty(), "{field} of {name}");
        }
    }
    let machine = &report["surroundings"];
    assert!(machine["instruction_sets"].as_array().unwrap().contains(&"portable".into()));
    assert!(machine["threads"][1].as_u64().unwrap() >= 2, "{machine}");
    assert!(table.contains("instruction sets: portable") && table.contains("memory: "), "{table}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "only the report is left");
}

#[test]
fn one_case_keeps_what_it_made() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for (case, file) in [("ply-quat-w-zero", "scene.ply"), ("product-f32-odd-shapes", "a_1x1.npy")]
    {
        let args = ["doctor", "--case", case, "--out", out.to_str().unwrap()];
        let output = scenesplat(&args);
        done(&output);
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(said.contains("1 cases, 1 passed, 0 failed"), "{said}");
        let kept = out.join(case);
        assert!(said.contains(kept.to_str().unwrap()), "{said}");
        assert!(kept.join(file).is_file(), "{file} of {case}");
        // A second run does not write into the folder of the first.
        let again = scenesplat(&args);
        assert_eq!(again.status.code(), Some(2), "{}", stderr(&again));
        assert!(stderr(&again).contains("is there already"), "{}", stderr(&again));
    }
}

#[test]
fn wrong_use_is_refused() {
    let output = scenesplat(&["doctor", "--case", "ply-quat-w-zer0"]);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(said.contains("no such case") && said.contains("ply-quat-w-zero"), "{said}");
    for args in [
        &["doctor", "--level", "operator"][..],
        &["doctor", "--threads", "0"],
        &["doctor", "--case", "ply-ascii", "--full"],
    ] {
        let output = scenesplat(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
    }
    let output = scenesplat(&["doctor", "--case", "ply-ascii", "--json", "no/folder/a.json"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("a.json"), "{}", stderr(&output));
}

/// Ctrl-C: it says so, and leaves nothing behind.
#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_stops_it() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("doctor.json");
    let mut command = Command::new(env!("CARGO_BIN_EXE_scenesplat"))
        .args(["doctor", "--json"])
        .arg(&json)
        .env("TMPDIR", folder.path())
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(command.stderr.take().unwrap());
    let mut line = String::new();
    said.read_line(&mut line).unwrap();
    assert!(line.contains("inputs"), "{line}");
    let interrupt = format!("kill -INT {}", command.id());
    assert!(Command::new("sh").args(["-c", &interrupt]).status().unwrap().success());
    assert_eq!(command.wait().unwrap().code(), Some(1));
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    assert!(rest.contains("stopped"), "{rest}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_short_soak_is_told_as_json_and_a_round_runs_again() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("soak.json");
    let output =
        scenesplat(&["doctor", "--soak", "2s", "--seed", "5", "--json", json.to_str().unwrap()]);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("seed 5") && said.trim_end().ends_with("passed"), "{said}");
    let report = report(&json);
    assert_eq!((&report["passed"], &report["seed"]), (&true.into(), &5.into()));
    assert!(report["rounds"].as_u64().unwrap() >= 7 && report["problems"] == Value::Array(vec![]));
    #[cfg(target_os = "linux")]
    assert!(report["memory"]["end"].as_u64().unwrap() > 0);
    let output = scenesplat(&["doctor", "--round", "3", "--seed", "5"]);
    done(&output);
    assert!(
        String::from_utf8_lossy(&output.stdout).contains("round 3 of seed 5 (network): passed")
    );
}

/// The thread that trains is one of those that compute: as a mere caller it would sleep and be woken around every operation,
/// a thousand times a step.
#[cfg(target_os = "linux")]
#[test]
#[expect(clippy::zombie_processes, reason = "`wait4` waits, and tells what was used")]
fn the_calling_thread_works_itself() {
    let child = std::process::Command::new(env!("CARGO_BIN_EXE_scenesplat"))
        .args(["doctor", "--training", "--steps", "3", "--seeds", "1", "--threads", "1"])
        .args(["--recipe", "self-distillation"])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let (mut status, mut usage) = (0, std::mem::MaybeUninit::<libc::rusage>::zeroed());
    // SAFETY: the process is a child that nobody else waits for, and both places are there to be written.
    let waited = unsafe { libc::wait4(child.id() as i32, &mut status, 0, usage.as_mut_ptr()) };
    assert_eq!((waited, status), (child.id() as i32, 0));
    // SAFETY: zeros are a value, and `wait4` wrote it.
    let switches = unsafe { usage.assume_init() }.ru_nvcsw;
    assert!(switches < 1000, "{switches} times asleep in twelve steps");
}

#[test]
fn a_short_grid_of_trainings_is_told_as_json() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("training.json");
    let path = json.to_str().unwrap();
    let args = ["doctor", "--training", "--steps", "1", "--seeds", "1", "--json", path];
    let output = scenesplat(&args);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("24 trainings, 0 failed"), "{said}");
    let report = report(&json);
    assert_eq!(report["runs"].as_array().unwrap().len(), 24);
    assert_eq!(report["poison"]["recovered"], true);
    let one = [&args[..], &["--recipe", "gaussian-ssl"]].concat();
    let output = scenesplat(&one);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("4 trainings, 0 failed") && !said.contains("poisoned"), "{said}");
}

#[test]
fn flags_that_would_do_nothing_are_refused() {
    for args in [
        &["doctor", "--seed", "3"][..],
        &["doctor", "--steps", "3"],
        &["doctor", "--recipe", "gaussian-ssl"],
        &["doctor", "--training", "--recipe", "none"],
        &["doctor", "--training", "--steps", "0"],
        &["doctor", "--training", "--seeds", "0"],
        &["doctor", "--soak", "1s", "--full"],
        &["doctor", "--soak", "1s", "--training"],
        &["doctor", "--round", "3", "--json", "a.json"],
        &["doctor", "--soak", "soon"],
    ] {
        let output = scenesplat(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
    }
}

#[test]
fn curves_are_told_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("curves");
    let path = out.to_str().unwrap();
    let few = ["doctor", "--curves", path, "--rooms", "1", "--gaussians"];
    let output = scenesplat(&[&few[..], &["1000"]].concat());
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout);
    for word in ["holes", "floaters", "f-mIoU", "largest fall", "rank correlation", "far away"] {
        assert!(said.contains(word), "{word}: {said}");
    }
    let found = report(&out.join("severity.json"));
    assert!(found["curves"].as_array().unwrap().len() >= 6, "{found}");
    assert!(out.join("severity.png").is_file() && out.join("severity.svg").is_file());
    let output = scenesplat(&[&few[..], &["10"]].concat());
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
}
