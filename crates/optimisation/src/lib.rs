//! Scenes of 3D Gaussians from posed pictures, on a CPU.
//!
//! ```text
//! frames ─► Optimiser::step: project, sort, tiles, blend ─► L1 + SSIM + depth ─► backward ─► Adam ─► strategy
//! ```
//!
//! Each part is a function of slices and public: losses with their gradients ([`image_loss`],
//! [`depth_loss`](mod@depth_loss)), [`adam`], [`relocation`], [`noise`], [`initial`] Gaussians. The step is
//! [`Optimiser`], what it does is [`OptimiseSettings`], and [`score`] says what came of it.
//!
//! Results do not depend on the number of threads, and a run that is resumed ends with the bits of one
//! that was not interrupted: random numbers are functions of seed, step and row.
//!
//! Not for: poses (they are taken as given), lenses with distortion, pictures without poses.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "guards are written so that NaN fails them")]

pub mod adam;
pub mod background;
pub mod capture_folder;
pub mod checkpoint;
pub mod cost;
pub mod curation;
pub mod depth_loss;
pub mod error;
pub mod exposure;
pub mod exposure_drift;
pub mod frame;
pub mod fused_points;
pub mod image_loss;
pub mod initial;
pub mod model;
pub mod noise;
pub mod optimiser;
mod random;
pub mod relocation;
mod sampling;
pub mod score;
pub mod settings;
pub mod strategy;
pub mod surfels;
pub mod view_points;
mod window;

pub use adam::{Adam, AdamSettings, Moments, Rates, Regularisers};
pub use background::Background;
pub use capture_folder::{Capture, CaptureFolder};
pub use checkpoint::newest_checkpoint;
pub use cost::StepCost;
pub use error::OptimiseError;
pub use exposure::Exposure;
pub use exposure_drift::{ExposureDrift, exposure_drift};
pub use frame::{Colors, TrainingFrame};
pub use fused_points::{fused_points, lifted};
pub use image_loss::{ImageComparison, ImageLoss, ImageWeights, SsimPadding};
pub use model::{Model, Stored};
pub use optimiser::{Optimiser, StepReport};
pub use score::{FrameScore, MeanScore, score_frame};
pub use settings::{
    BaseRates, DepthKind, DepthTerm, OptimiseSettings, SceneScale, StepOrder, Strategy,
};
pub use strategy::{DefaultSettings, McmcSettings, Refined};
pub use view_points::{Focus, focus_of, points_in_view, thin};
