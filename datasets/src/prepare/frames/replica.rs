//! Replica as rendered for SLAM: pictures and depths in `results`, poses in `traj.txt`.

use super::files::{DepthOf, FrameEntry, PICTURES, PoseOf, SeparateFiles};
use super::frame::{Listed, SkipReason};
use super::lens::{Lens, pose_of};
use super::text::{keyed, numbers_of};
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::input_file::read_text_file;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct CameraFile {
    camera: CameraOf,
}

#[derive(Deserialize)]
struct CameraOf {
    w: u32,
    h: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Steps of a depth per meter.
    scale: f64,
}

pub(super) fn open(folder: &Path) -> Result<Listed, DataError> {
    let CameraOf { w, h, fx, fy, cx, cy, scale } = camera(folder)?;
    let lens = Lens::of_centre([fx, fy, cx, cy], Some([w, h]));
    let poses = folder.join("traj.txt");
    let text = read_text_file(&poses)?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    let results = folder.join("results");
    let numbered = |prefix, endings: &[&str]| -> Result<BTreeMap<u64, PathBuf>, DataError> {
        let found = keyed(&results, prefix, endings)?;
        Ok(found.into_iter().map(|((number, _), path)| (number, path)).collect())
    };
    let mut pictures = numbered("frame", &PICTURES)?;
    let mut depths = numbered("depth", &[".png"])?;
    let mut list = Vec::with_capacity(lines.len());
    // The number of a picture is that of its line.
    for (number, line) in lines.iter().enumerate() {
        let pose = numbers_of(line).ok().and_then(|values| pose_of(&values)).ok_or_else(|| {
            let problem = format!("line {} is not 16 numbers", number + 1);
            bad_file(&poses, problem, "fetch the sequence again")
        })?;
        let (picture, depth) = (pictures.remove(&(number as u64)), depths.remove(&(number as u64)));
        let name = format!("frame{number:06}");
        list.push(FrameEntry { name, picture, depth, pose: PoseOf::Known(Ok(pose)), lens });
    }
    for (number, picture) in pictures {
        let (name, picture) = (format!("frame{number:06}"), Some(picture));
        let pose = PoseOf::Known(Err(SkipReason::NoPose));
        list.push(FrameEntry { name, picture, depth: None, pose, lens });
    }
    let files = SeparateFiles { list, depth: DepthOf::Png(scale), depth_lens: None };
    Ok(Listed { files: Box::new(files), notes: Vec::new() })
}

/// `cam_params.json` in the folder or in the one around it, which holds all scenes.
fn camera(folder: &Path) -> Result<CameraOf, DataError> {
    let here = folder.join("cam_params.json");
    let path = match here.is_file() {
        true => here,
        false => folder.join("..").join("cam_params.json"),
    };
    let text = read_text_file(&path)?;
    let help = "it is an object camera with w, h, fx, fy, cx, cy and scale";
    let file: CameraFile = serde_json::from_str(&text)
        .map_err(|e| bad_file(&path, format!("is no camera of Replica: {e}"), help))?;
    let scale = file.camera.scale;
    if !(scale.is_finite() && scale > 0.0) {
        return Err(bad_file(&path, format!("scale is {scale}, steps per meter"), help));
    }
    Ok(file.camera)
}
