use crate::MetricError;
use crate::error::check_num_rows;
use std::collections::BinaryHeap;

/// Points per leaf; below this, looking at all of them beats descending further.
const LEAF_SIZE: usize = 16;

/// Above this many points the two halves of the tree are arranged in parallel.
const PARALLEL_SIZE: usize = 1 << 14;

/// A point near a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbor {
    /// Squared distance in m²: f32 coordinates, f64 arithmetic.
    pub distance_squared: f64,
    /// Row of the point in the coordinates the tree was built from.
    pub row: u32,
}

impl Neighbor {
    /// The order of all searches: nearer first, smaller row first among equals.
    fn key(&self, other: &Self) -> std::cmp::Ordering {
        self.distance_squared
            .total_cmp(&other.distance_squared)
            .then_with(|| self.row.cmp(&other.row))
    }
}

impl Eq for Neighbor {}

impl PartialOrd for Neighbor {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Neighbor {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key(other)
    }
}

/// Squared distance, as every search of this crate computes it.
#[inline]
pub(crate) fn distance_squared(a: [f32; 3], b: [f32; 3]) -> f64 {
    let d: [f64; 3] = std::array::from_fn(|i| f64::from(a[i]) - f64::from(b[i]));
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

/// Exact nearest neighbours among fixed points, with an answer that is unique.
///
/// Among points at the same distance the smaller row comes first, also at the border between the
/// k-th neighbour and the next one. That makes votes reproducible on real scenes, where points
/// repeat and lie on grids, and it is why this is not one of the existing tree crates: they keep
/// whichever equal point their traversal meets first.
///
/// Every split halves the points, by (coordinate, row), so the depth is logarithmic for any input;
/// each node knows its bounding box and its smallest row, so a search also leaves early when 10⁵
/// points coincide.
#[derive(Debug, Clone)]
pub struct KdTree {
    points: Vec<Point>,
    /// Depth-first: the left child of an inner node is the next one.
    nodes: Vec<Node>,
}

#[derive(Debug, Clone, Copy)]
struct Point {
    coord: [f32; 3],
    row: u32,
}

#[derive(Debug, Clone)]
struct Node {
    lower: [f32; 3],
    upper: [f32; 3],
    min_row: u32,
    start: u32,
    end: u32,
    /// Index of the right child; 0 marks a leaf, as the root is nobody's child.
    right: u32,
}

impl KdTree {
    /// A tree of `coord`, `[N, 3]` in metres.
    ///
    /// # Errors
    /// If a coordinate is not finite, or there are 2³² − 1 or more points.
    pub fn new(coord: &[[f32; 3]]) -> Result<Self, MetricError> {
        Self::of_rows(coord, 0..coord.len())
    }

    /// A tree of some rows of `coord`.
    pub(crate) fn of_rows(
        coord: &[[f32; 3]],
        rows: impl Iterator<Item = usize>,
    ) -> Result<Self, MetricError> {
        check_num_rows("reference coord", coord.len())?;
        let mut points = Vec::new();
        for row in rows {
            let value = coord[row];
            if !value.iter().all(|v| v.is_finite()) {
                return Err(MetricError::NonFinite { what: "reference coord", row, value });
            }
            points.push(Point { coord: value, row: row as u32 });
        }
        arrange(&mut points);
        let mut tree = Self { nodes: Vec::new(), points };
        if !tree.points.is_empty() {
            tree.add_node(0, tree.points.len());
        }
        Ok(tree)
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The `k` nearest points, nearest first, equally near ones by row; all points if there are
    /// fewer.
    ///
    /// A query that is not finite has no neighbours.
    pub fn nearest(&self, query: [f32; 3], k: usize) -> Vec<Neighbor> {
        let mut found = BinaryHeap::new();
        self.search(query, k, &mut found);
        found.into_sorted_vec()
    }

    /// As [`nearest`](Self::nearest), into a heap that is emptied first; in no order.
    pub(crate) fn search(&self, query: [f32; 3], k: usize, found: &mut BinaryHeap<Neighbor>) {
        found.clear();
        if k == 0 || self.is_empty() || !query.iter().all(|v| v.is_finite()) {
            return;
        }
        // Depth of the far sides still to visit; halving bounds it.
        let mut pending = [(Neighbor { distance_squared: 0.0, row: 0 }, 0_u32); 40];
        let mut num_pending = 1;
        pending[0].0 = self.nodes[0].bound(query);
        while num_pending > 0 {
            num_pending -= 1;
            let (bound, mut index) = pending[num_pending];
            if found.len() == k && found.peek().is_some_and(|worst| bound > *worst) {
                continue;
            }
            loop {
                let node = &self.nodes[index as usize];
                if node.right == 0 {
                    self.search_leaf(node, query, k, found);
                    break;
                }
                let (left, right) = (index + 1, node.right);
                let bounds =
                    [left, right].map(|child| (self.nodes[child as usize].bound(query), child));
                let [near, far] = match bounds[0].0 <= bounds[1].0 {
                    true => bounds,
                    false => [bounds[1], bounds[0]],
                };
                pending[num_pending] = far;
                num_pending += 1;
                if found.len() == k && found.peek().is_some_and(|worst| near.0 > *worst) {
                    break;
                }
                index = near.1;
            }
        }
    }

    fn search_leaf(
        &self,
        leaf: &Node,
        query: [f32; 3],
        k: usize,
        found: &mut BinaryHeap<Neighbor>,
    ) {
        for point in &self.points[leaf.start as usize..leaf.end as usize] {
            let candidate =
                Neighbor { distance_squared: distance_squared(point.coord, query), row: point.row };
            if found.len() < k {
                found.push(candidate);
            } else if let Some(mut worst) = found.peek_mut()
                && candidate < *worst
            {
                *worst = candidate;
            }
        }
    }

    fn add_node(&mut self, start: usize, end: usize) -> u32 {
        // At most 2³² − 2 points, and no more nodes than points.
        let index = self.nodes.len() as u32;
        let points = &self.points[start..end];
        let (lower, upper) = bounding_box(points);
        let min_row = points.iter().map(|p| p.row).fold(u32::MAX, u32::min);
        let (first, last) = (start as u32, end as u32);
        self.nodes.push(Node { lower, upper, min_row, start: first, end: last, right: 0 });
        if end - start > LEAF_SIZE {
            let middle = start + (end - start) / 2;
            self.add_node(start, middle);
            self.nodes[index as usize].right = self.add_node(middle, end);
        }
        index
    }
}

impl Node {
    /// No point of this node comes before this in the order of a search. In f64, as in f32, a
    /// rounded difference, square or sum never falls when its exact value grows, so the bound holds
    /// for the rounded distances.
    #[inline]
    fn bound(&self, query: [f32; 3]) -> Neighbor {
        let nearest = std::array::from_fn(|i| query[i].max(self.lower[i]).min(self.upper[i]));
        Neighbor { distance_squared: distance_squared(nearest, query), row: self.min_row }
    }
}

fn bounding_box(points: &[Point]) -> ([f32; 3], [f32; 3]) {
    let mut lower = [f32::INFINITY; 3];
    let mut upper = [f32::NEG_INFINITY; 3];
    for point in points {
        for i in 0..3 {
            lower[i] = lower[i].min(point.coord[i]);
            upper[i] = upper[i].max(point.coord[i]);
        }
    }
    (lower, upper)
}

/// Puts the points in tree order: halves by the widest axis, and so on within the halves.
fn arrange(points: &mut [Point]) {
    if points.len() <= LEAF_SIZE {
        return;
    }
    let (lower, upper) = bounding_box(points);
    // In f64: the difference of two f32 can overflow.
    let extent = |i: usize| f64::from(upper[i]) - f64::from(lower[i]);
    let axis = (1..3).fold(0, |widest, i| if extent(i) > extent(widest) { i } else { widest });
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| {
        a.coord[axis].total_cmp(&b.coord[axis]).then_with(|| a.row.cmp(&b.row))
    });
    let (left, right) = points.split_at_mut(middle);
    if left.len() >= PARALLEL_SIZE {
        rayon::join(|| arrange(left), || arrange(right));
    } else {
        arrange(left);
        arrange(right);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_points_no_neighbours() {
        let tree = KdTree::new(&[]).unwrap();
        assert!(tree.is_empty() && tree.nearest([0.0; 3], 3).is_empty());
        let tree = KdTree::new(&[[1.0; 3]]).unwrap();
        assert!(tree.nearest([0.0; 3], 0).is_empty());
        assert!(tree.nearest([f32::NAN; 3], 1).is_empty());
        assert_eq!(tree.nearest([0.0; 3], 9), [Neighbor { distance_squared: 3.0, row: 0 }]);
    }

    #[test]
    fn coincident_points_come_by_row_and_cost_little() {
        let tree = KdTree::new(&vec![[0.5, -1.0, 2.0]; 100_000]).unwrap();
        for query in [[0.5, -1.0, 2.0], [9.0, 9.0, 9.0]] {
            let rows: Vec<u32> = tree.nearest(query, 25).iter().map(|n| n.row).collect();
            assert_eq!(rows, (0..25).collect::<Vec<_>>());
        }
    }

    #[test]
    fn refuses_coordinates_that_are_not_finite() {
        let error = KdTree::new(&[[0.0; 3], [0.0, f32::NAN, 0.0]]).unwrap_err();
        assert!(matches!(error, MetricError::NonFinite { row: 1, .. }));
    }
}
