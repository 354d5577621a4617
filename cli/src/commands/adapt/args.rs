//! The flags of `adapt`.

use crate::flags::{Shared, SourceArgs, parse_part, parse_share, parse_unit, parse_up};
use scenesplat::AlignmentSettings;
use scenesplat::adaptation::AdaptSettings;
use scenesplat::network::Weights;
use scenesplat::scene::{LoadedScene, Up};
use std::path::PathBuf;

/// Teaches the network inside the program, or another one that is read with its vocabulary, the labels of one scene: a few
/// hundred steps, each of a part of the scene and of a synthetic room, so that nothing is forgotten. Leaves a model folder for
/// --weights (with --text vocabulary), and says what the network knew before and knows now.
///
/// Ctrl-C saves and stops; the same command goes on, with the bits that an uninterrupted run has.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// Its labels: the folder that collect-labels --teacher wrote for it, or a file with a class id for each Gaussian, such as
    /// labels.npy of segment (−1 or 255 for none).
    #[arg(long, value_name = "DIR|FILE.npy")]
    pub labels: PathBuf,
    /// Names of the ids of a file, one a line or as JSON; by default those of classes.json beside it, else ids are classes of
    /// the vocabulary. A name means the class of that name, or that its phrase surely means.
    #[arg(long, value_name = "FILE")]
    pub label_names: Option<PathBuf>,
    /// Which class of the vocabulary each of these names means (TOML or JSON); names without one are no labels.
    #[arg(long, value_name = "FILE", requires = "label_names")]
    pub class_map: Option<PathBuf>,
    /// The labels that the scene itself carries are the truth, by the same names: they are only compared with.
    #[arg(long)]
    pub truth: bool,
    /// The weights to start from: embedded, or a model folder whose texts are the vocabulary, such as one that adapt left.
    #[arg(long, value_name = "PATH|embedded", default_value = "embedded")]
    pub weights: Weights,
    /// Steps.
    #[arg(long, value_name = "N", default_value_t = AdaptSettings::default().steps, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub steps: u64,
    /// Seed of all that is random: order, augmentation, rooms, held-out labels.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Largest learning rate; parameters inside blocks have a tenth of it.
    #[arg(long, value_name = "RATE", default_value_t = AdaptSettings::default().lr, value_parser = crate::flags::parse_positive)]
    pub lr: f64,
    /// How far the weights go from those before to those trained: 1 is all the way, and forgets more.
    #[arg(long, value_name = "SHARE", default_value_t = AdaptSettings::default().share, value_parser = parse_part)]
    pub share: f64,
    /// Share of the labels that are not learned but compared with, in cubes of half a meter; below 1, 0 learns all.
    #[arg(long, value_name = "SHARE", default_value_t = AdaptSettings::default().held_out, value_parser = parse_share)]
    pub held_out: f64,
    /// Synthetic rooms that are labeled before and after; 0 for none.
    #[arg(long, value_name = "N", default_value_t = AdaptSettings::default().rooms)]
    pub rooms: usize,
    /// Gaussians of synthetic rooms, those to learn from, too; by their size if not given.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(100..=10_000_000))]
    pub room_gaussians: Option<u64>,
    /// Starts over where the folder holds an adaptation of something else, whose training is removed.
    #[arg(long)]
    pub anew: bool,
    /// Which way is up in the scene; judged by the scene if not given.
    #[arg(long, value_name = "AXIS|X,Y,Z", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// What one unit of the scene is: m, cm, mm, km or a number of meters; judged by the scene if not given.
    #[arg(long, value_name = "UNIT|METRES", value_parser = parse_unit)]
    pub unit: Option<f64>,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

impl Args {
    /// How the network learns.
    pub fn settings(&self) -> AdaptSettings {
        let Self { steps, seed, lr, held_out, share, rooms, .. } = *self;
        let room_gaussians = self.room_gaussians.and_then(|n| usize::try_from(n).ok());
        AdaptSettings { steps, seed, lr, held_out, share, rooms, room_gaussians }
    }

    /// What is known of how the scene lies.
    pub fn alignment(&self, loaded: &LoadedScene, square: bool) -> AlignmentSettings {
        AlignmentSettings {
            up: self.up,
            stated_up: loaded.stated_up,
            metres_per_unit: self.unit,
            floor: None,
            square,
            as_is: false,
        }
    }
}
