//! From features to labels to numbers: zero-shot classification, neighbor votes, streaming
//! metrics, and a guard that proves the whole chain on known truth.
//!
//! Everything works on slices and plain structs. There is no tensor library, no file format and no
//! logging in here, so a number can be recomputed from arrays that any program has written.
//!
//! The chain of a zero-shot evaluation, each link usable alone:
//!
//! ```text
//! feature rows ──classify──► label per splat ──vote──► label per query point
//!                                                        ▼
//!                                  ConfusionMatrix ──► TesterReport, EvaluatorReport
//! ```
//!
//! # Conventions
//! - A **label** is an `i32`: `0..num_classes` is a class, `-1` ([`IGNORE`]) is none. Any other
//!   value is an error that names its row, never silently dropped: data sets that mark unlabeled
//!   rows with 255 map it first.
//! - Ties go to the smallest id, everywhere.
//! - Rows are processed in parallel, and no result depends on the number of threads.
//! - A number that cannot be computed (no labeled row, say) is `None`, never NaN.
//!
//! # Two definitions of mIoU
//! The original code computes its metrics in two places which disagree. Both are here under their
//! own names, [`TesterReport`] and [`EvaluatorReport`]; see there before comparing numbers.
//!
//! # Trusting a number
//! [`OracleCheck`] runs the chain on features whose right answer is known. An evaluation should run
//! it first and refuse to print anything if it fails.
//!
//! ```
//! use scenesplat_metrics::{
//!     ConfusionMatrix, FeatureSlice, Metric, TextRows, ZeroShotOptions, classify, vote,
//! };
//!
//! let text = TextRows::new(&[1.0, 0.0, 0.0, 1.0], 2)?; // two classes, two channels
//! let features = [0.9, 0.1, 0.8, 0.3, 0.2, 0.7]; // three splats
//! let found = classify(&FeatureSlice::new(&features, 2)?, text, &ZeroShotOptions::default())?;
//! assert_eq!(found.labels, [0, 0, 1]);
//!
//! let coord = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]];
//! let voted = vote(&coord, &found.labels, None, &coord, 3, text.num_classes())?;
//! assert_eq!(voted, [0, 0, 0]);
//!
//! let mut confusion = ConfusionMatrix::new(text.num_classes())?;
//! confusion.update((&voted, &[0, 0, 1]))?;
//! assert_eq!(confusion.tester_report().all_accuracy, Some(2.0 / 3.0));
//! # Ok::<(), scenesplat_metrics::MetricError>(())
//! ```

mod calibration;
pub mod collapse;
mod confusion_matrix;
mod error;
pub mod image;
mod metric;
mod oracle;
mod random_labels;
mod rank_correlation;
mod report;
mod rows;
mod scene_truth;
mod similarity;
mod sweep;
mod text_rows;
mod voting;
mod zero_shot;

pub use calibration::{ConfidenceBins, ProbabilityError, fit_temperature, probability_error};
pub use confusion_matrix::ConfusionMatrix;
pub use error::MetricError;
pub use metric::{Measurement, Metric};
pub use oracle::{Fault, OracleCheck, OracleFailure, OracleReport, OracleStage, OracleVote};
pub use random_labels::random_labels;
pub use rank_correlation::rank_correlation;
pub use report::{EvaluatorClass, EvaluatorReport, TesterClass, TesterReport};
pub use rows::{FeatureFn, FeatureRows, FeatureSlice};
pub use scene_truth::{SceneTruth, Scores, VoteRule};
pub use similarity::cosine_scores;
pub use text_rows::TextRows;
pub use voting::{MAX_VOTERS, keep_withheld, vote};
pub use zero_shot::{
    UnknownRule, ZeroShotLabels, ZeroShotOptions, class_probabilities, classify,
    sigmoid_threshold_to_cosine,
};

/// Exact nearest neighbors, re-exported from the kernels.
pub use scenesplat_kernels::neighbors::{KdTree, Neighbor};

/// The label of a row that has none: unlabeled truth, or a prediction that was withheld.
pub const IGNORE: i32 = -1;
