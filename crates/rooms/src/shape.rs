//! Curved and flat pieces of surface that Gaussians are scattered on.

use crate::vector::{V3, Z, add, add_times, basis, cross, dot, length, mix, sub, times, unit_or};
use scenesplat_kernels::random::{SampleRng, cos_sin, direction, unit};
use std::f64::consts::PI;

/// A box along the axes of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Block {
    pub(crate) low: V3,
    pub(crate) high: V3,
}

impl Block {
    /// The box of a point alone.
    pub(crate) fn at(point: V3) -> Self {
        Self { low: point, high: point }
    }

    fn around(centre: V3, reach: V3) -> Self {
        Self { low: sub(centre, reach), high: add(centre, reach) }
    }

    /// The box around two boxes.
    pub(crate) fn join(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|i| self.low[i].min(other.low[i])),
            high: std::array::from_fn(|i| self.high[i].max(other.high[i])),
        }
    }

    pub(crate) fn moved(self, by: V3) -> Self {
        Self { low: add(self.low, by), high: add(self.high, by) }
    }

    pub(crate) fn middle(&self) -> V3 {
        std::array::from_fn(|i| (self.low[i] + self.high[i]) / 2.0)
    }

    pub(crate) fn size(&self) -> V3 {
        sub(self.high, self.low)
    }
}

/// A point of a surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    pub(crate) coord: V3,
    /// Unit, outwards.
    pub(crate) normal: V3,
    /// Unit, in the surface: along the nearest edge, or along a slender piece.
    pub(crate) tangent: V3,
    /// Place on the surface, meters: what textures are a function of.
    pub(crate) st: [f64; 2],
    /// Distance from the nearest edge, meters; a large number where there is none.
    pub(crate) edge: f64,
}

/// Folds of a patch, across its first direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wave {
    /// Half the depth of a fold, meters.
    pub(crate) amplitude: f64,
    /// Number of folds.
    pub(crate) count: f64,
    /// Where the first fold starts, in folds.
    pub(crate) phase: f64,
}

/// A piece of surface, z up, meters.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shape {
    /// Between four corners (at 0 0, 1 0, 0 1, 1 1); the normal is that of the first direction
    /// times the second. `bulge` meters stand out in the middle.
    Patch { corners: [V3; 4], bulge: f64, wave: Option<Wave> },
    /// Tube or cone without ends. Only the directions whose cosine with `toward` is at least
    /// `arc` exist; −1 is all around.
    Frustum { base: V3, axis: V3, bottom: f64, top: f64, toward: V3, arc: f64 },
    /// Ellipse with half axes `u` and `v` and a hole of this share of its radius; normal `u × v`.
    Disc { centre: V3, u: V3, v: V3, hole: f64 },
    /// Part `from..to` (of −1..1, along the third axis) of an ellipsoid with perpendicular half
    /// axes; 0 is round, toward 1 it nears the box around it.
    Ellipsoid { centre: V3, axes: [V3; 3], from: f64, to: f64, boxy: f64, inward: bool },
    /// A bent rod: around the ellipse with half axes `u` and `v`, or half of it.
    Ring { centre: V3, u: V3, v: V3, rod: f64, half: bool },
    /// A blade that starts at `base`, goes `along`, is `side` wide to both sides and falls by
    /// `droop`.
    Leaf { base: V3, along: V3, side: V3, droop: f64 },
    /// Small leaves: points throughout a ball, in all directions.
    Foliage { centre: V3, radius: f64 },
}

impl Shape {
    /// A parallelogram; its normal is `u × v`.
    pub(crate) fn flat(corner: V3, u: V3, v: V3) -> Self {
        Self::bulging(corner, u, v, 0.0)
    }

    /// A parallelogram whose middle stands out.
    pub(crate) fn bulging(corner: V3, u: V3, v: V3, bulge: f64) -> Self {
        let corners = [corner, add(corner, u), add(corner, v), add(add(corner, u), v)];
        Self::Patch { corners, bulge, wave: None }
    }

    /// A cone from one point to another.
    pub(crate) fn cone(from: V3, to: V3, bottom: f64, top: f64) -> Self {
        Self::Frustum { base: from, axis: sub(to, from), bottom, top, toward: Z, arc: -1.0 }
    }

    /// The same shape elsewhere.
    pub(crate) fn moved(mut self, by: V3) -> Self {
        match &mut self {
            Self::Patch { corners, .. } => *corners = corners.map(|p| add(p, by)),
            Self::Frustum { base: p, .. }
            | Self::Leaf { base: p, .. }
            | Self::Disc { centre: p, .. }
            | Self::Ellipsoid { centre: p, .. }
            | Self::Ring { centre: p, .. }
            | Self::Foliage { centre: p, .. } => *p = add(*p, by),
        }
        self
    }

    /// Area, square meters; of folded, bent and elliptic pieces nearly.
    pub(crate) fn area(&self) -> f64 {
        match *self {
            Self::Patch { corners: [a, b, c, d], bulge, wave } => {
                let u = times(add(sub(b, a), sub(d, c)), 0.5);
                let v = times(add(sub(c, a), sub(d, b)), 0.5);
                let slope = wave.map_or(0.0, |w| 4.0 * w.amplitude * w.count / length(u).max(1e-3));
                length(cross(u, v)) * (1.0 + slope * slope).sqrt()
                    + bulge.abs() * (length(u) + length(v))
            }
            Self::Frustum { axis, bottom, top, arc, .. } => {
                let height = length(axis);
                let side = ((bottom - top) * (bottom - top) + height * height).sqrt();
                // The share of the circle, exact at −1, 0 and 1.
                PI * (bottom + top) * side * (1.0 - arc.clamp(-1.0, 0.9)) / 2.0
            }
            Self::Disc { u, v, hole, .. } => PI * length(u) * length(v) * (1.0 - hole * hole),
            Self::Ellipsoid { axes, from, to, boxy, .. } => {
                let [a, b, c] = axes.map(|v| dot(v, v));
                let round = 4.0 * PI * ((a * b + a * c + b * c) / 3.0).sqrt();
                round * (to - from) / 2.0 * (1.0 + 0.9 * boxy)
            }
            Self::Ring { u, v, rod, half, .. } => {
                let around = PI * (length(u) + length(v)) * if half { 0.5 } else { 1.0 };
                2.0 * PI * rod * around
            }
            // Both sides of a blade whose mean width is 2/3 of the largest.
            Self::Leaf { along, side, .. } => 2.0 * length(along) * length(side) * 4.0 / 3.0,
            // As if the leaves of a ball made three layers.
            Self::Foliage { radius, .. } => 12.0 * PI * radius * radius,
        }
    }

    /// The box along the axes around the surface.
    pub(crate) fn bounds(&self) -> Block {
        let around = Block::around;
        match *self {
            Self::Patch { corners, bulge, wave } => {
                let off = bulge.abs() + wave.map_or(0.0, |w| w.amplitude);
                let [a, b, c, d] = corners;
                let normal = unit_or(cross(sub(b, a), sub(c, a)), Z);
                // The normal of a twisted patch differs from place to place.
                let is_flat = dot(sub(d, a), normal).abs() < 1e-9;
                let normal = normal.map(|n| if is_flat { n.abs() * off } else { off });
                let Block { low, high } =
                    corners.map(Block::at).into_iter().fold(Block::at(a), Block::join);
                Block { low: sub(low, normal), high: add(high, normal) }
            }
            Self::Frustum { base, axis, bottom, top, .. } => {
                let w = unit_or(axis, Z);
                let ring = |at: V3, radius: f64| {
                    around(at, w.map(|c: f64| radius * (1.0 - c * c).max(0.0).sqrt()))
                };
                ring(base, bottom).join(ring(add(base, axis), top))
            }
            Self::Disc { centre, u, v, .. } => {
                around(centre, std::array::from_fn(|i| (u[i] * u[i] + v[i] * v[i]).sqrt()))
            }
            Self::Ellipsoid { centre, axes: [a, b, c], from, to, boxy, .. } => {
                let reach = |i: usize| -> f64 {
                    let round: f64 = (a[i] * a[i] + b[i] * b[i]).sqrt();
                    round + (a[i].abs() + b[i].abs() - round) * boxy
                };
                let ends = [times(c, from), times(c, to)];
                let reach: V3 = std::array::from_fn(reach);
                around(add(centre, ends[0]), reach).join(around(add(centre, ends[1]), reach))
            }
            Self::Ring { centre, u, v, rod, .. } => {
                let reach = |i: usize| (u[i] * u[i] + v[i] * v[i]).sqrt() + rod;
                around(centre, std::array::from_fn(reach))
            }
            Self::Leaf { base, along, side, droop } => {
                let tip = add(base, along);
                let low = add_times(tip, Z, -droop);
                let wide = side.map(f64::abs);
                around(base, wide).join(around(tip, wide)).join(around(low, wide))
            }
            Self::Foliage { centre, radius } => around(centre, [radius; 3]),
        }
    }

    /// A random point of the surface.
    pub(crate) fn sample(&self, rng: &mut SampleRng) -> SurfacePoint {
        match *self {
            Self::Patch { corners, bulge, wave } => {
                sample_patch(&corners, bulge, wave, [unit(rng), unit(rng)])
            }
            Self::Frustum { base, axis, bottom, top, toward, arc } => {
                sample_frustum(base, axis, [bottom, top], toward, arc, rng)
            }
            Self::Disc { centre, u, v, hole } => {
                let [c, s] = cos_sin(rng);
                let r = (hole * hole + unit(rng) * (1.0 - hole * hole)).sqrt();
                let out = add(times(u, c), times(v, s));
                SurfacePoint {
                    coord: add_times(centre, out, r),
                    normal: unit_or(cross(u, v), Z),
                    tangent: unit_or(sub(times(v, c), times(u, s)), Z),
                    st: [r * c * length(u), r * s * length(v)],
                    edge: (1.0 - r) * length(out),
                }
            }
            Self::Ellipsoid { centre, axes, from, to, boxy, inward } => {
                sample_ellipsoid(centre, &axes, [from, to], boxy, inward, rng)
            }
            Self::Ring { centre, u, v, rod, half } => {
                let [c, s] = cos_sin(rng);
                let s = if half { s.abs() } else { s };
                let radial = add(times(u, c), times(v, s));
                let out = unit_or(radial, Z);
                let [pc, ps] = cos_sin(rng);
                let normal = add(times(out, pc), times(unit_or(cross(u, v), Z), ps));
                SurfacePoint {
                    coord: add_times(add(centre, radial), normal, rod),
                    normal: unit_or(normal, Z),
                    tangent: unit_or(sub(times(v, c), times(u, s)), Z),
                    st: [c * length(u), s * length(v)],
                    edge: FAR,
                }
            }
            Self::Leaf { base, along, side, droop } => sample_leaf(base, along, side, droop, rng),
            Self::Foliage { centre, radius } => {
                let d = direction(rng);
                // Denser outside, hollow inside: the larger of two uniform numbers.
                let r = radius * unit(rng).max(unit(rng));
                let normal = direction(rng);
                SurfacePoint {
                    coord: add_times(centre, d, r),
                    normal,
                    tangent: basis(normal)[0],
                    st: [r * d[0], r * d[2]],
                    edge: FAR,
                }
            }
        }
    }
}

/// As the distance from an edge where there is no edge, meters.
pub(crate) const FAR: f64 = 1.0;

fn sample_patch(
    [a, b, c, d]: &[V3; 4],
    bulge: f64,
    wave: Option<Wave>,
    [s, t]: [f64; 2],
) -> SurfacePoint {
    let (low, high) = (mix(*a, *b, s), mix(*c, *d, s));
    let mut u = mix(sub(*b, *a), sub(*d, *c), t);
    let mut v = sub(high, low);
    let mut coord = mix(low, high, t);
    let normal = unit_or(cross(u, v), Z);
    let size = [length(u), length(v)];
    if bulge != 0.0 {
        let profile =
            |x: f64| 1.0 - (2.0 * x - 1.0) * (2.0 * x - 1.0) * (2.0 * x - 1.0) * (2.0 * x - 1.0);
        let slope = |x: f64| -8.0 * (2.0 * x - 1.0) * (2.0 * x - 1.0) * (2.0 * x - 1.0);
        coord = add_times(coord, normal, bulge * profile(s) * profile(t));
        u = add_times(u, normal, bulge * slope(s) * profile(t));
        v = add_times(v, normal, bulge * profile(s) * slope(t));
    }
    if let Some(wave) = wave {
        let (height, slope) = fold_at(wave.count * s + wave.phase);
        coord = add_times(coord, normal, wave.amplitude * height);
        u = add_times(u, normal, wave.amplitude * slope * wave.count);
    }
    let (to_u, to_v) = (s.min(1.0 - s) * size[0], t.min(1.0 - t) * size[1]);
    // A slender piece, or an edge, gives the direction.
    let along_v = if size[0] < 0.08 && size[1] > size[0] {
        true
    } else if size[1] < 0.08 {
        false
    } else {
        to_u < to_v
    };
    SurfacePoint {
        coord,
        normal: unit_or(cross(u, v), normal),
        tangent: unit_or(if along_v { v } else { u }, normal),
        st: [s * size[0], t * size[1]],
        edge: to_u.min(to_v),
    }
}

/// A wave of period 1 and height ±1 made of parabolas, and its slope.
fn fold_at(x: f64) -> (f64, f64) {
    let f = x - x.floor();
    if f < 0.5 {
        (16.0 * f * (0.5 - f), 8.0 - 32.0 * f)
    } else {
        (-16.0 * (f - 0.5) * (1.0 - f), 32.0 * f - 24.0)
    }
}

fn sample_frustum(
    base: V3,
    axis: V3,
    [bottom, top]: [f64; 2],
    toward: V3,
    arc: f64,
    rng: &mut SampleRng,
) -> SurfacePoint {
    let w = unit_or(axis, Z);
    let height = length(axis);
    let [mut u, mut v] = basis(w);
    if arc > -1.0 {
        u = unit_or(sub(toward, times(w, dot(toward, w))), u);
        v = cross(w, u);
    }
    let mut turn = cos_sin(rng);
    // A third of the circle or more always exists; a few tries end with very high probability.
    for _ in 0..64 {
        if turn[0] >= arc {
            break;
        }
        turn = cos_sin(rng);
    }
    let [c, s] = turn;
    let c = c.max(arc);
    // The radius of a uniform point: its square is uniform between the ends'.
    let share = unit(rng);
    let r = (bottom * bottom + share * (top * top - bottom * bottom)).max(0.0).sqrt();
    let along = if (top - bottom).abs() > 1e-6 { (r - bottom) / (top - bottom) } else { share };
    let radial = unit_or(add(times(u, c), times(v, s)), u);
    let slope = (bottom - top) / height.max(1e-6);
    // An angle in quarter turns that needs no trigonometry.
    let quarter = if s >= 0.0 { 1.0 - c } else { 3.0 + c };
    SurfacePoint {
        coord: add(add_times(base, w, along * height), times(radial, r)),
        normal: unit_or(add_times(radial, w, slope), radial),
        tangent: if height > 2.0 * bottom.max(top) { w } else { cross(w, radial) },
        st: [quarter * r * PI / 2.0, along * height],
        edge: along.min(1.0 - along) * height,
    }
}

fn sample_ellipsoid(
    centre: V3,
    axes: &[V3; 3],
    part: [f64; 2],
    boxy: f64,
    inward: bool,
    rng: &mut SampleRng,
) -> SurfacePoint {
    let z = part[0] + (part[1] - part[0]) * unit(rng);
    let [cos, sin] = cos_sin(rng);
    let r = (1.0 - z * z).max(0.0).sqrt();
    let round = [r * cos, r * sin, z];
    let most = round.iter().fold(0.0_f64, |m, v| m.max(v.abs())).max(1e-9);
    // On the box around it, stretched sideways only: `from..to` stays the part that is shown.
    let mut d = round;
    let mut n = round;
    if boxy > 0.0 {
        let face: V3 = round.map(|v| if v.abs() >= most - 1e-12 { v.signum() } else { 0.0 });
        d = mix(round, times(round, 1.0 / most), boxy);
        d = [d[0], d[1], d[2].clamp(part[0], part[1])];
        n = mix(round, face, boxy);
    }
    let coord = (0..3).fold(centre, |p, i| add_times(p, axes[i], d[i]));
    let normal = (0..3)
        .fold([0.0; 3], |p, i| add_times(p, axes[i], n[i] / dot(axes[i], axes[i]).max(1e-12)));
    let normal = unit_or(normal, Z);
    SurfacePoint {
        coord,
        normal: if inward { times(normal, -1.0) } else { normal },
        tangent: basis(normal)[0],
        st: [d[0] * length(axes[0]), d[1] * length(axes[1]) + d[2] * length(axes[2])],
        edge: FAR,
    }
}

fn sample_leaf(base: V3, along: V3, side: V3, droop: f64, rng: &mut SampleRng) -> SurfacePoint {
    // Widest in the middle: the mean of two uniform numbers is there most often.
    let s = (unit(rng) + unit(rng)) / 2.0;
    let width = 4.0 * s * (1.0 - s);
    let t = (2.0 * unit(rng) - 1.0) * width;
    let coord = add_times(add_times(add_times(base, along, s), side, t), Z, -droop * s * s);
    let direction = add_times(along, Z, -2.0 * droop * s);
    SurfacePoint {
        coord,
        normal: unit_or(cross(direction, side), Z),
        tangent: unit_or(direction, Z),
        st: [s * length(along), t * length(side)],
        edge: (width - t.abs()) * length(side),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::sample_rng;

    fn some_of_each() -> Vec<Shape> {
        let (x, y) = ([0.6, 0.0, 0.1], [0.0, 0.4, 0.2]);
        vec![
            Shape::flat([1.0, 2.0, 3.0], x, y),
            Shape::bulging([0.0; 3], x, y, 0.05),
            Shape::Patch {
                corners: [[0.0; 3], x, [0.1, 0.4, 0.1], [0.5, 0.5, 0.3]],
                bulge: -0.02,
                wave: Some(Wave { amplitude: 0.03, count: 4.0, phase: 0.3 }),
            },
            Shape::cone([0.1, 0.2, 0.3], [0.3, 0.1, 0.9], 0.2, 0.05),
            Shape::cone([0.1, 0.2, 0.3], [0.9, 0.2, 0.3], 0.02, 0.02),
            Shape::Frustum {
                base: [0.0; 3],
                axis: [0.0, 0.0, 0.5],
                bottom: 0.3,
                top: 0.4,
                toward: [0.0, -1.0, 0.0],
                arc: 0.2,
            },
            Shape::Disc { centre: [0.0; 3], u: x, v: y, hole: 0.4 },
            Shape::Ellipsoid {
                centre: [0.5; 3],
                axes: [[0.3, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.1]],
                from: -1.0,
                to: 0.2,
                boxy: 0.6,
                inward: true,
            },
            Shape::Ring { centre: [0.0; 3], u: x, v: y, rod: 0.02, half: true },
            Shape::Leaf {
                base: [0.0; 3],
                along: [0.3, 0.0, 0.2],
                side: [0.0, 0.05, 0.0],
                droop: 0.2,
            },
            Shape::Foliage { centre: [0.2; 3], radius: 0.3 },
        ]
    }

    #[test]
    fn points_are_inside_the_bounds_with_unit_normals_and_tangents() {
        let mut rng = sample_rng(3, 1, 4);
        for shape in some_of_each() {
            let Block { low, high } = shape.bounds();
            assert!(shape.area() > 0.0, "{shape:?}");
            for _ in 0..2000 {
                let p = shape.sample(&mut rng);
                for i in 0..3 {
                    let inside = low[i] - 1e-9..=high[i] + 1e-9;
                    assert!(inside.contains(&p.coord[i]), "{shape:?} {p:?} {low:?} {high:?}");
                }
                assert!((length(p.normal) - 1.0).abs() < 1e-9, "{shape:?}");
                assert!((length(p.tangent) - 1.0).abs() < 1e-9, "{shape:?}");
                assert!(p.st.iter().all(|v| v.is_finite()) && p.edge.is_finite());
            }
        }
    }

    #[test]
    fn areas_of_plain_shapes() {
        let flat = Shape::flat([0.0; 3], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0]);
        assert_eq!(flat.area(), 6.0);
        let tube = Shape::cone([0.0; 3], [0.0, 0.0, 2.0], 0.5, 0.5);
        assert!((tube.area() - 2.0 * PI).abs() < 1e-12);
        let ball = Shape::Ellipsoid {
            centre: [0.0; 3],
            axes: [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]],
            from: -1.0,
            to: 1.0,
            boxy: 0.0,
            inward: false,
        };
        assert!((ball.area() - 16.0 * PI).abs() < 1e-12);
    }

    #[test]
    fn degenerate_shapes_give_numbers() {
        let mut rng = sample_rng(3, 1, 5);
        let shapes = [
            Shape::flat([0.0; 3], [0.0; 3], [0.0; 3]),
            Shape::cone([0.0; 3], [0.0; 3], 0.0, 0.0),
            Shape::Foliage { centre: [0.0; 3], radius: 0.0 },
            Shape::Leaf { base: [0.0; 3], along: [0.0; 3], side: [0.0; 3], droop: 0.0 },
        ];
        for shape in shapes {
            let p = shape.sample(&mut rng);
            let all = [p.coord, p.normal, p.tangent];
            assert!(all.iter().flatten().all(|v| v.is_finite()), "{shape:?} {p:?}");
        }
    }
}
