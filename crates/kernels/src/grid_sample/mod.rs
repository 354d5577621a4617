//! Which rows share a voxel, and which row stands for each voxel.
//!
//! [`voxel_groups`] finds the groups; the methods of [`VoxelGroups`] pick rows from them: the train
//! rule, the test rule (fragments), the row nearest to the voxel center, and the rule that thins
//! labeled points. Nothing here draws random numbers: the caller passes the draws.

mod bounds;
mod group;
mod hash_order;
mod keys;
mod parts;

pub use group::voxel_groups;
pub use keys::{fnv_key, morton_key, ravel_key};

use rayon::prelude::*;

/// Largest cell index per axis after the shift to zero: three axes of 21 bits fill one 63-bit key.
pub const MAX_CELL: u32 = (1 << 21) - 1;

/// Rows per parallel task: large enough that a task outweighs its scheduling.
const CHUNK: usize = 1 << 14;

/// The order in which voxels are listed: ascending unsigned key of the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum KeyOrder {
    /// The original system's default: a 64-bit hash, so neighbors in the list are far apart in
    /// space. For comparison with its results.
    Fnv,
    /// The original system's alternative: `(x · ny + y) · nz + z`. For comparison with its results.
    Ravel,
    /// Along a z-order curve: neighbors in the list are near in space, so later gathers hit cache.
    #[default]
    Morton,
}

/// Largest voxel, meters: a larger one holds any scene, and its results say nothing.
pub const MAX_GRID_SIZE: f64 = 1e6;

/// Whether voxels can have this size, meters: above 0, and at most [`MAX_GRID_SIZE`].
pub fn is_grid_size(size: f64) -> bool {
    size > 0.0 && size <= MAX_GRID_SIZE
}

/// Why rows cannot be grouped into voxels.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GridSampleError {
    /// The voxel size is none.
    #[error("voxel size must be above 0 and at most {MAX_GRID_SIZE} m, got {grid_size}")]
    GridSize {
        /// The size given, meters.
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
        /// The coordinate of that row, meters.
        value: f32,
        /// Extent of the axis in voxels.
        cells: f64,
        /// Voxel size, meters.
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
    /// Voxel size, meters.
    pub grid_size: f64,
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
    /// The original draws uniformly below [`Self::largest_count`], which favors the first
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

    /// The row nearest to the center of each voxel; the smallest of equals. `[V]`
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
            // Strictly smaller replaces, so the first of equals is kept.
            rows[1..]
                .iter()
                .fold((rows[0], distance(rows[0], v)), |best, &row| {
                    let d = distance(row, v);
                    if d < best.1 { (row, d) } else { best }
                })
                .0
        }))
    }

    /// The rule that thins labeled points: the first labeled row of each voxel, else its first
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

    /// Where a coordinate lies relative to the center of a voxel, in voxels: `-0.5..0.5` inside.
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

fn check_row_count(rows: usize) -> Result<(), GridSampleError> {
    if u32::try_from(rows).is_ok() { Ok(()) } else { Err(GridSampleError::TooManyRows { rows }) }
}

fn check_length(field: &'static str, expected: usize, got: usize) -> Result<(), GridSampleError> {
    if expected == got { Ok(()) } else { Err(GridSampleError::Length { field, expected, got }) }
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
}
