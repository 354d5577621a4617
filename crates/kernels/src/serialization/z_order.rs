//! Morton codes.

/// Interleaves `bits` low bits of x, y, z; in each triple x is the most significant.
#[inline(always)]
pub fn morton_code(cell: [u32; 3], bits: u32) -> u64 {
    let mask = (1u64 << bits) - 1;
    let [x, y, z] = cell.map(|v| spread(u64::from(v) & mask));
    x << 2 | y << 1 | z
}

/// Moves bit i of a 21-bit number to bit 3i.
#[inline(always)]
fn spread(v: u64) -> u64 {
    let v = (v | v << 32) & 0x001f_0000_0000_ffff;
    let v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    let v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    let v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}
