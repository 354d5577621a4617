//! Finding out what a path holds, and reading it.

use super::json_text::is_json;
use super::ply::PlyFile;
use super::table::{FORMATS, supported};
use super::{
    LoadedScene, ReadOptions, cameras, compressed_ply, inria_ply, npy_folder, ply, sog, splat,
};
use crate::SceneError;
#[cfg(doc)]
use crate::input_file::COPIED_BELOW;
use crate::input_file::InputFile;
use std::path::Path;

/// Reads a scene from a file or folder in any format.
///
/// What it is is found out by looking into it, whatever it is called. Small files are
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
        let problem = if cameras::is_colmap_folder(path) {
            "is a folder of COLMAP cameras, not of a scene"
        } else {
            "is a folder without coord.npy or meta.json"
        };
        return Err(SceneError::format(path, problem, supported()));
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
    Err(SceneError::format(path, describe(path, bytes), supported()))
}

fn read_ply(file: &PlyFile, options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    if compressed_ply::is_compressed(file) {
        return compressed_ply::read_compressed_ply(file, options);
    }
    inria_ply::read_inria_ply(file, options)
}

/// What an unsupported file seems to be.
fn describe(path: &Path, bytes: &[u8]) -> String {
    let by_content = match bytes {
        [] => Some("is empty"),
        [b'p', b'l', b'y', ..] => Some("begins like a PLY file, but its first line is not `ply`"),
        [0x1f, 0x8b, ..] => Some("is gzip-compressed, but no .spz file"),
        [0x28, 0xb5, 0x2f, 0xfd, ..] => Some("is zstd-compressed, but no .spz file"),
        [b'P', b'K', 3 | 5, ..] => {
            Some("is a zip archive that is cut short, or without a meta.json of SOG")
        }
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => {
            Some("is a single .npy array; give the folder that holds coord.npy")
        }
        _ if is_json(bytes) && cameras::is_cameras_json(bytes) => {
            Some("holds the cameras of a scene, not the scene")
        }
        _ if is_json(bytes) && cameras::is_transforms_json(bytes) => {
            Some("holds the cameras of a scene (transforms.json), not the scene")
        }
        _ if is_json(bytes) => Some("is JSON, but neither glTF nor SOG"),
        _ => None,
    };
    if let Some(text) = by_content {
        return text.to_owned();
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    match extension.to_ascii_lowercase().as_str() {
        "splat" => splat::splat_problem(bytes)
            .unwrap_or_else(|| "is a .splat file by its name only".to_owned()),
        "ksplat" => "is a .ksplat file by its name, but its header is not".to_owned(),
        "spz" => "is an .spz file by its name, but does not begin like one".to_owned(),
        _ => "is no scene that can be recognized".to_owned(),
    }
}
