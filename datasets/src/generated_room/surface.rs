//! Surfaces that Gaussians are scattered on.

use crate::rng::{SampleRng, cos_sin, direction, unit};

/// A point of a surface.
pub(super) struct SurfacePoint {
    pub(super) coord: [f64; 3],
    /// Unit, outwards.
    pub(super) normal: [f64; 3],
    /// sRGB 0..=255.
    pub(super) color: [f64; 3],
}

/// A shape in the room, z up, metres.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// Parallelogram `corner + s u + t v`; its normal is `u × v`.
    Quad { corner: [f64; 3], u: [f64; 3], v: [f64; 3] },
    /// Upright tube without caps.
    Tube { base: [f64; 3], radius: f64, height: f64 },
    /// Level disc, normal up.
    Disc { centre: [f64; 3], radius: f64 },
    /// Upright cone without floor: radius at the bottom and at the top.
    Cone { base: [f64; 3], bottom: f64, top: f64, height: f64 },
    /// Sphere.
    Ball { centre: [f64; 3], radius: f64 },
    /// Leaves: points throughout a ball, in all directions.
    Foliage { centre: [f64; 3], radius: f64 },
}

/// How colour varies over a surface.
#[derive(Debug, Clone, Copy)]
pub(super) enum Pattern {
    Plain,
    /// Boards of this width along `u`, metres.
    Boards(f64),
    /// Squares of this size, metres, and the second colour.
    Checks(f64, [f64; 3]),
    /// Upright stripes of this width, each with its own colour: the backs of books.
    Books(f64),
}

/// A shape with what it is made of and whom it belongs to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    pub(super) shape: Shape,
    pub(super) color: [f64; 3],
    pub(super) pattern: Pattern,
    pub(super) class: usize,
    pub(super) instance: i32,
    /// Gaussians per area, relative to a plain wall.
    pub(super) density: f64,
}

impl Surface {
    pub(super) fn area(&self) -> f64 {
        use std::f64::consts::PI;
        match self.shape {
            Shape::Quad { u, v, .. } => length(cross(u, v)),
            Shape::Tube { radius, height, .. } => 2.0 * PI * radius * height,
            Shape::Disc { radius, .. } => PI * radius * radius,
            Shape::Cone { bottom, top, height, .. } => {
                PI * (bottom + top) * ((bottom - top) * (bottom - top) + height * height).sqrt()
            }
            Shape::Ball { radius, .. } => 4.0 * PI * radius * radius,
            // As if the leaves of a ball made three layers.
            Shape::Foliage { radius, .. } => 12.0 * PI * radius * radius,
        }
    }

    pub(super) fn sample(&self, rng: &mut SampleRng) -> SurfacePoint {
        let (coord, normal, [s, t]) = match self.shape {
            Shape::Quad { corner, u, v } => {
                let (s, t) = (unit(rng), unit(rng));
                let normal = cross(u, v);
                let norm = length(normal).max(1e-12);
                let coord = std::array::from_fn(|a| corner[a] + s * u[a] + t * v[a]);
                (coord, normal.map(|n| n / norm), [s * length(u), t * length(v)])
            }
            Shape::Tube { base, radius, height } => {
                let [x, y] = cos_sin(rng);
                let z = unit(rng) * height;
                let coord = [base[0] + radius * x, base[1] + radius * y, base[2] + z];
                (coord, [x, y, 0.0], [radius * x, z])
            }
            Shape::Disc { centre, radius } => {
                let [x, y] = cos_sin(rng);
                let r = radius * unit(rng).sqrt();
                ([centre[0] + r * x, centre[1] + r * y, centre[2]], [0.0, 0.0, 1.0], [r * x, r * y])
            }
            Shape::Cone { base, bottom, top, height } => {
                let [x, y] = cos_sin(rng);
                // The radius of a uniform point: its square is uniform between the ends'.
                let r = (bottom * bottom + unit(rng) * (top * top - bottom * bottom)).sqrt();
                let z = height * (r - bottom) / (top - bottom);
                let slope = (bottom - top) / height;
                let norm = (1.0 + slope * slope).sqrt();
                let coord = [base[0] + r * x, base[1] + r * y, base[2] + z];
                (coord, [x / norm, y / norm, slope / norm], [r * x, z])
            }
            Shape::Ball { centre, radius } => {
                let d = direction(rng);
                let coord = std::array::from_fn(|a| centre[a] + radius * d[a]);
                (coord, d, [radius * d[0], radius * d[2]])
            }
            Shape::Foliage { centre, radius } => {
                let d = direction(rng);
                // Denser outside, hollow inside: the larger of two uniform numbers.
                let r = radius * unit(rng).max(unit(rng));
                let coord = std::array::from_fn(|a| centre[a] + r * d[a]);
                (coord, direction(rng), [r * d[0], r * d[2]])
            }
        };
        SurfacePoint { coord, normal, color: self.color_at(s, t) }
    }

    fn color_at(&self, s: f64, t: f64) -> [f64; 3] {
        match self.pattern {
            Pattern::Plain => self.color,
            Pattern::Boards(width) => {
                let shade = 18.0 * (scramble((t / width).floor()) - 0.5);
                // Dark joints between boards.
                let joint = if (t / width).fract().abs() < 0.04 { -35.0 } else { 0.0 };
                self.color.map(|c| c + shade + joint)
            }
            Pattern::Checks(size, other) => {
                let odd = ((s / size).floor() + (t / size).floor()).rem_euclid(2.0) >= 1.0;
                if odd { other } else { self.color }
            }
            Pattern::Books(width) => {
                let book = (s / width).floor();
                let [r, g, b] = [0.0, 0.3, 0.7].map(|k| 40.0 + 190.0 * scramble(book * 3.0 + k));
                [r, g * 0.8, b * 0.9]
            }
        }
    }
}

/// A fixed pseudo-random number in 0..1 for a number.
fn scramble(value: f64) -> f64 {
    // The finisher of splitmix64: neighbouring numbers share nothing.
    let mut bits = ((value * 16.0) as i64).cast_unsigned().wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((bits ^ bits >> 31) >> 40) as f64 / f64::from(1 << 24)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
