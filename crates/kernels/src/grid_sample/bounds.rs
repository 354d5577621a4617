//! Which cells a scene reaches, and whether an index can hold them.

use super::{CHUNK, GridSampleError, MAX_CELL};
use crate::simd::{Vector, dispatch};
use rayon::prelude::*;

/// Values that are compared together: rows of three in whole registers.
const LANES: usize = 48;

/// Smallest cell and largest shifted index per axis, after checking every coordinate.
pub(super) fn cell_bounds(
    coord: &[[f32; 3]],
    grid_size: f64,
) -> Result<([f64; 3], [u32; 3]), GridSampleError> {
    if coord.is_empty() {
        return Ok(([0.0; 3], [0; 3]));
    }
    // Division and floor keep order, so the bounds of the cells are the cells of the bounds.
    let extent = coord
        .par_chunks(CHUNK)
        .map(|rows| dispatch!((rows: &[[f32; 3]]) -> Extent, V => extent::<V>(rows)))
        .reduce(|| Extent::NOTHING, Extent::joined);
    let not_finite = |c: &[f32; 3]| !c.iter().all(|v| v.is_finite());
    if extent.not_finite
        && let Some(row) = coord.par_iter().position_first(not_finite)
    {
        let axis = coord[row].iter().position(|v| !v.is_finite()).unwrap_or(0);
        return Err(GridSampleError::NotFinite { row, axis: AXES[axis], value: coord[row][axis] });
    }
    let floor_cell = |v: f32| (f64::from(v) / grid_size).floor();
    let mut max_index = [0; 3];
    for axis in 0..3 {
        let cells = floor_cell(extent.high[axis]) - floor_cell(extent.low[axis]);
        // Also true for NaN, which infinite quotients give.
        if cells.is_nan() || cells > f64::from(MAX_CELL) {
            return Err(too_wide(coord, axis, cells + 1.0, grid_size));
        }
        max_index[axis] = cells as u32;
    }
    Ok((extent.low.map(floor_cell), max_index))
}

/// Bounds of some rows; arbitrary if one is not finite.
#[derive(Clone, Copy)]
struct Extent {
    low: [f32; 3],
    high: [f32; 3],
    not_finite: bool,
}

impl Extent {
    const NOTHING: Self =
        Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3], not_finite: false };

    fn joined(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|a| self.low[a].min(other.low[a])),
            high: std::array::from_fn(|a| self.high[a].max(other.high[a])),
            not_finite: self.not_finite || other.not_finite,
        }
    }
}

/// Plain code that the compiler fits to the registers of each instruction set.
#[inline(always)]
unsafe fn extent<V: Vector>(rows: &[[f32; 3]]) -> Extent {
    let mut low = [f32::INFINITY; LANES];
    let mut high = [f32::NEG_INFINITY; LANES];
    let mut not_finite = [0u32; LANES];
    let mut widen = |i: usize, v: f32| {
        low[i] = if v < low[i] { v } else { low[i] };
        high[i] = if v > high[i] { v } else { high[i] };
        // The exponent of NaN and infinities is all ones.
        not_finite[i] |= u32::from(v.to_bits() & 0x7f80_0000 == 0x7f80_0000);
    };
    let (blocks, rest) = rows.as_flattened().as_chunks::<LANES>();
    for block in blocks {
        for i in 0..LANES {
            widen(i, block[i]);
        }
    }
    for (i, &v) in rest.iter().enumerate() {
        widen(i, v);
    }
    (0..LANES / 3).fold(Extent::NOTHING, |all, row| {
        let at = |values: &[f32; LANES]| std::array::from_fn(|a| values[3 * row + a]);
        let not_finite = not_finite[3 * row..3 * row + 3].iter().any(|&n| n != 0);
        all.joined(Extent { low: at(&low), high: at(&high), not_finite })
    })
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
