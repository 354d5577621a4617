//! What scores a network during training. Each owns its data.

mod distillation;
mod own_metric;
mod scenes;
mod segmentation;
mod zero_shot;

pub use distillation::{Agreement, DistillationEvaluator, DistillationScores};
pub use scenes::VOTE_K;
pub use scenesplat_metrics::Scores;
pub use segmentation::SegmentationEvaluator;
pub use zero_shot::ZeroShotEvaluator;
