//! Whole pictures.

use crate::canvas::Canvas;
use crate::gaussians::expect;
use crate::projection::CullCounts;
use crate::visitors::{Color, Depth, Features, Last, Nothing, Transmittance, Weights};
use crate::{
    Gaussians, Projected, RasterError, RasterSettings, TileLists, TileRect, TileVisitor, View,
    blend, project, tile_lists,
};
use std::array::from_fn;

/// Most channels of a feature picture, and most values of one: 4 GiB.
const MAX_FEATURE_VALUES: usize = 1 << 30;

/// Which depths to render. Depth is along the camera's z axis, in units of the world.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DepthRequest {
    /// `Σ w z`.
    pub accumulated: bool,
    /// `Σ w z / max(Σ w, 1e-10)`: 0 where nothing is.
    pub expected: bool,
    /// Of the last Gaussian whose transmittance before it was above ½, 0 where nothing is: robust at
    /// silhouettes.
    pub median: bool,
}

/// What to render. What is not asked for is not computed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RenderRequest {
    /// Color.
    pub rgb: bool,
    /// Depths.
    pub depth: DepthRequest,
    /// Weight that each Gaussian has in the picture.
    pub contributions: bool,
    /// For a backward pass: per pixel the last list position.
    pub last: bool,
    /// Highest band of the harmonics to use; `None` is all there are.
    pub sh_degree: Option<u8>,
}

impl RenderRequest {
    /// Color only.
    pub fn rgb() -> Self {
        Self { rgb: true, ..Self::default() }
    }
}

/// What each Gaussian did in one picture, over the pixels that took it. `[N]` each
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Contributions {
    /// `Σ w`, pixels.
    pub sum: Vec<f32>,
    /// Largest `w`.
    pub max: Vec<f32>,
    /// Number of pixels.
    pub count: Vec<u32>,
}

/// Work that one render did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WorkCounters {
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Gaussians in the picture.
    pub visible: usize,
    /// Quaternions made into a rotation, visible Gaussians.
    pub rotated: usize,
    /// Antialiasing factors.
    pub compensated: usize,
    /// Evaluated bands of spherical harmonics, by degree.
    pub sh_bands: [usize; 4],
    /// Gaussians in lists of tiles.
    pub pairs: usize,
    /// Pixels that accumulated a depth.
    pub depth_pixels: usize,
    /// Pixels that a background was added to.
    pub background_pixels: usize,
}

/// A picture, row by row from the upper left. `H` rows of `W` pixels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rendered {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Color with the background, at least 0 and without upper limit. `[H, W, 3]`
    pub rgb: Option<Vec<f32>>,
    /// Light that passes all Gaussians, in 0..=1. `[H, W]`
    pub transmittance: Vec<f32>,
    /// `Σ w z`. `[H, W]`
    pub depth_accumulated: Option<Vec<f32>>,
    /// `Σ w z / Σ w`. `[H, W]`
    pub depth_expected: Option<Vec<f32>>,
    /// See [`DepthRequest::median`]. `[H, W]`
    pub depth_median: Option<Vec<f32>>,
    /// Per pixel the position + 1, in its tile's list, of the last Gaussian it took; 0 for none. `[H, W]`
    pub last: Option<Vec<u32>>,
    /// Weights of the Gaussians.
    pub contributions: Option<Contributions>,
    /// What was not drawn, and why.
    pub culled: CullCounts,
    /// Work done.
    pub work: WorkCounters,
}

impl Rendered {
    /// `1 − transmittance`. `[H, W]`
    pub fn alpha(&self) -> Vec<f32> {
        self.transmittance.iter().map(|t| 1.0 - t).collect()
    }
}

/// Renders a view.
///
/// # Errors
/// What [`project`] refuses, and a requested degree above 3.
///
/// # Examples
/// ```
/// use scenesplat_rasterizer::{Gaussians, RasterSettings, RenderRequest, View, render};
///
/// let dot = Gaussians {
///     means: vec![[0.0, 0.0, 2.0]],
///     quats: vec![[1.0, 0.0, 0.0, 0.0]],
///     scales: vec![[0.1; 3]],
///     opacities: vec![0.5],
///     sh: vec![0.0; 3],
///     sh_degree: 0,
/// };
/// let view = View {
///     world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]],
///     fx: 50.0,
///     fy: 50.0,
///     cx: 4.5,
///     cy: 4.5,
///     width: 9,
///     height: 9,
/// };
/// let out = render(&dot, &view, &RasterSettings::default(), &RenderRequest::rgb())?;
/// let rgb = out.rgb.expect("color was asked for");
/// // Half of the light is taken in the middle, by a gray of one half.
/// assert!((rgb[3 * (4 * 9 + 4)] - 0.25).abs() < 1e-6);
/// # Ok::<(), scenesplat_rasterizer::RasterError>(())
/// ```
pub fn render(
    gaussians: &Gaussians,
    view: &View,
    settings: &RasterSettings,
    request: &RenderRequest,
) -> Result<Rendered, RasterError> {
    if let Some(degree) = request.sh_degree.filter(|&d| d > 3) {
        return Err(RasterError::Degree { degree });
    }
    let mut projected = project(gaussians, view, settings)?;
    let mut colors = Vec::new();
    let degree = request.sh_degree.unwrap_or(3).min(gaussians.sh_degree);
    if request.rgb {
        colors = crate::colors(gaussians, view, &projected, degree);
        projected.drop_bad_colors(&mut colors);
    }
    let lists = tile_lists(&projected, view, settings);
    let scene = Scene { projected: &projected, lists: &lists, view, settings };
    let mut out = scene.render(request, request.rgb.then_some(&colors[..]), gaussians.len());
    out.culled = projected.culled;
    let visible = projected.len();
    let pixels = |on: bool| if on { view.pixels() } else { 0 };
    let band = |l: usize| request.rgb && l <= usize::from(degree);
    let depth = request.depth != DepthRequest::default();
    out.work = WorkCounters {
        gaussians: gaussians.len(),
        visible,
        rotated: if settings.isotropic { 0 } else { visible },
        compensated: if settings.antialiased { visible } else { 0 },
        sh_bands: from_fn(|l| if band(l) { visible } else { 0 }),
        pairs: lists.entries.len(),
        depth_pixels: pixels(depth),
        background_pixels: pixels(request.rgb && settings.background.is_some()),
    };
    Ok(out)
}

/// Renders `dim` channels per pixel, `Σ w f`, without background. `[H, W, dim]`
///
/// `features` is `[N, dim]`; rows that are not visible are not read, and values that are not finite reach
/// the pixels that take their Gaussian.
///
/// # Errors
/// What [`project`] refuses; `features` of another length; `dim` 0, or a picture of more than
/// 2³⁰ values.
pub fn render_features(
    gaussians: &Gaussians,
    view: &View,
    settings: &RasterSettings,
    features: &[f32],
    dim: usize,
) -> Result<Vec<f32>, RasterError> {
    let values = view.pixels().saturating_mul(dim);
    if dim == 0 || values > MAX_FEATURE_VALUES {
        let range = "at least 1, and at most 2³⁰ values per picture";
        return Err(RasterError::Number { field: "dim", value: dim as f64, range });
    }
    expect("features", gaussians.len().saturating_mul(dim), features.len())?;
    let projected = project(gaussians, view, settings)?;
    let lists = tile_lists(&projected, view, settings);
    let mut picture = vec![0.0; values];
    let canvas = Canvas::new(&mut picture, view.width, dim);
    blend(&projected, &lists, view, settings, |rect| {
        // SAFETY: `blend` makes one visitor per tile.
        Features::new(features, &projected.index, dim, unsafe { canvas.tile(rect) })
    });
    Ok(picture)
}

/// The median depth of a view that is projected and listed already. `[H, W]`
pub(crate) fn median_depth(
    projected: &Projected,
    lists: &TileLists,
    view: &View,
    settings: &RasterSettings,
) -> Vec<f32> {
    let mut medians = vec![0.0; view.pixels()];
    let canvas = Canvas::new(&mut medians, view.width, 1);
    let isa = settings.isa();
    // By itself, not through `Scene::render`: no other output keeps the loop going.
    blend(projected, lists, view, settings, |rect| {
        // SAFETY: `blend` makes one visitor per tile.
        Depth::<true>::new(&projected.depth, unsafe { canvas.tile(rect) }, isa)
    });
    medians
}

/// What the pixel loop reads.
#[derive(Clone, Copy)]
struct Scene<'a> {
    projected: &'a Projected,
    lists: &'a TileLists,
    view: &'a View,
    settings: &'a RasterSettings,
}

impl Scene<'_> {
    /// Picks the visitors; every combination is a pixel loop of its own.
    fn render(self, request: &RenderRequest, colors: Option<&[[f32; 3]]>, n: usize) -> Rendered {
        let DepthRequest { accumulated, expected, median } = request.depth;
        let pixels = self.view.pixels();
        let plane = |on: bool, channels: usize| vec![0.0; if on { pixels * channels } else { 0 }];
        let mut rgb = plane(colors.is_some(), 3);
        let mut sums = plane(accumulated || expected, 1);
        let mut medians = plane(median, 1);
        let mut transmittance = plane(true, 1);
        let mut last = vec![0u32; if request.last { pixels } else { 0 }];
        let width = self.view.width;
        let canvases = Canvases {
            rgb: Canvas::new(&mut rgb, width, 3),
            sums: Canvas::new(&mut sums, width, 1),
            medians: Canvas::new(&mut medians, width, 1),
            transmittance: Canvas::new(&mut transmittance, width, 1),
            last: Canvas::new(&mut last, width, 1),
        };
        let background = self.settings.background;
        let contributions = match colors {
            Some(colors) => self.with_depth(request, &canvases, n, |rect| {
                // SAFETY: `blend` makes one visitor per tile.
                Color::new(colors, background, unsafe { canvases.rgb.tile(rect) })
            }),
            None => self.with_depth(request, &canvases, n, |_| Nothing),
        };
        let expected = expected.then(|| {
            let pairs = sums.iter().zip(&transmittance);
            pairs.map(|(sum, t)| sum / (1.0 - t).max(1e-10)).collect()
        });
        Rendered {
            width,
            height: self.view.height,
            rgb: colors.is_some().then_some(rgb),
            transmittance,
            depth_accumulated: accumulated.then_some(sums),
            depth_expected: expected,
            depth_median: median.then_some(medians),
            last: request.last.then_some(last),
            contributions,
            ..Rendered::default()
        }
    }

    fn with_depth<C: TileVisitor<Output = ()>>(
        self,
        request: &RenderRequest,
        canvases: &Canvases<'_>,
        n: usize,
        color: impl Fn(TileRect) -> C + Sync,
    ) -> Option<Contributions> {
        let (depth, isa) = (&self.projected.depth, self.settings.isa());
        // SAFETY: `blend` makes one visitor per tile.
        let sums = |rect| Depth::<false>::new(depth, unsafe { canvases.sums.tile(rect) }, isa);
        // SAFETY: as above.
        let medians = |rect| Depth::<true>::new(depth, unsafe { canvases.medians.tile(rect) }, isa);
        let mean = request.depth.accumulated || request.depth.expected;
        match (mean, request.depth.median) {
            (false, false) => self.with_weights(request, canvases, n, color),
            (true, false) => self.with_weights(request, canvases, n, |r| (color(r), sums(r))),
            (false, true) => self.with_weights(request, canvases, n, |r| (color(r), medians(r))),
            (true, true) => {
                self.with_weights(request, canvases, n, |r| (color(r), (sums(r), medians(r))))
            }
        }
    }

    fn with_weights<V: TileVisitor>(
        self,
        request: &RenderRequest,
        canvases: &Canvases<'_>,
        n: usize,
        visitor: impl Fn(TileRect) -> V + Sync,
    ) -> Option<Contributions> {
        if !request.contributions {
            self.with_last(request, canvases, visitor);
            return None;
        }
        let outputs = self.with_last(request, canvases, |rect| {
            let tile = rect.tile;
            let len = self.lists.offsets[tile + 1] - self.lists.offsets[tile];
            (visitor(rect), Weights::new(len))
        });
        Some(self.sum(n, outputs.into_iter().map(|(_, weights)| weights)))
    }

    fn with_last<V: TileVisitor>(
        self,
        request: &RenderRequest,
        canvases: &Canvases<'_>,
        visitor: impl Fn(TileRect) -> V + Sync,
    ) -> Vec<V::Output> {
        // SAFETY: `blend` makes one visitor per tile.
        let light = |rect| unsafe { canvases.transmittance.tile(rect) };
        let Self { projected, lists, view, settings } = self;
        if !request.last {
            let make = |rect| (visitor(rect), Transmittance::new(light(rect)));
            let outputs = blend(projected, lists, view, settings, make);
            return outputs.into_iter().map(|(out, ())| out).collect();
        }
        let make = |rect| {
            // SAFETY: as above.
            let last = unsafe { canvases.last.tile(rect) };
            (visitor(rect), (Transmittance::new(light(rect)), Last::new(last)))
        };
        let outputs = blend(projected, lists, view, settings, make);
        outputs.into_iter().map(|(out, _)| out).collect()
    }

    /// Sums weights of the tiles, in their order, per Gaussian.
    fn sum(self, n: usize, tiles: impl Iterator<Item = Vec<(f32, f32, u32)>>) -> Contributions {
        let mut out = Contributions { sum: vec![0.0; n], max: vec![0.0; n], count: vec![0; n] };
        for (tile, weights) in tiles.enumerate() {
            let entries = &self.lists.entries[self.lists.offsets[tile]..];
            for (&row, (sum, max, count)) in entries.iter().zip(weights) {
                let i = self.projected.index[row as usize] as usize;
                out.sum[i] += sum;
                out.max[i] = out.max[i].max(max);
                out.count[i] += count;
            }
        }
        out
    }
}

/// Pictures of a render; empty where not asked for.
struct Canvases<'a> {
    rgb: Canvas<'a>,
    sums: Canvas<'a>,
    medians: Canvas<'a>,
    transmittance: Canvas<'a>,
    last: Canvas<'a, u32>,
}
