//! Nearest points: a k-d tree that keeps its points in one array, median at the middle of each
//! span. Exact; no assumption about density, outliers or duplicates.

/// Spans up to this length are searched one by one.
const LEAF: usize = 12;

/// Spans above this length are built in parallel.
const PARALLEL: usize = 1 << 14;

pub(crate) struct NearestPoints<'a> {
    coord: &'a [[f32; 3]],
    rows: Vec<u32>,
    axes: Vec<u8>,
}

/// A point found: squared distance and row.
pub(crate) type Found = (f64, u32);

impl<'a> NearestPoints<'a> {
    /// `coord` must be finite and have fewer than 2³² rows.
    pub(crate) fn new(coord: &'a [[f32; 3]]) -> Self {
        let mut rows: Vec<u32> = (0..coord.len() as u32).collect();
        let mut axes = vec![0; coord.len()];
        build(coord, &mut rows, &mut axes);
        Self { coord, rows, axes }
    }

    /// Writes the `k` points nearest to point `row`, itself left out, nearest first.
    ///
    /// Fewer if there are fewer. Which of several equally far points is taken is fixed but not
    /// specified.
    pub(crate) fn around(&self, row: u32, k: usize, found: &mut Vec<Found>) {
        found.clear();
        if k > 0 {
            self.visit(0, self.rows.len(), row, k, found);
        }
    }

    fn visit(&self, low: usize, high: usize, centre: u32, k: usize, found: &mut Vec<Found>) {
        if high - low <= LEAF {
            for &row in &self.rows[low..high] {
                self.offer(row, centre, k, found);
            }
            return;
        }
        let middle = low.midpoint(high);
        let (row, axis) = (self.rows[middle], self.axes[middle] as usize);
        let to_plane = f64::from(self.coord[centre as usize][axis])
            - f64::from(self.coord[row as usize][axis]);
        let (near, far) = if to_plane < 0.0 {
            ((low, middle), (middle + 1, high))
        } else {
            ((middle + 1, high), (low, middle))
        };
        self.visit(near.0, near.1, centre, k, found);
        self.offer(row, centre, k, found);
        if found.len() < k || to_plane * to_plane < found[k - 1].0 {
            self.visit(far.0, far.1, centre, k, found);
        }
    }

    fn offer(&self, row: u32, centre: u32, k: usize, found: &mut Vec<Found>) {
        if row == centre {
            return;
        }
        let distance = square_distance(self.coord[row as usize], self.coord[centre as usize]);
        if found.len() == k {
            if distance >= found[k - 1].0 {
                return;
            }
            found.pop();
        }
        let at = found.partition_point(|f| f.0 <= distance);
        found.insert(at, (distance, row));
    }
}

pub(crate) fn square_distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2)).sum()
}

fn build(coord: &[[f32; 3]], rows: &mut [u32], axes: &mut [u8]) {
    if rows.len() <= LEAF {
        // The span's order must not depend on how the selection above permuted it.
        rows.sort_unstable();
        return;
    }
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for &row in rows.iter() {
        for axis in 0..3 {
            low[axis] = low[axis].min(coord[row as usize][axis]);
            high[axis] = high[axis].max(coord[row as usize][axis]);
        }
    }
    let extent = |axis: &usize| f64::from(high[*axis]) - f64::from(low[*axis]);
    let axis = (0..3).max_by(|a, b| extent(a).total_cmp(&extent(b))).unwrap_or(0);
    // `visit` splits the same span at the same place.
    let middle = rows.len() / 2;
    rows.select_nth_unstable_by(middle, |&a, &b| {
        coord[a as usize][axis].total_cmp(&coord[b as usize][axis]).then(a.cmp(&b))
    });
    axes[middle] = axis as u8;
    let (left, right) = rows.split_at_mut(middle);
    let (left_axes, right_axes) = axes.split_at_mut(middle);
    let (right, right_axes) = (&mut right[1..], &mut right_axes[1..]);
    if left.len() > PARALLEL {
        rayon::join(|| build(coord, left, left_axes), || build(coord, right, right_axes));
    } else {
        build(coord, left, left_axes);
        build(coord, right, right_axes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{sample_rng, unit};

    fn check(coord: &[[f32; 3]], k: usize) {
        let tree = NearestPoints::new(coord);
        let mut found = Vec::new();
        for row in (0..coord.len()).step_by(coord.len() / 50 + 1) {
            tree.around(row as u32, k, &mut found);
            let mut slow: Vec<f64> = (0..coord.len())
                .filter(|&r| r != row)
                .map(|r| square_distance(coord[r], coord[row]))
                .collect();
            slow.sort_by(f64::total_cmp);
            slow.truncate(k);
            assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), slow);
        }
    }

    #[test]
    fn equals_the_slow_search() {
        let mut rng = sample_rng(1, 0, 0);
        for rows in [0, 1, 2, 12, 13, 14, 400, 40_000] {
            let mut coord: Vec<[f32; 3]> =
                (0..rows).map(|_| std::array::from_fn(|_| unit(&mut rng) as f32)).collect();
            for k in [0, 1, 3, 16] {
                check(&coord, k);
            }
            // Everything on one plane, and one point far away.
            coord.iter_mut().for_each(|c| c[1] = 0.5);
            if let Some(c) = coord.first_mut() {
                *c = [1e30, -1e30, 0.0];
            }
            check(&coord, 3);
        }
    }

    #[test]
    fn duplicates_do_not_make_it_quadratic() {
        let coord = vec![[0.25; 3]; 100_000];
        let tree = NearestPoints::new(&coord);
        let mut found = Vec::new();
        for row in 0..100_000 {
            tree.around(row, 3, &mut found);
            assert!(found.len() == 3 && found.iter().all(|f| f.0 == 0.0 && f.1 != row));
        }
    }
}
