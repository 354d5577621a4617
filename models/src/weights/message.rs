//! Errors of weight files, with the file's name.

use scenesplat_scene::printable;
use std::path::Path;

/// An error of this file.
pub(super) fn at(path: &Path, problem: impl std::fmt::Display) -> candle_core::Error {
    candle_core::Error::Msg(format!("{}: {problem}", printable(path)))
}

/// An error in opening; those of the scene crate name the file themselves.
pub(super) fn about(path: &Path, error: impl std::error::Error + 'static) -> candle_core::Error {
    let error: &dyn std::error::Error = &error;
    let source = error.source().map_or_else(String::new, |source| format!(": {source}"));
    match error.downcast_ref::<scenesplat_scene::SceneError>() {
        Some(error) => candle_core::Error::Msg(format!("{error}{source}")),
        None => at(path, error),
    }
}
