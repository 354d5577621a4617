//! How a piece in a room differs from the model of a catalogue that it is of: another width, depth and
//! height, other colors. A catalogue has five sofas; homes have not.

use crate::dice::between;
use crate::shape::{Block, SurfacePoint};
use crate::vector::{V3, Z, length, unit_or};
use scenesplat_kernels::random::{SampleRng, unit};

/// All sides together, and each by itself, by a factor between these.
const SIZE: [f64; 2] = [0.9, 1.1];
const SIDE: [f64; 2] = [0.88, 1.14];

/// Colors keep this to that much of their distance from gray, and of their light.
const SATURATION: [f64; 2] = [0.4, 1.4];
const LIGHT: [f64; 2] = [0.6, 1.25];

/// Tangent of half the largest turn of the hue (90 degrees); small turns are likelier.
const HUE: f64 = 1.0;

/// What is changed of a model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Variation {
    /// Along the axes of the model.
    stretch: V3,
    /// Rows of a matrix of colors.
    color: [V3; 3],
}

/// A box of a model as it is in the room.
pub(crate) fn varied(block: Block, by: Option<&Variation>) -> Block {
    by.map_or(block, |by| by.block(block))
}

impl Variation {
    /// Another size, unless it is to fit a hole, and other colors.
    pub(crate) fn draw(keeps_size: bool, rng: &mut SampleRng) -> Self {
        let all = between(rng, SIZE[0], SIZE[1]);
        let sides: V3 = std::array::from_fn(|_| all * between(rng, SIDE[0], SIDE[1]));
        let half = HUE * (2.0 * unit(rng) - 1.0) * unit(rng);
        let saturation = between(rng, SATURATION[0], SATURATION[1]);
        let light = between(rng, LIGHT[0], LIGHT[1]);
        Self {
            stretch: if keeps_size { [1.0; 3] } else { sides },
            color: colors(half, saturation, light),
        }
    }

    fn block(&self, block: Block) -> Block {
        Block { low: self.place(block.low), high: self.place(block.high) }
    }

    /// A place of the model, here.
    pub(crate) fn place(&self, p: V3) -> V3 {
        std::array::from_fn(|i| p[i] * self.stretch[i])
    }

    /// What a piece of the surface grows by, square meters a square meter, by its unit normal.
    pub(crate) fn growth(&self, normal: V3) -> f64 {
        let [x, y, z] = self.stretch;
        length(self.turned(normal)) * x * y * z
    }

    pub(crate) fn point(&self, point: SurfacePoint) -> SurfacePoint {
        let least = self.stretch.into_iter().fold(f64::INFINITY, f64::min);
        SurfacePoint {
            coord: self.place(point.coord),
            normal: unit_or(self.turned(point.normal), Z),
            tangent: unit_or(self.place(point.tangent), point.tangent),
            edge: point.edge * least,
            ..point
        }
    }

    /// A color, 0..=255.
    pub(crate) fn color(&self, color: V3) -> V3 {
        self.color
            .map(|row| (0..3).map(|i| row[i] * color[i]).sum::<f64>())
            .map(|c| c.clamp(0.0, 255.0))
    }

    /// A normal, not of length 1.
    fn turned(&self, normal: V3) -> V3 {
        std::array::from_fn(|i| normal[i] / self.stretch[i])
    }
}

/// Turns hues about gray by the angle whose half has this tangent, then moves colors from or to gray.
fn colors(half: f64, saturation: f64, light: f64) -> [V3; 3] {
    let square = half * half;
    let (cos, sin) = ((1.0 - square) / (1.0 + square), 2.0 * half / (1.0 + square));
    let across = sin / 3.0_f64.sqrt();
    let even = (1.0 - cos) / 3.0;
    // Rodrigues' formula about (1, 1, 1).
    let turn = [
        [cos + even, even - across, even + across],
        [even + across, cos + even, even - across],
        [even - across, even + across, cos + even],
    ];
    turn.map(|row| row.map(|v| light * ((1.0 - saturation) / 3.0 + saturation * v)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::{cross, dot};
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn grey_stays_grey_and_light_is_kept_but_for_its_factor() {
        for (half, saturation, light) in [(0.7, 1.3, 0.8), (-1.0, 0.4, 1.2), (0.0, 1.0, 1.0)] {
            let of = Variation { stretch: [1.0; 3], color: colors(half, saturation, light) };
            let grey = of.color([100.0; 3]);
            assert!(grey.iter().all(|c| (c - 100.0 * light).abs() < 1e-9), "{grey:?}");
            let [r, g, b] = of.color([90.0, 100.0, 110.0]);
            assert!((r + g + b - 300.0 * light).abs() < 1e-9);
            // The distance from gray grows by the saturation, whatever the turn.
            let far = [r, g, b].iter().map(|c| (c - 100.0 * light).powi(2)).sum::<f64>().sqrt();
            assert!((far - 200.0_f64.sqrt() * saturation * light).abs() < 1e-9, "{far}");
        }
        let third = Variation { stretch: [1.0; 3], color: colors(3.0_f64.sqrt(), 1.0, 1.0) };
        let green = third.color([200.0, 0.0, 0.0]);
        assert!((green[1] - 200.0).abs() < 1e-9 && green[0].abs() < 1e-9, "120 degrees: {green:?}");
    }

    #[test]
    fn a_stretched_triangle_has_its_normal_and_area() {
        let mut rng = sample_rng(5, 0, 0);
        for _ in 0..50 {
            let of = Variation::draw(false, &mut rng);
            let corner = |rng: &mut SampleRng| -> V3 { std::array::from_fn(|_| unit(rng) - 0.5) };
            let (u, v) = (corner(&mut rng), corner(&mut rng));
            let (was, is) = (cross(u, v), cross(of.place(u), of.place(v)));
            let normal = unit_or(was, Z);
            assert!((of.growth(normal) - length(is) / length(was)).abs() < 1e-9);
            let point =
                SurfacePoint { coord: u, normal, tangent: unit_or(u, Z), st: [0.0; 2], edge: 1.0 };
            let point = of.point(point);
            assert!(dot(point.normal, unit_or(is, Z)) > 1.0 - 1e-9);
            assert!(dot(point.normal, point.tangent).abs() < 1e-9);
            assert!(point.edge < 1.3 && point.edge > 0.78);
        }
        let fixed = Variation::draw(true, &mut rng);
        assert_eq!(fixed.place([1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
    }
}
