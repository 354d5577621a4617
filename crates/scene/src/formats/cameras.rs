//! Files of cameras: `cameras.json` of the original trainer, COLMAP models, `transforms.json`.
//!
//! [`open_cameras`] finds out what a path holds. All give [`Camera`]s in the conventions stated
//! there, in the order of the file and in the world of the file.

pub mod cameras_json;
pub mod colmap;
mod image_size;
pub mod nerfstudio;

pub use cameras_json::{is_cameras_json, read_cameras_json, write_cameras_json};
pub use colmap::{is_colmap_folder, read_colmap_binary, read_colmap_text};
pub use image_size::picture_size;
pub use nerfstudio::{is_transforms_json, read_transforms_json};

use super::json_text::without_mark;
use crate::input_file::InputFile;
use crate::place::{NO_ORIGIN, origin_of, sample_rows};
use crate::{Camera, SceneError};
use serde::Serialize;
use std::path::{Path, PathBuf};

const SUPPORTED: &str = "supported are cameras.json, transforms.json and folders of COLMAP with \
                         cameras and images as .bin or .txt, also in sparse/0";

/// The kinds of files that hold cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraKind {
    /// `cameras.json` as the original trainer writes it.
    CamerasJson,
    /// `cameras.bin` and `images.bin`.
    ColmapBinary,
    /// `cameras.txt` and `images.txt`.
    ColmapText,
    /// `transforms.json` of NeRF programs.
    TransformsJson,
}

/// Points that the cameras' poses were computed with.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SparsePoints {
    /// Positions in the world of the cameras. `[M, 3]`
    pub coord: Vec<[f64; 3]>,
    /// Red, green, blue. `[M, 3]`
    pub color: Vec<[u8; 3]>,
}

/// All cameras of a file or folder.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSet {
    /// In the order of the file; at least one, all checked.
    pub cameras: Vec<Camera>,
    /// If the file has any.
    pub points: Option<SparsePoints>,
    /// What it was.
    pub kind: CameraKind,
    /// Remarks, such as a transformation that the file mentions.
    pub notes: Vec<String>,
}

impl CameraSet {
    /// What to subtract from the world of the cameras so that f32 holds their points: zero for points
    /// near 0, and without points. Where cameras stand says too little of how large a scene is.
    pub fn far_origin(&self) -> [f64; 3] {
        let points = self.points.as_ref().map_or(&[][..], |points| &points.coord);
        origin_of(sample_rows(points.len()).map(|row| points[row]))
    }

    /// Cameras and points in a world from whose positions `origin` is subtracted.
    pub fn relative_to(mut self, origin: [f64; 3]) -> Self {
        if origin != NO_ORIGIN {
            self.cameras.iter_mut().for_each(|camera| *camera = camera.relative_to(origin));
            let points = self.points.iter_mut().flat_map(|points| &mut points.coord);
            points.for_each(|p| p.iter_mut().zip(origin).for_each(|(v, o)| *v -= o));
        }
        self
    }

    /// Checks every camera, and that there is one.
    pub(crate) fn finish(mut self, path: &Path) -> Result<Self, SceneError> {
        if self.cameras.is_empty() {
            return Err(SceneError::format(path, "has no cameras", "export the cameras again"));
        }
        self.cameras.iter_mut().try_for_each(|camera| camera.check(path))?;
        Ok(self)
    }
}

/// Reads the cameras of a file, or of a folder that holds one of the known files.
///
/// In a folder, a COLMAP model is looked for first, then `transforms.json`, then `cameras.json`.
///
/// # Errors
/// If there are no cameras, if a file is malformed, or if a lens is of a model that [`Camera`]
/// cannot hold.
pub fn open_cameras(path: &Path) -> Result<CameraSet, SceneError> {
    let failed = SceneError::io(path, "cannot open the cameras");
    let about = std::fs::metadata(path).map_err(failed)?;
    if about.is_dir() {
        if let Some(folder) = colmap::model_folder(path) {
            return colmap::open_colmap(&folder);
        }
        let file = ["transforms.json", "cameras.json"].map(|name| path.join(name));
        return match file.iter().find(|file| file.is_file()) {
            Some(file) => open_cameras(file),
            None => Err(SceneError::format(path, "is a folder without cameras", SUPPORTED)),
        };
    }
    // Asked before opening: to open a pipe would wait for someone to write into it.
    if !about.is_file() {
        return Err(SceneError::format(path, "is neither a file nor a folder", SUPPORTED));
    }
    if let Some(folder) = path.parent().filter(|_| colmap::is_model_file(path)) {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        return colmap::open_colmap(folder);
    }
    let file = InputFile::open(path)?;
    // By the first sign only, so that a damaged file is told what is wrong with it.
    match without_mark(file.bytes()).iter().find(|byte| !byte.is_ascii_whitespace()) {
        Some(b'[') => read_cameras_json(file.bytes(), path),
        Some(b'{') => read_transforms_json(file.bytes(), path),
        _ => Err(SceneError::format(path, "is no file of cameras", SUPPORTED)),
    }
}

/// A number of pixels; some programs write `800.0`.
fn pixels(value: f64) -> Option<u32> {
    (value.fract() == 0.0 && value >= 1.0 && value <= f64::from(u32::MAX)).then_some(value as u32)
}

/// The file beside `path` that a name means, if it stays below that folder.
fn beside(path: &Path, name: &str) -> Option<PathBuf> {
    use std::path::Component::{CurDir, Normal};
    let below = Path::new(name).components().all(|c| matches!(c, CurDir | Normal(_)));
    (below && !name.is_empty()).then(|| path.parent().unwrap_or(Path::new("")).join(name))
}
