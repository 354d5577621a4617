//! The room that speeds are measured on, made from a fixed seed: the same on every machine.
//!
//! `scenesplat bench` and the benchmarks time the same work by it. For rooms with labels and colors see
//! `scenesplat-rooms`.

use crate::random::unit;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use std::collections::HashSet;

/// Side of a voxel, meters.
pub const VOXEL: f32 = 0.02;
/// Side of the cells that are sorted along curves, meters: 11 bits an axis for a million points.
const FINE_CELL: f32 = 0.003;
/// Standard deviation of the distance of a point from its surface, meters. With it and the density
/// below, a voxel has 14 occupied voxels in the 3³ around it, as in the scans the networks read.
const NOISE: f32 = 0.008;
/// Occupied voxels per square meter of surface.
const VOXELS_PER_M2: f32 = 3650.0;
/// Points per square meter that occupy so many voxels, two a voxel.
const POINTS_PER_M2: f32 = 6850.0;
/// Keeps noise on the walls above zero, meters.
const MARGIN: f32 = 0.1;

/// `n` distinct voxels in random order, indices from 0. `[n, 3]`
pub fn voxels(n: usize) -> Vec<[i32; 3]> {
    let mut room = Room::new(n, n as f32 / VOXELS_PER_M2);
    let mut taken = HashSet::with_capacity(n);
    let mut out = Vec::with_capacity(n);
    // Some two points a voxel: the density was chosen so.
    while out.len() < n {
        let voxel = cell(room.point(), VOXEL);
        if taken.insert(voxel) {
            out.push(voxel);
        }
    }
    out
}

/// `n` points on the surfaces of a room, meters, in random order. `[n, 3]`
pub fn points(n: usize) -> Vec<[f32; 3]> {
    let mut room = Room::new(n, n as f32 / POINTS_PER_M2);
    (0..n).map(|_| room.point()).collect()
}

/// Cells of `n` points, small enough that few share one, in random order. `[n, 3]`
pub fn fine_cells(n: usize) -> Vec<[i32; 3]> {
    points(n).into_iter().map(|p| cell(p, FINE_CELL)).collect()
}

/// Values in -1..1, the same for each `n` and `seed`.
pub fn values(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| between(&mut rng, -1.0, 1.0)).collect()
}

/// A number in `low..high`, one of 2²³ steps.
fn between(rng: &mut ChaCha8Rng, low: f32, high: f32) -> f32 {
    let share = (rng.next_u32() >> 9) as f32 / (1_u32 << 23) as f32;
    share * (high - low) + low
}

fn cell(point: [f32; 3], side: f32) -> [i32; 3] {
    point.map(|v| (v / side) as i32)
}

/// A rectangle: a corner, its two edges, and the axis across it.
struct Face {
    corner: [f32; 3],
    size: [f32; 3],
    across: usize,
}

/// Surfaces to draw points from.
struct Room {
    faces: Vec<Face>,
    /// Area of all faces up to this one, as a share of the whole.
    until: Vec<f32>,
    rng: ChaCha8Rng,
}

impl Room {
    /// A room with boxes on its floor that has `area` square meters of surface; `n`, the number of
    /// rows wanted of it, decides how many boxes.
    fn new(n: usize, area: f32) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut boxes = vec![([0.0; 3], [6.0, 5.0, 2.6])];
        for _ in 0..(n / 8000).clamp(2, 12) {
            let low = [between(&mut rng, 0.0, 5.0), between(&mut rng, 0.0, 4.0), 0.0];
            boxes.push((low, [1.0, 1.0, 1.5].map(|most| between(&mut rng, 0.3, most))));
        }
        let mut faces = Vec::new();
        for (corner, size) in boxes {
            for across in 0..3 {
                for side in [0.0, size[across]] {
                    let (mut corner, mut size) = (corner, size);
                    corner[across] += side;
                    size[across] = 0.0;
                    faces.push(Face { corner, size, across });
                }
            }
        }
        let total: f32 = faces.iter().map(Face::area).sum();
        let scale = (area / total).sqrt();
        let mut sum = 0.0;
        let until = faces.iter().map(|face| {
            sum += face.area() / total;
            sum
        });
        let until = until.collect();
        for face in &mut faces {
            face.corner = face.corner.map(|v| v * scale + MARGIN);
            face.size = face.size.map(|v| v * scale);
        }
        Self { faces, until, rng }
    }

    /// The next point.
    fn point(&mut self) -> [f32; 3] {
        let at = unit(&mut self.rng) as f32;
        // Rounding may leave the last share a little below 1.
        let index = self.until.partition_point(|&u| u <= at).min(self.faces.len() - 1);
        let face = &self.faces[index];
        let mut point: [f32; 3] =
            std::array::from_fn(|i| face.corner[i] + face.size[i] * unit(&mut self.rng) as f32);
        // A normal deviate by Box and Muller; the logarithm of 0 is kept away.
        let radius = (-2.0 * (1.0 - unit(&mut self.rng) as f32).ln()).sqrt();
        let noise = NOISE * radius * (std::f32::consts::TAU * unit(&mut self.rng) as f32).cos();
        point[face.across] += noise;
        point.map(|v| v.max(0.0))
    }
}

impl Face {
    fn area(&self) -> f32 {
        let [a, b] = [(self.across + 1) % 3, (self.across + 2) % 3];
        self.size[a] * self.size[b]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid_sample::{KeyOrder, voxel_groups};
    use crate::kernel_map::KernelMap;

    #[test]
    fn the_room_is_as_full_as_a_scan() {
        for n in [2000, 20_000, 100_000] {
            let voxels = voxels(n);
            let map = KernelMap::build(&voxels, &[0, n], 3).unwrap();
            let taps = map.num_pairs() as f64 / n as f64;
            assert!(!map.has_duplicates() && (13.0..16.0).contains(&taps), "{n}: {taps}");
            assert!(voxels.iter().flatten().all(|&v| (0..2048).contains(&v)));
        }
        assert_eq!(voxels(2000), voxels(2000));
        let groups = voxel_groups(&points(100_000), 0.02, KeyOrder::Morton).unwrap();
        let share = groups.num_voxels() as f64 / 1e5;
        assert!((0.48..0.56).contains(&share), "{share}");
    }
}
