//! Leaves of a streamed scene, and coarser levels of each.

use crate::GaussianScene;
use crate::bounds::bounding_box;
use serde_json::{Value, json};

/// Most rows of a leaf: what a viewer loads, shows and drops as one.
const LEAF_ROWS: usize = 1 << 16;
/// Runs of so few rows are not split for the order of the rows any further.
const FINEST: usize = 32;
/// How much Gaussians may grow to stand for those that are left out.
const MOST_GROWTH: f64 = 2.0;

/// A part of space with some of the Gaussians.
pub(super) struct Leaf {
    /// Rows of the scene, neighbors near each other.
    pub(super) rows: Vec<u32>,
}

/// A node: a leaf by its number, or two halves.
pub(super) enum Node {
    Leaf(usize),
    Halves(Box<[Node; 2]>),
}

/// Cuts a scene into leaves, each time in halves across the longest side.
pub(super) fn leaves(scene: &GaussianScene) -> (Node, Vec<Leaf>) {
    let mut rows: Vec<u32> = (0..scene.len() as u32).collect();
    let mut leaves = Vec::new();
    let root = split(scene, &mut rows, &mut leaves);
    (root, leaves)
}

fn split(scene: &GaussianScene, rows: &mut [u32], leaves: &mut Vec<Leaf>) -> Node {
    if rows.len() <= LEAF_ROWS {
        arrange(scene, rows);
        leaves.push(Leaf { rows: rows.to_vec() });
        return Node::Leaf(leaves.len() - 1);
    }
    let (low, high) = halve(scene, rows);
    let low = split(scene, low, leaves);
    Node::Halves(Box::new([low, split(scene, high, leaves)]))
}

/// Puts neighbors near each other, for textures that compress well.
fn arrange(scene: &GaussianScene, rows: &mut [u32]) {
    if rows.len() > FINEST {
        let (low, high) = halve(scene, rows);
        arrange(scene, low);
        arrange(scene, high);
    } else {
        rows.sort_unstable();
    }
}

/// The lower and the upper half along the longest side; of equals the earlier rows are lower.
fn halve<'a>(scene: &GaussianScene, rows: &'a mut [u32]) -> (&'a mut [u32], &'a mut [u32]) {
    let (min, max) = bounding_box(rows.iter().map(|&row| scene.coord[row as usize]));
    let side = |a: usize| max[a] - min[a];
    let axis = (1..3).fold(0, |best, a| if side(a) > side(best) { a } else { best });
    let middle = rows.len() / 2;
    rows.select_nth_unstable_by(middle, |&a, &b| {
        let at = |row: u32| scene.coord[row as usize][axis];
        at(a).total_cmp(&at(b)).then(a.cmp(&b))
    });
    rows.split_at_mut(middle)
}

impl Leaf {
    /// The rows that stand for the leaf at a level, in their order, and how much larger they are
    /// drawn: a quarter of the rows for each level, those that cover the most (opacity times the
    /// area of the two longer axes), grown so that they cover what all did, at most to twice the
    /// size.
    pub(super) fn at_level(&self, scene: &GaussianScene, level: u8) -> (Vec<u32>, f64) {
        let count = self.rows.len().div_ceil(1 << (2 * u32::from(level)));
        if count == self.rows.len() {
            return (self.rows.clone(), 1.0);
        }
        let mut by_cover: Vec<(f64, usize)> =
            self.rows.iter().enumerate().map(|(i, &row)| (cover(scene, row), i)).collect();
        let all: f64 = by_cover.iter().map(|c| c.0).sum();
        by_cover.select_nth_unstable_by(count, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        by_cover.truncate(count);
        by_cover.sort_unstable_by_key(|c| c.1);
        let kept: f64 = by_cover.iter().map(|c| c.0).sum();
        let growth = (all / kept).sqrt();
        let growth = if growth.is_finite() { growth.clamp(1.0, MOST_GROWTH) } else { 1.0 };
        (by_cover.into_iter().map(|(_, i)| self.rows[i]).collect(), growth)
    }

    /// What the leaf reaches: its centers, and three standard deviations around them.
    pub(super) fn bound(&self, scene: &GaussianScene) -> [[f64; 3]; 2] {
        let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for &row in &self.rows {
            let row = row as usize;
            let largest = scene.log_scale[row].into_iter().fold(f32::NEG_INFINITY, f32::max);
            let reach = 3.0 * f64::from(largest).exp();
            for a in 0..3 {
                let v = f64::from(scene.coord[row][a]);
                (min[a], max[a]) = (min[a].min(v - reach), max[a].max(v + reach));
            }
        }
        // JSON has no infinity; nothing is larger than what f32 holds.
        let finite = |v: [f64; 3]| v.map(|v| v.clamp(f64::from(f32::MIN), f64::from(f32::MAX)));
        [finite(min), finite(max)]
    }
}

fn cover(scene: &GaussianScene, row: u32) -> f64 {
    let mut sizes = scene.log_scale[row as usize];
    sizes.sort_by(f32::total_cmp);
    f64::from(scene.opacity(row as usize)) * (f64::from(sizes[1]) + f64::from(sizes[2])).exp()
}

impl Node {
    /// The tree as JSON, given bounds and runs of each leaf.
    pub(super) fn to_json(&self, bounds: &[[[f64; 3]; 2]], lods: &[Value]) -> Value {
        self.with_bound(bounds, lods).0
    }

    fn with_bound(&self, bounds: &[[[f64; 3]; 2]], lods: &[Value]) -> (Value, [[f64; 3]; 2]) {
        let json_of = |[min, max]: [[f64; 3]; 2]| json!({ "min": min, "max": max });
        match self {
            Self::Leaf(number) => {
                let bound = bounds[*number];
                (json!({ "bound": json_of(bound), "lods": lods[*number] }), bound)
            }
            Self::Halves(halves) => {
                let [a, b] = [0, 1].map(|i| halves[i].with_bound(bounds, lods));
                let min = [0, 1, 2].map(|i| a.1[0][i].min(b.1[0][i]));
                let max = [0, 1, 2].map(|i| a.1[1][i].max(b.1[1][i]));
                let bound = [min, max];
                (json!({ "bound": json_of(bound), "children": [a.0, b.0] }), bound)
            }
        }
    }
}
