//! Labels of pictures onto Gaussians, without optimisation.
//!
//! A picture is cut into segments, each with one feature. A Gaussian's feature is the mean of the
//! features of the pixels that show it, weighted by how much: `F = Σ w f / Σ w` with the blending
//! weight `w = α T`. Because `f` is constant on a segment, the pixel loop only sums *one number per
//! Gaussian and segment*, whatever the width of the features:
//!
//! ```text
//! per picture:  blend ─► W[Gaussian, segment] = Σ α T over the segment's pixels    (WeightSpool)
//! once:         F[Gaussian] = Σ W · feature / Σ W, or a rule that bears wrong labels (finalise_block)
//! ```
//!
//! [`Lifter`] does both, for up to four granularities of segments in one pass over the pixels.
//! Everything is in memory up to a budget; beyond it weights wait in a file. Results depend neither on
//! the budget nor on the number of threads. Gaussians keep their order; one without a label has a row
//! of zeros.
//!
//! [`Lifter::indexed`] gives the same labels in two bytes a Gaussian: each has the number of a cluster of segments, and each
//! cluster has a feature.
//!
//! Where a scene has [`Panes`] of glass, what names a pane and what names what is behind it are kept apart.
//!
//! [`fuse_crops`] makes the feature of a segment from three crops of a picture.
//!
//! Not for: making segments or features (see [`crate::segments`] for how they come in).

mod aggregate;
mod alpha_weighted;
mod centre_pixel;
mod depth_probe;
mod disagreement;
mod error;
mod finalise;
mod fusion;
mod index_form;
mod lifter;
mod panes;
mod segment_map;
mod spool;
mod tables;
mod tile_segments;
mod vector;
mod view_weights;

pub use aggregate::Aggregate;
pub use depth_probe::{DepthEffect, DepthProbe};
pub use disagreement::Disagreement;
pub use error::LiftError;
pub use finalise::{BlockFeatures, FinaliseSettings, finalise_block};
pub use fusion::{FrameWeight, FusedFeatures, fuse_crops};
pub use index_form::{IndexSettings, IndexedLabels, MAX_CLUSTERS, NO_CLUSTER};
pub use lifter::{LabelledPicture, LiftSettings, Lifter, PictureReport, Robust};
pub use panes::Panes;
pub use segment_map::{NO_SEGMENT, SegmentMap};
pub use spool::{BlockWeights, SegmentWeight, WeightSpool};
pub use tables::SegmentTables;
pub use view_weights::{DepthTolerance, LabelledView, LiftRule, ViewWeights, view_weights};
