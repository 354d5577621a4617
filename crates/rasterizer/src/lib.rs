//! Pictures of 3D Gaussians on a CPU, their gradients, and labels lifted from pictures onto them.
//!
//! No tensor library, no graphics device. The forward pass is five steps, each public:
//!
//! ```text
//! Gaussians ─ project ─► Projected ─ tile_lists ─► TileLists ─ blend(visitor) ─► one output per tile
//!                            └ colors ─► [f32; 3] per visible Gaussian ─┘
//! ```
//!
//! [`render()`] runs them all. The pixel loop exists once, in [`mod@blend`], and is compiled anew for each
//! [`TileVisitor`]: color, depth, features, weights. What is not asked for is
//! not in the loop.
//!
//! Results do not depend on the number of threads; they may differ in the last bits between
//! instruction sets. Threads come from rayon's current pool.
//!
//! Not for: lenses with distortion (undistort the pictures first), Gaussians rendered by ray
//! tracing, more than 2³² − 2 Gaussians.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "guards are written so that NaN fails them")]

pub mod backward;
pub mod blend;
mod canvas;
mod depth_order;
pub mod error;
pub mod gaussians;
mod lanes;
pub mod lifting;
pub mod plan;
pub mod profile;
pub mod projection;
pub mod render;
pub mod segments;
pub mod settings;
pub mod spherical_harmonics;
mod splats;
pub mod tiles;
pub mod view;
mod visitors;

pub use blend::{SPAN, Span, TILE, TileRect, TileVisitor, blend};
pub use error::RasterError;
pub use gaussians::Gaussians;
pub use plan::{Bound, Decision, NeededGradients, PlanError, PlanRequest, Prepared, RenderPlan};
pub use profile::{HarmonicsProfile, SceneProfile};
pub use projection::{CullCounts, Projected, project};
pub use render::{
    Contributions, DepthRequest, RenderRequest, Rendered, WorkCounters, render, render_features,
};
pub use settings::{ExtentRule, RasterSettings};
pub use spherical_harmonics::colors;
pub use tiles::{TileLists, tile_lists};
pub use view::{MAX_PIXELS, MAX_SIDE, View};
