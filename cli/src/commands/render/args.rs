//! The flags of `render`.

use super::parse::{parse_color, parse_fov, parse_point, parse_size};
use crate::flags::{Shared, SourceArgs, parse_positive, parse_up};
use clap::ValueEnum;
use scenesplat::datasets::effects::EffectSet;
use scenesplat::rasterizer::RasterSettings;
use scenesplat::scene::Up;
use std::path::{Path, PathBuf};

/// Draws a scene: one PNG for each camera of a file, or for cameras around the scene. With --depth
/// also depth/NAME.png (16 bits) and depth_color/NAME.png. cameras.json has the cameras of the pictures, as
/// optimise and lift-labels read them.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// cameras.json, transforms.json or a COLMAP folder; without it the scene is looked at from
    /// around it.
    #[arg(long, value_name = "PATH")]
    pub cameras: Option<PathBuf>,
    /// Only these cameras: names of pictures, or numbers from 0.
    #[arg(long = "camera", value_name = "NAME|INDEX", num_args = 1.., requires = "cameras")]
    pub chosen: Vec<String>,
    /// Number of cameras around the scene; 4 if no other cameras are given.
    #[arg(long, value_name = "N", conflicts_with_all = ["cameras", "eye", "inside"],
          value_parser = clap::value_parser!(u16).range(1..=3600))]
    pub orbit: Option<u16>,
    /// Number of cameras that look around from a free place inside the scene: for rooms.
    #[arg(long, value_name = "N", conflicts_with_all = ["cameras", "eye"],
          value_parser = clap::value_parser!(u16).range(1..=3600))]
    pub inside: Option<u16>,
    /// Where a single camera stands, in the coordinates of the scene.
    #[arg(long, value_name = "X,Y,Z", requires = "target", conflicts_with = "cameras",
          value_parser = parse_point, allow_hyphen_values = true)]
    pub eye: Option<[f64; 3]>,
    /// What it looks at.
    #[arg(long, value_name = "X,Y,Z", requires = "eye",
          value_parser = parse_point, allow_hyphen_values = true)]
    pub target: Option<[f64; 3]>,
    /// Angle of view across the shorter side of the picture, of --eye (60 by default) and --inside
    /// (75).
    #[arg(long, value_name = "DEGREES", conflicts_with_all = ["cameras", "orbit"],
          value_parser = parse_fov)]
    pub fov: Option<f64>,
    /// Also writes depth.
    #[arg(long)]
    pub depth: bool,
    /// What one unit of the scene is in the 16-bit pictures of depth: 1000 writes millimeters of a
    /// scene in meters.
    #[arg(long, value_name = "STEPS", default_value_t = 1000.0, requires = "depth",
          value_parser = parse_positive, allow_hyphen_values = true)]
    pub depth_scale: f64,
    /// Size of the pictures; by default the cameras' own, 640x480 for those around the scene.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Whose constants to use.
    #[arg(long, value_enum, default_value_t = PresetArg::Gsplat16)]
    pub preset: PresetArg,
    /// Whether opacities make up for the low-pass, as for scenes that were trained so; as the scene's
    /// file says if not given.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
          require_equals = true)]
    pub antialiased: Option<bool>,
    /// Color behind the scene, 0 to 1; black by default.
    #[arg(long, value_name = "R,G,B", value_parser = parse_color)]
    pub background: Option<[f32; 3]>,
    /// auto leaves out what the scene does not have; full computes everything.
    #[arg(long, value_enum, default_value_t = PlanArg::Auto)]
    pub plan: PlanArg,
    /// What a bad capture does, and how strong from 0 to 5: blur, glass, light, noise happen to the
    /// pictures; holes, floaters, surface to the scene before. Lengths are meters. Also writes
    /// effects.json, what became of each picture.
    #[arg(long, value_name = "NAME=SEVERITY,…", default_value = "none")]
    pub effect: EffectSet,
    /// Which of the possible damages.
    #[arg(long, value_name = "N", default_value_t = 0, requires = "effect")]
    pub seed: u64,
    /// Which way is up for --orbit, --inside and --eye; judged by the scene if not given.
    #[arg(long, value_name = "AXIS|X,Y,Z", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Whose constants to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PresetArg {
    /// gsplat 1.6.
    #[value(name = "gsplat-1.6")]
    Gsplat16,
    /// gsplat 1.5.
    #[value(name = "gsplat-1.5")]
    Gsplat15,
    /// Inria's original rasterizer.
    #[value(name = "inria")]
    Inria,
}

/// What to compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PlanArg {
    /// What the scene and the request call for.
    Auto,
    /// Everything.
    Full,
}

impl Args {
    /// Whether the cameras that are read are those of the output folder, which stay as they are.
    pub(super) fn keeps_cameras(&self) -> bool {
        let same = |a: &Path, b: &Path| match (a.canonicalize(), b.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => false,
        };
        let out = &self.shared.out;
        let is_there = |given: &PathBuf| same(given, out) || same(given, &out.join("cameras.json"));
        self.cameras.as_ref().is_some_and(is_there)
    }
}

impl PresetArg {
    /// Its constants.
    pub fn settings(self) -> RasterSettings {
        match self {
            Self::Gsplat16 => RasterSettings::gsplat_1_6(),
            Self::Gsplat15 => RasterSettings::gsplat_1_5(),
            Self::Inria => RasterSettings::inria(),
        }
    }
}
