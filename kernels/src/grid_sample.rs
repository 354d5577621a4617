//! Which rows share a voxel, and which row stands for each voxel.
//!
//! [`voxel_groups`] finds the groups; the methods of [`VoxelGroups`] pick rows from them: the train
//! rule, the test rule (fragments), the row nearest to the voxel centre, and the rule that thins
//! labelled points. Nothing here draws random numbers: the caller passes the draws.

use crate::serialization::sort_with_rows;
use rayon::prelude::*;

/// Largest cell index per axis after the shift to zero: three axes of 21 bits fill one 63-bit key.
pub const MAX_CELL: u32 = (1 << 21) - 1;

const FNV_OFFSET: u64 = 14_695_981_039_346_656_037;
const FNV_PRIME: u64 = 1_099_511_628_211;

/// Rows per parallel task: large enough that a task outweighs its scheduling.
const CHUNK: usize = 1 << 14;

/// The order in which voxels are listed: ascending unsigned key of the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum KeyOrder {
    /// The original system's default: a 64-bit hash, so neighbours in the list are far apart in
    /// space. For comparison with its results.
    Fnv,
    /// The original system's alternative: `(x · ny + y) · nz + z`. For comparison with its results.
    Ravel,
    /// Along a z-order curve: neighbours in the list are near in space, so later gathers hit cache.
    #[default]
    Morton,
}

/// Why rows cannot be grouped into voxels.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GridSampleError {
    /// The voxel size is not a positive number.
    #[error("voxel size must be finite and above 0, got {grid_size}")]
    GridSize {
        /// The size given, metres.
        grid_size: f64,
    },
    /// A coordinate is NaN or infinite.
    #[error(
        "row {row}, axis {axis}: coordinate {value} is not finite (remove the row or repair the file)"
    )]
    NotFinite {
        /// Row of the coordinate.
        row: usize,
        /// `x`, `y` or `z`.
        axis: char,
        /// The coordinate.
        value: f32,
    },
    /// The rows spread over more voxels than an index can hold.
    #[error(
        "row {row}, axis {axis}: coordinate {value} m stretches the scene to {cells:.0} voxels of \
         {grid_size} m, at most {MAX_CELL} are possible (remove outliers or use larger voxels)"
    )]
    TooWide {
        /// The row farthest from the median of its axis.
        row: usize,
        /// `x`, `y` or `z`.
        axis: char,
        /// The coordinate of that row, metres.
        value: f32,
        /// Extent of the axis in voxels.
        cells: f64,
        /// Voxel size, metres.
        grid_size: f64,
    },
    /// More rows than a 32-bit row number can name.
    #[error("{rows} rows are more than the {} that one scene can hold (split the scene)", u32::MAX)]
    TooManyRows {
        /// Number of rows given.
        rows: usize,
    },
    /// An array that goes with the rows or voxels has another length.
    #[error("{field}: expected {expected} values, got {got}")]
    Length {
        /// Which argument.
        field: &'static str,
        /// Length expected.
        expected: usize,
        /// Length found.
        got: usize,
    },
}

/// Rows grouped by voxel.
///
/// `N` rows, `V` voxels; voxels are listed by ascending key (see [`KeyOrder`]).
#[derive(Debug, Clone, PartialEq)]
pub struct VoxelGroups {
    /// Rows voxel by voxel, ascending inside a voxel. `[N]`
    pub order: Vec<u32>,
    /// Voxel `v` owns `order[offsets[v]..offsets[v + 1]]`. `[V + 1]`
    pub offsets: Vec<u32>,
    /// Voxel of each row. `[N]`
    pub inverse: Vec<u32>,
    /// Cell of each voxel, shifted so that the smallest per axis is 0. `[V, 3]`
    pub grid_coord: Vec<[i32; 3]>,
    /// The shift: smallest cell per axis, a whole number.
    pub min_cell: [f64; 3],
    /// Voxel size, metres.
    pub grid_size: f64,
}

/// Groups rows by voxel.
///
/// The cell of a coordinate is `floor(coord / grid_size)`, divided in f64, minus the smallest cell
/// of its axis. Rows of one cell form one voxel. No rows give no voxels.
///
/// # Shapes
/// - `coord`: `[N, 3]` metres, finite
///
/// # Errors
/// If `grid_size` is not a positive number, a coordinate is not finite, an axis spans more than
/// [`MAX_CELL`] + 1 cells, or the rows outnumber `u32`. Row and axis are named.
///
/// # Source
/// `GridSample` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1, with the division of
/// NumPy 2. Differs: the sort is stable, so rows inside a voxel are ascending; groups are formed by
/// cell, not by key, so two cells whose hashes collide stay two voxels (listed by `x, y, z`).
pub fn voxel_groups(
    coord: &[[f32; 3]],
    grid_size: f64,
    key_order: KeyOrder,
) -> Result<VoxelGroups, GridSampleError> {
    check_row_count(coord.len())?;
    if !(grid_size.is_finite() && grid_size > 0.0) {
        return Err(GridSampleError::GridSize { grid_size });
    }
    let (min_cell, max_index) = cell_bounds(coord, grid_size)?;
    let cell_of = |row: u32| cell(coord[row as usize], grid_size, min_cell);

    let shape = max_index.map(|m| u64::from(m) + 1);
    let keys: Vec<u64> = coord
        .par_iter()
        .with_min_len(CHUNK)
        .map(|&c| {
            let cell = cell(c, grid_size, min_cell);
            match key_order {
                KeyOrder::Fnv => fnv_key(cell),
                KeyOrder::Ravel => ravel_key(cell, shape),
                KeyOrder::Morton => morton_key(cell),
            }
        })
        .collect();
    let (keys, mut order) = sort_with_rows(&keys);

    let mut offsets = vec![0];
    let mut start = 0;
    while start < order.len() {
        let end = start + keys[start..].iter().take_while(|&&k| k == keys[start]).count();
        let run = &mut order[start..end];
        // The other two keys are one-to-one.
        let collides = key_order == KeyOrder::Fnv
            && run[1..].iter().any(|&row| cell_of(row) != cell_of(run[0]));
        if collides {
            run.sort_by_key(|&row| cell_of(row));
            for i in 1..run.len() {
                if cell_of(run[i]) != cell_of(run[i - 1]) {
                    offsets.push((start + i) as u32);
                }
            }
        }
        offsets.push(end as u32);
        start = end;
    }

    let mut inverse = vec![0; order.len()];
    for (voxel, span) in offsets.windows(2).enumerate() {
        for &row in &order[span[0] as usize..span[1] as usize] {
            inverse[row as usize] = voxel as u32;
        }
    }
    let grid_coord = offsets[..offsets.len() - 1]
        .par_iter()
        .with_min_len(CHUNK)
        .map(|&first| cell_of(order[first as usize]).map(|c| c as i32))
        .collect();
    Ok(VoxelGroups { order, offsets, inverse, grid_coord, min_cell, grid_size })
}

impl VoxelGroups {
    /// Number of voxels.
    pub fn num_voxels(&self) -> usize {
        self.grid_coord.len()
    }

    /// Rows of a voxel, ascending.
    pub fn rows_of(&self, voxel: usize) -> &[u32] {
        &self.order[self.offsets[voxel] as usize..self.offsets[voxel + 1] as usize]
    }

    /// Rows in the fullest voxel; 0 without voxels. Also the number of fragments of the test rule.
    pub fn largest_count(&self) -> usize {
        self.offsets.windows(2).map(|w| (w[1] - w[0]) as usize).max().unwrap_or(0)
    }

    /// The smallest row of each voxel. `[V]`
    pub fn first_rows(&self) -> Vec<u32> {
        self.pick(|_, rows| rows[0])
    }

    /// The train rule: element `draws[v] % count[v]` of each voxel. `[V]`
    ///
    /// The original draws uniformly below [`Self::largest_count`], which favours the first
    /// elements of a voxel slightly.
    ///
    /// # Errors
    /// If there is not one draw per voxel.
    pub fn drawn_rows(&self, draws: &[u32]) -> Result<Vec<u32>, GridSampleError> {
        check_length("draws", self.num_voxels(), draws.len())?;
        Ok(self.pick(|v, rows| rows[draws[v] as usize % rows.len()]))
    }

    /// The test rule: element `fragment % count[v]` of each voxel. `[V]`
    ///
    /// Fragments `0..largest_count()` together hold every row at least once.
    pub fn fragment_rows(&self, fragment: usize) -> Vec<u32> {
        self.pick(|_, rows| rows[fragment % rows.len()])
    }

    /// The row nearest to the centre of each voxel; the smallest of equals. `[V]`
    ///
    /// # Errors
    /// If `coord` is not the array that was grouped (by its length).
    pub fn nearest_to_centre(&self, coord: &[[f32; 3]]) -> Result<Vec<u32>, GridSampleError> {
        check_length("coord", self.order.len(), coord.len())?;
        let distance = |row: u32, voxel: usize| {
            let [x, y, z] = self.displacement(coord[row as usize], voxel);
            x * x + y * y + z * z
        };
        Ok(self.pick(|v, rows| {
            // Strictly smaller replaces, so the first of equals stays.
            rows[1..]
                .iter()
                .fold((rows[0], distance(rows[0], v)), |best, &row| {
                    let d = distance(row, v);
                    if d < best.1 { (row, d) } else { best }
                })
                .0
        }))
    }

    /// The rule that thins labelled points: the first labelled row of each voxel, else its first
    /// row. `[V]`
    ///
    /// # Errors
    /// If there is not one label per row.
    pub fn labelled_rows(&self, label: &[i32], ignore: i32) -> Result<Vec<u32>, GridSampleError> {
        check_length("label", self.order.len(), label.len())?;
        Ok(self.pick(|_, rows| {
            rows.iter().copied().find(|&r| label[r as usize] != ignore).unwrap_or(rows[0])
        }))
    }

    /// Lower corner of the cell with index 0, metres.
    pub fn min_coord(&self) -> [f64; 3] {
        self.min_cell.map(|c| c * self.grid_size)
    }

    /// Where a coordinate lies relative to the centre of a voxel, in voxels: `-0.5..0.5` inside.
    pub fn displacement(&self, coord: [f32; 3], voxel: usize) -> [f64; 3] {
        std::array::from_fn(|a| {
            f64::from(coord[a]) / self.grid_size
                - self.min_cell[a]
                - f64::from(self.grid_coord[voxel][a])
                - 0.5
        })
    }

    fn pick(&self, rule: impl Fn(usize, &[u32]) -> u32 + Sync) -> Vec<u32> {
        (0..self.num_voxels())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|v| rule(v, self.rows_of(v)))
            .collect()
    }
}

/// The hash of a cell that the original system orders voxels by: multiply, then xor, per axis.
pub fn fnv_key(cell: [u32; 3]) -> u64 {
    cell.iter().fold(FNV_OFFSET, |h, &c| h.wrapping_mul(FNV_PRIME) ^ u64::from(c))
}

/// Row-major index of a cell in a grid of the given shape, at most `2^21` per axis.
pub fn ravel_key(cell: [u32; 3], shape: [u64; 3]) -> u64 {
    let [x, y, z] = cell.map(u64::from);
    (x * shape[1] + y) * shape[2] + z
}

/// The bits of a cell interleaved, `x` above `y` above `z`; indices up to [`MAX_CELL`].
pub fn morton_key(cell: [u32; 3]) -> u64 {
    let [x, y, z] = cell.map(spread_bits);
    x << 2 | y << 1 | z
}

/// Moves bit `i` to bit `3 i`, for 21 bits.
fn spread_bits(value: u32) -> u64 {
    let mut v = u64::from(value & MAX_CELL);
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

fn check_row_count(rows: usize) -> Result<(), GridSampleError> {
    if u32::try_from(rows).is_ok() { Ok(()) } else { Err(GridSampleError::TooManyRows { rows }) }
}

fn check_length(field: &'static str, expected: usize, got: usize) -> Result<(), GridSampleError> {
    if expected == got { Ok(()) } else { Err(GridSampleError::Length { field, expected, got }) }
}

fn cell(coord: [f32; 3], grid_size: f64, min_cell: [f64; 3]) -> [u32; 3] {
    std::array::from_fn(|a| ((f64::from(coord[a]) / grid_size).floor() - min_cell[a]) as u32)
}

/// Smallest cell and largest shifted index per axis, after checking every coordinate.
fn cell_bounds(
    coord: &[[f32; 3]],
    grid_size: f64,
) -> Result<([f64; 3], [u32; 3]), GridSampleError> {
    if coord.is_empty() {
        return Ok(([0.0; 3], [0; 3]));
    }
    if let Some(row) = coord.par_iter().position_first(|c| !c.iter().all(|v| v.is_finite())) {
        let axis = coord[row].iter().position(|v| !v.is_finite()).unwrap_or(0);
        return Err(GridSampleError::NotFinite { row, axis: AXES[axis], value: coord[row][axis] });
    }
    // Division and floor keep order, so the bounds of the cells are the cells of the bounds.
    let (low, high) = coord
        .par_chunks(CHUNK)
        .map(|chunk| {
            chunk.iter().fold((chunk[0], chunk[0]), |(low, high), c| {
                (
                    std::array::from_fn(|a| low[a].min(c[a])),
                    std::array::from_fn(|a| high[a].max(c[a])),
                )
            })
        })
        .reduce(
            || (coord[0], coord[0]),
            |(low, high), (l, h)| {
                (
                    std::array::from_fn(|a: usize| low[a].min(l[a])),
                    std::array::from_fn(|a: usize| high[a].max(h[a])),
                )
            },
        );
    let floor_cell = |v: f32| (f64::from(v) / grid_size).floor();
    let mut max_index = [0; 3];
    for axis in 0..3 {
        let cells = floor_cell(high[axis]) - floor_cell(low[axis]);
        // Also true for NaN, which infinite quotients give.
        if cells.is_nan() || cells > f64::from(MAX_CELL) {
            return Err(too_wide(coord, axis, cells + 1.0, grid_size));
        }
        max_index[axis] = cells as u32;
    }
    Ok((low.map(floor_cell), max_index))
}

const AXES: [char; 3] = ['x', 'y', 'z'];

/// Blames the row farthest from the median: with one outlier on the low side, the rows beyond the
/// limit would be all the good ones.
fn too_wide(coord: &[[f32; 3]], axis: usize, cells: f64, grid_size: f64) -> GridSampleError {
    let mut values: Vec<f32> = coord.iter().map(|c| c[axis]).collect();
    let middle = (values.len() - 1) / 2;
    let median = f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1);
    let (row, _) = coord.iter().enumerate().fold((0, -1.0), |best, (row, c)| {
        let distance = (f64::from(c[axis]) - median).abs();
        if distance > best.1 { (row, distance) } else { best }
    });
    GridSampleError::TooWide { row, axis: AXES[axis], value: coord[row][axis], cells, grid_size }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_counts_beyond_u32_are_refused() {
        assert!(check_row_count(u32::MAX as usize).is_ok());
        let rows = u32::MAX as usize + 1;
        assert_eq!(check_row_count(rows), Err(GridSampleError::TooManyRows { rows }));
    }

    #[test]
    fn hash_values_of_the_original() {
        for (cell, key) in [
            ([0, 0, 0], 15_658_191_375_538_532_279),
            ([1, 0, 0], 15_657_234_800_422_177_934),
            ([0, 1, 0], 15_658_190_276_026_904_068),
            ([0, 0, 1], 15_658_191_375_538_532_278),
            ([3, 5, 7], 15_655_318_351_654_584_612),
            ([1000, 2000, 300], 14_764_297_218_073_129_843),
        ] {
            assert_eq!(fnv_key(cell), key);
        }
    }

    #[test]
    fn morton_bits_interleave() {
        assert_eq!(morton_key([1, 0, 0]), 0b100);
        assert_eq!(morton_key([0, 1, 0]), 0b010);
        assert_eq!(morton_key([0b10, 0b01, 0b11]), 0b101_011);
        assert_eq!(morton_key([MAX_CELL; 3]), (1 << 63) - 1);
    }
}
