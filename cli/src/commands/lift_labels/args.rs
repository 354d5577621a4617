//! The flags of `lift-labels`.

use crate::commands::many::OneOrMany;
use crate::flags::{PreviewArgs, Shared, SourceArgs, parse_level, parse_positive, parse_up};
use crate::receipt::Receipt;
use clap::ValueEnum;
use clap::builder::TypedValueParser;
use scenesplat::datasets::effects::plan::EffectChoices;
use scenesplat::memory::Bytes;
use scenesplat::rasterizer::RasterSettings;
use scenesplat::rasterizer::lifting::{DepthTolerance, LiftSettings};
use scenesplat::scene::Up;
use std::path::PathBuf;

/// Lifts the segments of pictures onto the Gaussians: writes lang_feat.npy ([N, D], f16, one row per
/// Gaussian of the file, 0 without a label), valid_feat_mask.npy, confidence.npy, views.npy,
/// coverage.npy, preview.png (colored by the features) and a receipt. With --form index segment_index.npy ([N], u16) and
/// segment_features.npy ([K, D], f16) instead of the first two.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which scenes.
    #[command(flatten)]
    pub input: OneOrMany,
    /// cameras.json, transforms.json or a COLMAP folder; pinhole cameras in the frame of the scene.
    #[arg(long, value_name = "PATH")]
    pub cameras: PathBuf,
    /// Folder with FRAME_s.npy and FRAME_f.npy, or FRAME.png (gray, or with a palette: the index is the id) with
    /// feature tables; frames are named as the cameras' pictures.
    #[arg(long, value_name = "DIR")]
    pub segments: PathBuf,
    /// Folder with the photos, called as their cameras, of these cameras' size: says what they show of motion
    /// blur, light, noise and coverage. One render for each.
    #[arg(long, value_name = "DIR")]
    pub photos: Option<PathBuf>,
    /// auto lets photos that were taken in motion count less, if blur is found.
    #[arg(long, value_enum, default_value_t = FrameWeightsArg::DEFAULT, requires = "photos")]
    pub frame_weights: FrameWeightsArg,
    /// Granularities of the maps, up to 4, comma-separated; several write into folders level-N.
    #[arg(long, value_name = "0..3", value_delimiter = ',', default_value = "0",
          value_parser = parse_level)]
    pub level: Vec<usize>,
    /// What guarding means.
    #[arg(long, value_enum, default_value_t = RobustRuleArg::Median)]
    pub robust_rule: RobustRuleArg,
    /// Power of the weight a picture has: 1 counts pixels, 0 gives every picture one vote.
    #[arg(long, value_name = "GAMMA", default_value_t = 1.0)]
    pub view_exponent: f32,
    /// Least labeled weight of a Gaussian, in pixels over all pictures; less gets no feature.
    #[arg(long, value_name = "TAU", default_value_t = 0.0)]
    pub coverage: f32,
    /// Least part of a Gaussian's weight that lies in segments.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub labelled_share: f32,
    /// Leaves out pixels this near to the border of a segment.
    #[arg(long, value_name = "PIXELS", default_value_t = 0)]
    pub erode: u32,
    /// What is done about effects of the capture (docs/effects.md); here there is glass alone: where the Gaussians show
    /// panes, segments that name a pane label the pane alone, the others what is behind it. A name that nothing
    /// acts on can only be auto or off.
    #[arg(long, value_name = "glass=auto|on|off", default_value = "auto")]
    pub effect: EffectChoices,
    /// The receipt.json of an earlier run on this scene: what was decided there by itself stays until its measure is
    /// 5 % on the other side of its threshold.
    #[arg(long, value_name = "FILE.json")]
    pub effect_before: Option<PathBuf>,
    /// Keeps the weighted mean as it is instead of dividing it by its length.
    #[arg(long)]
    pub unnormalised: bool,
    /// Value of PNG pixels that belong to no segment; by default 255, or 65535 of 16 bits.
    #[arg(long, value_name = "VALUE")]
    pub no_segment: Option<u16>,
    /// What collect-labels can say, too.
    #[command(flatten)]
    pub lifting: LiftArgs,
}

/// How labels are lifted, wherever they come from.
#[derive(Debug, Clone, clap::Args)]
pub struct LiftArgs {
    /// Whether the scene is drawn so that opacities make up for the low-pass; as its file says if not
    /// given.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
          require_equals = true)]
    pub antialiased: Option<bool>,
    /// What is written. full: a feature for each Gaussian. index: segments are clustered once over all pictures; each Gaussian
    /// has the number of a cluster, two bytes, and each cluster a feature. Much smaller, of less quality, and not for training.
    #[arg(long, value_enum, default_value_t = FormArg::Full)]
    pub form: FormArg,
    /// Which pixels label a Gaussian.
    #[arg(long, value_enum, default_value_t = RuleArg::AlphaWeighted)]
    pub rule: RuleArg,
    /// Guards against wrong labels: always, never, or if the pictures contradict each other.
    #[arg(long, value_enum, default_value_t = RobustArg::Auto)]
    pub robust: RobustArg,
    /// Leaves out pixels whose depth is not the Gaussian's: `render` by the median depth of the scene
    /// itself (1 % and two standard deviations), or a folder of FRAME.npy, [H, W], or FRAME.png of 16 bits, 0 =
    /// unknown (3 % and 0.05 units; a picture without one has that of the scene); `auto` does what `render` does if
    /// up to 16 of the pictures, spread evenly, show in the first level that it leaves out wrong labels and keeps half
    /// of the weight (`off` with the rule centre-pixel).
    #[arg(
        long,
        value_name = "auto|off|render|DIR",
        default_value = "auto",
        value_parser = clap::builder::PathBufValueParser::new().map(DepthArg::from)
    )]
    pub depth: DepthArg,
    /// Steps per unit of the scene in 16-bit pictures of depth: 1000 for millimeters.
    #[arg(long, value_name = "STEPS", default_value_t = 1000.0, value_parser = parse_positive)]
    pub depth_scale: f64,
    /// Memory for weights that wait (8GB, 512MB; at least 49.2 kB); more wait in a file in the output
    /// folder.
    #[arg(long, value_name = "SIZE")]
    pub max_memory: Option<Bytes>,
    /// Which way is up; judged by the scene if not given.
    #[arg(long, value_name = "AXIS|X,Y,Z", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// The picture.
    #[command(flatten)]
    pub preview: PreviewArgs,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FormArg {
    /// A feature for each Gaussian.
    Full,
    /// A number for each Gaussian, a feature for each cluster of segments.
    Index,
}

/// Which pixels count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RuleArg {
    /// All that show it, by their blending weights.
    AlphaWeighted,
    /// The one at its center, as Occam's LGS, with the constants of gsplat 1.4.
    CentrePixel,
}

impl RuleArg {
    /// Notes the rule in the receipt.
    pub fn record(self, receipt: &Receipt) {
        let name = self.to_possible_value().map_or(String::new(), |v| v.get_name().to_owned());
        receipt.setting("rule", name, "which pixels label a Gaussian");
    }
}

/// What photos are worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FrameWeightsArg {
    /// By the detail that they lack along their motion, if they are blurred.
    Auto,
    /// All the same.
    Off,
}

impl FrameWeightsArg {
    /// What was measured to be worth it (docs/lifting.md).
    pub const DEFAULT: Self = Self::Auto;
}

/// When to guard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RobustArg {
    /// If measured disagreement is high.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// How to guard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RobustRuleArg {
    /// Geometric median.
    Median,
    /// The heaviest group of labels that are alike.
    HeaviestGroup,
}

impl Args {
    /// How weights are collected.
    pub(super) fn settings(
        &self,
        depth: Option<DepthTolerance>,
        antialiased: bool,
    ) -> LiftSettings {
        let base = match self.lifting.rule {
            RuleArg::AlphaWeighted => LiftSettings::default(),
            RuleArg::CentrePixel => LiftSettings::centre_pixel(),
        };
        LiftSettings {
            raster: RasterSettings { antialiased, ..base.raster },
            erosion: self.erode,
            depth,
            memory: self.lifting.max_memory.map_or(base.memory, |b| b.0),
            spill_folder: self.lifting.shared.out.clone(),
            ..base
        }
    }
}

/// Which depth has to agree.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DepthArg {
    /// That of the scene, if some pictures show that it helps.
    Auto,
    /// None.
    Off,
    /// That of the scene.
    Render,
    /// What was measured, one file per frame.
    Folder(PathBuf),
}

impl From<PathBuf> for DepthArg {
    fn from(path: PathBuf) -> Self {
        match path.to_str() {
            Some("auto") => Self::Auto,
            Some("off") => Self::Off,
            Some("render") => Self::Render,
            _ => Self::Folder(path),
        }
    }
}
