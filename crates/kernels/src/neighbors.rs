//! The points nearest to a point: exact, and unique where distances tie.
//!
//! [`KdTree`] serves any distribution: 10⁵ points in one place, points on a plane, one point
//! kilometers away. It is for fixed points in three dimensions; there is no insertion, no other
//! metric and no approximate search.

use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Points per leaf and queries per group: near the minimum of the measured time for k = 3 … 25.
const LEAF_SIZE: usize = 16;

/// Above this many points the two halves are arranged in parallel.
const PARALLEL_SIZE: usize = 1 << 13;

/// Queries handled by one task; large enough that its buffers pay.
const CHUNK: usize = 32 * LEAF_SIZE;

/// A point near a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbor {
    /// Squared distance in m²: f32 coordinates, f64 arithmetic.
    pub distance_squared: f64,
    /// Row of the point in the coordinates the tree was built from.
    pub row: u32,
}

impl Eq for Neighbor {}

impl PartialOrd for Neighbor {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Neighbor {
    /// The order of all searches: nearer first, smaller row first among equals.
    fn cmp(&self, other: &Self) -> Ordering {
        self.distance_squared
            .total_cmp(&other.distance_squared)
            .then_with(|| self.row.cmp(&other.row))
    }
}

/// Points that no tree can be built of. There is no third reason, so callers may list both.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NeighborError {
    /// A coordinate is NaN or infinite.
    #[error("coord[{row}] is not finite: {value:?}; repair or remove the point")]
    NotFinite {
        /// Row of the point.
        row: usize,
        /// The coordinate found, meters.
        value: [f32; 3],
    },
    /// More rows than a 32-bit row number can tell apart; one number is kept free.
    #[error("coord: {rows} rows, at most 4294967294 are supported")]
    TooManyRows {
        /// Rows found.
        rows: usize,
    },
}

/// Squared distance in f64, m², as every search computes it.
#[inline]
pub fn distance_squared(a: [f32; 3], b: [f32; 3]) -> f64 {
    let d: [f64; 3] = std::array::from_fn(|i| f64::from(a[i]) - f64::from(b[i]));
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

/// Exact nearest neighbors among fixed points, with an answer that is unique.
///
/// Among points at the same distance the smaller row comes first, also at the border between the
/// k-th neighbor and the next one. That makes votes reproducible on real scenes, where points
/// repeat and lie on grids.
///
/// Every split halves the points, by (coordinate, row), so the depth is logarithmic for any input;
/// each node knows its bounding box and its smallest row, so a search also leaves early when 10⁵
/// points coincide.
///
/// ```
/// use scenesplat_kernels::neighbors::KdTree;
///
/// let tree = KdTree::new(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 0.0, 0.0]])?;
/// let rows: Vec<u32> = tree.nearest([2.0, 0.0, 0.0], 2).iter().map(|n| n.row).collect();
/// assert_eq!(rows, [1, 2]); // both at distance 1: the smaller row first
/// # Ok::<(), scenesplat_kernels::neighbors::NeighborError>(())
/// ```
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

#[derive(Debug, Clone, Copy)]
struct Bounds {
    lower: [f32; 3],
    upper: [f32; 3],
}

#[derive(Debug, Clone)]
struct Node {
    bounds: Bounds,
    min_row: u32,
    start: u32,
    end: u32,
    /// Index of the right child; 0 marks a leaf, as the root is no child.
    right: u32,
}

impl KdTree {
    /// A tree of all points.
    ///
    /// # Shapes
    /// `coord`: `[N, 3]` meters, finite
    ///
    /// # Errors
    /// If a coordinate is not finite, or there are 2³² − 1 or more points.
    pub fn new(coord: &[[f32; 3]]) -> Result<Self, NeighborError> {
        Self::of_rows(coord, 0..coord.len())
    }

    /// A tree of some rows; the others may hold anything.
    ///
    /// # Errors
    /// If a coordinate of these rows is not finite, or `coord` has 2³² − 1 or more rows.
    ///
    /// # Panics
    /// If a row number is out of range (a bug of the caller).
    pub fn of_rows(
        coord: &[[f32; 3]],
        rows: impl IntoIterator<Item = usize>,
    ) -> Result<Self, NeighborError> {
        if coord.len() >= u32::MAX as usize {
            return Err(NeighborError::TooManyRows { rows: coord.len() });
        }
        let mut points = Vec::new();
        for row in rows {
            let value = coord[row];
            if !is_finite(value) {
                return Err(NeighborError::NotFinite { row, value });
            }
            points.push(Point { coord: value, row: row as u32 });
        }
        arrange(&mut points);
        let mut tree = Self { nodes: Vec::new(), points };
        if !tree.points.is_empty() {
            tree.nodes.reserve(4 * tree.points.len() / LEAF_SIZE + 1);
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
    /// A query that is not finite has no neighbors. For many queries [`Self::map_nearest`] is
    /// several times faster.
    pub fn nearest(&self, query: [f32; 3], k: usize) -> Vec<Neighbor> {
        let mut found = BinaryHeap::new();
        self.search(query, k.min(self.len()), f64::INFINITY, &mut found);
        found.into_sorted_vec()
    }

    /// `answer(scratch, i, neighbours)` for every query `i`, in the order of the queries.
    ///
    /// The neighbors are those of [`Self::nearest`]. Queries are visited in parallel, those that
    /// are close together by the same task, each task with a scratch value made by `init`.
    ///
    /// # Shapes
    /// `query`: `[M, 3]` meters · returns `[M]`
    ///
    /// # Panics
    /// If there are 2³² or more queries.
    ///
    /// ```
    /// use scenesplat_kernels::neighbors::KdTree;
    ///
    /// // Distance of each point to its nearest other point.
    /// let coord = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0]];
    /// let spacing = KdTree::new(&coord)?
    ///     .map_nearest(&coord, 2, || (), |(), _, near| near[1].distance_squared.sqrt());
    /// assert_eq!(spacing, [3.0, 3.0, 4.0]);
    /// # Ok::<(), scenesplat_kernels::neighbors::NeighborError>(())
    /// ```
    pub fn map_nearest<S, T: Default + Send>(
        &self,
        query: &[[f32; 3]],
        k: usize,
        init: impl Fn() -> S + Sync,
        answer: impl Fn(&mut S, usize, &[Neighbor]) -> T + Sync,
    ) -> Vec<T> {
        assert!(u32::try_from(query.len()).is_ok(), "queries outnumber u32");
        let k = k.min(self.len());
        let mut queries: Vec<Point> =
            (0..).zip(query).map(|(row, &coord)| Point { coord, row }).collect();
        let mut lost = Vec::new();
        queries.retain(|q| {
            let searchable = k > 0 && is_finite(q.coord);
            if !searchable {
                lost.push(q.row);
            }
            searchable
        });
        arrange(&mut queries);
        let answers: Vec<Vec<T>> = queries
            .par_chunks(CHUNK)
            .map_init(
                || (init(), Batch::default()),
                |(scratch, batch), chunk| {
                    let mut answers = Vec::with_capacity(chunk.len());
                    batch.last = None;
                    for group in chunk.chunks(LEAF_SIZE) {
                        batch.visit(self, group, k, |row, near| {
                            answers.push(answer(scratch, row as usize, near));
                        });
                    }
                    answers
                },
            )
            .collect();
        let mut out: Vec<T> = Vec::new();
        out.resize_with(query.len(), T::default);
        for (q, answer) in queries.iter().zip(answers.into_iter().flatten()) {
            out[q.row as usize] = answer;
        }
        let mut scratch = init();
        for row in lost {
            out[row as usize] = answer(&mut scratch, row as usize, &[]);
        }
        out
    }

    /// Puts the `k` nearest points into `found`, in no order. `k` is at most the number of points,
    /// and at least `k` points must lie within the squared distance `limit`.
    fn search(&self, query: [f32; 3], k: usize, limit: f64, found: &mut BinaryHeap<Neighbor>) {
        found.clear();
        if k == 0 || !is_finite(query) {
            return;
        }
        let mut worst = Neighbor { distance_squared: limit, row: u32::MAX };
        // Far sides still to visit; halving bounds their number.
        let mut pending = [(worst, 0_u32); 40];
        let mut num_pending = 1;
        pending[0].0 = self.nodes[0].bound(query);
        while num_pending > 0 {
            num_pending -= 1;
            let (mut bound, mut index) = pending[num_pending];
            while bound <= worst {
                let node = &self.nodes[index as usize];
                if node.right == 0 {
                    for point in self.points_of(node) {
                        let candidate = Neighbor {
                            distance_squared: distance_squared(point.coord, query),
                            row: point.row,
                        };
                        if candidate > worst {
                            continue;
                        }
                        if found.len() < k {
                            found.push(candidate);
                        } else if let Some(mut last) = found.peek_mut() {
                            *last = candidate;
                        }
                        if found.len() == k
                            && let Some(last) = found.peek()
                        {
                            worst = *last;
                        }
                    }
                    break;
                }
                let [mut near, mut far] = [index + 1, node.right]
                    .map(|child| (self.nodes[child as usize].bound(query), child));
                if far.0 < near.0 {
                    std::mem::swap(&mut near, &mut far);
                }
                pending[num_pending] = far;
                num_pending += 1;
                (bound, index) = near;
            }
        }
    }

    fn points_of(&self, node: &Node) -> &[Point] {
        &self.points[node.start as usize..node.end as usize]
    }

    fn add_node(&mut self, start: usize, end: usize) -> u32 {
        // At most 2³² − 2 points, and no more nodes than points.
        let index = self.nodes.len() as u32;
        let (first, last) = (start as u32, end as u32);
        let bounds = Bounds::EMPTY;
        self.nodes.push(Node { bounds, min_row: u32::MAX, start: first, end: last, right: 0 });
        if end - start > LEAF_SIZE {
            let middle = start + middle(end - start);
            let left = self.add_node(start, middle);
            let right = self.add_node(middle, end);
            let [a, b] = [left, right].map(|child| &self.nodes[child as usize]);
            let (bounds, min_row) = (a.bounds.join(&b.bounds), a.min_row.min(b.min_row));
            let node = &mut self.nodes[index as usize];
            (node.bounds, node.min_row, node.right) = (bounds, min_row, right);
        } else {
            let points = &self.points[start..end];
            let min_row = points.iter().map(|p| p.row).fold(u32::MAX, u32::min);
            let bounds = Bounds::of(points);
            let node = &mut self.nodes[index as usize];
            (node.bounds, node.min_row) = (bounds, min_row);
        }
        index
    }
}

impl Node {
    /// No point of this node comes before this in the order of a search.
    #[inline]
    fn bound(&self, query: [f32; 3]) -> Neighbor {
        Neighbor { distance_squared: self.bounds.distance_squared(query), row: self.min_row }
    }
}

/// Grows a squared distance by more than what rounding can have taken from it.
const SLACK: f64 = 1.0 + 1e-12;

/// Searches for queries that lie close together: the points around all of them are collected once,
/// then each query compares itself with that short list.
///
/// With `r` the distance of the k-th neighbor of the group's center `c`, a query `q` has at least
/// k points within `r + |q − c|`, so nothing outside that radius can be among its k nearest.
#[derive(Default)]
struct Batch {
    heap: BinaryHeap<Neighbor>,
    /// Center of the last group and the distance of its k-th neighbor.
    last: Option<([f32; 3], f64)>,
    /// The list, as columns.
    columns: [Vec<f64>; 3],
    rows: Vec<u32>,
    distances: Vec<f64>,
    /// Places in the list that are near enough.
    picked: Vec<u32>,
    /// (bits of the squared distance, row) in one number: the order of [`Neighbor`], quicker to
    /// sort.
    keys: Vec<u128>,
    found: Vec<Neighbor>,
}

impl Batch {
    fn visit(
        &mut self,
        tree: &KdTree,
        group: &[Point],
        k: usize,
        mut answer: impl FnMut(u32, &[Neighbor]),
    ) {
        let bounds = Bounds::of(group);
        let centre = bounds.centre();
        let limit = self.last.map_or(f64::INFINITY, |(last, reach)| within(reach, centre, last));
        tree.search(centre, k, limit, &mut self.heap);
        let reach = self.heap.peek().map_or(0.0, |last| last.distance_squared.sqrt());
        self.last = Some((centre, reach));
        let widest = group.iter().map(|q| within(reach, q.coord, centre)).fold(0.0, f64::max);
        let fits = self.collect(tree, &bounds, widest, 32 * k + 512);
        let mut before = (centre, reach);
        for q in group {
            let limit = within(reach, q.coord, centre).min(within(before.1, q.coord, before.0));
            if fits {
                self.select(q.coord, k, limit);
                before =
                    (q.coord, self.found.last().map_or(0.0, |last| last.distance_squared.sqrt()));
            } else {
                // Few queries among many points, or many points in one place.
                tree.search(q.coord, k, limit, &mut self.heap);
                self.found.clear();
                self.found.extend(self.heap.drain());
                self.found.sort_unstable();
            }
            answer(q.row, &self.found);
        }
    }

    /// Lists the points no further than `limit` (squared) from a box; false if there are more than
    /// `most`.
    fn collect(&mut self, tree: &KdTree, bounds: &Bounds, limit: f64, most: usize) -> bool {
        self.columns.iter_mut().for_each(Vec::clear);
        self.rows.clear();
        let mut pending = [0_u32; 40];
        let mut num_pending = 1;
        while num_pending > 0 {
            num_pending -= 1;
            let mut index = pending[num_pending];
            loop {
                let node = &tree.nodes[index as usize];
                if node.bounds.distance_squared_to(bounds) > limit {
                    break;
                }
                if node.right == 0 {
                    for point in tree.points_of(node) {
                        if bounds.distance_squared(point.coord) <= limit {
                            for (column, value) in self.columns.iter_mut().zip(point.coord) {
                                column.push(f64::from(value));
                            }
                            self.rows.push(point.row);
                        }
                    }
                    if self.rows.len() > most {
                        return false;
                    }
                    break;
                }
                pending[num_pending] = node.right;
                num_pending += 1;
                index += 1;
            }
        }
        true
    }

    /// The `k` nearest of the list, sorted; they lie within `limit` (squared).
    fn select(&mut self, query: [f32; 3], k: usize, limit: f64) {
        let [qx, qy, qz] = query.map(f64::from);
        let [xs, ys, zs] = &self.columns;
        self.distances.clear();
        self.distances.extend(xs.iter().zip(ys).zip(zs).map(|((x, y), z)| {
            let d = [x - qx, y - qy, z - qz];
            d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        }));
        if self.picked.len() < self.rows.len() {
            self.picked.resize(self.rows.len(), 0);
        }
        let mut count = 0;
        for (i, &distance) in (0..).zip(&self.distances) {
            self.picked[count] = i;
            count += usize::from(distance <= limit);
        }
        self.keys.clear();
        self.keys.extend(self.picked[..count].iter().map(|&i| {
            // Bits of numbers that are not negative rise with the numbers.
            let bits = self.distances[i as usize].to_bits();
            u128::from(bits) << 32 | u128::from(self.rows[i as usize])
        }));
        let keys = &mut self.keys[..];
        if k < count {
            keys.select_nth_unstable(k - 1);
        }
        let keys = &mut keys[..k.min(count)];
        keys.sort_unstable();
        self.found.clear();
        self.found.extend(keys.iter().map(|&key| Neighbor {
            distance_squared: f64::from_bits((key >> 32) as u64),
            row: key as u32,
        }));
    }
}

/// Squared radius around `a` that holds everything within `reach` of `b`.
fn within(reach: f64, a: [f32; 3], b: [f32; 3]) -> f64 {
    let radius = reach + distance_squared(a, b).sqrt();
    radius * radius * SLACK
}

impl Bounds {
    const EMPTY: Self = Self { lower: [f32::INFINITY; 3], upper: [f32::NEG_INFINITY; 3] };

    fn of(points: &[Point]) -> Self {
        let mut bounds = Self::EMPTY;
        for point in points {
            bounds = bounds.join(&Self { lower: point.coord, upper: point.coord });
        }
        bounds
    }

    #[inline]
    fn join(&self, other: &Self) -> Self {
        // Comparisons, not `f32::min`: nothing here is NaN, and these are one instruction.
        let min = |a: f32, b: f32| if a < b { a } else { b };
        let max = |a: f32, b: f32| if a > b { a } else { b };
        Self {
            lower: std::array::from_fn(|i| min(self.lower[i], other.lower[i])),
            upper: std::array::from_fn(|i| max(self.upper[i], other.upper[i])),
        }
    }

    fn centre(&self) -> [f32; 3] {
        std::array::from_fn(|i| self.lower[i].midpoint(self.upper[i]))
    }

    /// Not above the squared distance from `query` to any point inside. In f64, as in f32, a rounded
    /// difference, square or sum never falls when its exact value grows, so this holds for the
    /// rounded distances.
    #[inline]
    fn distance_squared(&self, query: [f32; 3]) -> f64 {
        self.distance_squared_to(&Self { lower: query, upper: query })
    }

    /// As [`Self::distance_squared`], for any two points of the boxes.
    #[inline]
    fn distance_squared_to(&self, other: &Self) -> f64 {
        let max = |a: f64, b: f64| if a > b { a } else { b };
        let gap: [f64; 3] = std::array::from_fn(|i| {
            let below = f64::from(self.lower[i]) - f64::from(other.upper[i]);
            let above = f64::from(other.lower[i]) - f64::from(self.upper[i]);
            max(max(below, above), 0.0)
        });
        gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2]
    }
}

fn is_finite(coord: [f32; 3]) -> bool {
    coord.iter().all(|v| v.is_finite())
}

/// Where a span is split: at full leaves, so that consecutive points `[LEAF_SIZE·i ..]` share one.
fn middle(len: usize) -> usize {
    let leaves = len.div_ceil(LEAF_SIZE);
    leaves.div_ceil(2) * LEAF_SIZE
}

/// Puts the points in tree order: two halves by the widest axis, and so on within the halves.
fn arrange(points: &mut [Point]) {
    if points.len() <= LEAF_SIZE {
        return;
    }
    let bounds = Bounds::of(points);
    // In f64: the difference of two f32 can overflow.
    let extent = |i: usize| f64::from(bounds.upper[i]) - f64::from(bounds.lower[i]);
    let axis = (1..3).fold(0, |widest, i| if extent(i) > extent(widest) { i } else { widest });
    let middle = middle(points.len());
    points.select_nth_unstable_by_key(middle, |p| {
        // Order of `f32::total_cmp`, then the row, in one number.
        let bits = p.coord[axis].to_bits();
        let rising = bits ^ ((bits as i32 >> 31) as u32 | 1 << 31);
        u64::from(rising) << 32 | u64::from(p.row)
    });
    let (left, right) = points.split_at_mut(middle);
    if left.len() >= PARALLEL_SIZE {
        rayon::join(|| arrange(left), || arrange(right));
    } else {
        arrange(left);
        arrange(right);
    }
}
