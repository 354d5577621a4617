//! The flags of `optimise`.

use crate::commands::render::parse_color;
use crate::flags::{Shared, parse_positive};
use clap::ValueEnum;
use scenesplat::memory::Bytes;
use scenesplat::optimisation::cost::set_cap;
use scenesplat::optimisation::{
    Background, DepthKind, DepthTerm, OptimiseSettings, SsimPadding, StepOrder,
};
use std::path::PathBuf;

/// Makes a scene of Gaussians from posed pictures: writes scene.ply, optimise.json, progress.jsonl, pictures
/// of truth, result and error in test/, and while it runs previews/ and checkpoints/.
///
/// Ctrl-C saves and stops; --resume goes on, with the bits that an uninterrupted run has.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// cameras.json, transforms.json or a COLMAP folder; pinhole cameras.
    #[arg(long, value_name = "PATH")]
    pub cameras: PathBuf,
    /// Folder of the pictures, PNG or JPEG, called as their cameras. Where one is transparent, nothing is there.
    #[arg(long, value_name = "DIR")]
    pub images: PathBuf,
    /// Folder of depths along the camera's axis, NAME.png of 16 bits or NAME.npy, [H, W]; 0 = unknown.
    #[arg(long, value_name = "DIR")]
    pub depth: Option<PathBuf>,
    /// Steps per unit of the scene in 16-bit pictures of depth: 1000 for millimeters.
    #[arg(long, value_name = "STEPS", default_value_t = 1000.0, value_parser = parse_positive,
          requires = "depth")]
    pub depth_scale: f64,
    /// Folder of masks, called as the cameras: black pixels do not count.
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// What is behind everything, also where pictures are transparent: auto (black, and behind transparent pictures
    /// another color at each step), random (the same behind all), black, white, or red, green and blue from 0 to 1.
    #[arg(long, value_name = "auto|random|black|white|R,G,B", default_value = "auto",
          value_parser = parse_background)]
    pub background: Background,
    /// A scene or point cloud to begin with. [default: points of the COLMAP model, else the depths, else
    /// random points where the cameras look]
    #[arg(long, value_name = "PATH")]
    pub points: Option<PathBuf>,
    /// What the first Gaussians are: `depth` lays flat ones on the surfaces that the depths show.
    #[arg(long, value_enum, default_value_t = InitArg::Points)]
    pub init: InitArg,
    /// Most Gaussians to begin with, where they come from depths or are random.
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = clap::value_parser!(u32).range(1..))]
    pub initial: u32,
    /// Whose settings.
    #[arg(long, value_enum, default_value_t = PresetArg::Scenesplat)]
    pub preset: PresetArg,
    /// Steps, a picture each; the preset's schedules shrink or grow with them.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub steps: Option<u64>,
    /// Most Gaussians.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub cap: Option<u32>,
    /// Most time (20min, 2h): size of the pictures, steps and cap are chosen by the speed of first steps, and
    /// the run ends when the time has.
    #[arg(long, value_name = "TIME", value_parser = crate::duration::parse_duration)]
    pub budget: Option<crate::duration::Seconds>,
    /// Weight of the depth loss; 0 is none.
    #[arg(long, value_name = "LAMBDA", value_parser = parse_weight)]
    pub depth_weight: Option<f32>,
    /// Which depth is compared: Σ w z (accumulated) or Σ w z / Σ w (expected).
    #[arg(long, value_enum)]
    pub depth_kind: Option<DepthKindArg>,
    /// Weight of the mean opacity. [default: of the preset; 0.01 for scenesplat without --depth]
    #[arg(long, value_name = "LAMBDA", value_parser = parse_weight)]
    pub opacity_reg: Option<f32>,
    /// Weight of the mean standard deviation.
    #[arg(long, value_name = "LAMBDA", value_parser = parse_weight)]
    pub scale_reg: Option<f32>,
    /// How SSIM treats borders.
    #[arg(long, value_enum)]
    pub ssim_border: Option<BorderArg>,
    /// Highest band of the harmonics.
    #[arg(long, value_name = "0..3", value_parser = clap::value_parser!(u8).range(0..=3))]
    pub sh_degree: Option<u8>,
    /// First steps with pictures of half the size.
    #[arg(long, value_name = "N")]
    pub half_steps: Option<u64>,
    /// Whether opacities make up for the low-pass; the file of the result says so.
    #[arg(long, value_name = "BOOL")]
    pub antialiased: Option<bool>,
    /// Learns a gain and an offset per channel of each picture, against automatic exposure: `auto` where pictures
    /// with depth show that it drifts, `on` always.
    #[arg(long, value_enum, num_args = 0..=1, default_value = "auto", default_missing_value = "on")]
    pub exposure: ExposureArg,
    /// Strategy before Adam (gsplat-1.3) or after it (gsplat-1.6).
    #[arg(long, value_enum)]
    pub order: Option<OrderArg>,
    /// Every N-th frame is kept for the test, from the first; 0 tests on frames that were learned from.
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub test_every: usize,
    /// Seed of all that is random.
    #[arg(long, value_name = "N", default_value_t = 42)]
    pub seed: u64,
    /// Steps between previews, 0 for none. [default: a tenth of the steps]
    #[arg(long, value_name = "N")]
    pub preview_every: Option<u64>,
    /// Steps between checkpoints, 0 for none but that of Ctrl-C.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub checkpoint_every: u64,
    /// Goes on with the newest checkpoint in --out.
    #[arg(long)]
    pub resume: bool,
    /// Most memory that is planned for (8GB); the cap is lowered to keep it.
    #[arg(long, value_name = "SIZE")]
    pub max_memory: Option<Bytes>,
    /// Also writes the figures as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// What the first Gaussians are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum InitArg {
    /// Balls at points: those of --points, else of the cameras' file, else on the depths, else random ones.
    Points,
    /// Discs with the normals of the depths, means over all frames.
    Depth,
}

/// Whose settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PresetArg {
    /// Those that the data set's authors published: MCMC, depth, antialiased.
    Scenesplat,
    /// MCMC of gsplat 1.6.
    GsplatMcmc,
    /// The default strategy of gsplat 1.6.
    GsplatDefault,
}

/// Which depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DepthKindArg {
    /// Σ w z.
    Accumulated,
    /// Σ w z / Σ w.
    Expected,
}

/// Which border.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum BorderArg {
    /// Windows inside the picture alone.
    Valid,
    /// Mirrored.
    Reflect,
    /// Black.
    Zero,
}

/// Whether exposure is learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExposureArg {
    /// Where the pictures show that it drifts.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// Which order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OrderArg {
    /// Strategy, then Adam.
    #[value(name = "gsplat-1.3")]
    Gsplat13,
    /// Adam, then strategy.
    #[value(name = "gsplat-1.6")]
    Gsplat16,
}

fn parse_weight(text: &str) -> Result<f32, String> {
    let value = text.parse().ok().filter(|v: &f32| v.is_finite() && *v >= 0.0);
    value.ok_or_else(|| format!("{text:?}: a weight is a number of at least 0"))
}

fn parse_background(text: &str) -> Result<Background, String> {
    match text {
        "auto" => Ok(Background::Auto),
        "random" => Ok(Background::Random),
        "black" => Ok(Background::Fixed([0.0; 3])),
        "white" => Ok(Background::Fixed([1.0; 3])),
        _ => parse_color(text)
            .map(Background::Fixed)
            .map_err(|problem| format!("{problem}, or one of auto, random, black, white")),
    }
}

impl Args {
    /// A flag about the depth loss where there is none: what to say.
    pub(super) fn idle_depth_flag(&self, settings: &OptimiseSettings) -> Option<String> {
        let weight = self.depth_weight.filter(|w| *w > 0.0).map(|_| "--depth-weight");
        let flag = self.depth_kind.map(|_| "--depth-kind").or(weight)?;
        if self.depth.is_none() {
            Some(format!("{flag} has no effect without --depth: give the folder of the depths"))
        } else if settings.depth_loss().is_none() {
            Some(format!(
                "{flag} has no effect without a depth loss: give --depth-weight, such as 1"
            ))
        } else {
            None
        }
    }

    /// The preset with what the flags change.
    pub(super) fn settings(&self) -> OptimiseSettings {
        let mut s = match self.preset {
            PresetArg::Scenesplat => OptimiseSettings::scenesplat(),
            PresetArg::GsplatMcmc => OptimiseSettings::gsplat_mcmc(),
            PresetArg::GsplatDefault => OptimiseSettings::gsplat_default(),
        };
        if let Some(steps) = self.steps {
            s = s.with_steps(steps);
        }
        if let Some(cap) = self.cap {
            set_cap(&mut s, cap as usize);
        }
        let reference = OptimiseSettings::scenesplat().depth;
        if let Some(weight) = self.depth_weight {
            s.depth = s.depth.or(reference).map(|term| DepthTerm { weight, ..term });
        }
        if let (Some(kind), Some(term)) = (self.depth_kind, &mut s.depth) {
            term.kind = match kind {
                DepthKindArg::Accumulated => DepthKind::Accumulated,
                DepthKindArg::Expected => DepthKind::Expected,
            };
        }
        // The original's 0 is for frames with depth. Without it nothing else removes what no view needs, and a few first
        // points end in fog between the views.
        if self.preset == PresetArg::Scenesplat && self.depth.is_none() {
            s.opacity_reg = OptimiseSettings::gsplat_mcmc().opacity_reg;
        }
        s.opacity_reg = self.opacity_reg.unwrap_or(s.opacity_reg);
        s.scale_reg = self.scale_reg.unwrap_or(s.scale_reg);
        s.initial.sh_degree = self.sh_degree.unwrap_or(s.initial.sh_degree);
        s.half_steps = self.half_steps.unwrap_or(s.half_steps);
        s.antialiased = self.antialiased.unwrap_or(s.antialiased);
        s.exposure = self.exposure == ExposureArg::On;
        s.background = self.background;
        s.seed = self.seed;
        s.ssim_border = self.ssim_border.map_or(s.ssim_border, |border| match border {
            BorderArg::Valid => SsimPadding::Valid,
            BorderArg::Reflect => SsimPadding::Reflect,
            BorderArg::Zero => SsimPadding::Zero,
        });
        s.order = self.order.map_or(s.order, |order| match order {
            OrderArg::Gsplat13 => StepOrder::Gsplat13,
            OrderArg::Gsplat16 => StepOrder::Gsplat16,
        });
        s
    }
}
