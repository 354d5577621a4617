//! ScanNet++: undistorted pictures of the camera, or pictures and depths of the phone.

use super::files::{DepthOf, FrameEntry, PoseOf, SeparateFiles, first_folder, picture_at};
use super::frame::{Listed, SkipReason};
use super::lens::{Lens, Pose, inverse, of_opengl, product};
use super::text::{below, stem};
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::input_file::{read_file, read_text_file};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// nerfstudio's world: x and y of the scan exchanged, z downward.
const NERFSTUDIO: Pose =
    [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
/// Largest list of the phone's frames: it has a line for each of a video, with its inertial measurements.
const MAX_LIST: u64 = 1 << 30;
const UNDISTORT: &str = "undistort the pictures with the benchmark's toolbox (dslr/undistort.py), which writes \
                         transforms_undistorted.json";

pub(super) fn open(path: &Path) -> Result<Listed, DataError> {
    let at = |below: &str, file: &str| {
        [path.join(below), path.to_owned()].into_iter().find(|folder| folder.join(file).is_file())
    };
    let list = "nerfstudio/transforms_undistorted.json";
    let phone = at("iphone", "pose_intrinsic_imu.json");
    if let Some(folder) = at("dslr", list) {
        let mut listed = of_camera(&folder, &folder.join(list))?;
        if let Some(phone) = phone {
            let text =
                format!("frames of the phone are left out: for them give {}", phone.display());
            listed.notes.push(text);
        }
        return Ok(listed);
    }
    if let Some(folder) = phone {
        return of_phone(&folder);
    }
    if let Some(folder) = at("dslr", "nerfstudio/transforms.json") {
        let file = folder.join("nerfstudio/transforms.json");
        return Err(bad_file(&file, "is of pictures with a fisheye's distortion", UNDISTORT));
    }
    let problem = "holds neither dslr/nerfstudio/transforms_undistorted.json nor iphone/pose_intrinsic_imu.json";
    Err(bad_file(path, problem, "give the folder of one scene"))
}

#[derive(Deserialize)]
struct CameraList {
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    w: f64,
    h: f64,
    camera_model: Option<String>,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    k4: f64,
    frames: Vec<CameraFrame>,
    #[serde(default)]
    test_frames: Vec<CameraFrame>,
    applied_transform: Option<Vec<[f64; 4]>>,
}

#[derive(Deserialize)]
struct CameraFrame {
    file_path: String,
    transform_matrix: Pose,
    #[serde(default)]
    is_bad: bool,
}

impl CameraList {
    /// What takes the world of the file to that of the scan, its mesh and its COLMAP model.
    fn to_scan(&self, path: &Path) -> Result<Pose, DataError> {
        let applied = match self.applied_transform.as_deref() {
            None => NERFSTUDIO,
            Some([a, b, c]) | Some([a, b, c, [0.0, 0.0, 0.0, 1.0]]) => {
                [*a, *b, *c, [0.0, 0.0, 0.0, 1.0]]
            }
            Some(other) => {
                let problem = format!("has an applied_transform of {} rows", other.len());
                return Err(bad_file(path, problem, "fetch the scene again"));
            }
        };
        Ok(inverse(&applied))
    }
}

fn of_camera(folder: &Path, path: &Path) -> Result<Listed, DataError> {
    let list: CameraList = serde_json::from_str(&read_text_file(path)?)
        .map_err(|e| bad_file(path, format!("is no list of frames: {e}"), "fetch it again"))?;
    let model = list.camera_model.as_deref().unwrap_or("PINHOLE");
    let bent = [list.k1, list.k2, list.k3, list.k4].iter().any(|k| *k != 0.0);
    if bent || !["PINHOLE", "OPENCV"].contains(&model) {
        return Err(bad_file(path, format!("is of the camera model {model}"), UNDISTORT));
    }
    let folders = ["resized_undistorted_images", "undistorted_images"].map(|f| folder.join(f));
    let Some(pictures) = first_folder(folders) else {
        return Err(bad_file(folder, "holds no folder resized_undistorted_images", UNDISTORT));
    };
    let size = [list.w, list.h].map(|v| v.clamp(0.0, f64::from(u32::MAX)) as u32);
    let lens = Lens::of_corner([list.fl_x, list.fl_y, list.cx, list.cy], Some(size));
    let to_scan = list.to_scan(path)?;
    let entry = |frame: &CameraFrame| -> Result<FrameEntry, DataError> {
        let pose = product(&to_scan, &of_opengl(frame.transform_matrix));
        Ok(FrameEntry {
            name: stem(&frame.file_path),
            picture: Some(below(&pictures, &frame.file_path, path)?),
            depth: None,
            pose: PoseOf::Known(if frame.is_bad { Err(SkipReason::MarkedBad) } else { Ok(pose) }),
            lens,
        })
    };
    let entries = list.frames.iter().map(entry).collect::<Result<_, _>>()?;
    let mut notes = vec![
        "poses were brought from nerfstudio's world back to that of the scan's mesh".to_owned(),
    ];
    if !list.test_frames.is_empty() {
        let count = list.test_frames.len();
        notes.push(format!("{count} test frames of the benchmark are left out"));
    }
    let files = SeparateFiles { list: entries, depth: DepthOf::Png(1000.0), depth_lens: None };
    Ok(Listed { files: Box::new(files), notes })
}

#[derive(Deserialize)]
struct PhoneFrame {
    pose: Option<Pose>,
    aligned_pose: Option<Pose>,
    intrinsic: [[f64; 3]; 3],
}

fn of_phone(folder: &Path) -> Result<Listed, DataError> {
    let path = folder.join("pose_intrinsic_imu.json");
    let frames: BTreeMap<String, PhoneFrame> = serde_json::from_slice(&read_file(&path, MAX_LIST)?)
        .map_err(|e| bad_file(&path, format!("is no list of frames: {e}"), "fetch it again"))?;
    let (all, mut unaligned) = (frames.len(), 0);
    let mut list = Vec::new();
    for (name, frame) in frames {
        // Pictures of a video are extracted one in some, and are then no loss.
        let depth = below(&folder.join("depth"), &format!("{name}.png"), &path)?;
        let Some(picture) = picture_at(&folder.join("rgb"), &name) else { continue };
        unaligned += usize::from(frame.aligned_pose.is_none());
        let pose = frame.aligned_pose.or(frame.pose).ok_or(SkipReason::NoPose);
        let [[fx, _, cx], [_, fy, cy], _] = frame.intrinsic;
        list.push(FrameEntry {
            depth: Some(depth),
            name,
            picture: Some(picture),
            pose: PoseOf::Known(pose),
            lens: Lens::of_corner([fx, fy, cx, cy], None),
        });
    }
    let missing = all - list.len();
    let mut notes = Vec::new();
    if missing > 0 {
        notes.push(format!(
            "{missing} of {all} frames of {} have no picture in rgb",
            path.display()
        ));
    }
    if unaligned > 0 {
        let text =
            "frames have no aligned_pose: theirs are in the phone's world, not in that of the mesh";
        notes.push(format!("{unaligned} {text}"));
    }
    if list.is_empty() {
        let problem = "has no frame whose picture is in rgb";
        return Err(bad_file(
            &path,
            problem,
            "extract them with iphone/prepare_iphone_data.py of the toolbox",
        ));
    }
    let files = SeparateFiles { list, depth: DepthOf::Png(1000.0), depth_lens: None };
    Ok(Listed { files: Box::new(files), notes })
}
