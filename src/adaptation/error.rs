use crate::experiment::ExperimentError;
use crate::inference::EncodeError;
use crate::labels::LabelError;
use crate::network::NetworkError;
use crate::taught::TaughtError;
use scenesplat_metrics::MetricError;
use scenesplat_rooms::RoomError;
use scenesplat_rooms::vocabulary::VocabularyError;
use scenesplat_scene::{SceneError, WriteError, printable};
use scenesplat_text::PhraseError;
use std::path::PathBuf;

/// Why a network cannot learn from a scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AdaptError {
    /// Labels that cannot be used.
    #[error("{}: {problem} ({help})", printable(path))]
    Labels {
        /// Which file or folder.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What would be right.
        help: String,
    },
    /// A network that gives no language features of the built-in vocabulary.
    #[error("{0}")]
    Network(String),
    /// What a teacher saw cannot be read.
    #[error(transparent)]
    Taught(#[from] TaughtError),
    /// The training failed, or what it needs does not fit together.
    #[error(transparent)]
    Experiment(Box<ExperimentError>),
    /// A network that cannot be loaded.
    #[error(transparent)]
    Weights(#[from] NetworkError),
    /// A network that cannot read a scene, or was stopped.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// Labels that cannot be made of features.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// Figures that cannot be counted.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// Rooms that cannot be made.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// A width that no vocabulary has.
    #[error(transparent)]
    Vocabulary(#[from] VocabularyError),
    /// The phrase table inside the program is damaged.
    #[error(transparent)]
    Phrases(#[from] PhraseError),
    /// A file that cannot be read, or a scene that cannot be written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A file that cannot be put in place.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// A file that cannot be read or written.
    #[error("{}", printable(path))]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

impl From<ExperimentError> for AdaptError {
    fn from(error: ExperimentError) -> Self {
        Self::Experiment(Box::new(error))
    }
}
