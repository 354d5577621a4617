//! Folders and arrays on disk.

use crate::DataError;
use scenesplat_scene::SceneError;
use scenesplat_scene::formats::npy::NpyFile;
use std::path::{Path, PathBuf};

/// A file that is not as it should be.
pub(crate) fn bad_file(
    path: &Path,
    problem: impl Into<String>,
    help: impl Into<String>,
) -> DataError {
    let (problem, help) = (problem.into(), help.into());
    SceneError::Format { path: path.to_owned(), problem, help }.into()
}

/// What is in a folder, sorted.
pub(crate) fn entries(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let action = "cannot list the folder";
    let failed = |source| SceneError::Io { path: folder.to_owned(), action, source };
    let mut out = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        out.push(entry.map_err(failed)?.path());
    }
    out.sort();
    Ok(out)
}

/// The name of a file or folder without the path to it.
pub(crate) fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Names of the `.npy` files in a folder without their ending, sorted.
pub(crate) fn arrays(folder: &Path) -> Result<Vec<String>, SceneError> {
    let names = entries(folder)?.into_iter().map(|path| name_of(&path));
    Ok(names.filter_map(|name| Some(name.strip_suffix(".npy")?.to_owned())).collect())
}

/// An array of positions, relative to the origin of their scene. `[M, 3]`
pub(crate) fn positions(path: &Path, origin: [f64; 3]) -> Result<Vec<[f32; 3]>, DataError> {
    let file = NpyFile::open(path)?;
    if !matches!(file.shape(), [_, 3]) {
        let problem = format!("expected shape (M, 3), got {:?}", file.shape());
        return Err(bad_file(path, problem, "remove the file or save positions"));
    }
    if origin == [0.0; 3] {
        return Ok(file.read_f32()?.as_chunks::<3>().0.to_vec());
    }
    let relative = |p: &[f64; 3]| [0, 1, 2].map(|i| (p[i] - origin[i]) as f32);
    Ok(file.read_f64()?.as_chunks::<3>().0.iter().map(relative).collect())
}

/// Rows of `width` values in the given order.
pub(crate) fn picked<T: Copy>(values: &[T], width: usize, rows: &[u32]) -> Vec<T> {
    let mut out = Vec::with_capacity(rows.len() * width);
    for &row in rows {
        out.extend_from_slice(&values[row as usize * width..(row as usize + 1) * width]);
    }
    out
}
