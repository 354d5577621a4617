//! Flags that commands share.

use crate::error::WrongUse;
use anyhow::Result;
use clap::ValueEnum;
use scenesplat::inspect::LengthUnit;
use scenesplat::kernels::Precision;
use scenesplat::kernels::grid_sample::{MAX_GRID_SIZE, is_grid_size};
use scenesplat::memory::Bytes;
use scenesplat::models::DeviceChoice;
use scenesplat::models::convert::{Branch, ConvLayout};
use scenesplat::network::{NetworkChoice, Weights};
use scenesplat::preview::{PreviewSettings, Theme};
use scenesplat::scene::{LoadedScene, Policy, ReadOptions, SpzFrame, Up};
use scenesplat::{AlignmentSettings, Setting};
use std::path::PathBuf;

/// Threads and progress.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Running {
    /// Threads; all cores by default. Results do not depend on it.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Says nothing about the progress, and prints no receipt; results and warnings are still printed.
    #[arg(long)]
    pub quiet: bool,
}

/// Flags of commands that write into a folder.
#[derive(Debug, Clone, clap::Args)]
pub struct Shared {
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
    /// Folder for the results.
    #[arg(long, value_name = "DIR", default_value = "scenesplat-out")]
    pub out: PathBuf,
    /// Also writes what was done and what it cost as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub receipt: Option<PathBuf>,
}

/// How preview.png is drawn.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct PreviewArgs {
    /// Width and height of each view of preview.png, pixels, 64 to 4096.
    #[arg(long, value_name = "PIXELS", default_value_t = 720, value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub preview_size: u32,
    /// Colors around the scene in preview.png: dark, or light, for paper.
    #[arg(
        long,
        value_name = "dark|light",
        value_enum,
        default_value_t,
        hide_possible_values = true
    )]
    pub preview_theme: PreviewTheme,
}

/// Colors of preview.png.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum PreviewTheme {
    /// Light letters on a dark ground.
    #[default]
    Dark,
    /// Dark letters on white.
    Light,
}

impl PreviewArgs {
    /// A picture with that first line, that way up.
    pub fn settings(self, title: String, warnings: Vec<String>, up: Up) -> PreviewSettings {
        let view_size = self.preview_size;
        let theme = match self.preview_theme {
            PreviewTheme::Dark => Theme::Dark,
            PreviewTheme::Light => Theme::Light,
        };
        PreviewSettings { title, warnings, up, view_size, theme, ..PreviewSettings::default() }
    }
}

/// Which network.
#[derive(Debug, Clone, clap::Args)]
pub struct NetworkArgs {
    /// Network: language, semseg, ssl, tiny, litept-s (-s-decoder, -b, -l) or a .toml file; from
    /// the weights' folder if it has one.
    #[arg(long, value_name = "NAME|FILE")]
    pub config: Option<NetworkChoice>,
    /// Checkpoint, model folder, seeded:N for values without meaning, or embedded, the small network
    /// inside the program, which is the default if no --config is given either.
    #[arg(long, value_name = "PATH|seeded:N|embedded")]
    pub weights: Option<Weights>,
}

/// Flags of commands that read a scene.
#[derive(Debug, Clone, clap::Args)]
pub struct SourceArgs {
    /// Which labels of a scene to read: a PLY property or the stem of a .npy file.
    #[arg(long, value_name = "NAME")]
    pub segment_name: Option<String>,
    /// Refuses files with values that would be repaired.
    #[arg(long)]
    pub strict: bool,
    /// What an SPZ file that is read is taken to be in: rub, as the format prescribes, or raw, as in
    /// the PLY file it was made from.
    #[arg(long, value_enum, default_value_t = SpzFrameArg::Rub)]
    pub spz_frame: SpzFrameArg,
    /// Level of detail of a streamed scene, 0 = finest.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub lod: usize,
}

impl Shared {
    /// Of a command that writes into a folder and has no other of these flags.
    pub fn into_folder(out: &std::path::Path, quiet: bool) -> Self {
        let running = Running { quiet, ..Running::default() };
        Self { running, out: out.to_owned(), receipt: None }
    }
}

impl NetworkArgs {
    /// The weights, given or by default.
    ///
    /// # Errors
    /// If a configuration is given without weights.
    pub fn weights(&self) -> Result<Weights> {
        match (&self.weights, &self.config) {
            (Some(weights), _) => Ok(weights.clone()),
            (None, None) => Ok(Weights::Embedded),
            (None, Some(_)) => Err(WrongUse(
                "--config (or a setting's net) needs --weights: give a checkpoint, or seeded:0 to try the program \
                 without one (its labels mean nothing then); without both, the small network inside \
                 the program is used"
                    .to_owned(),
            )
            .into()),
        }
    }

    /// Whether the network inside the program is used, whose texts are its own vocabulary.
    pub fn is_embedded(&self) -> bool {
        matches!((&self.weights, &self.config), (Some(Weights::Embedded), _) | (None, None))
    }
}

impl SourceArgs {
    /// What to read; nothing but what a network needs.
    pub fn options(&self) -> ReadOptions {
        ReadOptions {
            policy: if self.strict { Policy::Strict } else { Policy::Repair },
            segment: self.segment_name.clone(),
            lang_feat: false,
            sh_rest: false,
            spz_frame: self.spz_frame.into(),
            extra: false,
            lod: self.lod,
        }
    }
}

/// Frames of SPZ files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SpzFrameArg {
    /// Right, up, back.
    Rub,
    /// As in the PLY file.
    Raw,
}

impl From<SpzFrameArg> for SpzFrame {
    fn from(frame: SpzFrameArg) -> Self {
        match frame {
            SpzFrameArg::Rub => Self::Rub,
            SpzFrameArg::Raw => Self::Raw,
        }
    }
}

/// Flags of commands that run a network over a scene.
#[derive(Debug, Clone, clap::Args)]
pub struct Inference {
    /// Which network.
    #[command(flatten)]
    pub network: NetworkArgs,
    /// Where the network computes: cpu; cuda:0 (or another number) or gpu (the best graphics processor of any maker;
    /// gpu:1, gpu:NAME for another), if the program was built for it (docs/devices.md); auto, which is the first of these
    /// that there is, else cpu.
    #[arg(long, value_name = "DEVICE", default_value_t = DeviceChoice::Cpu)]
    pub device: DeviceChoice,
    /// Seed of everything random (nothing is, unless asked for).
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// The original's steps (a sampling at half the voxel size, several passes, average) instead of
    /// one pass.
    #[arg(long)]
    pub exact: bool,
    /// Form of the numbers that are multiplied: f32; split (f32 as two bf16, where the CPU has bf16
    /// tiles); bf16 (rounded to 8 bits; about twice as fast with AVX512-BF16); int8 (layers of 64
    /// channels and more as 8-bit integers with scales; fast with AVX512-VNNI or AVX-VNNI); f16 (rows and weights in 16
    /// bits, for --device gpu alone). f32 if not given.
    #[arg(long, value_name = "f32|split|bf16|int8|f16", value_parser = Precision::of_any_device)]
    pub precision: Option<Precision>,
    /// Voxel size, meters; by default the one that the network was trained at.
    #[arg(long, value_name = "M", value_parser = parse_grid_size, allow_hyphen_values = true)]
    pub grid_size: Option<f64>,
    /// All that trades accuracy for time in one string, such as voxel=0.04,patch=256,k=8: voxel, net,
    /// precision, patch, stage, rank, passes, tta, anchor, codes, k (docs/settings.md).
    #[arg(long, value_name = "KEY=VALUE,...", value_parser = parse_setting)]
    pub setting: Option<Setting>,
    /// The parts of the setting and of the flags that say the same, see [`Self::settled`].
    #[arg(skip)]
    pub effective: Setting,
    /// Limit for the whole process (8GB, 512MB); larger scenes go through overlapping tiles.
    #[arg(long, value_name = "SIZE")]
    pub max_memory: Option<Bytes>,
    /// Context around a tile, voxels.
    #[arg(long, value_name = "N", default_value_t = 50)]
    pub halo: u32,
    /// Shuffles curve orders as the original does, but with --seed.
    #[arg(long)]
    pub shuffle_orders: bool,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Loads what fits of a checkpoint that does not fit the network.
    #[arg(long)]
    pub partial_weights: bool,
    /// Half of a self-supervised checkpoint.
    #[arg(long, value_enum, default_value_t = BranchArg::Teacher)]
    pub branch: BranchArg,
    /// Layout of sparse convolutions in the checkpoint.
    #[arg(long, value_enum, default_value_t = ConvLayoutArg::Spconv2)]
    pub conv_layout: ConvLayoutArg,
    /// Which language head, of a checkpoint with several (projection.NAME.weight).
    #[arg(long, value_name = "NAME")]
    pub head: Option<String>,
    /// Which way is up in the scene, for pictures and for the network, which reads a turned copy of a
    /// scene that lies otherwise than +z; judged by the scene if not given.
    #[arg(long, value_name = "AXIS|X,Y,Z", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// What one unit of the scene is: m, cm, mm, km or a number of meters. The network reads a scaled
    /// copy; judged by the scene if not given.
    #[arg(long, value_name = "UNIT|METRES", value_parser = parse_unit, allow_hyphen_values = true)]
    pub unit: Option<f64>,
    /// Height of the floor along up, in the scene's unit (where the floor is out of level, once it is
    /// level); for networks that read heights, such as the one inside the program. Looked for if not given.
    #[arg(long, value_name = "HEIGHT", value_parser = parse_height, allow_hyphen_values = true)]
    pub floor: Option<f64>,
    /// The network reads the scene as it is: neither turned nor scaled.
    #[arg(long, visible_alias = "no-align", conflicts_with = "unit")]
    pub as_is: bool,
}

impl Inference {
    /// What is known of a scene. `square`: whether the network knows rooms along the axes.
    pub fn alignment(&self, loaded: &LoadedScene, square: bool) -> AlignmentSettings {
        AlignmentSettings {
            up: self.up,
            stated_up: loaded.stated_up,
            metres_per_unit: self.unit,
            floor: self.floor,
            square,
            as_is: self.as_is,
        }
    }

    /// A flag that was given and only means something to a network.
    pub fn network_flag(&self) -> Option<&'static str> {
        self.network_flags().next()
    }

    /// As [`network_flag`](Self::network_flag) for a command that has places and sizes of things without a
    /// network, too: unit and floor are for these as well.
    pub fn only_network_flag(&self) -> Option<&'static str> {
        self.network_flags().find(|flag| !["--unit", "--floor", "--as-is"].contains(flag))
    }

    fn network_flags(&self) -> impl Iterator<Item = &'static str> {
        let flags = [
            (self.network_part().is_some(), "--setting"),
            (self.device != DeviceChoice::Cpu, "--device"),
            (self.exact, "--exact"),
            (self.precision.is_some(), "--precision"),
            (self.grid_size.is_some(), "--grid-size"),
            (self.max_memory.is_some(), "--max-memory"),
            (self.halo != 50, "--halo"),
            (self.shuffle_orders, "--shuffle-orders"),
            (self.partial_weights, "--partial-weights"),
            (self.unit.is_some(), "--unit"),
            (self.floor.is_some(), "--floor"),
            (self.as_is, "--as-is"),
        ];
        flags.into_iter().filter(|(given, _)| *given).map(|(_, name)| name)
    }
}

/// Half of a self-supervised checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum BranchArg {
    /// The averaged network.
    Teacher,
    /// The trained network.
    Student,
}

/// Layout of sparse convolutions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ConvLayoutArg {
    /// `[out, kx, ky, kz, in]`
    Spconv2,
    /// `[kx, ky, kz, in, out]`
    Spconv1,
}

impl From<BranchArg> for Branch {
    fn from(branch: BranchArg) -> Self {
        match branch {
            BranchArg::Teacher => Self::Teacher,
            BranchArg::Student => Self::Student,
        }
    }
}

impl From<ConvLayoutArg> for ConvLayout {
    fn from(layout: ConvLayoutArg) -> Self {
        match layout {
            ConvLayoutArg::Spconv2 => Self::OutKernelIn,
            ConvLayoutArg::Spconv1 => Self::KernelInOut,
        }
    }
}

/// Reads a setting that names at least one part.
pub fn parse_setting(text: &str) -> Result<Setting, String> {
    match text.parse::<Setting>() {
        Ok(setting) if setting.is_empty() => {
            Err(format!("no part is named; write KEY=VALUE, of {}", Setting::KEYS.join(", ")))
        }
        Ok(setting) => Ok(setting),
        Err(error) => Err(error.to_string()),
    }
}

/// Reads a number above 0.
pub fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err(format!("{text:?}: a number above 0 is expected")),
    }
}

/// Reads a share that is not all.
pub fn parse_share(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|share| (0.0..1.0).contains(share));
    share.ok_or_else(|| format!("{text:?}: a share is expected, 0 to below 1, such as 0.2"))
}

/// Reads a share that is not nothing.
pub fn parse_part(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|share| *share > 0.0 && *share <= 1.0);
    share.ok_or_else(|| format!("{text:?}: a share is expected, above 0 to 1, such as 0.5"))
}

/// Reads the size of voxels, meters.
pub fn parse_grid_size(text: &str) -> Result<f64, String> {
    let size = text.parse().ok().filter(|size| is_grid_size(*size));
    size.ok_or_else(|| format!("{text:?}: meters above 0, at most {MAX_GRID_SIZE}"))
}

/// Reads the number of a granularity.
pub fn parse_level(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(level @ 0..=3) => Ok(level),
        _ => Err(format!("{text:?}: levels are 0 to 3")),
    }
}

/// Reads the name of an axis, or a direction.
pub fn parse_up(text: &str) -> Result<Up, String> {
    text.parse()
}

/// Reads a height.
pub fn parse_height(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(height) if height.is_finite() => Ok(height),
        _ => Err(format!("{text:?}: a height is expected, such as -0.4")),
    }
}

/// Reads a unit of length, in meters.
pub fn parse_unit(text: &str) -> Result<f64, String> {
    let named = LengthUnit::ALL.into_iter().find(|unit| unit.symbol() == text);
    named
        .map(LengthUnit::metres)
        .or_else(|| text.parse().ok().filter(|m: &f64| m.is_finite() && *m > 0.0))
        .ok_or_else(|| {
            format!("{text:?} is no unit; write mm, cm, m, km or meters, such as 0.3048")
        })
}
