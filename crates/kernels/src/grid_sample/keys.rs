//! Keys of cells.

use super::MAX_CELL;

const FNV_OFFSET: u64 = 14_695_981_039_346_656_037;
const FNV_PRIME: u64 = 1_099_511_628_211;

/// The hash of a cell that the original system orders voxels by: multiply, then xor, per axis.
#[inline(always)]
pub fn fnv_key(cell: [u32; 3]) -> u64 {
    cell.iter().fold(FNV_OFFSET, |h, &c| h.wrapping_mul(FNV_PRIME) ^ u64::from(c))
}

/// Row-major index of a cell in a grid of the given shape, at most `2^21` per axis.
pub fn ravel_key(cell: [u32; 3], shape: [u64; 3]) -> u64 {
    let [x, y, z] = cell.map(u64::from);
    (x * shape[1] + y) * shape[2] + z
}

/// The bits of a cell interleaved, `x` above `y` above `z`; indices up to [`MAX_CELL`].
#[inline(always)]
pub fn morton_key(cell: [u32; 3]) -> u64 {
    let [x, y, z] = cell.map(spread_bits);
    x << 2 | y << 1 | z
}

/// Moves bit `i` to bit `3 i`, for 21 bits.
#[inline(always)]
fn spread_bits(value: u32) -> u64 {
    let mut v = u64::from(value & MAX_CELL);
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

/// The cell of a [`morton_key`].
#[inline(always)]
pub(super) fn morton_cell(key: u64) -> [u32; 3] {
    [key >> 2, key >> 1, key].map(gather_bits)
}

/// Moves bit `3 i` to bit `i`, for 21 bits.
#[inline(always)]
fn gather_bits(key: u64) -> u32 {
    let mut v = key & 0x1249_2492_4924_9249;
    v = (v | v >> 2) & 0x10c3_0c30_c30c_30c3;
    v = (v | v >> 4) & 0x100f_00f0_0f00_f00f;
    v = (v | v >> 8) & 0x001f_0000_ff00_00ff;
    v = (v | v >> 16) & 0x001f_0000_0000_ffff;
    (v | v >> 32) as u32 & MAX_CELL
}

#[cfg(test)]
mod tests {
    use super::*;

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
        for cell in [[0; 3], [MAX_CELL, 0, 1], [0, MAX_CELL, 2], [1_234_567, 7, MAX_CELL]] {
            assert_eq!(morton_cell(morton_key(cell)), cell);
        }
    }
}
