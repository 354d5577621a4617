//! Space-filling curves: from voxels to the four orders in which attention walks a scene.
//!
//! Four curves as in the original: Morton (`Z`), Hilbert, and both with the first two axes
//! exchanged. Codes have up to 21 bits an axis (the original stops at 16). A scene whose voxels are
//! all at the origin has depth 0 and code 0 for each curve, where the original fails.

mod hilbert;
mod radix_sort;
mod z_order;

pub use hilbert::hilbert_code;
pub(crate) use radix_sort::{Sorted, order_and_inverse, shared};
pub use radix_sort::{argsort, argsort_into, invert};
pub use z_order::morton_code;

use crate::KernelError;
use crate::simd::{Vector, dispatch};
use hilbert::{LANES, hilbert_codes};
use rayon::prelude::*;

/// Most bits that a grid coordinate may have.
pub const MAX_DEPTH: u32 = 21;

/// One space-filling curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Curve {
    /// Morton order, x most significant.
    Z,
    /// Morton order of (y, x, z).
    ZTrans,
    /// Hilbert order.
    Hilbert,
    /// Hilbert order of (y, x, z).
    HilbertTrans,
}

impl Curve {
    /// The order list of every released configuration.
    pub const ALL: [Self; 4] = [Self::Z, Self::ZTrans, Self::Hilbert, Self::HilbertTrans];

    /// Name as configurations spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Z => "z",
            Self::ZTrans => "z-trans",
            Self::Hilbert => "hilbert",
            Self::HilbertTrans => "hilbert-trans",
        }
    }

    /// The curve of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|c| c.name() == name)
    }

    /// Code of one cell; `depth` bits an axis, higher bits are cut off.
    pub fn code(self, cell: [u32; 3], depth: u32) -> u64 {
        let [x, y, z] = cell;
        match self {
            Self::Z => morton_code([x, y, z], depth),
            Self::ZTrans => morton_code([y, x, z], depth),
            Self::Hilbert => hilbert_code([x, y, z], depth),
            Self::HilbertTrans => hilbert_code([y, x, z], depth),
        }
    }
}

/// Bits that the largest coordinate of these cells has; 0 when all are at the origin.
///
/// # Errors
/// If a coordinate is negative or has more than [`MAX_DEPTH`] bits, naming row, axis and value.
pub fn depth_of(grid_coord: &[[i32; 3]]) -> Result<u32, KernelError> {
    let (low, high) = grid_coord
        .par_iter()
        .map(|c| (c[0].min(c[1]).min(c[2]), c[0].max(c[1]).max(c[2])))
        .reduce(|| (0, 0), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let depth = 32 - high.max(0).leading_zeros();
    if low < 0 || depth > MAX_DEPTH {
        let (row, axis, value) = grid_coord
            .iter()
            .enumerate()
            .flat_map(|(row, c)| c.iter().enumerate().map(move |(axis, v)| (row, axis, *v)))
            .find(|&(_, _, v)| !(0..1 << MAX_DEPTH).contains(&v))
            .unwrap_or_default();
        return Err(KernelError::GridCoord { row, axis, value });
    }
    Ok(depth)
}

/// Codes of all cells. `[N]`
pub fn codes(curve: Curve, grid_coord: &[[i32; 3]], depth: u32) -> Vec<u64> {
    let mut out = vec![0; grid_coord.len()];
    codes_into(curve, grid_coord, depth, &mut out);
    out
}

/// Writes the codes of all cells into `out` (same length).
pub fn codes_into(curve: Curve, grid_coord: &[[i32; 3]], depth: u32, out: &mut [u64]) {
    const BLOCK: usize = 4096;
    assert!(depth <= MAX_DEPTH && out.len() == grid_coord.len(), "curve codes: arguments");
    out.par_chunks_mut(BLOCK).zip(grid_coord.par_chunks(BLOCK)).for_each(|(out, cells)| {
        dispatch!((curve: Curve, cells: &[[i32; 3]], depth: u32, out: &mut [u64]),
            V => code_block::<V>(curve, cells, depth, out));
    });
}

/// Plain code that the compiler fits to the registers of each instruction set; reading the cells
/// and writing the codes is what remains. Deposits of bits (`pdep`) are no faster: one at a time,
/// three a cell, against sixteen cells together.
#[inline(always)]
unsafe fn code_block<V: Vector>(curve: Curve, cells: &[[i32; 3]], depth: u32, out: &mut [u64]) {
    let swapped = matches!(curve, Curve::ZTrans | Curve::HilbertTrans);
    if matches!(curve, Curve::Z | Curve::ZTrans) {
        let [first, second] = if swapped { [1, 0] } else { [0, 1] };
        for (o, c) in out.iter_mut().zip(cells) {
            *o = morton_code([c[first] as u32, c[second] as u32, c[2] as u32], depth);
        }
        return;
    }
    let (blocks, rest) = cells.as_chunks::<LANES>();
    let (outs, last) = out.as_chunks_mut::<LANES>();
    let [mut x, mut y, mut z] = [[0u32; LANES]; 3];
    for (out, cells) in outs.iter_mut().zip(blocks) {
        for i in 0..LANES {
            [x[i], y[i], z[i]] = cells[i].map(|v| v as u32);
        }
        let [first, second] = if swapped { [&mut y, &mut x] } else { [&mut x, &mut y] };
        hilbert_codes(first, second, &mut z, depth, out);
    }
    for (out, &c) in last.iter_mut().zip(rest) {
        *out = curve.code(c.map(|v| v as u32), depth);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use rand::{Rng, SeedableRng};

    #[test]
    fn agrees_with_the_bitwise_reference_at_every_depth() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for depth in 0..=MAX_DEPTH {
            for _ in 0..200 {
                let cell: [u32; 3] =
                    std::array::from_fn(|_| rng.random::<u32>() & ((1 << depth) - 1));
                assert_eq!(morton_code(cell, depth), reference::morton_code(cell, depth));
                assert_eq!(
                    hilbert_code(cell, depth),
                    reference::hilbert_code(cell, depth),
                    "{cell:?} {depth}"
                );
            }
        }
    }

    #[test]
    fn consecutive_hilbert_cells_touch() {
        let mut cells: Vec<[i32; 3]> = (0..4096).map(|i| [i & 15, i >> 4 & 15, i >> 8]).collect();
        cells.sort_by_key(|c| Curve::Hilbert.code(c.map(|v| v as u32), 4));
        for pair in cells.windows(2) {
            let step: i32 = (0..3).map(|a| (pair[0][a] - pair[1][a]).abs()).sum();
            assert_eq!(step, 1);
        }
    }

    #[test]
    fn a_coarser_code_is_the_shifted_code() {
        let cell = [40_000, 12_345, 54_321];
        for curve in Curve::ALL {
            assert_eq!(curve.code(cell, 16) >> 3, curve.code(cell.map(|v| v >> 1), 15));
        }
    }

    #[test]
    fn refuses_what_codes_cannot_hold() {
        assert_eq!(depth_of(&[]).unwrap(), 0);
        assert_eq!(depth_of(&[[0; 3]; 5]).unwrap(), 0);
        assert_eq!(depth_of(&[[0, (1 << 21) - 1, 3]]).unwrap(), 21);
        assert!(matches!(
            depth_of(&[[0; 3], [0, 1 << 21, 0]]),
            Err(KernelError::GridCoord { row: 1, axis: 1, value: 2_097_152 })
        ));
        assert!(matches!(
            depth_of(&[[0, 0, -1]]),
            Err(KernelError::GridCoord { row: 0, axis: 2, value: -1 })
        ));
    }
}
