//! Gradients of a picture with respect to the Gaussians in it.
//!
//! ```text
//! trace ─► Trace { picture, projection, tile lists, last Gaussian per pixel }
//! backward: pixels (per tile, back to front) ─► one record per (tile, Gaussian)
//!           ─► sums per Gaussian, in the order of the tiles ─► projection, harmonics ─► Gradients
//! ```
//!
//! No thread adds to another's sums, so gradients do not depend on the number of threads. They are
//! those of the picture with its decisions held fixed: which Gaussians take part at a pixel, their
//! order and where a pixel stops have no derivative.

mod features;
mod gradients;
mod harmonics;
mod pixels;
mod projection;
mod reduce;
mod rows;
mod trace;
mod upstream;
mod workspace;

pub use gradients::{GradMask, Gradients};
pub use trace::{Trace, TraceRequest, trace};
pub use upstream::{BackwardError, FeatureGradient, Upstream};
pub use workspace::Workspace;

use crate::{Gaussians, RasterSettings, View};

/// Gradients of `Σ upstream · picture` with respect to the Gaussians that the picture was traced
/// from.
///
/// `gaussians`, `view` and `settings` are those that [`trace()`] was given. Gaussians that are not in
/// the picture have gradient 0; so have groups that `mask` leaves out, and what they alone need is
/// not computed.
///
/// # Errors
/// An upstream gradient of another size or with a value that is not finite, one for a picture that
/// was not traced, a trace of other Gaussians.
pub fn backward(
    gaussians: &Gaussians,
    view: &View,
    settings: &RasterSettings,
    trace: &Trace,
    upstream: &Upstream<'_>,
    mask: GradMask,
) -> Result<Gradients, BackwardError> {
    let mut out = Gradients::zeros(gaussians, upstream.feature_dim());
    Workspace::new().backward(gaussians, view, settings, trace, upstream, mask, &mut out)?;
    Ok(out)
}
