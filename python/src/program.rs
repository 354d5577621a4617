//! The program as a function.

use crate::errors::panicked;
use pyo3::prelude::*;
use scenesplat_cli::{called, signals};
use std::ffi::OsString;
use std::panic::catch_unwind;

/// Runs the program on its words, the first of which is its name, and gives its exit code. `started_by`: the words that
/// start it as a process. The process is the program's: its Ctrl-C, its threads.
#[pyfunction]
pub fn run_program(
    py: Python<'_>,
    words: Vec<OsString>,
    started_by: Vec<OsString>,
) -> PyResult<u8> {
    called::started_by(started_by);
    signals::say_when_a_file_is_cut();
    py.detach(|| catch_unwind(|| scenesplat_cli::run(words))).map_err(|e| panicked(&*e))
}
