//! Boxes around things, as some benchmarks have instead of labeled points.

use rayon::prelude::*;
use scenesplat_scene::vector::dot;

/// A box that may be turned.
#[derive(Debug, Clone, Copy)]
pub(super) struct Box3 {
    pub(super) center: [f64; 3],
    /// Half of the lengths.
    pub(super) half: [f64; 3],
    /// Unit directions of the sides, one a row.
    pub(super) axes: [[f64; 3]; 3],
    /// Number of the name.
    pub(super) name: i32,
}

impl Box3 {
    /// Whether a point is inside or on the border.
    pub(super) fn contains(&self, p: [f32; 3]) -> bool {
        let to = [0, 1, 2].map(|k| f64::from(p[k]) - self.center[k]);
        (0..3).all(|i| dot(self.axes[i], to).abs() <= self.half[i])
    }

    fn volume(&self) -> f64 {
        self.half.iter().product()
    }
}

/// Name and number of the smallest box around each point, of equals the first; −1 outside of all.
pub(super) fn label(points: &[[f32; 3]], boxes: &[Box3]) -> (Vec<i32>, Vec<i32>) {
    let smallest = |p: &[f32; 3]| {
        let inside = (0..).zip(boxes).filter(|(_, b)| b.contains(*p));
        let found = inside.min_by(|(_, a), (_, b)| a.volume().total_cmp(&b.volume()));
        found.map_or((-1, -1), |(number, b)| (b.name, number))
    };
    points.par_iter().map(smallest).unzip()
}
