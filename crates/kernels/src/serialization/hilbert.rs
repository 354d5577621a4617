//! Hilbert codes by Skilling's transform, many cells at a time.
//!
//! The transform flips and exchanges the lower bits of the coordinates level by level. Without
//! branches it is a dozen bit operations a level, the same for each cell, so it runs in all lanes
//! of a register: faster than a state machine with a table, whose lookups wait for each other.

use super::z_order::morton_code;

/// Cells that are transformed together. Long enough for a loop that compilers turn into vector
/// code; sixteen, one register, they unroll into scalars.
pub(super) const LANES: usize = 64;

/// Hilbert code of one cell with `bits` bits an axis (at most 21).
pub fn hilbert_code(cell: [u32; 3], bits: u32) -> u64 {
    let [x, y, z] = cell;
    let mut code = [0];
    hilbert_codes(&mut [x], &mut [y], &mut [z], bits, &mut code);
    code[0]
}

/// Hilbert codes of cells given axis by axis; the coordinates are used up.
#[inline(always)]
pub(super) fn hilbert_codes<const N: usize>(
    x: &mut [u32; N],
    y: &mut [u32; N],
    z: &mut [u32; N],
    bits: u32,
    codes: &mut [u64; N],
) {
    for level in (0..bits).rev() {
        let lower = (1u32 << level) - 1;
        for i in 0..N {
            x[i] ^= lower & bit_mask(x[i], level);
            turn(&mut x[i], &mut y[i], level, lower);
            turn(&mut x[i], &mut z[i], level, lower);
        }
    }
    for i in 0..N {
        // The Gray code of the code, of which a bit is the parity of these from the top down to it.
        let gray = morton_code([x[i], y[i], z[i]], bits);
        codes[i] = [1, 2, 4, 8, 16, 32].into_iter().fold(gray, |g, step| g ^ g >> step);
    }
}

/// All ones where the bit is set, else zero.
#[inline(always)]
fn bit_mask(value: u32, bit: u32) -> u32 {
    0u32.wrapping_sub(value >> bit & 1)
}

/// Flips the lower bits of `x` where `other` has the level's bit, else exchanges those of the two.
#[inline(always)]
fn turn(x: &mut u32, other: &mut u32, level: u32, lower: u32) {
    let set = bit_mask(*other, level);
    let exchange = (*x ^ *other) & lower & !set;
    *x ^= exchange | lower & set;
    *other ^= exchange;
}
