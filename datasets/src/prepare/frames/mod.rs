//! From the frames of a benchmark, as it ships them, to posed pictures with depth.
//!
//! ```text
//! scan (.sens, folders) ─ open_frames ─► Frames ─ read(i) ─► PosedFrame: camera, picture as it is, depth in mm
//!                                                       └──► Skipped: no picture, no pose, …
//! ```
//!
//! A layout lists its frames once and then hands out one at a time ([`Frames`]). Poses stay in the world of the
//! capture; only the axes of the cameras are made those of [`Camera`](scenesplat_scene::Camera). Principal points of
//! files that count from the center of the first pixel (OpenCV's way: all but ARKit's, nerfstudio's, Hypersim's and
//! Matterport3D's) are moved by half a pixel, because ours count from its corner.

mod arkitscenes;
mod depth;
mod files;
mod frame;
mod hypersim;
mod lens;
mod matterport3d;
mod replica;
mod rgbd;
mod scannet;
mod scannetpp;
mod sens;
mod text;
mod three_r_scan;

pub use depth::{FrameDepth, STEPS_PER_METRE};
pub use frame::{FrameRead, Frames, PosedFrame, SkipReason};

use crate::DataError;
use std::path::Path;

/// How the frames of a scan are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameLayout {
    /// A `.sens` file, a folder that holds one, or the exported folders `color`, `depth`, `pose` and `intrinsic`.
    Scannet,
    /// A folder with `dslr/nerfstudio/transforms_undistorted.json` and undistorted pictures, or with
    /// `iphone/pose_intrinsic_imu.json` and the pictures and depths extracted from its video.
    ScannetPp,
    /// A folder with `lowres_wide`, `lowres_depth`, `lowres_wide_intrinsics` and `lowres_wide.traj`.
    Arkitscenes,
    /// A folder with `undistorted_camera_parameters/SCAN.conf` and the undistorted pictures and depths.
    Matterport3d,
    /// A folder with `sequence/_info.txt` and `sequence/frame-N.{color.jpg,depth.pgm,pose.txt}`.
    ThreeRScan,
    /// A folder with `_detail/cam_XX` and `images/scene_cam_XX_*`.
    Hypersim,
    /// A folder with `traj.txt` and `results/{frame,depth}N`; `cam_params.json` in it or above it.
    Replica,
    /// A folder with `camera-intrinsics.txt` and `frame-N.{color.jpg,depth.png,pose.txt}`.
    Rgbd,
}

impl FrameLayout {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Scannet,
        Self::ScannetPp,
        Self::Arkitscenes,
        Self::Matterport3d,
        Self::ThreeRScan,
        Self::Hypersim,
        Self::Replica,
        Self::Rgbd,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scannet => "scannet",
            Self::ScannetPp => "scannetpp",
            Self::Arkitscenes => "arkitscenes",
            Self::Matterport3d => "matterport3d",
            Self::ThreeRScan => "3rscan",
            Self::Hypersim => "hypersim",
            Self::Replica => "replica",
            Self::Rgbd => "rgbd",
        }
    }
}

/// Lists the frames of a scan.
///
/// # Errors
/// If a file that all frames need is missing or is not what the layout says, or if there are no frames.
pub fn open_frames(path: &Path, layout: FrameLayout) -> Result<Frames, DataError> {
    let listed = match layout {
        FrameLayout::Scannet => scannet::open(path),
        FrameLayout::ScannetPp => scannetpp::open(path),
        FrameLayout::Arkitscenes => arkitscenes::open(path),
        FrameLayout::Matterport3d => matterport3d::open(path),
        FrameLayout::ThreeRScan => three_r_scan::open(path),
        FrameLayout::Hypersim => hypersim::open(path),
        FrameLayout::Replica => replica::open(path),
        FrameLayout::Rgbd => rgbd::open(path),
    }?;
    Frames::new(path, listed)
}

#[cfg(test)]
mod tests;
