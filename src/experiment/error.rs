use crate::network::NetworkError;
use crate::preview::PreviewError;
use crate::text::TextError;
use scenesplat_datasets::DataError;
use scenesplat_losses::LossError;
use scenesplat_metrics::MetricError;
use scenesplat_rooms::vocabulary::VocabularyError;
use scenesplat_scene::{SceneError, WriteError};
use scenesplat_trainers::TrainError;
use std::path::{Path, PathBuf};

/// Why an experiment cannot be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExperimentError {
    /// What went wrong with one part of it: a file, a table of the file, a checkpoint.
    #[error("{place}")]
    At {
        /// Which part.
        place: String,
        /// What went wrong there.
        #[source]
        source: Box<ExperimentError>,
    },
    /// A setting that cannot be used.
    #[error("{field}: {problem}")]
    Setting {
        /// Its name in the file.
        field: String,
        /// What is wrong, and what would be right.
        problem: String,
    },
    /// A file that is no TOML, or has unknown or wrong fields.
    #[error(transparent)]
    Syntax(#[from] toml::de::Error),
    /// A configuration that TOML cannot hold.
    #[error(transparent)]
    Toml(#[from] toml::ser::Error),
    /// A record that JSON cannot hold.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// A file or folder that cannot be reached.
    #[error("{}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A file that extends itself, maybe by way of others.
    #[error("{}: extends itself", path.display())]
    Circle {
        /// Which.
        path: PathBuf,
    },
    /// A folder with a run in it, which was not to be resumed.
    #[error("{}: holds a run already; resume it, or choose another folder", path.display())]
    HoldsRun {
        /// Which.
        path: PathBuf,
    },
    /// A folder without a run in it.
    #[error("{}: there is no checkpoint to resume from", path.display())]
    NothingToResume {
        /// Which.
        path: PathBuf,
    },
    /// A folder without a checkpoint to make a model of.
    #[error("{}: no checkpoint", path.display())]
    NoCheckpoint {
        /// Which.
        path: PathBuf,
    },
    /// A log without any value.
    #[error("{}: the log holds no value to draw", path.display())]
    EmptyLog {
        /// The picture that was to show it.
        path: PathBuf,
    },
    /// Classes of the labels that are not those of the texts or of the network.
    #[error("{0}")]
    Classes(String),
    /// Scenes or transforms that cannot be had.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Training that failed.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A network that cannot be had.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A network that cannot be built, or weights that do not fit it.
    #[error(transparent)]
    Model(#[from] candle_core::Error),
    /// A loss that cannot be built.
    #[error(transparent)]
    Loss(#[from] LossError),
    /// Class texts that cannot be read.
    #[error(transparent)]
    Text(#[from] TextError),
    /// Words that cannot be had.
    #[error(transparent)]
    Vocabulary(#[from] VocabularyError),
    /// Texts that cannot be compared with.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// Names of classes that cannot be used, or a file that cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A file that cannot be written, or a folder that another run writes to.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Curves that cannot be drawn.
    #[error(transparent)]
    Picture(#[from] PreviewError),
}

impl ExperimentError {
    /// A setting that cannot be used, because of `problem`.
    pub(super) fn setting(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Setting { field: field.into(), problem: problem.into() }
    }

    /// Turns an I/O error into one about `path`; made for `map_err`.
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}

/// Says where in an experiment something went wrong.
pub(super) trait Place<T> {
    /// The same result, with the place if it is an error.
    fn at(self, place: impl FnOnce() -> String) -> Result<T, ExperimentError>;
}

impl<T, E: Into<ExperimentError>> Place<T> for Result<T, E> {
    fn at(self, place: impl FnOnce() -> String) -> Result<T, ExperimentError> {
        self.map_err(|e| ExperimentError::At { place: place(), source: Box::new(e.into()) })
    }
}
