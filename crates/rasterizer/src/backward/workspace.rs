//! Memory of traces and backward passes, used again: what a step of optimisation is run with.

use super::reduce::PairsOfRow;
use super::rows::{Pass, PixelMemory, Sums};
use super::trace::draw;
use super::{BackwardError, GradMask, Gradients, Trace, TraceRequest, Upstream};
use crate::projection::project_into;
use crate::spherical_harmonics::colors_into;
use crate::splats::Splat;
use crate::tiles::{TileMemory, tile_lists_into};
use crate::{Gaussians, Projected, RasterError, RasterSettings, View};

/// [`trace()`](super::trace()) and [`backward`](super::backward()) without reserving memory: after the first few
/// views what they need is there, and results are the same bits.
///
/// It holds about 300 bytes per Gaussian and 60 per place in a list of a tile, and gives none back
/// before it is dropped.
#[derive(Debug, Default)]
pub struct Workspace {
    parts: Vec<Projected>,
    tiles: TileMemory,
    plain: Vec<Splat<0>>,
    pub(crate) backward: BackwardMemory,
}

/// What the backward pass writes and reads.
#[derive(Debug, Default)]
pub(crate) struct BackwardMemory {
    pub(crate) pairs: PairsOfRow,
    pub(crate) rows: Vec<Sums>,
    pub(crate) pixels: PixelMemory,
}

impl Workspace {
    /// Nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// [`trace()`](super::trace()) into a trace whose memory is used again, whatever it was of.
    ///
    /// # Errors
    /// As [`trace()`](super::trace()); `out` is then not to be used for a backward pass.
    pub fn trace(
        &mut self,
        gaussians: &Gaussians,
        view: &View,
        settings: &RasterSettings,
        request: TraceRequest,
        out: &mut Trace,
    ) -> Result<(), RasterError> {
        if let Some(degree) = request.sh_degree.filter(|&d| d > 3) {
            return Err(RasterError::Degree { degree });
        }
        // Until it is whole it belongs to nothing.
        out.gaussians = usize::MAX;
        project_into(gaussians, view, settings, &mut self.parts, &mut out.projected)?;
        out.sh_degree = request.sh_degree.unwrap_or(3).min(gaussians.sh_degree);
        out.colors.clear();
        if request.rgb {
            colors_into(gaussians, view, &out.projected, out.sh_degree, &mut out.colors);
            out.projected.drop_bad_colors(&mut out.colors);
        }
        tile_lists_into(&out.projected, view, settings, &mut self.tiles, &mut out.lists);
        draw(out, view, settings, request, &mut self.plain);
        out.gaussians = gaussians.len();
        Ok(())
    }

    /// [`backward`](super::backward()), added to what `out` holds: for the sum over several views.
    ///
    /// # Errors
    /// As [`backward`](super::backward()); and if `out` is of other sizes. `out` is then as it was.
    #[allow(clippy::too_many_arguments, reason = "those of the function, and where to add")]
    pub fn backward(
        &mut self,
        gaussians: &Gaussians,
        view: &View,
        settings: &RasterSettings,
        trace: &Trace,
        upstream: &Upstream<'_>,
        mask: GradMask,
        out: &mut Gradients,
    ) -> Result<(), BackwardError> {
        trace.check(gaussians, view)?;
        upstream.check(trace, gaussians)?;
        out.check(gaussians, upstream.feature_dim())?;
        let pass = Pass { gaussians, view, settings, trace, upstream, mask };
        let BackwardMemory { pairs, rows, pixels } = &mut self.backward;
        pairs.fill(&trace.lists, trace.projected.len())?;
        pass.pixels(pairs, pixels, rows);
        pass.features(pairs, rows, &mut out.features);
        pass.parameters(rows, out);
        Ok(())
    }
}
