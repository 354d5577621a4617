//! A forward pass that remembers what the backward pass needs.

use super::{BackwardError, Workspace};
use crate::blend::blend_in;
use crate::canvas::Canvas;
use crate::gaussians::expect;
use crate::splats::Splat;
use crate::visitors::{Color, Depth, Last, Nothing, Transmittance};
use crate::{
    Gaussians, Projected, RasterError, RasterSettings, Rendered, TileLists, TileRect, TileVisitor,
    View,
};

/// Which pictures to trace; the transmittance always is one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TraceRequest {
    /// Color.
    pub rgb: bool,
    /// Accumulated and expected depth.
    pub depth: bool,
    /// Highest band of the harmonics to use; `None` is all there are.
    pub sh_degree: Option<u8>,
}

impl TraceRequest {
    /// Color only.
    pub fn rgb() -> Self {
        Self { rgb: true, ..Self::default() }
    }

    /// Color and depth.
    pub fn rgb_depth() -> Self {
        Self { rgb: true, depth: true, sh_degree: None }
    }
}

/// A picture, and how it came about. Empty by default, for [`Workspace::trace`] to fill.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// The pictures that were asked for.
    pub picture: Rendered,
    /// Visible Gaussians.
    pub projected: Projected,
    /// Who is drawn where.
    pub lists: TileLists,
    /// Their colors; empty if color was not asked for. `[visible, 3]`
    pub colors: Vec<[f32; 3]>,
    /// Degree of the harmonics that the colors are made of.
    pub sh_degree: u8,
    /// Gaussians in the scene.
    pub(crate) gaussians: usize,
    /// List position + 1 of the last Gaussian the pixel took. `[H, W]`
    pub(crate) last: Vec<u32>,
}

impl Trace {
    /// That the trace belongs to these inputs, as far as sizes tell.
    pub(crate) fn check(&self, gaussians: &Gaussians, view: &View) -> Result<(), BackwardError> {
        gaussians.check()?;
        expect("Gaussians of the trace", gaussians.len(), self.gaussians)?;
        expect("pixels of the trace", view.pixels(), self.picture.transmittance.len())?;
        expect("last Gaussians of the trace", view.pixels(), self.last.len())?;
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
    let mut out = Trace::default();
    Workspace::new().trace(gaussians, view, settings, request, &mut out)?;
    Ok(out)
}

/// Draws what a trace has projected and listed, and remembers it.
pub(crate) fn draw(
    trace: &mut Trace,
    view: &View,
    settings: &RasterSettings,
    request: TraceRequest,
    splats: &mut Vec<Splat<0>>,
) {
    let Trace { picture, projected, lists, colors, last, .. } = trace;
    let pixels = view.pixels();
    (picture.width, picture.height, picture.culled) = (view.width, view.height, projected.culled);
    // Every pixel is written below.
    picture.transmittance.resize(pixels, 0.0);
    last.resize(pixels, 0);
    plane(&mut picture.rgb, request.rgb.then_some(3 * pixels));
    plane(&mut picture.depth_accumulated, request.depth.then_some(pixels));
    plane(&mut picture.depth_expected, request.depth.then_some(pixels));
    let (rgb, sums) = (&mut picture.rgb, &mut picture.depth_accumulated);
    let (rgb, sums) = (rgb.as_deref_mut().unwrap_or(&mut []), sums.as_deref_mut());
    let rgb = Canvas::new(rgb, view.width, 3);
    let sums = Canvas::new(sums.unwrap_or(&mut []), view.width, 1);
    let light = Canvas::new(&mut picture.transmittance, view.width, 1);
    let last = Canvas::new(last, view.width, 1);
    let draw = Draw { projected, lists, view, settings, light, last };
    let background = settings.background;
    // SAFETY: `blend_in` makes one visitor per tile, here and below.
    let color = |rect| Color::new(colors, background, unsafe { rgb.tile(rect) });
    let depth =
        // SAFETY: as above.
        |rect| Depth::<false>::new(&projected.depth, unsafe { sums.tile(rect) }, settings.isa());
    match (request.rgb, request.depth) {
        (true, true) => draw.with(splats, |rect| (color(rect), depth(rect))),
        (true, false) => draw.with(splats, color),
        (false, true) => draw.with(splats, depth),
        (false, false) => draw.with(splats, |_| Nothing),
    }
    let (sums, light) = (picture.depth_accumulated.as_deref(), &picture.transmittance);
    if let (Some(expected), Some(sums)) = (&mut picture.depth_expected, sums) {
        for ((to, sum), t) in expected.iter_mut().zip(sums).zip(light) {
            *to = sum / (1.0 - t).max(1e-10);
        }
    }
}

/// Gives a picture a size, or takes it away; values are left over.
fn plane(values: &mut Option<Vec<f32>>, len: Option<usize>) {
    match len {
        Some(len) => values.get_or_insert_default().resize(len, 0.0),
        None => *values = None,
    }
}

/// What the pixel loop reads, and where transmittance and last positions go.
struct Draw<'a> {
    projected: &'a Projected,
    lists: &'a TileLists,
    view: &'a View,
    settings: &'a RasterSettings,
    light: Canvas<'a>,
    last: Canvas<'a, u32>,
}

impl Draw<'_> {
    /// Draws with a visitor that leaves nothing but pixels.
    fn with<V: TileVisitor>(
        &self,
        splats: &mut Vec<Splat<0>>,
        visitor: impl Fn(TileRect) -> V + Sync,
    ) {
        let make = |rect| {
            // SAFETY: `blend_in` makes one visitor per tile.
            let (light, last) = unsafe { (self.light.tile(rect), self.last.tile(rect)) };
            (visitor(rect), (Transmittance::new(light), Last::new(last)))
        };
        blend_in(self.projected, self.lists, self.view, self.settings, splats, make);
    }
}
