//! Models of COLMAP: lenses, pictures with poses, and points, each in a file of its own.

mod binary;
mod models;
mod text;

pub use binary::read_colmap_binary;
pub use text::read_colmap_text;

use super::{CameraKind, CameraSet, SparsePoints};
use crate::gaussian_scene::retain_flagged;
use crate::input_file::InputFile;
use crate::vector::rotation;
use crate::{Camera, SceneError};
use models::{Lens, intrinsics};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const MEND: &str = "export the model from COLMAP again";

/// Where a model may be below the folder of a dataset.
const PLACES: [&str; 4] = ["", "sparse/0", "sparse", "colmap/sparse/0"];

/// A picture with its pose, as the files say it.
struct Picture {
    name: String,
    lens: u32,
    /// World to camera, `w, x, y, z`.
    quat: [f64; 4],
    translation: [f64; 3],
}

/// Whether the folder, or `sparse/0` in it, holds a COLMAP model, binary or text.
pub fn is_colmap_folder(path: &Path) -> bool {
    model_folder(path).is_some()
}

/// The folder with the files of the model.
pub(super) fn model_folder(path: &Path) -> Option<PathBuf> {
    let folders = PLACES.iter().map(|place| path.join(place));
    folders.into_iter().find(|folder| ["bin", "txt"].iter().any(|ending| has(folder, ending)))
}

/// Whether a file has the name of one of the model's.
pub(super) fn is_model_file(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let stem = name.strip_suffix(".bin").or_else(|| name.strip_suffix(".txt"));
    matches!(stem, Some("cameras" | "images" | "points3D"))
}

fn has(folder: &Path, ending: &str) -> bool {
    ["cameras", "images"].iter().all(|stem| folder.join(format!("{stem}.{ending}")).is_file())
}

/// Reads the model in a folder, the binary files if there are both.
pub(super) fn open_colmap(folder: &Path) -> Result<CameraSet, SceneError> {
    let Some(ending) = ["bin", "txt"].into_iter().find(|ending| has(folder, ending)) else {
        let problem = "has not both cameras and images of a COLMAP model";
        return Err(SceneError::format(folder, problem, MEND));
    };
    let open = |stem: &str| InputFile::open(&folder.join(format!("{stem}.{ending}")));
    let (cameras, images) = (open("cameras")?, open("images")?);
    let points = folder.join(format!("points3D.{ending}"));
    let points = if points.is_file() { Some(InputFile::open(&points)?) } else { None };
    let points = points.as_ref().map(InputFile::bytes);
    let read = if ending == "bin" { read_colmap_binary } else { read_colmap_text };
    read(cameras.bytes(), images.bytes(), points, folder)
}

/// Gives each picture its lens; `ending` is that of the model's files.
fn join(
    lenses: Vec<Lens>,
    pictures: Vec<Picture>,
    points: Option<SparsePoints>,
    kind: CameraKind,
    folder: &Path,
    ending: &str,
) -> Result<CameraSet, SceneError> {
    let file = |stem: &str| folder.join(format!("{stem}.{ending}"));
    let bad = |problem: String| SceneError::format(&file("cameras"), problem, MEND);
    let bad_image = |problem: String| SceneError::format(&file("images"), problem, MEND);
    let mut by_id = BTreeMap::new();
    for lens in lenses {
        let id = lens.id;
        if by_id.insert(id, lens).is_some() {
            return Err(bad(format!("has two cameras of id {id}")));
        }
    }
    let mut cameras = Vec::with_capacity(pictures.len());
    for picture in pictures {
        let Some(lens) = by_id.get(&picture.lens) else {
            let (name, id) = (picture.name, picture.lens);
            return Err(bad_image(format!("image {name:?} is of camera {id}, which is missing")));
        };
        cameras.push(camera(picture, lens, &file("cameras"), &file("images"))?);
    }
    let mut notes = Vec::new();
    let points = points.map(|points| finite_points(points, &mut notes));
    CameraSet { cameras, points, kind, notes }.finish(folder)
}

/// The camera of a picture; the paths are those of the files of lenses and of pictures.
fn camera(
    picture: Picture,
    lens: &Lens,
    lenses: &Path,
    pictures: &Path,
) -> Result<Camera, SceneError> {
    let Picture { name, quat, translation, .. } = picture;
    let size = |v: u64| {
        let problem = || format!("camera {} is {v} pixels wide or high", lens.id);
        u32::try_from(v).map_err(|_| SceneError::format(lenses, problem(), MEND))
    };
    let (width, height) = (size(lens.width)?, size(lens.height)?);
    // Only lenses that a picture was taken with must be understood.
    let (fx, fy, cx, cy, distortion) = intrinsics(lens).map_err(|problem| {
        SceneError::format(lenses, problem, "undistort the pictures with COLMAP first")
    })?;
    let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !(norm > 0.0 && norm.is_finite()) {
        let problem = format!("image {name:?} has the rotation {quat:?}");
        return Err(SceneError::format(pictures, problem, MEND));
    }
    let rotation = rotation(quat.map(|v| v / norm));
    Ok(Camera { name, width, height, fx, fy, cx, cy, distortion, rotation, translation })
}

/// Leaves out points without a position, and says so.
fn finite_points(mut points: SparsePoints, notes: &mut Vec<String>) -> SparsePoints {
    let finite = |p: &[f64; 3]| p.iter().all(|v| v.is_finite());
    let keep: Vec<bool> = points.coord.iter().map(finite).collect();
    let dropped = keep.iter().filter(|&&keep| !keep).count();
    if dropped > 0 {
        notes.push(format!("{dropped} points without a finite position were left out"));
        retain_flagged(&mut points.color, &keep);
        points.coord.retain(finite);
    }
    points
}
