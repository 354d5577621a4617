//! Which captures and which scenes are worth keeping, and why.

mod coverage;
mod floaters;
mod frames;
mod quality;
mod table;

pub use coverage::{Coverage, coverage};
pub use floaters::{Floaters, floaters};
pub use frames::{FrameReport, JudgedFrame, judge_frames};
pub use quality::{Gates, Reason, SceneQuality};
pub use table::{QualityTable, markdown};
