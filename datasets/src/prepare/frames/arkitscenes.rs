//! ARKitScenes: pictures, depths and lenses by time, and a trajectory of its own rate.

use super::files::{DepthOf, FrameEntry, PoseOf, SeparateFiles, first_folder};
use super::frame::{Listed, SkipReason};
use super::lens::{IDENTITY, Lens, Pose, inverse};
use super::text::{keyed, numbers, numbers_of};
use crate::DataError;
use crate::files::{bad_file, name_of};
use scenesplat_scene::input_file::read_text_file;
use std::path::{Path, PathBuf};

/// How far a pose may be from its picture, seconds, and a lens: what the benchmark's own tools allow.
const POSE_WITHIN: f64 = 0.1;
const LENS_WITHIN: f64 = 0.002;
/// Times are written with three digits: what is read of them is off by less than this.
const ROUNDING: f64 = 1e-6;

pub(super) fn open(path: &Path) -> Result<Listed, DataError> {
    let named = path.join(format!("{}_frames", name_of(path)));
    let folder = first_folder([path, &named].map(|p| p.join("lowres_wide")));
    let Some(pictures) = folder else {
        let problem = "holds no folder lowres_wide";
        return Err(bad_file(
            path,
            problem,
            "give the folder of one video, with its assets unpacked",
        ));
    };
    let folder = pictures.parent().unwrap_or(path);
    let beside = folder.join("lowres_wide.traj");
    let poses = match beside.is_file() {
        true => beside,
        false => path.join("lowres_wide.traj"),
    };
    let poses = trajectory(&poses)?;
    let lenses = by_time(&folder.join("lowres_wide_intrinsics"), ".pincam")?;
    let mut list = Vec::new();
    for (time, picture) in by_time(&pictures, ".png")? {
        let file = name_of(&picture);
        let name = file.trim_end_matches(".png").to_owned();
        let mut pose = nearest(&poses, time, POSE_WITHIN).copied().ok_or(SkipReason::NoPose);
        let lens = match nearest(&lenses, time, LENS_WITHIN) {
            Some(path) => lens(path)?,
            None => {
                pose = Err(SkipReason::NoIntrinsics);
                Lens::of_corner([1.0; 4], None)
            }
        };
        let depth = Some(folder.join("lowres_depth").join(&file));
        list.push(FrameEntry {
            name,
            picture: Some(picture),
            depth,
            pose: PoseOf::Known(pose),
            lens,
        });
    }
    let files = SeparateFiles { list, depth: DepthOf::Png(1000.0), depth_lens: None };
    Ok(Listed { files: Box::new(files), notes: Vec::new() })
}

/// Files `ID_TIME` of a folder with that ending, by time.
fn by_time(folder: &Path, ending: &str) -> Result<Vec<(f64, PathBuf)>, DataError> {
    let mut out = Vec::new();
    for ((_, key), path) in keyed(folder, "", &[ending])? {
        let time = key.rsplit('_').next().and_then(|time| time.parse::<f64>().ok());
        let Some(time) = time.filter(|time| time.is_finite()) else {
            let problem = "has a name without a time: ID_TIME is expected";
            return Err(bad_file(&path, problem, "remove the file, or fetch the video again"));
        };
        out.push((time, path));
    }
    out.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(out)
}

/// What is nearest to a time in a sorted list, if it is near enough.
fn nearest<T>(sorted: &[(f64, T)], time: f64, within: f64) -> Option<&T> {
    let at = sorted.partition_point(|(t, _)| *t < time);
    let around = sorted[at.saturating_sub(1)..].iter().take(2);
    let off = |(t, _): &&(f64, T)| (t - time).abs();
    let near = around.min_by(|a, b| off(a).total_cmp(&off(b)))?;
    (off(&near) <= within + ROUNDING).then_some(&near.1)
}

/// Poses by time: a line is a time, a turn (axis times angle) and a shift, world to camera.
fn trajectory(path: &Path) -> Result<Vec<(f64, Pose)>, DataError> {
    let mut out = Vec::new();
    for (number, line) in read_text_file(path)?.lines().enumerate() {
        let values = numbers_of(line).unwrap_or_default();
        if line.trim().is_empty() {
            continue;
        }
        let &[time, rx, ry, rz, x, y, z] = values.as_slice() else {
            let problem = format!("line {} is not 7 numbers", number + 1);
            return Err(bad_file(path, problem, "fetch the video again"));
        };
        let mut to_camera = turn([rx, ry, rz]);
        (to_camera[0][3], to_camera[1][3], to_camera[2][3]) = (x, y, z);
        out.push((time, inverse(&to_camera)));
    }
    out.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(out)
}

/// The rotation about a vector by its length in radians (Rodrigues).
fn turn(vector: [f64; 3]) -> Pose {
    let angle = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [x, y, z] = if angle == 0.0 { [0.0; 3] } else { vector.map(|v| v / angle) };
    let (sin, cos) = angle.sin_cos();
    let across = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
    let mut out = IDENTITY;
    for i in 0..3 {
        for j in 0..3 {
            let along = [x, y, z][i] * [x, y, z][j];
            out[i][j] = f64::from(i == j) * cos + sin * across[i][j] + (1.0 - cos) * along;
        }
    }
    out
}

/// A line of width, height, focal lengths and principal point.
fn lens(path: &Path) -> Result<Lens, DataError> {
    let values = numbers(path)?;
    let &[w, h, fx, fy, cx, cy] = values.as_slice() else {
        let problem = format!("has {} numbers, expected w h fx fy cx cy", values.len());
        return Err(bad_file(path, problem, "fetch the video again"));
    };
    let size = [w, h].map(|v| v.clamp(0.0, f64::from(u32::MAX)) as u32);
    Ok(Lens::of_corner([fx, fy, cx, cy], Some(size)))
}
