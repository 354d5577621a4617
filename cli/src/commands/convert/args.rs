//! The flags of `convert`.

use crate::flags::{Running, SourceArgs, SpzFrameArg, parse_positive};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use scenesplat::scene::edit::{
    CropBox, EulerAngles, FrameChange, Offset, SampleSize, SceneEdit, UpSource,
};
use scenesplat::scene::formats::FORMATS;
use scenesplat::scene::{SceneFormat, StatedUp};
use std::path::PathBuf;

/// Writes a scene in another format, whole or in part; several scenes become one. Labels, scores,
/// instances and language codes go along. What the format cannot hold is said.
///
/// Changes are made in this order: floaters, crop, sample, harmonics, scale, frame, up and level,
/// rotation, translation.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes in any format: PLY, compressed PLY, .splat, .spz, SOG, .ksplat, glTF, USD, folder of .npy
    /// files. Of several, the rows follow each other in one scene.
    #[arg(required = true, num_args = 1..)]
    pub from: Vec<PathBuf>,
    /// The new file; its ending says the format: .ply, .compressed.ply, .spz, .splat, .glb, .usda, .usdz,
    /// .sog, meta.json (a SOG folder), lod-meta.json (a streamed SOG folder), or none (a folder of
    /// .npy files).
    pub to: PathBuf,
    /// The format, where the name does not say it.
    #[arg(long, value_name = "NAME", value_parser = format_parser())]
    pub format: Option<SceneFormat>,
    /// Removes Gaussians that `inspect` calls floaters (no neighbors where others have some) and
    /// giants (larger than the scene).
    #[arg(long)]
    pub remove_floaters: bool,
    /// Keeps the Gaussians with their center in this box, in the coordinates of the source.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub crop: Option<CropBox>,
    /// Keeps that many Gaussians, or that part, chosen by --seed.
    #[arg(long, value_name = "N|P%")]
    pub sample: Option<SampleSize>,
    /// Cuts spherical harmonics above this degree.
    #[arg(long, value_name = "0..4", value_parser = clap::value_parser!(u8).range(0..=4))]
    pub sh: Option<u8>,
    /// Multiplies positions and sizes: 0.001 for a scene in millimeters.
    #[arg(long, value_name = "FACTOR", value_parser = parse_positive, allow_hyphen_values = true)]
    pub scale: Option<f64>,
    /// Renames the axes: the directions of +x, +y, +z as letters of right/left, up/down,
    /// forward/back. FROM is RDF if not given, the frame of scenes in memory. SPZ, glTF and USD files
    /// are converted from and to the frame of their format: read, they refuse it as FROM; written, they refuse this.
    #[arg(long, value_name = "[FROM:]TO")]
    pub frame: Option<FrameChange>,
    /// Turns the scene so that this direction of it becomes +z: +x, -x, +y, -y, +z, -z, X,Y,Z, or auto for
    /// the one that `inspect` finds.
    #[arg(long, value_name = "AXIS|X,Y,Z|auto", value_parser = parse_up_source, allow_hyphen_values = true)]
    pub up: Option<UpSource>,
    /// Turns the scene so that its floor lies level at z = 0; which direction is up is found, or said
    /// by --up.
    #[arg(long)]
    pub level: bool,
    /// Turns the scene about the axes x, then y, then z, by degrees.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub rotate: Option<EulerAngles>,
    /// Moves the scene, after all turns.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub translate: Option<Offset>,
    /// Makes language codes of this many numbers from the scene's language features.
    #[arg(long, value_name = "K")]
    pub language_code: Option<usize>,
    /// Language features for --language-code, one row per row of the source, as `scenesplat
    /// features` writes them.
    #[arg(long, value_name = "FILE.npy", requires = "language_code")]
    pub features: Option<PathBuf>,
    /// How to read the source.
    #[command(flatten)]
    pub source: SourceArgs,
    /// What an SPZ file is written in: rub, as the format prescribes, or raw, as in a PLY file, which
    /// some programs expect.
    #[arg(long, value_enum, default_value_t = SpzFrameArg::Rub)]
    pub to_spz_frame: SpzFrameArg,
    /// Version of an SPZ file to write.
    #[arg(long, value_name = "2..4", default_value_t = 4, value_parser = clap::value_parser!(u8).range(2..=4))]
    pub spz_version: u8,
    /// Levels of detail of a streamed SOG folder (lod-meta.json) to write; each has a quarter of the
    /// Gaussians of the one before.
    #[arg(long, value_name = "1..8", default_value_t = 4, value_parser = clap::value_parser!(u8).range(1..=8))]
    pub lod_levels: u8,
    /// Replaces the target if it exists.
    #[arg(long)]
    pub overwrite: bool,
    /// Writes what was done as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Seed of --sample and of the codes.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
}

impl Args {
    /// What is done to a scene whose file says this about up.
    pub fn edit(&self, stated_up: StatedUp) -> SceneEdit {
        SceneEdit {
            crop: self.crop,
            sample: self.sample,
            sh_degree: self.sh,
            scale: self.scale,
            frame: self.frame,
            up: self.up,
            stated_up,
            level: self.level,
            rotate: self.rotate,
            translate: self.translate,
            seed: self.seed,
        }
    }
}

/// Names of the formats that can be written.
fn format_parser() -> impl TypedValueParser<Value = SceneFormat> {
    let writable = FORMATS.iter().filter(|row| row.is_writable());
    PossibleValuesParser::new(writable.map(|row| PossibleValue::new(row.name).help(row.about)))
        .try_map(|name| SceneFormat::from_name(&name).ok_or("no such format"))
}

fn parse_up_source(text: &str) -> Result<UpSource, String> {
    match text {
        "auto" => Ok(UpSource::Auto),
        axis => Ok(UpSource::Given(axis.parse()?)),
    }
}
