//! The projection of sixteen Gaussians side by side.

use super::Projected;
use crate::{ExtentRule, Gaussians, RasterSettings, View};
use scenesplat_scene::vector::{cross, dot, rotation};
use std::ops::Range;

/// Gaussians side by side: compilers make registers of such arrays.
const SIDE: usize = 16;
/// Squared norm below which a quaternion has no direction.
const MIN_QUAT: f32 = 1e-12;

type Lane = [f32; SIDE];

/// What becomes of a Gaussian: the first reason that applies not to draw it.
mod fate {
    pub const DRAWN: u32 = 0;
    pub const NOT_FINITE: u32 = 1;
    pub const DEPTH: u32 = 2;
    pub const OUTSIDE: u32 = 3;
    pub const ZERO_QUAT: u32 = 4;
    pub const OVERFLOW: u32 = 5;
    pub const OPACITY: u32 = 6;
}

/// Lowest and highest tangent that the Jacobian of the projection sees, along x and y.
pub(crate) fn tangent_limits(view: &View, settings: &RasterSettings) -> [[f32; 2]; 2] {
    let limit = |f: f32, c: f32, size: u32| {
        let size = size as f32;
        let half = size / (2.0 * f);
        if settings.centred_tangents {
            [-1.3 * half, 1.3 * half]
        } else {
            [-(c / f + 0.3 * half), (size - c) / f + 0.3 * half]
        }
    };
    [limit(view.fx, view.cx, view.width), limit(view.fy, view.cy, view.height)]
}

/// Projects some rows.
#[inline(always)]
pub(super) fn project_rows(
    lens: &Lens<'_>,
    gaussians: &Gaussians,
    rows: Range<usize>,
    out: &mut Projected,
) {
    let mut block = Block::default();
    for first in rows.clone().step_by(SIDE) {
        let count = SIDE.min(rows.end - first);
        block.load(gaussians, first, count);
        lens.place(&mut block);
        // Scenes are often stored by place, so whole blocks are behind the camera.
        if block.fate.contains(&fate::DRAWN) {
            if lens.settings.isotropic {
                lens.shape::<true>(&mut block);
            } else {
                lens.shape::<false>(&mut block);
            }
            lens.extend(&mut block);
        }
        for k in 0..count {
            let culled = &mut out.culled;
            match block.fate[k] {
                fate::DRAWN => block.push((first + k) as u32, k, out),
                fate::NOT_FINITE => culled.not_finite += 1,
                fate::DEPTH => culled.depth += 1,
                fate::ZERO_QUAT => culled.zero_quat += 1,
                fate::OVERFLOW => culled.overflow += 1,
                fate::OPACITY => culled.opacity += 1,
                _ => culled.outside += 1,
            }
        }
    }
}

/// Sixteen Gaussians and what is found out about them, value by value.
#[derive(Default)]
struct Block {
    mean: [Lane; 3],
    quat: [Lane; 4],
    scale: [Lane; 3],
    opacity: Lane,
    fate: [u32; SIDE],
    depth: Lane,
    /// Limited tangents of the direction.
    tangent: [Lane; 2],
    mean2d: [Lane; 2],
    /// Variances and covariance in the picture, with the low-pass.
    variance: [Lane; 2],
    covariance: Lane,
    det: Lane,
    compensation: Lane,
    level: Lane,
    half_extent: [Lane; 2],
}

impl Block {
    /// Takes `count` rows; the other lanes hold the last of them again.
    #[inline(always)]
    fn load(&mut self, gaussians: &Gaussians, first: usize, count: usize) {
        for k in 0..SIDE {
            let i = first + k.min(count - 1);
            let (mean, quat, scale) = (gaussians.means[i], gaussians.quats[i], gaussians.scales[i]);
            for axis in 0..3 {
                self.mean[axis][k] = mean[axis];
                self.scale[axis][k] = scale[axis];
            }
            for part in 0..4 {
                self.quat[part][k] = quat[part];
            }
            self.opacity[k] = gaussians.opacities[i];
        }
    }

    #[inline(always)]
    fn push(&self, index: u32, k: usize, out: &mut Projected) {
        let inverse = 1.0 / self.det[k];
        let [v11, v22] = [self.variance[0][k], self.variance[1][k]];
        out.index.push(index);
        out.mean2d.push([self.mean2d[0][k], self.mean2d[1][k]]);
        out.depth.push(self.depth[k]);
        out.conic.push([v22 * inverse, -self.covariance[k] * inverse, v11 * inverse]);
        out.opacity.push(self.opacity[k]);
        out.compensation.push(self.compensation[k]);
        out.variance.push([v11, v22]);
        out.level.push(self.level[k]);
        out.half_extent.push([self.half_extent[0][k], self.half_extent[1][k]]);
    }
}

/// A view and settings with everything that does not depend on the Gaussian.
pub(super) struct Lens<'a> {
    view: &'a View,
    settings: &'a RasterSettings,
    tangents: [[f32; 2]; 2],
    size: [f32; 2],
    /// Standard deviations at which opacity 1 falls below the cut: 3.33 for the usual one.
    reach: f32,
}

impl<'a> Lens<'a> {
    pub(super) fn new(view: &'a View, settings: &'a RasterSettings) -> Self {
        let tangents = tangent_limits(view, settings);
        let size = [view.width as f32, view.height as f32];
        let reach = (-2.0 * settings.alpha_cut.ln()).sqrt();
        Self { view, settings, tangents, size, reach }
    }

    /// Centers in the picture, and who is out of it whatever its orientation: a bound that costs a
    /// fraction of the footprint, for the many that are far outside.
    #[inline(always)]
    fn place(&self, block: &mut Block) {
        let (view, settings) = (self.view, self.settings);
        // As `View::to_camera`: scenes far from their origin lose digits in f32.
        let wide =
            |r: [f32; 4]| [f64::from(r[0]), f64::from(r[1]), f64::from(r[2]), f64::from(r[3])];
        let [r0, r1, r2] = view.world_to_camera;
        let (r0, r1, r2) = (wide(r0), wide(r1), wide(r2));
        // The circle of other presets may be larger.
        let bounded = settings.extent == ExtentRule::Ellipse && settings.normalize_quats;
        let low_pass = settings.eps2d.sqrt();
        for k in 0..SIDE {
            let m = [block.mean[0][k], block.mean[1][k], block.mean[2][k]];
            let p = [f64::from(m[0]), f64::from(m[1]), f64::from(m[2])];
            let along = |r: [f64; 4]| (r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]) as f32;
            let (x, y, z) = (along(r0), along(r1), along(r2));
            let near = (z > settings.near) | (!settings.near_excluded & (z == settings.near));
            let in_depth = near & (z <= settings.far);
            let inverse = 1.0 / z;
            let limited = |t: f32, [low, high]: [f32; 2]| t.max(low).min(high);
            let tx = limited(x * inverse, self.tangents[0]);
            let ty = limited(y * inverse, self.tangents[1]);
            let u = view.fx * x / z + view.cx;
            let v = view.fy * y / z + view.cy;
            let s = [block.scale[0][k], block.scale[1][k], block.scale[2][k]];
            let largest = s[0].abs().max(s[1].abs()).max(s[2].abs());
            // Radii are rounded up to whole pixels.
            let radius = |f: f32, t: f32| {
                1.001 * self.reach * (f / z * (1.0 + t * t).sqrt() * largest + low_pass) + 1.0
            };
            let (ru, rv) = (radius(view.fx, tx), radius(view.fy, ty));
            let beside =
                (u + ru < 0.0) | (u - ru > self.size[0]) | (v + rv < 0.0) | (v - rv > self.size[1]);
            // `max` forgets a NaN, which has to be counted as such later.
            let finite = s[0].is_finite() & s[1].is_finite() & s[2].is_finite();
            let centre = m[0].is_finite() & m[1].is_finite() & m[2].is_finite();
            let lost = if centre { fate::DEPTH } else { fate::NOT_FINITE };
            let far = if bounded & finite & beside { fate::OUTSIDE } else { fate::DRAWN };
            block.fate[k] = if in_depth { far } else { lost };
            block.depth[k] = z;
            (block.tangent[0][k], block.tangent[1][k]) = (tx, ty);
            (block.mean2d[0][k], block.mean2d[1][k]) = (u, v);
        }
    }

    /// Footprints: the rows of `V = J R Q diag(s)`, and from them variances and determinant.
    #[inline(always)]
    fn shape<const ISOTROPIC: bool>(&self, block: &mut Block) {
        let (view, settings) = (self.view, self.settings);
        let [r0, r1, r2] = view.world_to_camera;
        let eps = settings.eps2d;
        let floor = settings.antialias_floor * settings.antialias_floor;
        for k in 0..SIDE {
            let inverse = 1.0 / block.depth[k];
            let row = |j: f32, along: [f32; 4], t: f32| {
                [j * (along[0] - t * r2[0]), j * (along[1] - t * r2[1]), j * (along[2] - t * r2[2])]
            };
            let p1 = row(view.fx * inverse, r0, block.tangent[0][k]);
            let p2 = row(view.fy * inverse, r1, block.tangent[1][k]);
            let (a, b, c) = (block.scale[0][k], block.scale[1][k], block.scale[2][k]);
            let (w, x, y, z) =
                (block.quat[0][k], block.quat[1][k], block.quat[2][k], block.quat[3][k]);
            let norm = w * w + x * x + y * y + z * z;
            let unit = if settings.normalize_quats { 1.0 / norm.sqrt() } else { 1.0 };
            let m = rotation([w * unit, x * unit, y * unit, z * unit]);
            let through = |p: [f32; 3]| {
                if ISOTROPIC {
                    return [p[0] * a, p[1] * a, p[2] * a];
                }
                [
                    a * (p[0] * m[0][0] + p[1] * m[1][0] + p[2] * m[2][0]),
                    b * (p[0] * m[0][1] + p[1] * m[1][1] + p[2] * m[2][1]),
                    c * (p[0] * m[0][2] + p[1] * m[1][2] + p[2] * m[2][2]),
                ]
            };
            let (r1, r2) = (through(p1), through(p2));
            let all = norm.is_finite() & b.is_finite() & c.is_finite();
            let finite = a.is_finite() & (ISOTROPIC | all);
            let directed = ISOTROPIC | !(norm < MIN_QUAT);
            let (s11, s22, s12) = (dot(r1, r1), dot(r2, r2), dot(r1, r2));
            let across = cross(r1, r2);
            let sharp = dot(across, across);
            let det = sharp + eps * (s11 + s22) + eps * eps;
            let held = (det > 0.0)
                & det.is_finite()
                & block.mean2d[0][k].is_finite()
                & block.mean2d[1][k].is_finite();
            let factor = (sharp / det).max(floor).sqrt();
            let compensation = if settings.antialiased { factor } else { 1.0 };
            let own = block.opacity[k];
            // `f32::min` takes the number if one side is NaN.
            let opacity = own.min(1.0) * compensation;
            let seen = !own.is_nan() & (opacity >= settings.alpha_cut);
            let found = if seen { fate::DRAWN } else { fate::OPACITY };
            let found = if held { found } else { fate::OVERFLOW };
            let found = if directed { found } else { fate::ZERO_QUAT };
            let found = if finite { found } else { fate::NOT_FINITE };
            let before = block.fate[k];
            block.fate[k] = if before == fate::DRAWN { found } else { before };
            (block.variance[0][k], block.variance[1][k]) = (s11 + eps, s22 + eps);
            (block.covariance[k], block.det[k]) = (s12, det);
            (block.compensation[k], block.opacity[k]) = (compensation, opacity);
        }
    }

    /// How far from its center a Gaussian is above the cut, and whether that is in the picture.
    #[inline(always)]
    fn extend(&self, block: &mut Block) {
        let settings = self.settings;
        for k in 0..SIDE {
            if block.fate[k] == fate::DRAWN {
                let level = 2.0 * (block.opacity[k] / settings.alpha_cut).ln();
                block.level[k] = level.max(0.0);
            }
        }
        for k in 0..SIDE {
            let [v11, v22] = [block.variance[0][k], block.variance[1][k]];
            let half = match settings.extent {
                ExtentRule::Ellipse => {
                    [(block.level[k] * v11).sqrt(), (block.level[k] * v22).sqrt()]
                }
                ExtentRule::Circle { sigma, floor } => {
                    let mean = 0.5 * (v11 + v22);
                    let longest = mean + (mean * mean - block.det[k]).max(floor).sqrt();
                    [(sigma * longest.sqrt()).ceil(); 2]
                }
            };
            let inside = |axis: usize| {
                let (centre, radius) = (block.mean2d[axis][k], half[axis].ceil());
                (centre + radius > 0.0) & (centre - radius < self.size[axis])
            };
            let found = if inside(0) & inside(1) { fate::DRAWN } else { fate::OUTSIDE };
            let before = block.fate[k];
            block.fate[k] = if before == fate::DRAWN { found } else { before };
            (block.half_extent[0][k], block.half_extent[1][k]) = (half[0], half[1]);
        }
    }
}
