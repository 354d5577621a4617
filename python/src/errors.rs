//! Errors of the library as exceptions of Python, in the same words.

use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyFileNotFoundError, PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;
use scenesplat_cli::called::{Failure, FailureKind};
use std::any::Any;

create_exception!(
    scenesplat,
    Error,
    PyException,
    "What the library refuses or cannot do, in the words of the program."
);

/// An error with all its causes.
pub fn error(error: impl Into<anyhow::Error>) -> PyErr {
    failure(&Failure::of(error))
}

/// Why a command failed.
pub fn failure(failure: &Failure) -> PyErr {
    let text = failure.text.clone();
    match failure.kind {
        FailureKind::WrongUse => PyValueError::new_err(text),
        FailureKind::Stopped => PyKeyboardInterrupt::new_err(()),
        FailureKind::NotFound => PyFileNotFoundError::new_err(text),
        FailureKind::Other => Error::new_err(text),
    }
}

/// What is wrong with an argument: its name, and what to do.
pub fn argument(name: &str, problem: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(format!("{name}: {problem}"))
}

/// A panic, which is a fault of the library and no reason to end the interpreter.
pub fn panicked(payload: &(dyn Any + Send)) -> PyErr {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    let text = text.unwrap_or_else(|| "no message".to_owned());
    Error::new_err(format!("a fault of scenesplat, please report it: {text}"))
}
