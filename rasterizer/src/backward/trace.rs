//! A forward pass that remembers what the backward pass needs.

use super::BackwardError;
use crate::canvas::Canvas;
use crate::gaussians::expect;
use crate::visitors::{Color, Depth, Nothing, Transmittance};
use crate::{
    Gaussians, Projected, RasterError, RasterSettings, Rendered, TileLists, TileRect, TileVisitor,
    View, blend, project, tile_lists,
};

/// Which pictures to trace; the transmittance always is one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TraceRequest {
    /// Colour.
    pub rgb: bool,
    /// Accumulated and expected depth.
    pub depth: bool,
    /// Highest band of the harmonics to use; `None` is all there are.
    pub sh_degree: Option<u8>,
}

impl TraceRequest {
    /// Colour only.
    pub fn rgb() -> Self {
        Self { rgb: true, ..Self::default() }
    }

    /// Colour and depth.
    pub fn rgb_depth() -> Self {
        Self { rgb: true, depth: true, sh_degree: None }
    }
}

/// A picture, and how it came about.
#[derive(Debug, Clone)]
pub struct Trace {
    /// The pictures that were asked for.
    pub picture: Rendered,
    /// Visible Gaussians.
    pub projected: Projected,
    /// Who is drawn where.
    pub lists: TileLists,
    /// Their colours; empty if colour was not asked for. `[visible, 3]`
    pub colors: Vec<[f32; 3]>,
    /// Degree of the harmonics that the colours are made of.
    pub sh_degree: u8,
    /// Gaussians in the scene.
    pub(crate) gaussians: usize,
    /// Per tile, 16 × 16: list position + 1 of the last Gaussian the pixel took.
    pub(crate) last: Vec<Vec<u32>>,
}

impl Trace {
    /// That the trace belongs to these inputs, as far as sizes tell.
    pub(crate) fn check(&self, gaussians: &Gaussians, view: &View) -> Result<(), BackwardError> {
        gaussians.check()?;
        expect("Gaussians of the trace", gaussians.len(), self.gaussians)?;
        expect("pixels of the trace", view.pixels(), self.picture.transmittance.len())?;
        expect("width of the trace", view.width as usize, self.picture.width as usize)?;
        // Positions in a list are compared as f32.
        let (what, limit) = ("Gaussians in the list of one tile", 1 << 24);
        let longest = self.lists.offsets.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
        if longest > limit {
            return Err(RasterError::TooMany { what, count: longest, limit }.into());
        }
        Ok(())
    }
}

/// [`render`](fn@crate::render) for a picture that gradients will come back to.
///
/// # Errors
/// As [`render`](fn@crate::render).
pub fn trace(
    gaussians: &Gaussians,
    view: &View,
    settings: &RasterSettings,
    request: TraceRequest,
) -> Result<Trace, RasterError> {
    if let Some(degree) = request.sh_degree.filter(|&d| d > 3) {
        return Err(RasterError::Degree { degree });
    }
    let mut projected = project(gaussians, view, settings)?;
    let sh_degree = request.sh_degree.unwrap_or(3).min(gaussians.sh_degree);
    let mut colors = Vec::new();
    if request.rgb {
        colors = crate::colors(gaussians, view, &projected, sh_degree);
        projected.drop_bad_colors(&mut colors);
    }
    let lists = tile_lists(&projected, view, settings);
    let plane =
        |on: bool, channels: usize| vec![0.0; if on { view.pixels() * channels } else { 0 }];
    let (mut rgb, mut sums, mut light) =
        (plane(request.rgb, 3), plane(request.depth, 1), plane(true, 1));
    let (rgb_canvas, sums_canvas, light_canvas) = (
        Canvas::new(&mut rgb, view.width, 3),
        Canvas::new(&mut sums, view.width, 1),
        Canvas::new(&mut light, view.width, 1),
    );
    let draw = Draw { projected: &projected, lists: &lists, view, settings, light: light_canvas };
    let background = settings.background;
    // SAFETY: `blend` makes one visitor per tile, here and below.
    let rgb_tile = |rect| unsafe { rgb_canvas.tile(rect) };
    let color = |rect| Color::new(&colors, background, rgb_tile(rect));
    // SAFETY: as above.
    let sums_tile = |rect| unsafe { sums_canvas.tile(rect) };
    let depth = |rect| Depth::<false>::new(&projected.depth, sums_tile(rect), settings.isa());
    let last = match (request.rgb, request.depth) {
        (true, true) => draw.with(|rect| (color(rect), depth(rect))),
        (true, false) => draw.with(color),
        (false, true) => draw.with(depth),
        (false, false) => draw.with(|_| Nothing),
    };
    let expected = request.depth.then(|| {
        let pairs = sums.iter().zip(&light);
        pairs.map(|(sum, t)| sum / (1.0 - t).max(1e-10)).collect()
    });
    let picture = Rendered {
        width: view.width,
        height: view.height,
        rgb: request.rgb.then_some(rgb),
        transmittance: light,
        depth_accumulated: request.depth.then_some(sums),
        depth_expected: expected,
        culled: projected.culled,
        ..Rendered::default()
    };
    Ok(Trace { picture, projected, lists, colors, sh_degree, gaussians: gaussians.len(), last })
}

/// What the pixel loop reads, and where the transmittance goes.
struct Draw<'a> {
    projected: &'a Projected,
    lists: &'a TileLists,
    view: &'a View,
    settings: &'a RasterSettings,
    light: Canvas<'a>,
}

impl Draw<'_> {
    /// Draws with a visitor, and gives back `last` of every tile.
    fn with<V: TileVisitor<Output: Send>>(
        &self,
        visitor: impl Fn(TileRect) -> V + Sync,
    ) -> Vec<Vec<u32>> {
        let make = |rect| {
            // SAFETY: `blend` makes one visitor per tile.
            (visitor(rect), Transmittance::<true>::new(unsafe { self.light.tile(rect) }))
        };
        let outputs = blend(self.projected, self.lists, self.view, self.settings, make);
        outputs.into_iter().map(|(_, last)| last).collect()
    }
}
