//! Why a front could not be measured or read.

use scenesplat::evaluation::EvaluationError;
use scenesplat::inference::EncodeError;
use scenesplat::input::InputError;
use scenesplat::labels::LabelError;
use scenesplat::outputs::OutputError;
use scenesplat_metrics::MetricError;
use scenesplat_scene::SceneError;
use scenesplat_scene::atomic_file::WriteError;
use std::path::PathBuf;

/// Why a front could not be measured, read or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ParetoError {
    /// A file could not be read or written.
    #[error("{}: {action}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        #[source]
        source: std::io::Error,
    },
    /// A grid that is no TOML of the form expected.
    #[error("{path}: {text}")]
    Grid {
        /// Which file.
        path: String,
        /// What is wrong with it.
        text: String,
    },
    /// A setting that cannot be used.
    #[error("{setting:?}: {text}")]
    Setting {
        /// The setting as it was written.
        setting: String,
        /// What is wrong with it.
        text: String,
    },
    /// A line that is no record.
    #[error("{}: line {line} is no record: {text}", path.display())]
    Record {
        /// Which file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        text: String,
    },
    /// Records that were made of something else.
    #[error(
        "{}: its records are of another {what} ({theirs}, here it is {ours}); records of different \
         {what}s do not compare: write into another folder, or take this one away", path.display()
    )]
    Foreign {
        /// Which file.
        path: PathBuf,
        /// What differs.
        what: &'static str,
        /// What the records say.
        theirs: String,
        /// What it is now.
        ours: String,
    },
    /// The same work gave other labels: a time of it means nothing.
    #[error("{scene}: repeat {repeat} gave other labels than the first run of the same setting")]
    NotRepeatable {
        /// Which scene.
        scene: String,
        /// Which repeat, from 1.
        repeat: usize,
    },
    /// The stages left too much of the time unexplained.
    #[error(
        "{setting}: the stages add up to {:.1} % of the time only; at least {:.0} % is needed",
        100.0 * coverage, 100.0 * least
    )]
    Stages {
        /// Which setting.
        setting: String,
        /// Share that the stages explain, 0..=1.
        coverage: f64,
        /// Least share that is accepted.
        least: f64,
    },
    /// A log of a training run that says nothing of quality and time.
    #[error("{}: {text}", path.display())]
    Training {
        /// Which file.
        path: PathBuf,
        /// What is missing.
        text: String,
    },
    /// Nothing was measured that a front could be made of.
    #[error("there is no measured setting with a {quality}: nothing to draw a front from")]
    Empty {
        /// Which figure is missing.
        quality: String,
    },
    /// A scene that could not be scored.
    #[error("{scene}")]
    Scene {
        /// Which scene.
        scene: String,
        /// Why.
        #[source]
        source: Box<ParetoError>,
    },
    /// A scene that cannot be read.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A network that failed.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// Labels that could not be made.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// A truth that cannot be scored.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
    /// Counts that do not go together.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// Arrays that could not be read or written.
    #[error(transparent)]
    Array(#[from] SceneError),
    /// Results that could not be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file that could not be put in its place.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// A picture that could not be written.
    #[error(transparent)]
    Picture(#[from] scenesplat::preview::PreviewError),
    /// A record that cannot be written as JSON.
    #[error("a record cannot be written as JSON")]
    Json(#[from] serde_json::Error),
}

impl ParetoError {
    /// Of an action on a file.
    pub(crate) fn io(
        path: &std::path::Path,
        action: &'static str,
    ) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}
