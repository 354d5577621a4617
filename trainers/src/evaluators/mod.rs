//! What scores a network during training. Each owns its data.

mod scenes;
mod segmentation;
mod zero_shot;

pub use segmentation::SegmentationEvaluator;
pub use zero_shot::ZeroShotEvaluator;
