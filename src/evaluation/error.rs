use crate::inference::EncodeError;
use crate::labels::LabelError;
use scenesplat_metrics::MetricError;

/// Why scenes could not be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluationError {
    /// A label that stands for nothing.
    #[error("row {row} has label {label}, but there are only {known} names")]
    UnknownLabel {
        /// First such row, of the Gaussians or of the labeled points.
        row: usize,
        /// Its label.
        label: i32,
        /// Labels that are known.
        known: usize,
    },
    /// A scene that says nothing about the classes.
    #[error("no point has a label of a known class; nothing to evaluate")]
    NoLabels,
    /// Only Gaussians with a collected feature were to vote.
    #[error("the scene does not say which Gaussians have a feature (no valid_feat_mask)")]
    NoVoters,
    /// A row that cannot be spoiled.
    #[error("row {row} cannot be spoiled: choose one with a label, in a scene with two classes")]
    Fault {
        /// The row.
        row: usize,
    },
    /// The truth itself does not come out as it must.
    #[error(
        "evaluation refused: the oracle falls short of its analytic value, so no number of this \
         chain can be trusted"
    )]
    Oracle(#[source] MetricError),
    /// What went wrong with one of several scenes.
    #[error("{scene}")]
    Scene {
        /// Its name.
        scene: String,
        /// What went wrong.
        #[source]
        source: Box<EvaluationError>,
    },
    /// The network failed, or was stopped.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// Features and texts that do not fit together.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// Texts, labels or settings that cannot be used.
    #[error(transparent)]
    Metric(#[from] MetricError),
}
