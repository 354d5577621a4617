//! Where checkpoints are written, and what of others they leave alone.

use crate::support::{Line, config, fit, names_in, numbers, stop_at, trainer};
use scenesplat_trainers::checkpoint::{newest_checkpoint, read_state};
use scenesplat_trainers::{Progress, TrainError};
use std::fs;
use std::path::Path;

/// A run that writes a checkpoint at step 3.
fn run(dir: &Path) -> Result<Progress, TrainError> {
    let module = Line::new();
    fit(trainer(&module, config(Some(dir))).with_callback(stop_at(3)), &module, numbers())
}

#[test]
fn nothing_is_removed_that_the_run_did_not_write() {
    let dir = tempfile::tempdir().unwrap();
    // A name that could be foreseen, and one that is like that of a part.
    let own = ["step-000000003.partial", ".step-000000003.mine.part"];
    for name in own {
        fs::create_dir(dir.path().join(name)).unwrap();
        fs::write(dir.path().join(name).join("precious"), "precious").unwrap();
    }
    run(dir.path()).unwrap();
    assert_eq!(names_in(dir.path(), ""), [own[1], "step-000000003", own[0]]);
    for name in own {
        assert_eq!(names_in(&dir.path().join(name), ""), ["precious"]);
    }
}

#[cfg(unix)]
#[test]
fn links_lead_no_checkpoint_out_of_its_folder() {
    for name in ["step-000000003.partial", "step-000000003"] {
        let dir = tempfile::tempdir().unwrap();
        let elsewhere = tempfile::tempdir().unwrap();
        fs::write(elsewhere.path().join("params.safetensors"), "precious").unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), dir.path().join(name)).unwrap();
        match run(dir.path()) {
            Ok(_) => assert_ne!(name, "step-000000003"),
            Err(error) => {
                assert_eq!(name, "step-000000003");
                assert!(error.to_string().contains("no folder"), "{error}");
            }
        }
        assert_eq!(names_in(elsewhere.path(), ""), ["params.safetensors"]);
        assert!(dir.path().join(name).is_symlink(), "{name}");
        assert!(names_in(dir.path(), ".").is_empty(), "nothing is left");
    }
}

#[test]
fn what_a_killed_run_left_is_removed_by_the_next_one() {
    let dir = tempfile::tempdir().unwrap();
    let left = dir.path().join(".step-000000007.0123456789abcdef.part");
    fs::create_dir(&left).unwrap();
    fs::write(left.join("params.safetensors"), "half").unwrap();
    // The same step twice, the second time over the first.
    for _ in 0..2 {
        run(dir.path()).unwrap();
        assert_eq!(names_in(dir.path(), ""), ["step-000000003"]);
    }
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    assert_eq!(read_state(&newest).unwrap().progress.step, 3);
}
