//! From Gaussians of the world to ellipses of a picture.

mod footprints;

use crate::{Gaussians, RasterError, RasterSettings, TILE, View};
pub(crate) use footprints::tangent_limits;
use footprints::{Lens, project_rows};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled_for;

/// Gaussians per task: few enough to share among threads, many enough not to be felt.
const CHUNK: usize = 4096;
/// Most entries of all tile lists: 2.5 GiB, and twice that while they are made.
const MAX_PAIRS: usize = 1 << 29;

/// Gaussians that were not drawn, by the first reason that applied.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CullCounts {
    /// A center, a quaternion or a scale that is not finite.
    pub not_finite: usize,
    /// A quaternion without a direction.
    pub zero_quat: usize,
    /// In front of `near` or beyond `far`.
    pub depth: usize,
    /// A footprint that f32 does not hold.
    pub overflow: usize,
    /// Opacity below the cut, or NaN.
    pub opacity: usize,
    /// Beside the picture.
    pub outside: usize,
    /// A color that is not finite. Only passes with color look.
    pub color: usize,
}

/// Gaussians in the picture: one row per visible one, in the order of their index.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Projected {
    /// Row in [`Gaussians`], ascending.
    pub index: Vec<u32>,
    /// Center, pixels.
    pub mean2d: Vec<[f32; 2]>,
    /// Along the camera's z axis, units of the world.
    pub depth: Vec<f32>,
    /// `a, b, c` of `σ = ½(a dx² + c dy²) + b dx dy`, px⁻².
    pub conic: Vec<[f32; 3]>,
    /// In 0..=1, after compensation.
    pub opacity: Vec<f32>,
    /// Factor that `opacity` has of antialiasing, 1 without.
    pub compensation: Vec<f32>,
    /// Variances along x and y with the low-pass, px²: the diagonal of the conic's inverse.
    pub variance: Vec<[f32; 2]>,
    /// `2σ` at which α falls below the cut.
    pub level: Vec<f32>,
    /// From the center to where α falls below the cut, pixels along x and y.
    pub half_extent: Vec<[f32; 2]>,
    /// What is not here, and why.
    pub culled: CullCounts,
}

impl Projected {
    /// Number of visible Gaussians.
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// None, with room for that many.
    fn clear(&mut self, rows: usize) {
        fn empty<T>(values: &mut Vec<T>, rows: usize) {
            values.clear();
            values.reserve(rows);
        }
        empty(&mut self.index, rows);
        empty(&mut self.mean2d, rows);
        empty(&mut self.depth, rows);
        empty(&mut self.conic, rows);
        empty(&mut self.opacity, rows);
        empty(&mut self.compensation, rows);
        empty(&mut self.variance, rows);
        empty(&mut self.level, rows);
        empty(&mut self.half_extent, rows);
        self.culled = CullCounts::default();
    }

    /// Tiles in the boxes of all: no fewer than their lists will have entries.
    fn boxes(&self, view: &View) -> usize {
        let (columns, rows) = view.tiles();
        let tiles = |k: usize, most: usize| {
            self.half_extent
                .iter()
                .map(move |e| {
                    // Casts saturate. One more tile for each end, one for rounding.
                    ((e[k] * (2.0 / TILE as f32)) as usize).saturating_add(3)
                })
                .map(move |tiles| tiles.min(most))
        };
        tiles(0, columns).zip(tiles(1, rows)).map(|(x, y)| x * y).sum()
    }

    /// Takes out the rows whose color is not finite, and counts them.
    pub(crate) fn drop_bad_colors(&mut self, colors: &mut Vec<[f32; 3]>) {
        let good = |c: &[f32; 3]| c.iter().all(|v| v.is_finite());
        if colors.par_iter().with_min_len(CHUNK).all(good) {
            return;
        }
        let keep: Vec<bool> = colors.iter().map(good).collect();
        let bad = keep.iter().filter(|&&k| !k).count();
        self.culled.color += bad;
        retain(&mut self.index, &keep);
        retain(&mut self.mean2d, &keep);
        retain(&mut self.depth, &keep);
        retain(&mut self.conic, &keep);
        retain(&mut self.opacity, &keep);
        retain(&mut self.compensation, &keep);
        retain(&mut self.variance, &keep);
        retain(&mut self.level, &keep);
        retain(&mut self.half_extent, &keep);
        retain(colors, &keep);
    }

    /// All parts, one after the other.
    fn join(&mut self, parts: &[Self]) {
        let mut culled = CullCounts::default();
        for part in parts {
            let o = part.culled;
            culled.not_finite += o.not_finite;
            culled.zero_quat += o.zero_quat;
            culled.depth += o.depth;
            culled.overflow += o.overflow;
            culled.opacity += o.opacity;
            culled.outside += o.outside;
            culled.color += o.color;
        }
        self.culled = culled;
        join(parts, |p| &p.index, &mut self.index);
        join(parts, |p| &p.mean2d, &mut self.mean2d);
        join(parts, |p| &p.depth, &mut self.depth);
        join(parts, |p| &p.conic, &mut self.conic);
        join(parts, |p| &p.opacity, &mut self.opacity);
        join(parts, |p| &p.compensation, &mut self.compensation);
        join(parts, |p| &p.variance, &mut self.variance);
        join(parts, |p| &p.level, &mut self.level);
        join(parts, |p| &p.half_extent, &mut self.half_extent);
    }
}

/// One column of all parts. Many threads copy, as fresh memory takes longer than the copy.
fn join<T: Copy + Default + Send + Sync>(
    parts: &[Projected],
    column: impl Fn(&Projected) -> &Vec<T>,
    out: &mut Vec<T>,
) {
    out.resize(parts.iter().map(Projected::len).sum(), T::default());
    let mut rest = &mut out[..];
    let mut copies = Vec::with_capacity(parts.len());
    for part in parts {
        let from = column(part);
        let (to, tail) = std::mem::take(&mut rest).split_at_mut(from.len());
        copies.push((to, from));
        rest = tail;
    }
    copies.into_par_iter().with_min_len(4).for_each(|(to, from)| to.copy_from_slice(from));
}

fn retain<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    values.retain(|_| keep.next().is_some_and(|&k| k));
}

/// Projects all Gaussians and keeps those that can touch the picture.
///
/// With `V = J R Q diag(s)` (2×3, rows `r₁`, `r₂`) the covariance in the picture is `VVᵀ`, and by
/// Lagrange's identity its determinant is `|r₁ × r₂|²`: no difference of large products, so needles
/// keep their digits in f32.
///
/// # Errors
/// What [`Gaussians::check`], [`View::check`] and [`RasterSettings::check`] refuse. Gaussians that
/// cannot be drawn are no error; they are counted.
///
/// # Source
/// `fully_fused_projection` of gsplat 1.6.0 (90d7b4b). Differs: the determinant; a quaternion
/// without a direction, and anything not finite, is not drawn; opacity above 1 counts as 1.
pub fn project(
    gaussians: &Gaussians,
    view: &View,
    settings: &RasterSettings,
) -> Result<Projected, RasterError> {
    let mut out = Projected::default();
    project_into(gaussians, view, settings, &mut Vec::new(), &mut out)?;
    Ok(out)
}

/// [`project`] with memory that is used again.
pub(crate) fn project_into(
    gaussians: &Gaussians,
    view: &View,
    settings: &RasterSettings,
    parts: &mut Vec<Projected>,
    out: &mut Projected,
) -> Result<(), RasterError> {
    gaussians.check()?;
    view.check()?;
    settings.check()?;
    let lens = Lens::new(view, settings);
    let isa = settings.isa();
    parts.resize_with(gaussians.len().div_ceil(CHUNK), Projected::default);
    parts.par_iter_mut().enumerate().for_each(|(c, part)| {
        let rows = c * CHUNK..((c + 1) * CHUNK).min(gaussians.len());
        part.clear(rows.len());
        compiled_for(
            isa,
            #[inline(always)]
            |_| project_rows(&lens, gaussians, rows, part),
        );
    });
    let boxes = parts.par_iter().map(|chunk| chunk.boxes(view)).sum::<usize>();
    if boxes > MAX_PAIRS {
        let what = "Gaussians in tiles";
        return Err(RasterError::TooMany { what, count: boxes, limit: MAX_PAIRS });
    }
    out.join(parts);
    Ok(())
}
