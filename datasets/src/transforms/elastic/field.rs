//! A smooth random displacement field.

use super::deform::Matrix;
use crate::error::require;
use crate::rng::normals;
use crate::{DataError, SampleRng};

/// Nodes of the largest field: 192 MiB of noise. A 6 m chunk has 10⁵ at the finest granularity in use.
const MAX_NODES: f64 = (1 << 24) as f64;

/// Displacements at the nodes of a grid, whose node 1 is at the lowest corner of the scene.
pub(super) struct Field {
    low: [f64; 3],
    granularity: f64,
    size: [usize; 3],
    /// Along x slowest, z fastest. `[size, 3]`
    values: Vec<[f32; 3]>,
}

impl Field {
    /// Draws a field over a bounding box.
    pub(super) fn random(
        [low, high]: [[f32; 3]; 2],
        granularity: f64,
        magnitude: f64,
        rng: &mut SampleRng,
    ) -> Result<Self, DataError> {
        let low = low.map(f64::from);
        let extent: [f64; 3] = std::array::from_fn(|a| f64::from(high[a]) - low[a]);
        let nodes = extent.map(|e| (e / granularity).floor() + 3.0);
        let value = format!("{granularity} m, for a scene of {extent:?} m,");
        let expected = "a coarser one, or a smaller scene (cut it into chunks, or remove outliers)";
        let ok = nodes.iter().product::<f64>() <= MAX_NODES;
        require(ok, "elastic_distortion.granularity", value, expected)?;
        let size = nodes.map(|n| n as usize);
        let mut values = vec![[0.0; 3]; size.iter().product()];
        let flat = values.as_flattened_mut();
        normals(rng, flat.len(), |i, x| flat[i] = (x * magnitude) as f32);
        let mut field = Self { low, granularity, size, values };
        for _ in 0..2 {
            (0..3).for_each(|axis| field.smooth(axis));
        }
        Ok(field)
    }

    /// The mean of three neighbors along an axis, zero beyond the ends.
    fn smooth(&mut self, axis: usize) {
        let stride: usize = self.size[axis + 1..].iter().product();
        let length = self.size[axis];
        let mut line = vec![[0.0; 3]; length + 2];
        for first in (0..self.values.len()).step_by(stride * length) {
            for start in first..first + stride {
                for i in 0..length {
                    line[i + 1] = self.values[start + i * stride];
                }
                for i in 0..length {
                    let sum = |c: usize| line[i][c] + line[i + 1][c] + line[i + 2][c];
                    self.values[start + i * stride] = std::array::from_fn(|c| sum(c) / 3.0);
                }
            }
        }
    }

    /// The displacement of a place and its gradient `∂dᵢ/∂xⱼ`; beyond the grid those of its edge.
    pub(super) fn at(&self, coord: [f32; 3]) -> ([f64; 3], Matrix) {
        let mut node = [0; 3];
        let mut part = [0.0; 3];
        let mut inside = [1.0; 3];
        for a in 0..3 {
            let place = (f64::from(coord[a]) - self.low[a]) / self.granularity + 1.0;
            let last = (self.size[a] - 1) as f64;
            inside[a] = if (0.0..=last).contains(&place) { 1.0 / self.granularity } else { 0.0 };
            let place = place.clamp(0.0, last);
            node[a] = (place as usize).min(self.size[a] - 2);
            part[a] = place - node[a] as f64;
        }
        let mut displacement = [0.0; 3];
        let mut gradient = [[0.0; 3]; 3];
        for corner in 0..8_usize {
            let bit: [usize; 3] = [corner >> 2 & 1, corner >> 1 & 1, corner & 1];
            let weight: [f64; 3] =
                std::array::from_fn(|a| if bit[a] == 1 { part[a] } else { 1.0 - part[a] });
            let slope: [f64; 3] =
                std::array::from_fn(|a| if bit[a] == 1 { inside[a] } else { -inside[a] });
            let [x, y, z]: [usize; 3] = std::array::from_fn(|a| node[a] + bit[a]);
            let value = self.values[(x * self.size[1] + y) * self.size[2] + z].map(f64::from);
            for i in 0..3 {
                displacement[i] += weight[0] * weight[1] * weight[2] * value[i];
                gradient[i][0] += slope[0] * weight[1] * weight[2] * value[i];
                gradient[i][1] += weight[0] * slope[1] * weight[2] * value[i];
                gradient[i][2] += weight[0] * weight[1] * slope[2] * value[i];
            }
        }
        (displacement, gradient)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_rng;

    fn field(high: [f32; 3]) -> Field {
        Field::random([[0.0; 3], high], 0.5, 1.0, &mut sample_rng(1, 0, 0)).unwrap()
    }

    #[test]
    fn sizes_follow_the_extent() {
        assert_eq!(field([0.0; 3]).size, [3; 3]);
        assert_eq!(field([1.0, 0.9, 2.6]).size, [5, 4, 8]);
    }

    #[test]
    fn smoothing_by_hand() {
        let mut field = field([0.0; 3]);
        field.values.fill([0.0; 3]);
        field.values[13] = [27.0, 0.0, 54.0];
        (0..3).for_each(|axis| field.smooth(axis));
        assert!(field.values.iter().all(|v| *v == [1.0, 0.0, 2.0]), "a box of 3³ nodes");
        field.smooth(2);
        let third = 2.0 / 3.0;
        assert_eq!(field.values[..3].iter().map(|v| v[0]).collect::<Vec<_>>(), [third, 1.0, third]);
    }

    #[test]
    fn nodes_have_their_values_and_gradients_are_slopes() {
        let field = field([2.0; 3]);
        let (value, _) = field.at([0.5, 1.0, 0.0]);
        let node = field.values[(2 * field.size[1] + 3) * field.size[2] + 1];
        assert!((0..3).all(|i| (value[i] - f64::from(node[i])).abs() < 1e-12));
        let place = [0.6_f32, 1.3, 0.2];
        let (_, gradient) = field.at(place);
        let h = 1.0 / 64.0;
        for axis in 0..3 {
            let (mut a, mut b) = (place, place);
            a[axis] -= h;
            b[axis] += h;
            let (below, above) = (field.at(a).0, field.at(b).0);
            let step = f64::from(b[axis]) - f64::from(a[axis]);
            for i in 0..3 {
                let slope = (above[i] - below[i]) / step;
                assert!((slope - gradient[i][axis]).abs() < 1e-9, "{slope} {}", gradient[i][axis]);
            }
        }
        let (outside, flat) = field.at([-90.0, 1.0, 1.0]);
        assert_eq!((outside, flat.map(|row| row[0])), (field.at([-0.5, 1.0, 1.0]).0, [0.0; 3]));
    }
}
