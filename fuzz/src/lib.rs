//! What every target holds its reader to.

use scenesplat_scene::{LoadedScene, ReadOptions, SceneError};
use std::path::Path;

/// A name for messages; no file of that name is there, so nothing beside it is found either.
pub fn path() -> &'static Path {
    Path::new("fuzz-input")
}

/// Reads with everything on.
pub fn options() -> ReadOptions {
    ReadOptions::default()
}

/// A scene that was read is whole, and no row is lost without a word.
pub fn check(read: Result<LoadedScene, SceneError>) {
    if let Ok(loaded) = read {
        loaded.scene.check_rows().expect("every array has one row per Gaussian");
        assert_eq!(loaded.scene.len() + loaded.report.dropped_rows, loaded.source_rows());
        assert!(loaded.scene.coord.iter().flatten().all(|v| v.is_finite()));
    }
}

/// Cuts an input in three by two lengths at its beginning.
pub fn three_parts(bytes: &[u8]) -> [&[u8]; 3] {
    let Some((lengths, rest)) = bytes.split_first_chunk::<8>() else { return [&[]; 3] };
    let length = |at: usize| {
        u32::from_le_bytes([lengths[at], lengths[at + 1], lengths[at + 2], lengths[at + 3]]) as usize
    };
    let (first, rest) = rest.split_at(length(0).min(rest.len()));
    let (second, third) = rest.split_at(length(4).min(rest.len()));
    [first, second, third]
}
