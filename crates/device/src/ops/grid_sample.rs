//! Which points share a voxel.

use super::{kernels, radix_sort, rows, scan};
use crate::launch::{
    Items::{PerBlock, PerThread},
    Launcher,
    Scalar::{F64, U32},
};

kernels! { "grid_sample":
    /// Bounds of the coordinates of a stretch of rows.
    COORDINATE_BOUNDS = coordinate_bounds, 256, PerBlock(4096);
    /// One code for each row's cell.
    CELL_CODES = cell_codes, 256, PerThread;
    /// Where a new cell begins.
    CELL_BEGINS = cell_begins, 256, PerThread;
    /// Voxels of the sorted codes.
    LIST_CELLS = list_cells, 256, PerThread;
    /// The original system's hash of each voxel.
    HASH_CELLS = hash_cells, 256, PerThread;
    /// Rows of each voxel in another order.
    MOVED_COUNTS = moved_counts, 256, PerThread;
    /// Voxels in another order.
    MOVE_CELLS = move_cells, 256, PerThread;
}

/// Largest cell index per axis after the shift to zero.
pub const MAX_CELL: u32 = (1 << 21) - 1;

/// The order in which voxels are listed: ascending unsigned key of the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum KeyOrder {
    /// The original system's 64-bit hash.
    Fnv,
    /// By x, y, z.
    Ravel,
    /// Along a z-order curve.
    #[default]
    Morton,
}

/// Why rows cannot be grouped into voxels. Which row is to blame, the CPU's function says.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GridSampleError<E: std::error::Error> {
    /// The voxel size is not a positive number.
    #[error("voxel size must be finite and above 0, got {0}")]
    GridSize(f64),
    /// A coordinate is NaN or infinite.
    #[error("a coordinate is not finite (remove its row or repair the file)")]
    NotFinite,
    /// The rows spread over more voxels than an index can hold.
    #[error(
        "axis {axis} stretches over {cells:.0} voxels, at most {MAX_CELL} are possible (remove outliers or use \
         larger voxels)"
    )]
    TooWide {
        /// `x`, `y` or `z`.
        axis: char,
        /// Extent of the axis in voxels.
        cells: f64,
    },
    /// The device reports an error.
    #[error(transparent)]
    Launch(#[from] E),
}

/// Rows grouped by voxel, on the device.
#[derive(Debug)]
pub struct VoxelGroups<B> {
    /// Rows voxel by voxel, ascending inside a voxel. `[N]` of `u32`
    pub order: B,
    /// Voxel `v` owns `order[offsets[v]..offsets[v + 1]]`; room for N + 1. `[V + 1]` of `u32`
    pub offsets: B,
    /// Voxel of each row. `[N]` of `u32`
    pub inverse: B,
    /// Cell of each voxel, shifted so that the smallest per axis is 0; room for N. `[V, 3]` of `i32`
    pub grid_coord: B,
    /// Voxels, V.
    pub num_voxels: u32,
    /// The shift: smallest cell per axis, a whole number.
    pub min_cell: [f64; 3],
    /// Largest shifted index per axis.
    pub max_index: [u32; 3],
}

/// Smallest cell and largest shifted index per axis.
type CellBounds = ([f64; 3], [u32; 3]);

fn cell_bounds<L: Launcher>(
    l: &L,
    coord: &L::Buffer,
    n: u32,
    grid_size: f64,
) -> Result<CellBounds, GridSampleError<L::Error>> {
    if n == 0 {
        return Ok(([0.0; 3], [0; 3]));
    }
    let blocks = u64::from(n).div_ceil(COORDINATE_BOUNDS.items_per_block()) as usize;
    let mut bounds = l.alloc_values::<[f32; 7]>(blocks)?;
    l.run(&COORDINATE_BOUNDS, n.into(), &[coord], &mut [&mut bounds], &[U32(n)])?;
    let bounds = l.download_values::<[f32; 7]>(&bounds, blocks)?;
    if bounds.iter().any(|b| b[6] != 0.0) {
        return Err(GridSampleError::NotFinite);
    }
    let (mut min_cell, mut max_index) = ([0.0; 3], [0; 3]);
    let floor_cell = |v: f32| (f64::from(v) / grid_size).floor();
    for axis in 0..3 {
        let low = bounds.iter().map(|b| b[axis]).fold(f32::INFINITY, f32::min);
        let high = bounds.iter().map(|b| b[3 + axis]).fold(f32::NEG_INFINITY, f32::max);
        min_cell[axis] = floor_cell(low);
        let cells = floor_cell(high) - min_cell[axis];
        // Also true for NaN, which infinite quotients give.
        if cells.is_nan() || cells > f64::from(MAX_CELL) {
            let axis = ['x', 'y', 'z'][axis];
            return Err(GridSampleError::TooWide { axis, cells: cells + 1.0 });
        }
        max_index[axis] = cells as u32;
    }
    Ok((min_cell, max_index))
}

/// How cells become codes.
struct Codes {
    along_curve: u32,
    y_bits: u32,
    z_bits: u32,
    /// Bits of a whole code.
    bits: u32,
}

impl Codes {
    fn of(key_order: KeyOrder, max_index: [u32; 3]) -> Self {
        let [x_bits, y_bits, z_bits] = max_index.map(|i| u32::BITS - i.leading_zeros());
        let bits = match key_order {
            KeyOrder::Morton => 3 * x_bits.max(y_bits).max(z_bits),
            KeyOrder::Fnv | KeyOrder::Ravel => x_bits + y_bits + z_bits,
        };
        let along_curve = u32::from(key_order == KeyOrder::Morton);
        Self { along_curve, y_bits, z_bits, bits }
    }
}

/// Groups rows by voxel: the cell of a coordinate is `floor(coord / grid_size)`, divided in f64, minus the
/// smallest cell of its axis. No rows give no voxels.
///
/// # Shapes
/// `coord`: `[N, 3]` of `f32`, meters
///
/// # Errors
/// If `grid_size` is not a positive number, a coordinate is not finite, an axis spans more than
/// [`MAX_CELL`] + 1 cells, or the launcher's.
pub fn voxel_groups<L: Launcher>(
    l: &L,
    coord: &L::Buffer,
    n: u32,
    grid_size: f64,
    key_order: KeyOrder,
) -> Result<VoxelGroups<L::Buffer>, GridSampleError<L::Error>> {
    if !(grid_size.is_finite() && grid_size > 0.0) {
        return Err(GridSampleError::GridSize(grid_size));
    }
    l.expect::<[f32; 3]>("coordinates", coord, n.into());
    let (min_cell, max_index) = cell_bounds(l, coord, n, grid_size)?;
    let Codes { along_curve, y_bits, z_bits, bits } = Codes::of(key_order, max_index);
    let rows = n as usize;
    let mut codes = l.alloc_values::<u64>(rows)?;
    l.run(
        &CELL_CODES,
        n.into(),
        &[coord],
        &mut [&mut codes],
        &[
            U32(n),
            F64(grid_size),
            F64(min_cell[0]),
            F64(min_cell[1]),
            F64(min_cell[2]),
            U32(along_curve),
            U32(y_bits),
            U32(z_bits),
        ],
    )?;
    let sorted = radix_sort::sort(l, codes, n, bits)?;
    let mut begins = l.alloc_values::<u32>(rows)?;
    l.run(&CELL_BEGINS, n.into(), &[&sorted.codes], &mut [&mut begins], &[U32(n)])?;
    let sums = scan::running_sums(l, &begins, n.into())?;
    let num_voxels = l.download_values::<u32>(&sums.total, 1)?[0];
    let mut found = VoxelGroups {
        order: sorted.rows,
        offsets: match n {
            0 => l.upload_values(&[0u32])?,
            _ => l.alloc_values::<u32>(num_voxels as usize + 1)?,
        },
        inverse: l.alloc_values::<u32>(rows)?,
        grid_coord: l.alloc_values::<[i32; 3]>(num_voxels as usize)?,
        num_voxels,
        min_cell,
        max_index,
    };
    l.run(
        &LIST_CELLS,
        n.into(),
        &[&sorted.codes, &found.order, &begins, &sums.before],
        &mut [&mut found.offsets, &mut found.grid_coord, &mut found.inverse],
        &[U32(n), U32(along_curve), U32(y_bits), U32(z_bits)],
    )?;
    Ok(match key_order {
        KeyOrder::Fnv => by_hash(l, &found, n)?,
        KeyOrder::Ravel | KeyOrder::Morton => found,
    })
}

/// The same voxels in the order of their hash; those of one hash stay in the order of x, y, z.
fn by_hash<L: Launcher>(
    l: &L,
    groups: &VoxelGroups<L::Buffer>,
    n: u32,
) -> Result<VoxelGroups<L::Buffer>, L::Error> {
    let voxels = groups.num_voxels;
    let mut hashes = l.alloc_values::<u64>(voxels as usize)?;
    l.run(&HASH_CELLS, voxels.into(), &[&groups.grid_coord], &mut [&mut hashes], &[U32(voxels)])?;
    let order = radix_sort::sort(l, hashes, voxels, u64::BITS)?.rows;
    let mut place = l.alloc_values::<u32>(voxels as usize)?;
    rows::invert(l, &order, voxels, &mut place)?;
    let mut counts = l.alloc_values::<u32>(voxels as usize)?;
    l.run(
        &MOVED_COUNTS,
        voxels.into(),
        &[&order, &groups.offsets],
        &mut [&mut counts],
        &[U32(voxels)],
    )?;
    let before = scan::running_sums(l, &counts, voxels.into())?.before;
    let mut end = vec![0u32; voxels as usize + 1];
    end[voxels as usize] = n;
    let mut moved = VoxelGroups {
        order: l.alloc_values::<u32>(n as usize)?,
        offsets: l.upload_values(&end)?,
        inverse: l.alloc_values::<u32>(n as usize)?,
        grid_coord: l.alloc_values::<[i32; 3]>(voxels as usize)?,
        ..*groups
    };
    l.run(
        &MOVE_CELLS,
        n.into(),
        &[&groups.order, &groups.inverse, &place, &groups.offsets, &before, &groups.grid_coord],
        &mut [&mut moved.order, &mut moved.inverse, &mut moved.offsets, &mut moved.grid_coord],
        &[U32(n)],
    )?;
    Ok(moved)
}
