//! `transforms.json` of NeRF programs: Blender's synthetic scenes, instant-ngp, nerfstudio.
//!
//! `transform_matrix` takes camera coordinates to the world, with camera axes right, up, back: its
//! second and third columns are negated here. Lenses stand at the top of the file, in a frame, or
//! both; those of the frame win. Focal lengths are `fl_x`, `fl_y` or follow from `camera_angle_x`,
//! `camera_angle_y`; sizes that are missing are taken from the picture's file, PNG or JPEG.
//!
//! nerfstudio may have moved the world of the structure-from-motion model, and says how:
//! `applied_transform`, then `applied_scale`. The matrices are of the world *after* that, in which
//! programs that read this file train; they are left there, and a note tells it.

use super::image_size::image_size;
use super::{CameraKind, CameraSet, beside, pixels, without_mark};
use crate::frame::Matrix3;
use crate::{Camera, Distortion, SceneError};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::path::Path;

/// Fewest bytes of a frame: a matrix of one digit each, and its name.
const FRAME_BYTES: usize = 48;

/// The top of the file, or a frame: both may have the same properties.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Level {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    file_path: Option<String>,
    transform_matrix: Option<Vec<[f64; 4]>>,
    applied_transform: Option<Vec<[f64; 4]>>,
    applied_scale: Option<f64>,
    frames: Vec<Level>,
}

/// Whether the bytes are an object with `frames` that have a `transform_matrix` each.
pub fn is_transforms_json(bytes: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Frame {
        #[serde(rename = "transform_matrix")]
        _matrix: IgnoredAny,
    }
    #[derive(Deserialize)]
    struct File {
        frames: Vec<Frame>,
    }
    serde_json::from_slice::<File>(without_mark(bytes)).is_ok_and(|file| !file.frames.is_empty())
}

/// Reads a `transforms.json`. Pictures are looked for below the folder of `path`, and only for
/// their sizes, if the file does not give them.
///
/// # Errors
/// If it is no such file, if a size or focal length is nowhere to be found, if a lens model is not
/// known, or if a camera is not usable.
pub fn read_transforms_json(bytes: &[u8], path: &Path) -> Result<CameraSet, SceneError> {
    let bad = |problem: String| SceneError::format(path, problem, "export the cameras again");
    let json = without_mark(bytes);
    let objects = json.iter().filter(|&&byte| byte == b'{').count();
    // An empty frame takes 2 bytes here and some hundred in memory.
    if objects > 16 + json.len() / FRAME_BYTES {
        return Err(bad(format!("has {objects} objects in {} bytes, no frames", json.len())));
    }
    let file: Level =
        serde_json::from_slice(json).map_err(|e| bad(format!("is no file of frames: {e}")))?;
    let mut cameras = Vec::with_capacity(file.frames.len());
    for (i, frame) in file.frames.iter().enumerate() {
        let name = frame.file_path.as_deref().unwrap_or_default();
        let camera = read_frame(&file, frame, name, path)
            .map_err(|problem| bad(format!("frame {i} {name:?} {problem}")))?;
        cameras.push(camera);
    }
    let mut notes = Vec::new();
    if let Some(applied) = &file.applied_transform {
        notes.push(format!(
            "the world was transformed by {applied:?} after the structure-from-motion model; \
             cameras are in the transformed world"
        ));
    }
    if let Some(scale) = file.applied_scale {
        notes.push(format!("the world was scaled by {scale} (applied_scale); so are the cameras"));
    }
    CameraSet { cameras, points: None, kind: CameraKind::TransformsJson, notes }.finish(path)
}

/// One camera; the error is what is wrong with the frame.
fn read_frame(file: &Level, frame: &Level, name: &str, path: &Path) -> Result<Camera, String> {
    let get = |of: fn(&Level) -> Option<f64>| of(frame).or_else(|| of(file));
    let (width, height) = match (get(|l| l.w), get(|l| l.h)) {
        (Some(w), Some(h)) => {
            let size = |v: f64| pixels(v).ok_or_else(|| format!("is {v} pixels wide or high"));
            (size(w)?, size(h)?)
        }
        _ => beside(path, name).and_then(|picture| image_size(&picture)).ok_or(
            "has no w and h, and they cannot be read from a PNG or JPEG picture of that name",
        )?,
    };
    // A frame's own angle goes before the focal length of the file.
    let own = |focal: fn(&Level) -> Option<f64>, angle: fn(&Level) -> Option<f64>, size: u32| {
        let of_angle = |angle: f64| f64::from(size) / 2.0 / (angle / 2.0).tan();
        let at = |level: &Level| focal(level).or_else(|| angle(level).map(of_angle));
        at(frame).or_else(|| at(file))
    };
    let fx = own(|l| l.fl_x, |l| l.camera_angle_x, width);
    let fy = own(|l| l.fl_y, |l| l.camera_angle_y, height);
    let (fx, fy) = match (fx, fy) {
        (Some(fx), fy) => (fx, fy.unwrap_or(fx)),
        (None, Some(fy)) => (fy, fy),
        (None, None) => return Err("has neither fl_x nor camera_angle_x".to_owned()),
    };
    let matrix = frame.transform_matrix.as_deref().ok_or("has no transform_matrix")?;
    let (axes, centre) = pose(matrix)?;
    let (rotation, translation) = Camera::pose_from_world(&axes, centre);
    Ok(Camera {
        name: name.to_owned(),
        width,
        height,
        fx,
        fy,
        cx: get(|l| l.cx).unwrap_or(f64::from(width) / 2.0),
        cy: get(|l| l.cy).unwrap_or(f64::from(height) / 2.0),
        distortion: distortion(file, frame)?,
        rotation,
        translation,
    })
}

/// The camera's axes (right, down, forward) as columns, and its center.
fn pose(matrix: &[[f64; 4]]) -> Result<(Matrix3, [f64; 3]), String> {
    let rows = match matrix {
        [a, b, c] => [a, b, c],
        [a, b, c, [x, y, z, w]] if [*x, *y, *z, *w] == [0.0, 0.0, 0.0, 1.0] => [a, b, c],
        _ => return Err(format!("has a transform_matrix that is no pose: {matrix:?}")),
    };
    Ok((rows.map(|row| [row[0], -row[1], -row[2]]), rows.map(|row| row[3])))
}

fn distortion(file: &Level, frame: &Level) -> Result<Distortion, String> {
    let number = |of: fn(&Level) -> Option<f64>| of(frame).or_else(|| of(file)).unwrap_or(0.0);
    let [k1, k2, k3, k4] = [number(|l| l.k1), number(|l| l.k2), number(|l| l.k3), number(|l| l.k4)];
    let [k5, k6] = [number(|l| l.k5), number(|l| l.k6)];
    let p = [number(|l| l.p1), number(|l| l.p2)];
    let model = frame.camera_model.as_deref().or(file.camera_model.as_deref());
    let fisheye = frame.is_fisheye.or(file.is_fisheye) == Some(true);
    match model.unwrap_or(if fisheye { "OPENCV_FISHEYE" } else { "OPENCV" }) {
        "SIMPLE_PINHOLE" | "PINHOLE" => Ok(Distortion::None),
        "OPENCV_FISHEYE" => Ok(Distortion::Fisheye { k: [k1, k2, k3, k4] }),
        "FULL_OPENCV" => Ok(Distortion::open_cv([k1, k2, k3, k4, k5, k6], p)),
        // In this file k4 goes with the eighth power of the radius; in OpenCV it is a divisor.
        "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" if k4 != 0.0 => {
            Ok(Distortion::Polynomial { k: [k1, k2, k3, k4], p })
        }
        "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" => {
            Ok(Distortion::open_cv([k1, k2, k3, 0.0, 0.0, 0.0], p))
        }
        other => Err(format!("is of the camera model {other:?}, which is not known")),
    }
}
