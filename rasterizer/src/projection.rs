//! From Gaussians of the world to ellipses of a picture.

use crate::{ExtentRule, Gaussians, RasterError, RasterSettings, View};
use rayon::prelude::*;

/// Gaussians per task: few enough to share among threads, many enough not to be felt.
const CHUNK: usize = 4096;
/// Squared norm below which a quaternion has no direction.
const MIN_QUAT: f32 = 1e-12;
/// Ellipses end at this many standard deviations at most: beyond it even opacity 1 is below 1/255.
const MAX_SIGMA: f32 = 3.33;

/// Gaussians that were not drawn, by the first reason that applied.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CullCounts {
    /// A centre, a quaternion or a scale that is not finite.
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
    /// A colour that is not finite. Only passes with colour look.
    pub colour: usize,
}

/// Gaussians in the picture: one row per visible one, in the order of their index.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Projected {
    /// Row in [`Gaussians`], ascending.
    pub index: Vec<u32>,
    /// Centre, pixels.
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
    /// From the centre to where α falls below the cut, pixels along x and y.
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

    /// Takes out the rows whose colour is not finite, and counts them.
    pub(crate) fn drop_bad_colours(&mut self, colours: &mut Vec<[f32; 3]>) {
        let keep: Vec<bool> = colours.iter().map(|c| c.iter().all(|v| v.is_finite())).collect();
        let bad = keep.iter().filter(|&&k| !k).count();
        if bad == 0 {
            return;
        }
        self.culled.colour += bad;
        retain(&mut self.index, &keep);
        retain(&mut self.mean2d, &keep);
        retain(&mut self.depth, &keep);
        retain(&mut self.conic, &keep);
        retain(&mut self.opacity, &keep);
        retain(&mut self.compensation, &keep);
        retain(&mut self.variance, &keep);
        retain(&mut self.level, &keep);
        retain(&mut self.half_extent, &keep);
        retain(colours, &keep);
    }

    fn push(&mut self, index: u32, row: &Row) {
        self.index.push(index);
        self.mean2d.push(row.mean2d);
        self.depth.push(row.depth);
        self.conic.push(row.conic);
        self.opacity.push(row.opacity);
        self.compensation.push(row.compensation);
        self.variance.push(row.variance);
        self.level.push(row.level);
        self.half_extent.push(row.half_extent);
    }

    fn append(&mut self, mut other: Self) {
        self.index.append(&mut other.index);
        self.mean2d.append(&mut other.mean2d);
        self.depth.append(&mut other.depth);
        self.conic.append(&mut other.conic);
        self.opacity.append(&mut other.opacity);
        self.compensation.append(&mut other.compensation);
        self.variance.append(&mut other.variance);
        self.level.append(&mut other.level);
        self.half_extent.append(&mut other.half_extent);
        let (c, o) = (&mut self.culled, other.culled);
        c.not_finite += o.not_finite;
        c.zero_quat += o.zero_quat;
        c.depth += o.depth;
        c.overflow += o.overflow;
        c.opacity += o.opacity;
        c.outside += o.outside;
        c.colour += o.colour;
    }
}

fn retain<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    values.retain(|_| keep.next().is_some_and(|&k| k));
}

/// One row of [`Projected`].
struct Row {
    mean2d: [f32; 2],
    depth: f32,
    conic: [f32; 3],
    opacity: f32,
    compensation: f32,
    variance: [f32; 2],
    level: f32,
    half_extent: [f32; 2],
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
    gaussians.check()?;
    view.check()?;
    settings.check()?;
    let lens = Lens::new(view, settings);
    let chunk = |c: usize| {
        let mut out = Projected::default();
        for i in c * CHUNK..((c + 1) * CHUNK).min(gaussians.len()) {
            if let Some(row) = lens.project(gaussians, i, &mut out.culled) {
                out.push(i as u32, &row);
            }
        }
        out
    };
    let chunks: Vec<Projected> =
        (0..gaussians.len().div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
    let mut all = Projected::default();
    for chunk in chunks {
        all.append(chunk);
    }
    Ok(all)
}

/// A view and settings with everything that does not depend on the Gaussian.
struct Lens<'a> {
    view: &'a View,
    settings: &'a RasterSettings,
    /// Lowest and highest tangent of the Jacobian, x and y.
    tangents: [[f32; 2]; 2],
    size: [f32; 2],
}

impl<'a> Lens<'a> {
    fn new(view: &'a View, settings: &'a RasterSettings) -> Self {
        let size = [view.width as f32, view.height as f32];
        let limit = |f: f32, c: f32, size: f32| {
            let half = size / (2.0 * f);
            if settings.centred_tangents {
                [-1.3 * half, 1.3 * half]
            } else {
                [-(c / f + 0.3 * half), (size - c) / f + 0.3 * half]
            }
        };
        let tangents = [limit(view.fx, view.cx, size[0]), limit(view.fy, view.cy, size[1])];
        Self { view, settings, tangents, size }
    }

    fn project(&self, gaussians: &Gaussians, i: usize, culled: &mut CullCounts) -> Option<Row> {
        let (view, settings) = (self.view, self.settings);
        let [x, y, z] = view.to_camera(gaussians.means[i]);
        let near = if settings.near_excluded { z > settings.near } else { z >= settings.near };
        if !(near && z <= settings.far) {
            let lost = !gaussians.means[i].iter().all(|v| v.is_finite());
            *if lost { &mut culled.not_finite } else { &mut culled.depth } += 1;
            return None;
        }
        let [r1, r2] = match self.rows(gaussians, i, [x, y, z]) {
            Ok(rows) => rows,
            Err(Undrawn::NotFinite) => {
                culled.not_finite += 1;
                return None;
            }
            Err(Undrawn::ZeroQuat) => {
                culled.zero_quat += 1;
                return None;
            }
        };
        let eps = settings.eps2d;
        let (s11, s22, s12) = (dot(r1, r1), dot(r2, r2), dot(r1, r2));
        let cross = cross(r1, r2);
        let det_sharp = dot(cross, cross);
        let det = det_sharp + eps * (s11 + s22) + eps * eps;
        let (v11, v22) = (s11 + eps, s22 + eps);
        let mean2d = [view.fx * x / z + view.cx, view.fy * y / z + view.cy];
        if !(det > 0.0 && det.is_finite() && mean2d.iter().all(|v| v.is_finite())) {
            culled.overflow += 1;
            return None;
        }
        let compensation = if settings.antialiased {
            (det_sharp / det).max(settings.antialias_floor * settings.antialias_floor).sqrt()
        } else {
            1.0
        };
        let opacity = gaussians.opacities[i].min(1.0) * compensation;
        // `f32::min` takes the number if one side is NaN.
        if gaussians.opacities[i].is_nan() || !(opacity >= settings.alpha_cut) {
            culled.opacity += 1;
            return None;
        }
        let level = (2.0 * (opacity / settings.alpha_cut).ln()).clamp(0.0, MAX_SIGMA * MAX_SIGMA);
        let half_extent = match settings.extent {
            ExtentRule::Ellipse => [(level * v11).sqrt(), (level * v22).sqrt()],
            ExtentRule::Circle { sigma, floor } => {
                let mean = 0.5 * (v11 + v22);
                let longest = mean + (mean * mean - det).max(floor).sqrt();
                [(sigma * longest.sqrt()).ceil(); 2]
            }
        };
        let radius = half_extent.map(f32::ceil);
        let inside = |k: usize| mean2d[k] + radius[k] > 0.0 && mean2d[k] - radius[k] < self.size[k];
        if !(inside(0) && inside(1)) {
            culled.outside += 1;
            return None;
        }
        let inverse = 1.0 / det;
        let conic = [v22 * inverse, -s12 * inverse, v11 * inverse];
        let variance = [v11, v22];
        Some(Row { mean2d, depth: z, conic, opacity, compensation, variance, level, half_extent })
    }

    /// The rows of `V = J R Q diag(s)`.
    fn rows(
        &self,
        gaussians: &Gaussians,
        i: usize,
        [x, y, z]: [f32; 3],
    ) -> Result<[[f32; 3]; 2], Undrawn> {
        let (view, settings) = (self.view, self.settings);
        let inverse = 1.0 / z;
        let tx = (x * inverse).clamp(self.tangents[0][0], self.tangents[0][1]);
        let ty = (y * inverse).clamp(self.tangents[1][0], self.tangents[1][1]);
        let (jx, jy) = (view.fx * inverse, view.fy * inverse);
        let r = &view.world_to_camera;
        let row = |j: f32, along: usize, t: f32| [0, 1, 2].map(|k| j * (r[along][k] - t * r[2][k]));
        let (p1, p2) = (row(jx, 0, tx), row(jy, 1, ty));
        let s = gaussians.scales[i];
        if settings.isotropic {
            let scale = |p: [f32; 3]| p.map(|v| v * s[0]);
            let rows = [scale(p1), scale(p2)];
            return if s[0].is_finite() { Ok(rows) } else { Err(Undrawn::NotFinite) };
        }
        let q = gaussians.quats[i];
        let norm = q.iter().map(|v| v * v).sum::<f32>();
        if !(norm.is_finite() && s.iter().all(|v| v.is_finite())) {
            return Err(Undrawn::NotFinite);
        }
        if norm < MIN_QUAT {
            return Err(Undrawn::ZeroQuat);
        }
        let unit = if settings.normalize_quats { 1.0 / norm.sqrt() } else { 1.0 };
        let m = rotation(q.map(|v| v * unit));
        let through = |p: [f32; 3]| {
            [0, 1, 2].map(|k| s[k] * (p[0] * m[0][k] + p[1] * m[1][k] + p[2] * m[2][k]))
        };
        Ok([through(p1), through(p2)])
    }
}

/// Why there are no rows.
enum Undrawn {
    NotFinite,
    ZeroQuat,
}

/// The matrix of a quaternion `w, x, y, z` of norm 1.
#[inline(always)]
fn rotation([w, x, y, z]: [f32; 4]) -> [[f32; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
