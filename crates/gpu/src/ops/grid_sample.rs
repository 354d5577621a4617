//! Which points share a voxel.
//!
//! The cell of a point is `floor(coordinate / grid_size)`, divided in f64, which devices here do not have. Both steps keep
//! order, so a cell is a stretch of coordinates: the host finds the smallest coordinate of each cell between the bounds of
//! the points, by that very division, and the device counts how many of them a point has reached. It compares whole numbers
//! only, so that cells are those of the CPU bit for bit.

use super::grouping::{By, Grouping, coarse_cells, group};
use super::pool::DeviceGroups;
use super::radix_sort::{Keys, Sorted, argsort, sort, sort_words};
use super::scenes::Scenes;
use super::{curves, groups_of_256, lists, number};
use crate::error::{GpuError, Result, shape};
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};
use scenesplat_kernels::grid_sample::{self as host, KeyOrder, MAX_CELL, is_grid_size};
use scenesplat_kernels::serialization::Curve;

const BOUNDS: &str =
    concat!(include_str!("../../wgsl/grid_bounds.wgsl"), include_str!("../../wgsl/ordered.wgsl"));
const CELLS: &str =
    concat!(include_str!("../../wgsl/grid_sample.wgsl"), include_str!("../../wgsl/ordered.wgsl"));
const KEYS: &str = include_str!("../../wgsl/voxel_keys.wgsl");
/// Rows of a workgroup that looks for bounds.
const BLOCK: usize = 2048;

/// Points grouped by voxel, on the device; voxels are listed by ascending key (see [`KeyOrder`]).
#[derive(Debug, Clone)]
pub struct VoxelGroups {
    /// Points voxel by voxel, ascending inside a voxel; where each voxel begins; and the voxel of each point.
    pub groups: DeviceGroups,
    /// Smallest point of each voxel. `[V]`
    pub first_rows: Array<u32>,
    /// Cell of each voxel, shifted so that the smallest of each axis is 0. `[V, 3]`
    pub cells: Array<[i32; 3]>,
    /// The shift: smallest cell of each axis, a whole number.
    pub min_cell: [f64; 3],
    /// Largest shifted cell of each axis.
    pub max_cell: [u32; 3],
    /// Voxel size, meters.
    pub grid_size: f64,
}

impl VoxelGroups {
    /// Number of voxels.
    pub fn num_voxels(&self) -> usize {
        self.cells.len()
    }

    /// Runs all commands so far and gives the groups to the host, whose functions pick points by rules in f64 (as the point
    /// nearest to a voxel's center).
    ///
    /// # Errors
    /// As [`Commands::read`].
    pub fn read(&self, commands: &mut Commands) -> Result<host::VoxelGroups> {
        Ok(host::VoxelGroups {
            order: commands.read(&self.groups.rows)?,
            offsets: commands.read(&self.groups.starts)?,
            inverse: commands.read(&self.groups.inverse)?,
            grid_coord: commands.read(&self.cells)?,
            min_cell: self.min_cell,
            grid_size: self.grid_size,
        })
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    others: [u32; 3],
}

/// Groups points by voxel, as `scenesplat_kernels::grid_sample::voxel_groups`. Runs all commands so far, twice: the bounds
/// of the points are read, and the number of voxels (of [`KeyOrder::Fnv`] twice).
///
/// # Shapes
/// `coord`: `[N, 3]` meters, finite
///
/// # Errors
/// What the CPU refuses, in its words: if `grid_size` is none, a coordinate is not finite, or an axis spans more than
/// [`MAX_CELL`] + 1 cells. If the device has no room.
pub fn voxel_groups(
    commands: &mut Commands,
    coord: &Array<[f32; 3]>,
    grid_size: f64,
    key_order: KeyOrder,
) -> Result<VoxelGroups> {
    let rows = coord.len();
    if !is_grid_size(grid_size) {
        return shape(host::GridSampleError::GridSize { grid_size }.to_string());
    }
    let grid = match bounds(commands, coord)? {
        Some(bounds) => match Grid::new(bounds, grid_size) {
            Some(grid) => grid,
            None => return Err(refusal(&commands.read(coord)?, grid_size)),
        },
        None if rows > 0 => return Err(refusal(&commands.read(coord)?, grid_size)),
        None => Grid::default(),
    };
    let of_rows = cells(commands, coord, &grid)?;
    let one = Scenes::upload(commands.gpu(), vec![0, rows], rows)?;
    let bits = grid.bits();
    let most = bits[0].max(bits[1]).max(bits[2]);
    let sorted = if key_order == KeyOrder::Morton {
        let keys = curves::codes(commands, Curve::Z, &of_rows, &one, &[most])?;
        sort(commands, &keys, None, 3 * most)?
    } else {
        let keys = keys(commands, &of_rows, None, [bits[1], bits[2]])?;
        sort(commands, &keys, None, bits[0] + bits[1] + bits[2])?
    };
    let mut found = group(commands, &one, &By::Keys(&sorted))?;
    drop(sorted);
    let no_shift = commands.gpu().upload("shifts", &[0u32])?;
    let mut cells = coarse_cells(commands, &one, &no_shift, &found.heads, &of_rows)?;
    if key_order == KeyOrder::Fnv {
        found = by_hash(commands, &one, &found, &cells)?;
        cells = coarse_cells(commands, &one, &no_shift, &found.heads, &of_rows)?;
    }
    let Grid { min_cell, max_cell, .. } = grid;
    let Grouping { groups, heads: first_rows, .. } = found;
    Ok(VoxelGroups { groups, first_rows, cells, min_cell, max_cell, grid_size })
}

/// The same groups in the order of the hashes of their cells; those of one hash stay as they are.
fn by_hash(
    commands: &mut Commands,
    scenes: &Scenes,
    found: &Grouping,
    cells: &Array<[i32; 3]>,
) -> Result<Grouping> {
    let hashes = keys(commands, cells, Some("FNV"), [0; 2])?;
    let order = argsort(commands, &hashes, u64::BITS)?;
    let places = lists::invert(commands, &order)?;
    let place_of_rows = lists::compose(commands, &places, &found.groups.inverse)?;
    let bits = usize::BITS - cells.len().saturating_sub(1).leading_zeros();
    let (low, rows) = sort_words(commands, &place_of_rows, None, bits)?;
    let high = commands.array("keys", low.len())?;
    commands.clear(&high);
    group(commands, scenes, &By::Keys(&Sorted { keys: Keys { low, high }, rows }))
}

/// Smallest and largest coordinate of each axis; `None` if there is no point, or one is not finite.
fn bounds(commands: &mut Commands, coord: &Array<[f32; 3]>) -> Result<Option<[[f32; 3]; 2]>> {
    if coord.is_empty() {
        return Ok(None);
    }
    let found: Array<u32> = commands.array("bounds", 7)?;
    commands.clear(&found);
    let kernel = commands.gpu().kernel("grid_bounds", BOUNDS, &[], &[]);
    let params = Params { rows: number(coord.len())?, others: [0; 3] };
    let blocks = coord.len().div_ceil(BLOCK) as u64;
    commands.run(&kernel, &params, &[(1, coord), (2, &found)], blocks)?;
    let found = commands.read(&found)?;
    let low = std::array::from_fn(|axis| value_of(!found[axis]));
    let high = std::array::from_fn(|axis| value_of(found[3 + axis]));
    Ok((found[6] == 0).then_some([low, high]))
}

/// A whole number that orders finite values as these; both zeros have one.
fn ordered(value: f32) -> u32 {
    let bits = (value + 0.0).to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// The value of an ordered number.
fn value_of(ordered: u32) -> f32 {
    f32::from_bits(if ordered >> 31 == 1 { ordered & !(1 << 31) } else { !ordered })
}

/// Cells between the bounds of points.
#[derive(Default)]
struct Grid {
    min_cell: [f64; 3],
    max_cell: [u32; 3],
    /// The smallest coordinate of each cell but the first, as ordered numbers, axis after axis.
    bounds: Vec<u32>,
}

impl Grid {
    /// `None` if an axis has too many cells.
    fn new([low, high]: [[f32; 3]; 2], grid_size: f64) -> Option<Self> {
        let floor_cell = |v: f32| (f64::from(v) / grid_size).floor();
        let mut grid = Self { min_cell: low.map(floor_cell), ..Self::default() };
        for axis in 0..3 {
            let most = floor_cell(high[axis]) - grid.min_cell[axis];
            // NaN, which infinite quotients give, is in no range.
            if !(0.0..=f64::from(MAX_CELL)).contains(&most) {
                return None;
            }
            grid.max_cell[axis] = most as u32;
        }
        for axis in 0..3 {
            let first = grid.min_cell[axis];
            let cell = |v: f32| floor_cell(v) - first;
            grid.bounds.extend((1..=grid.max_cell[axis]).map(|wanted| {
                let wanted = f64::from(wanted);
                // A step or two from the right one.
                let mut value =
                    (((first + wanted) * grid_size) as f32).clamp(low[axis], high[axis]);
                while cell(value) >= wanted {
                    value = value.next_down();
                }
                while cell(value) < wanted {
                    value = value.next_up();
                }
                ordered(value)
            }));
        }
        Some(grid)
    }

    /// Bits of the cells of each axis.
    fn bits(&self) -> [u32; 3] {
        self.max_cell.map(|most| u32::BITS - most.leading_zeros())
    }
}

/// Why the CPU refuses these points.
fn refusal(coord: &[[f32; 3]], grid_size: f64) -> GpuError {
    let refused = host::voxel_groups(coord, grid_size, KeyOrder::Morton).err();
    let message = refused.map_or("points that cannot be grouped".to_owned(), |e| e.to_string());
    GpuError::Shape(message)
}

/// Cell of each point. `[N, 3] → [N, 3]`
fn cells(commands: &mut Commands, coord: &Array<[f32; 3]>, grid: &Grid) -> Result<Array<[i32; 3]>> {
    let out = commands.array("cells", coord.len())?;
    let bounds = commands.gpu().upload("bounds of cells", &grid.bounds)?;
    let [x, y, z] = grid.max_cell;
    let params = Params { rows: number(coord.len())?, others: [x, x + y, x + y + z] };
    let kernel = commands.gpu().kernel("grid_sample", CELLS, &[], &[]);
    let arrays: [(u32, &dyn Bound); 3] = [(1, coord), (2, &bounds), (3, &out)];
    commands.run(&kernel, &params, &arrays, groups_of_256(coord.len()))?;
    Ok(out)
}

/// Keys of cells. `[N, 3] → [N]`
fn keys(
    commands: &mut Commands,
    cells: &Array<[i32; 3]>,
    flag: Option<&str>,
    [y_bits, z_bits]: [u32; 2],
) -> Result<Keys> {
    let out = Keys::new(commands, cells.len())?;
    let flags: Vec<&str> = flag.into_iter().collect();
    let kernel = commands.gpu().kernel("voxel_keys", KEYS, &flags, &[]);
    let params = Params { rows: number(cells.len())?, others: [y_bits, z_bits, 0] };
    let arrays: [(u32, &dyn Bound); 3] = [(1, cells), (2, &out.low), (3, &out.high)];
    commands.run(&kernel, &params, &arrays, groups_of_256(cells.len()))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Choice, Gpu};

    #[test]
    fn hashes_are_those_of_the_original() {
        let gpu = match Gpu::open(&Choice::Best) {
            Ok(gpu) => gpu,
            Err(error) => {
                println!("skipped: {error}");
                return;
            }
        };
        let mut cells: Vec<[i32; 3]> = vec![[0; 3], [3, 5, 7], [MAX_CELL as i32; 3]];
        // Enough for a carry in each multiplication.
        cells.extend((0..9000).map(|i| [i * 233, i * 31, (i * 7919) % 2_097_152]));
        let mut commands = gpu.commands();
        let device = gpu.upload("cells", &cells).unwrap();
        let got = keys(&mut commands, &device, Some("FNV"), [0; 2]).unwrap();
        let want: Vec<u64> =
            cells.iter().map(|cell| host::fnv_key(cell.map(|v| v as u32))).collect();
        assert_eq!(got.read(&mut commands).unwrap(), want);
    }

    #[test]
    fn ordered_numbers_order_values_and_lead_back() {
        let values = [
            f32::MIN,
            -1.0,
            -f32::MIN_POSITIVE,
            -1e-45,
            0.0,
            1e-45,
            f32::MIN_POSITIVE,
            0.5,
            f32::MAX,
        ];
        assert!(values.windows(2).all(|pair| ordered(pair[0]) < ordered(pair[1])));
        assert!(values.iter().all(|value| value_of(ordered(*value)) == *value));
        assert_eq!(ordered(-0.0), ordered(0.0));
    }

    #[test]
    fn a_bound_is_the_smallest_coordinate_of_its_cell() {
        for (low, high, size) in
            [(-3.7, 5.2, 0.02), (1e6, 1e6 + 40.0, 0.1), (0.0, 1e-40, 1e-43), (-1e-3, 1e38, 1e34)]
        {
            let grid = Grid::new([[low; 3], [high; 3]], size).unwrap();
            assert_eq!(grid.bounds.len(), 3 * grid.max_cell[0] as usize);
            let cell = |v: f32| (f64::from(v) / size).floor() - grid.min_cell[0];
            for (i, bound) in grid.bounds[..grid.max_cell[0] as usize].iter().enumerate() {
                let value = value_of(*bound);
                assert!(cell(value) >= (i + 1) as f64 && cell(value.next_down()) < (i + 1) as f64);
            }
        }
    }
}
