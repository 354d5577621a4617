//! Matterport3D: undistorted pictures and depths, with a list of lenses and poses.
//!
//! The benchmark counts rows from the lower edge, so its principal point does, too; poses have axes right, up, back.

use super::files::{DepthOf, FrameEntry, PoseOf, SeparateFiles};
use super::frame::Listed;
use super::lens::{Lens, of_opengl, pose_of};
use super::text::{below, numbers_of, stem};
use crate::DataError;
use crate::files::{bad_file, entries};
use scenesplat_scene::input_file::read_text_file;
use std::path::{Path, PathBuf};

/// Steps of a depth per meter.
const STEPS: f64 = 4000.0;

pub(super) fn open(folder: &Path) -> Result<Listed, DataError> {
    let list = list_file(&folder.join("undistorted_camera_parameters"))?;
    let text = read_text_file(&list)?;
    let (colors, depths) =
        (folder.join("undistorted_color_images"), folder.join("undistorted_depth_images"));
    let mut lens = None;
    let mut frames = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let bad = |what: &str| {
            let problem = format!("line {} {what}", number + 1);
            bad_file(&list, problem, "fetch undistorted_camera_parameters again")
        };
        let (command, rest) = line.trim().split_once(char::is_whitespace).unwrap_or((line, ""));
        match command {
            "intrinsics_matrix" => {
                let values = numbers_of(rest).unwrap_or_default();
                let &[fx, _, cx, _, fy, cy, ..] = values.as_slice() else {
                    return Err(bad("has no matrix of 9 numbers"));
                };
                let own = Lens::of_corner([fx, fy, cx, cy], None);
                lens = Some(Lens { from_below: true, ..own });
            }
            "scan" => {
                let words: Vec<&str> = rest.split_whitespace().collect();
                let [depth, color, matrix @ ..] = words.as_slice() else {
                    return Err(bad("has not two files and 16 numbers"));
                };
                let pose = numbers_of(&matrix.join(" ")).ok().and_then(|values| pose_of(&values));
                let pose = pose.ok_or_else(|| bad("has not 16 numbers after its two files"))?;
                let lens = lens.ok_or_else(|| bad("comes before any intrinsics_matrix"))?;
                frames.push(FrameEntry {
                    name: stem(color),
                    picture: Some(below(&colors, color, &list)?),
                    depth: Some(below(&depths, depth, &list)?),
                    pose: PoseOf::Known(Ok(of_opengl(pose))),
                    lens,
                });
            }
            _ => {}
        }
    }
    let files = SeparateFiles { list: frames, depth: DepthOf::Png(STEPS), depth_lens: None };
    Ok(Listed { files: Box::new(files), notes: Vec::new() })
}

/// The one `.conf` of a folder.
fn list_file(folder: &Path) -> Result<PathBuf, DataError> {
    let is_list = |path: &PathBuf| path.extension().is_some_and(|e| e == "conf");
    let found: Vec<PathBuf> = entries(folder)?.into_iter().filter(is_list).collect();
    match <[PathBuf; 1]>::try_from(found) {
        Ok([one]) => Ok(one),
        Err(found) => {
            let problem = format!("holds {} files .conf, expected one", found.len());
            Err(bad_file(folder, problem, "unpack undistorted_camera_parameters.zip of one house"))
        }
    }
}
