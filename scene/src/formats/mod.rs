//! The files a scene can come from and go to.
//!
//! [`open_scene`] finds out what a path holds by looking into it, never by its name.

pub mod cameras;
pub mod compressed_ply;
mod files;
pub mod gltf;
pub mod inria_ply;
pub mod ksplat;
mod label_column;
pub mod labelled_ply;
mod language_columns;
pub(crate) mod memory;
pub mod npy;
pub mod npy_folder;
pub mod npy_writer;
mod packed_values;
pub mod ply;
mod scene_blocks;
pub(crate) mod semantics;
<<<<<<< HEAD
pub mod spz;
pub mod sog;
=======
pub mod splat;
>>>>>>> packed
pub mod write;

pub use write::{
    PrecisionLimit, SceneFormat, WriteOptions, WriteProgress, WriteReport, write_scene,
};

use crate::value_policy::clean_scene;
use crate::{GaussianScene, Policy, RepairReport, SceneError};
use ply::PlyFile;
use serde::{Deserialize, Serialize};
use std::io::Read;
use std::path::{Path, PathBuf};

/// What to read, and what to do about bad values.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReadOptions {
    /// Whether bad values are repaired or the file is refused.
    pub policy: Policy,
    /// Which labels become `segment`: the stem of a file in a folder (`segment20`), or a PLY
    /// property. `None`: `segment`, or else `label` (PLY) or the only file `segment*` (folder).
    pub segment: Option<String>,
    /// Whether to read language features; they are by far the largest part of a scene.
    pub lang_feat: bool,
    /// Whether to read spherical harmonics beyond the DC term.
    pub sh_rest: bool,
    /// The frame that SPZ files are taken to be in.
    pub spz_frame: SpzFrame,
    /// Level of detail of a streamed scene, 0 = finest; formats without levels ignore it.
    pub lod: usize,
}

/// The frame of the numbers in an SPZ file, which the file itself does not say.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpzFrame {
    /// Right, up, back, as the format prescribes; converted to the canonical frame.
    #[default]
    Rub,
    /// As in the PLY file it was made from, as several programs write it; not converted.
    Raw,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            policy: Policy::Repair,
            segment: None,
            lang_feat: true,
            sh_rest: true,
            spz_frame: SpzFrame::Rub,
            lod: 0,
        }
    }
}

/// The kinds of files that hold a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneKind {
    /// PLY with one float per property.
    InriaPly,
    /// PLY with packed integers in chunks of 256.
    CompressedPly,
    /// Folder of `.npy` files.
    NpyFolder,
    /// 32 bytes a Gaussian, no header.
    Splat,
    /// Niantic's compressed container.
    Spz,
    /// Textures and codebooks in a folder or archive.
    Sog,
    /// Sections of buckets, for one viewer.
    Ksplat,
    /// A glTF primitive with Gaussian attributes.
    Gltf,
}

impl SceneKind {
    /// The word for it in messages and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::InriaPly => "ply",
            Self::CompressedPly => "compressed-ply",
            Self::NpyFolder => "npy",
            Self::Splat => "splat",
            Self::Spz => "spz",
            Self::Sog => "sog",
            Self::Ksplat => "ksplat",
            Self::Gltf => "gltf",
        }
    }
}

/// A scene with what is needed to write results back to where it came from.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedScene {
    /// The usable Gaussians.
    pub scene: GaussianScene,
    /// What was noticed on the way.
    pub report: RepairReport,
    /// Rows of the source that `scene` is made of, ascending; `None` if all of them.
    pub kept_rows: Option<Vec<u32>>,
    /// The file or folder.
    pub path: PathBuf,
    /// What it is.
    pub kind: SceneKind,
}

impl LoadedScene {
    /// Applies the value policy to a scene as it was read.
    pub(crate) fn finish(
        scene: GaussianScene,
        mut report: RepairReport,
        policy: Policy,
        path: &Path,
        kind: SceneKind,
    ) -> Result<Self, SceneError> {
        let (scene, kept_rows) = clean_scene(scene, &mut report, policy, path)?;
        Ok(Self { scene, report, kept_rows, path: path.to_owned(), kind })
    }

    /// Number of rows in the source, those left out included.
    pub fn source_rows(&self) -> usize {
        self.report.source_rows
    }

    /// One value per row of the source, from one value per Gaussian; rows left out get `fill`.
    ///
    /// # Errors
    /// If `values` does not have one row per Gaussian.
    pub fn to_source_rows<T: Clone>(&self, values: &[T], fill: T) -> Result<Vec<T>, SceneError> {
        if values.len() != self.scene.len() {
            let expected = self.scene.len();
            return Err(SceneError::RowCount { field: "values", expected, got: values.len() });
        }
        let Some(kept) = &self.kept_rows else { return Ok(values.to_vec()) };
        let mut out = vec![fill; self.source_rows()];
        for (&row, value) in kept.iter().zip(values) {
            out[row as usize] = value.clone();
        }
        Ok(out)
    }
}

/// What can be read, for error messages.
const SUPPORTED: &str = "supported are PLY scenes (plain or compressed) and folders of .npy files \
                         with coord.npy; .splat, .ksplat, .spz and .sog are not supported yet, \
                         convert them to PLY";

/// Reads a scene from a PLY file, a compressed PLY file or a preprocessed folder.
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
        return Err(SceneError::format(path, "is a folder without coord.npy", SUPPORTED));
    }
    // Asked before opening: to open a pipe would wait for someone to write into it.
    let about = std::fs::metadata(path).map_err(SceneError::io(path, "cannot open the scene"))?;
    if !about.is_file() {
        return Err(SceneError::format(path, "is neither a file nor a folder", SUPPORTED));
    }
    let mut head = Vec::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(64).read_to_end(&mut head))
        .map_err(SceneError::io(path, "cannot open the scene"))?;
    if !ply::is_ply(&head) {
        return Err(SceneError::format(path, describe(path, &head), SUPPORTED));
    }
    let file = PlyFile::open(path)?;
    if compressed_ply::is_compressed(&file) {
        return compressed_ply::read_compressed_ply(&file, options);
    }
    inria_ply::read_inria_ply(&file, options)
}

/// What an unsupported file seems to be.
fn describe(path: &Path, head: &[u8]) -> String {
    let by_content = match head {
        [] => Some("is empty"),
        [b'p', b'l', b'y', ..] => Some("begins like a PLY file, but its first line is not `ply`"),
        [0x1f, 0x8b, ..] => Some("is gzip-compressed, perhaps .spz"),
        [b'N', b'G', b'S', b'P', ..] => Some("is an .spz file"),
        [0x28, 0xb5, 0x2f, 0xfd, ..] => Some("is zstd-compressed, perhaps .spz"),
        [b'P', b'K', 3 | 5, ..] => Some("is a zip archive, perhaps .sog or .npz"),
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => {
            Some("is a single .npy array; give the folder that holds coord.npy")
        }
        _ => None,
    };
    if let Some(text) = by_content {
        return text.to_owned();
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    match extension.to_ascii_lowercase().as_str() {
        "splat" => "is a .splat file by its name".to_owned(),
        "ksplat" => "is a .ksplat file by its name".to_owned(),
        _ => "is no scene that can be recognised".to_owned(),
    }
}
