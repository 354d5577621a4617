use crate::network::NetworkError;
use scenesplat_datasets::DataError;
use scenesplat_metrics::MetricError;
use scenesplat_trainers::TrainError;
use std::path::PathBuf;

/// Why there is no probe.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProbeError {
    /// A setting outside its range.
    #[error("{setting}: {value} is not allowed, expected {expected}")]
    Setting {
        /// Which.
        setting: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// A folder that cannot be read.
    #[error("{}: cannot be read", path.display())]
    Folder {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A set of objects without some to learn from, or some to score.
    #[error(
        "{}: has no objects in CLASS/{part}/FILE or {part}/CLASS/FILE; a set of objects has train and test, with a folder a \
         class",
        root.display()
    )]
    NoObjects {
        /// The folder.
        root: PathBuf,
        /// `train` or `test`.
        part: &'static str,
    },
    /// Too few scenes to learn from some and score others.
    #[error("{scenes} scenes: a probe learns from some and is scored on others; give two or more")]
    TooFewScenes {
        /// How many there are.
        scenes: usize,
    },
    /// Scenes without labels.
    #[error("none of the scenes has a label: a probe learns from labels and is scored by them")]
    NoLabels,
    /// A channel that is not finite.
    #[error("scene {id}: channel {channel} of row {row} is {value}")]
    NotFinite {
        /// Which scene.
        id: String,
        /// Row of the network.
        row: usize,
        /// Its channel.
        channel: usize,
        /// Its value.
        value: f32,
    },
    /// Someone asked to stop.
    #[error("interrupted")]
    Stopped,
    /// A network that no decoder can stand on.
    #[error("model.architecture: a decoder stands on point_transformer_v3; this is {architecture}")]
    NoDecoder {
        /// What it is.
        architecture: &'static str,
    },
    /// Scenes that cannot be had.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A network that cannot be had.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A network that cannot be run.
    #[error(transparent)]
    Model(#[from] candle_core::Error),
    /// A probe that cannot be trained.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// Labels that cannot be scored.
    #[error(transparent)]
    Metric(#[from] MetricError),
}
