//! The points nearest to a point, and votes among them.

use super::grid_sample::COORDINATE_BOUNDS;
use super::{kernels, radix_sort};
use crate::launch::{
    Items::PerThread,
    Launcher,
    Scalar::{self, F64, I32, U32},
};

kernels! { "neighbors":
    /// Cell of each point in a coarse grid.
    NEIGHBOR_CELLS = neighbor_cells, 256, PerThread;
    /// Nearest points of each query.
    NEAREST_POINTS = nearest_points, 128, PerThread;
    /// Most frequent label of the neighbors.
    VOTE_LABELS = vote_labels, 128, PerThread;
}

/// Most neighbors of a query.
pub const MOST_NEIGHBORS: u32 = 32;
/// Points that a cell would hold if they filled their box evenly.
const POINTS_PER_CELL: f64 = 4.0;
/// Most cells along an axis.
const MOST_CELLS: f64 = 1024.0;

/// Points sorted by the cells of a coarse grid, on the device.
#[derive(Debug)]
pub struct Cells<'a, B> {
    points: &'a B,
    num_points: u32,
    sorted: radix_sort::Sorted<B>,
    grid: Grid,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Grid {
    low: [f64; 3],
    side: f64,
    cells: [i32; 3],
}

impl Grid {
    /// A grid over a box that holds this many points.
    fn of(low: [f64; 3], high: [f64; 3], points: u32) -> Self {
        let extent: [f64; 3] = std::array::from_fn(|a| high[a] - low[a]);
        let longest = extent.iter().copied().fold(0.0, f64::max);
        // Axes along which there is next to nothing do not count.
        let counted: Vec<f64> = extent.into_iter().filter(|&e| e > longest * 1e-3).collect();
        if counted.is_empty() {
            return Self { low, side: 1.0, cells: [1; 3] };
        }
        let cells = (f64::from(points) / POINTS_PER_CELL).max(1.0);
        let volume: f64 = counted.iter().product();
        let side = (volume / cells).powf(1.0 / counted.len() as f64).max(longest / MOST_CELLS);
        let cells = extent.map(|e| ((e / side).floor() + 1.0).clamp(1.0, MOST_CELLS) as i32);
        Self { low, side, cells }
    }

    /// After a kernel's own numbers, the grid's.
    fn scalars(&self, own: &[Scalar]) -> Vec<Scalar> {
        let ([x, y, z], [nx, ny, nz]) = (self.low, self.cells);
        [own, &[x, y, z, self.side].map(F64), &[nx, ny, nz].map(I32)].concat()
    }

    /// Bits of a cell's number.
    fn bits(&self) -> u32 {
        let cells: u64 = self.cells.iter().map(|&c| c.unsigned_abs() as u64).product();
        u64::BITS - (cells - 1).leading_zeros()
    }
}

/// Sorts points by cells. Where coordinates are not finite, results are arbitrary; the caller checks them.
///
/// # Shapes
/// `points`: `[N, 3]` of `f32`, meters
///
/// # Errors
/// Those of the launcher.
pub fn sort_points<'a, L: Launcher>(
    l: &L,
    points: &'a L::Buffer,
    num_points: u32,
) -> Result<Cells<'a, L::Buffer>, L::Error> {
    l.expect::<[f32; 3]>("points", points, num_points.into());
    let blocks = u64::from(num_points).div_ceil(COORDINATE_BOUNDS.items_per_block()) as usize;
    let mut bounds = l.alloc_values::<[f32; 7]>(blocks)?;
    l.run(
        &COORDINATE_BOUNDS,
        num_points.into(),
        &[points],
        &mut [&mut bounds],
        &[U32(num_points)],
    )?;
    let bounds = l.download_values::<[f32; 7]>(&bounds, blocks)?;
    let fold = |at: usize, start: f32, f: fn(f32, f32) -> f32| {
        f64::from(bounds.iter().map(|b| b[at]).fold(start, f))
    };
    let low = std::array::from_fn(|a| fold(a, f32::INFINITY, f32::min));
    let high = std::array::from_fn(|a| fold(3 + a, f32::NEG_INFINITY, f32::max));
    let grid = Grid::of(low, high, num_points);
    let mut codes = l.alloc_values::<u64>(num_points as usize)?;
    let scalars = grid.scalars(&[U32(num_points)]);
    l.run(&NEIGHBOR_CELLS, num_points.into(), &[points], &mut [&mut codes], &scalars)?;
    let sorted = radix_sort::sort(l, codes, num_points, grid.bits())?;
    Ok(Cells { points, num_points, sorted, grid })
}

/// The `k` nearest points of each query: nearest first, equally near ones by row, `u32::MAX` where there are
/// fewer; none for queries that are not finite.
///
/// # Shapes
/// `queries`: `[M, 3]` of `f32`, meters · returns `[M, k]` of `u32`
///
/// # Errors
/// Those of the launcher.
///
/// # Panics
/// If `k` is 0 or above [`MOST_NEIGHBORS`].
pub fn nearest<L: Launcher>(
    l: &L,
    cells: &Cells<'_, L::Buffer>,
    queries: &L::Buffer,
    num_queries: u32,
    k: u32,
) -> Result<L::Buffer, L::Error> {
    assert!((1..=MOST_NEIGHBORS).contains(&k), "{k} neighbors, 1 to {MOST_NEIGHBORS} are possible");
    l.expect::<[f32; 3]>("queries", queries, num_queries.into());
    let mut found = l.alloc_values::<u32>(num_queries as usize * k as usize)?;
    let inputs = [cells.points, &cells.sorted.codes, &cells.sorted.rows, queries];
    let scalars = cells.grid.scalars(&[U32(cells.num_points), U32(num_queries), U32(k)]);
    l.run(&NEAREST_POINTS, num_queries.into(), &inputs, &mut [&mut found], &scalars)?;
    Ok(found)
}

/// The majority label among the neighbors of each query: a neighbor without a label (−1) takes up its place
/// and counts for no class; of equally frequent labels the smaller wins; −1 where no neighbor has one.
///
/// # Shapes
/// `neighbors`: `[M, k]` of `u32`, as [`nearest`] gives them · `labels`: `[N]` of `i32` · returns `[M]` of `i32`
///
/// # Errors
/// Those of the launcher.
pub fn vote<L: Launcher>(
    l: &L,
    neighbors: &L::Buffer,
    labels: &L::Buffer,
    num_queries: u32,
    k: u32,
) -> Result<L::Buffer, L::Error> {
    l.expect::<u32>("neighbours", neighbors, u64::from(num_queries) * u64::from(k));
    let mut winners = l.alloc_values::<i32>(num_queries as usize)?;
    l.run(
        &VOTE_LABELS,
        num_queries.into(),
        &[neighbors, labels],
        &mut [&mut winners],
        &[U32(num_queries), U32(k)],
    )?;
    Ok(winners)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_hold_their_points() {
        // Eight cells, four points in each.
        let cube = Grid::of([0.0; 3], [6.5; 3], 32);
        assert!((cube.side - 3.25).abs() < 1e-9, "{cube:?}");
        let five_bits = Grid { cells: [3; 3], ..cube };
        assert_eq!((five_bits.bits(), Grid { cells: [1; 3], ..cube }.bits()), (5, 0));
        // A plane has cells along two axes.
        let plane = Grid::of([0.0; 3], [10.0, 10.0, 0.0], 400);
        assert_eq!((plane.side, plane.cells), (1.0, [11, 11, 1]));
        // One place, one point, none.
        assert_eq!(Grid::of([2.0; 3], [2.0; 3], 1000).cells, [1; 3]);
        assert_eq!(Grid::of([f64::INFINITY; 3], [f64::NEG_INFINITY; 3], 0).cells, [1; 3]);
        // One far point does not ask for more cells than there may be.
        let far = Grid::of([0.0; 3], [1e6, 1.0, 1.0], 1 << 30);
        assert!(far.cells.iter().all(|&c| c <= 1024), "{far:?}");
    }
}
