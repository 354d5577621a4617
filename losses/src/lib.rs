//! Losses for language pretraining, distillation, semantic segmentation and self-supervision, on candle
//! tensors.
//!
//! | loss | for | formula |
//! |---|---|---|
//! | [`CosineLoss`], [`L2Loss`], [`SmoothL1Loss`] | features with target features | [`cosine`], [`l2`], [`smooth_l1`] |
//! | [`AggregatedContrastive`] | features with classes | [`aggregated_contrastive`] |
//! | [`TextClassification`] | features with labels, by the texts of the classes | cross entropy and Lovász of cosines |
//! | [`TextDistillation`] | features with target features, by the texts of the classes | divergence of softmaxes of cosines |
//! | [`CrossEntropy`], [`LovaszSoftmax`] | logits with labels | [`cross_entropy`], [`lovasz_softmax`] |
//! | [`self_supervised`] | views and masked Gaussians with a teacher's | a table of its own |
//!
//! Each is a free function with its settings in a struct that implements [`Loss`]. An [`Objective`] is
//! their weighted sum and gives each term for the log; [`LossConfig`] is their form in a file.
//!
//! # Numbers
//! Predictions and targets may be f32, f64, bf16 or f16. They are read in that type, computed with
//! in f32 (f64 stays f64) and added up in f64; the loss is f32 (f64 for f64), its gradient has the
//! type of the predictions. Gradients of means over 10⁵ rows are near 10⁻⁸: f16 cannot hold them
//! without a scaled loss, bf16 can; beyond its largest number f16 saturates. Results have the same bits for any number of threads.
//!
//! # Hard input
//! | input | what happens |
//! |---|---|
//! | no row counts (none valid, all ignored, N = 0) | the term is off: `None`, never NaN or an empty tensor |
//! | zero rows | cosine 1, gradient by the floor of the norm, as PyTorch |
//! | one class | contrastive exactly 0 |
//! | equal rows, equal logits | finite, ties in the order of rows |
//! | huge or tiny finite values | no overflow on the way; a loss beyond f32 is infinite, its gradient is right |
//! | NaN, ±∞ in a row that counts | an error that names row and channel |
//! | NaN, ±∞ in a row that does not count | not read; its gradient is 0 |

mod config;
mod contrastive;
mod cosine;
mod cross_entropy;
mod error;
mod l2;
mod loss;
mod lovasz;
mod objective;
mod rows;
mod scalar_op;
pub mod self_supervised;
mod smooth_l1;
mod text_classification;
mod text_distillation;
mod values;
mod vector;

pub use config::{
    ClassSourceConfig, ContrastiveConfig, CrossEntropyConfig, LossConfig, LovaszConfig,
    RowLossConfig, SmoothL1Config, TextClassificationConfig, TextDistillationConfig,
    build_objective,
};
pub use contrastive::{
    AggregatedContrastive, ClassHalves, ClassSource, TermSchedule, TextColumns,
    aggregated_contrastive, argmax_labels, pseudo_labels, split_classes,
};
pub use cosine::{CosineLoss, cosine};
pub use cross_entropy::{CrossEntropy, cross_entropy};
pub use error::LossError;
pub use l2::{L2Loss, l2};
pub use loss::{IGNORE, Loss, LossInput};
pub use lovasz::{LovaszSoftmax, lovasz_softmax};
pub use objective::{Objective, ObjectiveOutput, OffTerm, Term};
pub use rows::Reduction;
pub use smooth_l1::{SmoothL1Loss, smooth_l1};
pub use text_classification::TextClassification;
pub use text_distillation::TextDistillation;
