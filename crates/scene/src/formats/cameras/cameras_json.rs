//! `cameras.json` of the original trainer of Gaussian splats.
//!
//! A list with one object for each picture: `position` is the camera's center, the rows of
//! `rotation` are those of the camera-to-world matrix (axes right, down, forward), focal lengths are
//! in pixels. There is no lens and no principal point: it is the middle of the picture. `cx` and
//! `cy` are read if they are there.

use super::{CameraKind, CameraSet, pixels, without_mark};
use crate::AtomicFile;
use crate::frame::Matrix3;
use crate::{Camera, Distortion, SceneError};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Step of written positions, relative to the largest coordinate; far above the rounding of the two
/// products with a rotation that is orthonormal to the last digits.
const GRID: f64 = 1.0 / (1u64 << 42) as f64;

/// One camera. Unknown properties are ignored.
#[derive(Serialize, Deserialize)]
struct Entry {
    #[serde(default, skip_deserializing)]
    id: usize,
    #[serde(default)]
    img_name: String,
    width: f64,
    height: f64,
    position: [f64; 3],
    rotation: Matrix3,
    #[serde(default)]
    fx: Option<f64>,
    #[serde(default)]
    fy: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cx: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cy: Option<f64>,
}

/// Whether the bytes are a list of objects with `position` and `rotation`.
pub fn is_cameras_json(bytes: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Probe {
        #[serde(rename = "position")]
        _position: IgnoredAny,
        #[serde(rename = "rotation")]
        _rotation: IgnoredAny,
    }
    serde_json::from_slice::<Vec<Probe>>(without_mark(bytes)).is_ok_and(|list| !list.is_empty())
}

/// Reads a `cameras.json`.
///
/// # Errors
/// If it is no such file, or if a camera is not usable.
pub fn read_cameras_json(bytes: &[u8], path: &Path) -> Result<CameraSet, SceneError> {
    let help = "export the cameras again";
    let entries: Vec<Entry> = serde_json::from_slice(without_mark(bytes))
        .map_err(|e| SceneError::format(path, format!("is no list of cameras: {e}"), help))?;
    let camera = |(i, entry): (usize, Entry)| -> Result<Camera, SceneError> {
        let bad = |problem: String| {
            SceneError::format(path, format!("camera {i} {:?} {problem}", entry.img_name), help)
        };
        let size = |v: f64| pixels(v).ok_or_else(|| bad(format!("is {v} pixels wide or high")));
        let (width, height) = (size(entry.width)?, size(entry.height)?);
        let fx = entry.fx.or(entry.fy).ok_or_else(|| bad("has no fx".to_owned()))?;
        let (rotation, translation) = Camera::pose_from_world(&entry.rotation, entry.position);
        Ok(Camera {
            fx,
            fy: entry.fy.unwrap_or(fx),
            cx: entry.cx.unwrap_or(f64::from(width) / 2.0),
            cy: entry.cy.unwrap_or(f64::from(height) / 2.0),
            name: entry.img_name,
            width,
            height,
            distortion: Distortion::None,
            rotation,
            translation,
        })
    };
    let cameras = entries.into_iter().enumerate().map(camera).collect::<Result<_, _>>()?;
    let kind = CameraKind::CamerasJson;
    CameraSet { cameras, points: None, kind, notes: Vec::new() }.finish(path)
}

/// Writes a `cameras.json`. A principal point off the middle is written as `cx` and `cy`, which
/// this crate reads and most other programs ignore. Writing what was read gives the same bytes.
///
/// # Errors
/// If a camera is not usable or has a lens that the file cannot hold, or if writing fails.
pub fn write_cameras_json(cameras: &[Camera], path: &Path) -> Result<(), SceneError> {
    let entry = |(id, camera): (usize, &Camera)| {
        let mut camera = camera.clone();
        camera.check(path)?;
        if camera.distortion != Distortion::None {
            let problem = format!("cannot hold the distortion of camera {:?}", camera.name);
            return Err(SceneError::format(path, problem, "undistort the pictures first"));
        }
        let off = |c: f64, size: u32| (c != f64::from(size) / 2.0).then_some(c);
        let to_world = camera.camera_to_world();
        Ok(Entry {
            id,
            width: f64::from(camera.width),
            height: f64::from(camera.height),
            position: stable_centre(&camera),
            rotation: [0, 1, 2].map(|i| [to_world[i][0], to_world[i][1], to_world[i][2]]),
            fx: Some(camera.fx),
            fy: Some(camera.fy),
            cx: off(camera.cx, camera.width),
            cy: off(camera.cy, camera.height),
            img_name: camera.name,
        })
    };
    let entries = cameras.iter().enumerate().map(entry).collect::<Result<Vec<_>, _>>()?;
    let bytes = serde_json::to_vec(&entries)
        .map_err(|e| SceneError::format(path, format!("cannot be written as JSON: {e}"), ""))?;
    Ok(AtomicFile::write(path, &bytes)?)
}

/// The center, rounded to about 12 digits of its largest coordinate.
///
/// A reader turns it into a translation and a writer back: the last digits of that would change
/// from file to file, and the rounding takes them away.
fn stable_centre(camera: &Camera) -> [f64; 3] {
    let mut centre = camera.centre();
    // Rounding up to a power of two makes the step larger, and then once more is enough.
    for _ in 0..4 {
        let largest = centre.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        if largest < f64::MIN_POSITIVE / GRID {
            return [0.0; 3];
        }
        let step = largest.log2().floor().exp2() * GRID;
        let rounded = centre.map(|v| (v / step).round() * step + 0.0);
        if rounded == centre {
            break;
        }
        centre = rounded;
    }
    centre
}
