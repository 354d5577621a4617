//! Finding out what a path holds, and reading it.

use super::json_text::is_json;
use super::named::{self, Named};
use super::ply::PlyFile;
use super::table::FORMATS;
use super::trained_folder::newest_scene;
use super::{LoadedScene, ReadOptions, compressed_ply, inria_ply, npy_folder, ply, sog};
use crate::SceneError;
#[cfg(doc)]
use crate::input_file::COPIED_BELOW;
use crate::input_file::InputFile;
use std::path::Path;

/// Reads a scene from a file or folder in any format.
///
/// What it is is found out by looking into it, whatever it is called. Of a trainer's folder of
/// results the newest iteration is read, and a note says which. Small files are
/// copied into memory, large ones mapped ([`COPIED_BELOW`]); a file that changes its length meanwhile is
/// an error.
///
/// ```no_run
/// use scenesplat_scene::{ReadOptions, open_scene};
/// let loaded = open_scene("room.ply".as_ref(), &ReadOptions::default())?;
/// println!("{} Gaussians\n{}", loaded.scene.len(), loaded.report);
/// # Ok::<(), scenesplat_scene::SceneError>(())
/// ```
///
/// # Errors
/// If the path cannot be read or holds no scene, if the file is malformed, if no usable Gaussian is
/// left, or, under the strict policy, if anything had to be repaired.
pub fn open_scene(path: &Path, options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    if path.is_dir() {
        if path.join("coord.npy").is_file() {
            return npy_folder::read_npy_folder(path, options);
        }
        if sog::is_sog_folder(path) {
            return sog::read_sog(path, options);
        }
        let Some((newest, note)) = newest_scene(path)? else {
            let Named { problem, help } = named::folder(path);
            return Err(SceneError::format(path, problem, help));
        };
        let mut loaded = open_scene(&newest, options)?;
        loaded.report.notes.insert(0, note);
        return Ok(loaded);
    }
    let file = InputFile::open(path)?;
    let bytes = file.bytes();
    if ply::is_ply(bytes) {
        // Keeps the map instead of a copy.
        let file = PlyFile::open_mapped(file)?;
        let loaded = read_ply(&file, options)?;
        file.check_length()?;
        return Ok(loaded);
    }
    // These are made of several files.
    if is_json(bytes) && (sog::is_sog_meta_json(bytes) || sog::is_lod_meta_json(bytes)) {
        return sog::read_sog(path, options);
    }
    let loaded = open_scene_bytes(bytes, path, options)?;
    file.check_length()?;
    Ok(loaded)
}

/// Reads a scene from the bytes of a single file; `path` is for messages, and for files that belong
/// to it (buffers of a glTF file, labels beside the scene).
///
/// # Errors
/// As [`open_scene`].
pub fn open_scene_bytes(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    if ply::is_ply(bytes) {
        return read_ply(&PlyFile::from_bytes(bytes, path)?, options);
    }
    for row in &FORMATS {
        if let Some((is_it, read)) = row.reader
            && is_it(bytes)
        {
            return read(bytes, path, options);
        }
    }
    let Named { problem, help } = named::file(path, bytes);
    Err(SceneError::format(path, problem, help))
}

/// The scene of a PLY file that was opened already, compressed or not.
///
/// # Errors
/// As [`open_scene`].
pub fn read_ply(file: &PlyFile, options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    if compressed_ply::is_compressed(file) {
        return compressed_ply::read_compressed_ply(file, options);
    }
    inria_ply::read_inria_ply(file, options)
}
