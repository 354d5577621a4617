//! The `scenesplat` program as a function: the binary calls [`run`], tests call [`run_captured`] in their own
//! process. Another program calls what a command computes by [`called`].
//!
//! A command runs on the thread that calls, and on the thread pool of that thread. Outside of a pool the first
//! command makes the global pool, with the calling thread in it, so that a program runs one command. What belongs to
//! a process and not to a command the binary does before: [`allocator`], [`signals`].

pub mod allocator;
mod bench;
mod budget;
pub mod called;
mod caller;
mod commands;
mod defaults;
mod duration;
mod effects;
mod error;
mod flags;
mod frame;
mod label_ids;
mod log;
mod outputs;
mod progress;
mod receipt;
mod session;
mod setting;
pub mod signals;
mod surfaces;
mod terminal;
mod threads;
mod version;

use std::ffi::OsString;
use std::path::Path;
pub use terminal::Captured;

/// Runs the program on the given arguments, the first of which is its name, with the file of defaults that this process
/// finds (docs/command_line.md). Gives the exit code.
pub fn run(args: impl IntoIterator<Item = OsString>) -> u8 {
    commands::run(args, defaults::find().as_deref())
}

/// Runs the program as [`run`] does, with this file of defaults instead, and gives its exit code with what it printed on
/// this thread instead of printing it. Child processes and libraries print as usual.
pub fn run_captured(
    args: impl IntoIterator<Item = OsString>,
    defaults: Option<&Path>,
) -> (u8, Captured) {
    terminal::captured(|| commands::run(args, defaults))
}
