//! Where a scene is: all of it, and the part that is not stray.

use crate::quantile::{quantile, rank};
use rayon::prelude::*;
use serde::Serialize;

/// Share of the rows, at each end of an axis, that the core leaves out: so many may be stray.
const OUTSIDE_CORE: f64 = 0.1;

/// The robust box is looked for within this many largest sides of the core around it. Real objects
/// and rooms lie within half a side; terrain and open scenes thin out beyond.
const REACH: f64 = 1.0;

/// Share of the rows within reach, at each end of an axis, that the robust box leaves out.
const FRINGE: f64 = 0.005;

/// An axis-aligned box, in units of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bounds {
    /// Smallest coordinates.
    pub low: [f64; 3],
    /// Largest coordinates.
    pub high: [f64; 3],
}

impl Bounds {
    /// Length along each axis.
    pub fn extent(&self) -> [f64; 3] {
        [0, 1, 2].map(|a| self.high[a] - self.low[a])
    }

    /// Longest side.
    pub fn largest_extent(&self) -> f64 {
        self.extent().into_iter().fold(0.0, f64::max)
    }

    /// Shortest side.
    pub fn smallest_extent(&self) -> f64 {
        self.extent().into_iter().fold(f64::INFINITY, f64::min)
    }

    /// Length of the diagonal.
    pub fn diagonal(&self) -> f64 {
        self.extent().iter().map(|e| e * e).sum::<f64>().sqrt()
    }

    /// Distance of a point from the box, 0 inside.
    pub fn distance(&self, point: [f32; 3]) -> f64 {
        let squared: f64 = (0..3)
            .map(|a| {
                let p = f64::from(point[a]);
                (self.low[a] - p).max(p - self.high[a]).max(0.0).powi(2)
            })
            .sum();
        squared.sqrt()
    }

    /// The box grown by a length on every side.
    pub fn grown(&self, by: f64) -> Self {
        Self { low: self.low.map(|v| v - by), high: self.high.map(|v| v + by) }
    }

    fn contains(&self, point: [f32; 3]) -> bool {
        (0..3).all(|a| (self.low[a]..=self.high[a]).contains(&f64::from(point[a])))
    }
}

/// Bounds of all rows, whose coordinates are finite; from infinity down to −infinity without any.
pub fn raw_bounds(coord: &[[f32; 3]]) -> Bounds {
    let parts = coord.par_chunks(1 << 14).map(|part| bounding_box(part.iter().copied()));
    let (low, high) = parts.reduce(|| EMPTY_BOX, joined_box);
    Bounds { low: low.map(f64::from), high: high.map(f64::from) }
}

/// Lowest and highest corner around nothing.
pub(crate) const EMPTY_BOX: ([f32; 3], [f32; 3]) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);

/// Lowest and highest corner of the box around some points.
pub fn bounding_box(coord: impl Iterator<Item = [f32; 3]>) -> ([f32; 3], [f32; 3]) {
    coord.fold(EMPTY_BOX, |bounds, p| joined_box(bounds, (p, p)))
}

/// The box around both.
pub(crate) fn joined_box(a: ([f32; 3], [f32; 3]), b: ([f32; 3], [f32; 3])) -> ([f32; 3], [f32; 3]) {
    ([0, 1, 2].map(|i| a.0[i].min(b.0[i])), [0, 1, 2].map(|i| a.1[i].max(b.1[i])))
}

/// The box that holds the scene without what is stray.
///
/// Its core spans the quantiles 10 % to 90 % of each axis; the box spans nearly all rows that lie
/// within one largest side of the core around it. Nothing that fewer than a tenth of the rows do can
/// move it by more than that. Without rows it is a point.
pub fn robust_bounds(coord: &[[f32; 3]]) -> Bounds {
    let mut core = between(coord, OUTSIDE_CORE);
    if core.largest_extent() == 0.0 {
        // Most rows are in one place.
        core = between(coord, 0.02);
    }
    if core.largest_extent() == 0.0 {
        core = between(coord, 0.0);
    }
    let zone = core.grown(REACH * core.largest_extent());
    let near: Vec<[f32; 3]> =
        coord.par_iter().with_min_len(1 << 14).copied().filter(|c| zone.contains(*c)).collect();
    // The core's own rows are in the zone axis by axis, but perhaps no row is on all three axes.
    if near.is_empty() { core } else { between(&near, fringe(near.len())) }
}

/// Few rows leave nothing out.
fn fringe(rows: usize) -> f64 {
    if rank(rows, FRINGE) < 2 { 0.0 } else { FRINGE }
}

fn between(coord: &[[f32; 3]], outside: f64) -> Bounds {
    let sides: Vec<(f64, f64)> = (0..3usize)
        .into_par_iter()
        .map(|axis| {
            let mut values: Vec<f32> = coord.iter().map(|c| c[axis]).collect();
            let low = quantile(&mut values, outside).unwrap_or(0.0);
            let high = quantile(&mut values, 1.0 - outside).unwrap_or(0.0);
            (f64::from(low), f64::from(high))
        })
        .collect();
    Bounds { low: [0, 1, 2].map(|a| sides[a].0), high: [0, 1, 2].map(|a| sides[a].1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Vec<[f32; 3]> {
        (0..1000u16).map(|i| [i % 10, i / 10 % 10, i / 100].map(f32::from)).collect()
    }

    #[test]
    fn a_tenth_of_stray_rows_does_not_move_the_box() {
        let clean = robust_bounds(&grid());
        assert_eq!((clean.low, clean.high), ([0.0; 3], [9.0; 3]));
        let mut coord = grid();
        coord.extend((0..99).map(|i| [1e6, 5.0 + i as f32, -1e30]));
        assert_eq!(robust_bounds(&coord), clean);
        assert_eq!(raw_bounds(&coord).high[0], 1e6);
    }

    #[test]
    fn points_lines_and_clumps() {
        let one = robust_bounds(&[[3.0, -2.0, 1.0]]);
        assert_eq!((one.largest_extent(), one.low), (0.0, [3.0, -2.0, 1.0]));
        let line: Vec<[f32; 3]> = (0..500).map(|i| [i as f32, 1.0, 1.0]).collect();
        assert_eq!(robust_bounds(&line).extent()[1..], [0.0, 0.0]);
        assert!(robust_bounds(&line).extent()[0] > 450.0);
        // 97 % in one place; what is left is not mistaken for nothing.
        let mut clump = vec![[0.0; 3]; 9_700];
        clump.extend((0..300).map(|i| [i as f32, 0.0, 0.0]));
        assert!(robust_bounds(&clump).extent()[0] > 0.0);
        // A cross: rows near the core of each axis, none near all three.
        let far = |axis: usize, i: i32| {
            let mut c = [0.0f32; 3];
            c[axis] = i as f32;
            c
        };
        let cross: Vec<[f32; 3]> = (0..3).flat_map(|a| (-50..50).map(move |i| far(a, i))).collect();
        assert!(robust_bounds(&cross).largest_extent() > 50.0);
    }

    #[test]
    fn distances_and_huge_coordinates() {
        let bounds = Bounds { low: [0.0; 3], high: [1.0, 2.0, 3.0] };
        assert_eq!(bounds.distance([0.5, 0.5, 0.5]), 0.0);
        assert_eq!(bounds.distance([4.0, 6.0, 2.0]), 5.0);
        let ends = [[f32::MIN; 3], [f32::MAX; 3], [0.0; 3]];
        let huge = robust_bounds(&ends);
        assert!(huge.diagonal().is_finite() && huge.diagonal() > 1e38);
        assert_eq!(raw_bounds(&ends).high, [f64::from(f32::MAX); 3]);
    }
}
