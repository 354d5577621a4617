//! The window of a kernel: which cells of which blocks its taps read.

use crate::simd::Isa;

/// Where the taps of a kernel lead from each of the 64 cells of a block.
pub(super) struct Kernel {
    pub(super) taps: usize,
    /// Words of 64 taps.
    pub(super) words: usize,
    /// For each cell and tap: which of the 27 blocks around, which cell of it.
    steps: Vec<(u8, u8)>,
    /// For each cell: the parts of the window.
    parts: Vec<Vec<Part>>,
}

/// Taps of one word that lead into one block. Cells and taps both ascend by `x, y, z`, so the n-th
/// tap leads to the n-th cell.
struct Part {
    block: usize,
    word: usize,
    cells: u64,
    taps: u64,
}

impl Kernel {
    pub(super) fn new(kernel_size: usize) -> Self {
        let taps = kernel_size.pow(3);
        let half = kernel_size as i32 / 2;
        let k = kernel_size as i32;
        let mut steps = Vec::with_capacity(64 * taps);
        for cell in 0..64 {
            let at = [cell >> 4, cell >> 2 & 3, cell & 3];
            for tap in 0..taps as i32 {
                let d = [tap / (k * k) - half, tap / k % k - half, tap % k - half];
                let to: [i32; 3] = std::array::from_fn(|a| at[a] + d[a]);
                let block = to.iter().fold(0, |b, v| b * 3 + v.div_euclid(4) + 1);
                let inner = to.iter().fold(0, |c, v| c * 4 + v.rem_euclid(4));
                steps.push((block as u8, inner as u8));
            }
        }
        let parts = steps.chunks(taps).map(parts_of).collect();
        Self { taps, words: taps.div_ceil(64), steps, parts }
    }

    /// For each tap from a cell: which of the 27 blocks around, which cell of it.
    #[inline(always)]
    pub(super) fn steps_of(&self, cell: usize) -> &[(u8, u8)] {
        &self.steps[cell * self.taps..(cell + 1) * self.taps]
    }

    /// Sets the bits of the taps from `cell` that meet a voxel; `near` gives the occupied cells of the
    /// blocks around. `has_bmi2` as [`with_bit_operations`] says it.
    #[inline(always)]
    pub(super) fn window(
        &self,
        has_bmi2: bool,
        cell: usize,
        near: impl Fn(usize) -> u64,
        found: &mut [u64],
    ) {
        found.fill(0);
        for part in &self.parts[cell] {
            found[part.word] |= taps_of_cells(has_bmi2, near(part.block), part);
        }
    }
}

fn parts_of(steps: &[(u8, u8)]) -> Vec<Part> {
    let mut parts: Vec<Part> = Vec::new();
    for (tap, &(block, inner)) in steps.iter().enumerate() {
        let (block, word) = (usize::from(block), tap / 64);
        let at = parts.iter().position(|p| (p.block, p.word) == (block, word));
        let at = at.unwrap_or_else(|| {
            parts.push(Part { block, word, cells: 0, taps: 0 });
            parts.len() - 1
        });
        parts[at].cells |= 1 << inner;
        parts[at].taps |= 1 << (tap % 64);
    }
    parts
}

/// The taps of a part whose cells are occupied.
#[inline(always)]
fn taps_of_cells(has_bmi2: bool, occupied: u64, part: &Part) -> u64 {
    #[cfg(target_arch = "x86_64")]
    if has_bmi2 {
        use std::arch::x86_64::{_pdep_u64, _pext_u64};
        // SAFETY: the caller found the instructions on this CPU.
        return unsafe { _pdep_u64(_pext_u64(occupied, part.cells), part.taps) };
    }
    let (mut cells, mut taps, mut found) = (part.cells, part.taps, 0);
    while cells != 0 {
        if occupied >> cells.trailing_zeros() & 1 == 1 {
            found |= taps & taps.wrapping_neg();
        }
        cells &= cells - 1;
        taps &= taps - 1;
    }
    found
}

/// Exchanges rows and columns of a matrix of 64 × 64 bits: squares of 32, 16, … bits change places.
#[inline(always)]
pub(super) fn transpose(rows: &mut [u64; 64]) {
    let mut mask = 0x0000_0000_ffff_ffff_u64;
    let mut side = 32;
    while side != 0 {
        for start in (0..64).step_by(2 * side) {
            for i in start..start + side {
                let exchange = (rows[i] >> side ^ rows[i + side]) & mask;
                rows[i + side] ^= exchange;
                rows[i] ^= exchange << side;
            }
        }
        side /= 2;
        mask ^= mask << side;
    }
}

/// Runs `body` compiled for a CPU that counts, finds and moves bits in one instruction, where it
/// does; says whether `pdep` and `pext` are quick. Processors with AVX2 alone include those on which
/// they are slower than a loop.
#[inline(always)]
pub(super) fn with_bit_operations(body: impl FnOnce(bool)) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
        fn compiled(body: impl FnOnce(bool), quick: bool) {
            body(quick);
        }
        let bits = is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("popcnt");
        let isa = Isa::current();
        if isa >= Isa::Avx2 && bits {
            // SAFETY: the features were detected.
            unsafe { compiled(body, isa >= Isa::Avx512) };
            return;
        }
    }
    body(false);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn transposes() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let rows: [u64; 64] = std::array::from_fn(|_| rng.random());
        let mut columns = rows;
        transpose(&mut columns);
        for (i, row) in rows.iter().enumerate() {
            for (j, column) in columns.iter().enumerate() {
                assert_eq!(row >> j & 1, column >> i & 1);
            }
        }
    }

    #[test]
    fn windows_are_the_taps_one_by_one() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        for kernel_size in [1, 3, 5, 7] {
            let kernel = Kernel::new(kernel_size);
            for cell in 0..64 {
                let near: [u64; 27] = std::array::from_fn(|_| rng.random());
                let mut want = vec![0; kernel.words];
                for (tap, &(block, inner)) in kernel.steps_of(cell).iter().enumerate() {
                    want[tap / 64] |= (near[usize::from(block)] >> inner & 1) << (tap % 64);
                }
                with_bit_operations(|quick| {
                    for has_bmi2 in [false, quick] {
                        let mut found = vec![u64::MAX; kernel.words];
                        kernel.window(has_bmi2, cell, |b| near[b], &mut found);
                        assert_eq!(found, want);
                    }
                });
            }
        }
    }
}
