//! The flags of `curate`.

use crate::flags::{Shared, SourceArgs, parse_positive};
use scenesplat::optimisation::curation::Gates;
use std::path::PathBuf;

/// Says which frames of a capture and which scenes are worth keeping, and why.
///
/// With --cameras and --images it judges frames (poses, duplicates, blur, coverage) and writes cameras.json of
/// those that are kept and frames.json; with --scene, too, it measures the scene at them and writes
/// scene_quality.json. With --scenes it makes the table of many: scenes.md and scenes.png.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// cameras.json, transforms.json or a COLMAP folder; pinhole cameras.
    #[arg(long, value_name = "PATH", requires = "images", required_unless_present = "scenes")]
    pub cameras: Option<PathBuf>,
    /// Folder of the pictures, called as their cameras.
    #[arg(long, value_name = "DIR", requires = "cameras")]
    pub images: Option<PathBuf>,
    /// Folder of depths along the camera's axis, NAME.png of 16 bits or NAME.npy.
    #[arg(long, value_name = "DIR", requires = "cameras")]
    pub depth: Option<PathBuf>,
    /// Steps per unit of the scene in 16-bit pictures of depth.
    #[arg(long, value_name = "STEPS", default_value_t = 1000.0, value_parser = parse_positive)]
    pub depth_scale: f64,
    /// The scene that was made of them.
    #[arg(long, value_name = "PATH", requires = "cameras")]
    pub scene: Option<PathBuf>,
    /// Whether the scene was made with antialiasing; as its file says if not given.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
          require_equals = true, requires = "scene")]
    pub antialiased: Option<bool>,
    /// Weights of LPIPS, as for compare; without them it is left out.
    #[arg(long, value_name = "FILE", requires = "scene")]
    pub lpips_weights: Option<PathBuf>,
    /// What evaluate --json wrote of the scene's labels: its mIoU goes into the table.
    #[arg(long, value_name = "FILE.json", requires = "scene")]
    pub evaluation: Option<PathBuf>,
    /// Most frames that the scene is measured at, spread evenly.
    #[arg(long, value_name = "N", default_value_t = 50,
          value_parser = clap::value_parser!(u32).range(1..))]
    pub scored: u32,
    /// A folder whose folders have a scene_quality.json each: makes the table.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["cameras", "scene"])]
    pub scenes: Option<PathBuf>,
    /// A frame is blurred if its sharpness is below this share of the median around it.
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    pub blur_share: f64,
    /// Least frames of a capture.
    #[arg(long, value_name = "N", default_value_t = Gates::default().frames)]
    pub min_frames: usize,
    /// Least PSNR, dB.
    #[arg(long, value_name = "DB", default_value_t = Gates::default().psnr)]
    pub min_psnr: f64,
    /// Largest mean error of depth, units of the scene.
    #[arg(long, value_name = "L1", default_value_t = Gates::default().depth_l1)]
    pub max_depth_l1: f64,
    /// Least Gaussians.
    #[arg(long, value_name = "N", default_value_t = Gates::default().gaussians)]
    pub min_gaussians: usize,
    /// Largest part of the blending weight that floats.
    #[arg(long, value_name = "SHARE", default_value_t = Gates::default().floaters)]
    pub max_floaters: f64,
    /// Largest part of the pixels without surface.
    #[arg(long, value_name = "SHARE", default_value_t = Gates::default().holes)]
    pub max_holes: f64,
    /// Name of the scene in the table. [default: the name of the output folder]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

impl Args {
    /// What a scene has to have.
    pub(super) fn gates(&self) -> Gates {
        Gates {
            frames: self.min_frames,
            psnr: self.min_psnr,
            depth_l1: self.max_depth_l1,
            gaussians: self.min_gaussians,
            floaters: self.max_floaters,
            holes: self.max_holes,
            ..Gates::default()
        }
    }
}
