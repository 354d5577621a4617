//! The program as a user runs it: files written, exit codes, messages, hostile input.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod bench;
mod budget;
mod chunk;
mod codes;
mod collect_end_to_end;
mod collect_labels;
mod commands;
mod compare;
mod convert;
mod demo_scene;
mod doctor;
mod effects;
mod hostile;
mod inputs;
mod inspect;
mod lift_labels;
mod many;
mod networks;
mod objects;
mod optimise;
mod outputs;
mod pareto;
mod prepare;
mod probe;
mod reconstruct;
mod render;
mod settings;
mod simulate;
mod strange;
mod text;
mod training;
mod upright;

pub use demo_scene::{asset, class_names};
use std::path::Path;
use std::process::{Command, Output};

/// Runs the program.
pub fn scenesplat(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_scenesplat")).args(args).output().unwrap()
}

/// Runs the program with the tiny seeded network, results in `out`.
pub fn tiny(command: &str, scene: &Path, out: &Path, more: &[&str]) -> Output {
    let mut args = vec![command, scene.to_str().unwrap()];
    if command == "query" {
        args.push(more[0]);
    }
    args.extend(["--config", "tiny", "--weights", "seeded:0", "--out", out.to_str().unwrap()]);
    args.extend(if command == "query" { &more[1..] } else { more });
    scenesplat(&args)
}

/// Standard error as text.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Asserts success.
pub fn done(output: &Output) {
    assert!(output.status.success(), "{}", stderr(output));
}
