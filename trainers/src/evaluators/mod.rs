//! Scores of a network during training. Each evaluator owns its data.

mod distillation;
mod own_metric;
mod scene_evaluator;
mod scenes;
mod segmentation;
mod zero_shot;

pub use distillation::{Agreement, DistillationEvaluator, DistillationScores};
pub use scene_evaluator::SceneEvaluator;
pub use scenes::VOTE_K;
pub use scenesplat_metrics::Scores;
pub use segmentation::SegmentationEvaluator;
pub use zero_shot::ZeroShotEvaluator;
