//! Copies of rows: gathers and permutations.

use crate::shape::elements;
use rayon::prelude::*;

/// Values that one task copies, about a second-level cache full.
const BLOCK_VALUES: usize = 1 << 16;

/// `out[i] = x[rows[i]]`. The backward of a permutation is the gather by its inverse.
///
/// # Shapes
/// `x`: `[M, C]` · `rows`: `[N]`, each below M · `out`: `[N, C]`
///
/// # Panics
/// If a row is out of range or `out` has another length (bugs of the caller).
pub fn gather_rows<T: Copy + Send + Sync>(x: &[T], c: usize, rows: &[u32], out: &mut [T]) {
    assert_eq!(out.len(), elements([rows.len(), c]), "gathered rows: output length");
    if c == 0 {
        return;
    }
    let block = (BLOCK_VALUES / c).max(1);
    out.par_chunks_mut(block * c).zip(rows.par_chunks(block)).for_each(|(out, rows)| {
        for (i, (to, &row)) in out.chunks_exact_mut(c).zip(rows).enumerate() {
            prefetch_rows(x, c, rows, i + 1, 1);
            let from = row_start(row, c);
            to.copy_from_slice(&x[from..from + c]);
        }
    });
}

/// First element of a row: the product is made in `usize`, so 2³¹ rows of 768 do not overflow.
#[inline(always)]
pub fn row_start(row: u32, c: usize) -> usize {
    row as usize * c
}

/// Asks for rows ahead of their use: `count` of those listed a while after position `next`. A core
/// guesses the next address of an array, not the next row of a list.
#[inline(always)]
pub(crate) fn prefetch_rows<T>(x: &[T], c: usize, rows: &[u32], next: usize, count: usize) {
    /// Rows ahead; a row is long enough for the memory to answer in the time these take.
    const AHEAD: usize = 8;
    /// Of longer rows the processor sees the pattern by itself.
    const MOST_BYTES: usize = 512;
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let bytes = (c * size_of::<T>()).min(MOST_BYTES);
        for &row in rows.iter().skip(next + AHEAD).take(count) {
            let start = x.as_ptr().wrapping_add(row_start(row, c)).cast::<i8>();
            for line in (0..bytes).step_by(64) {
                // SAFETY: a hint that reads nothing, harmless at any address.
                unsafe { _mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(line)) };
            }
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (x, c, rows, next, count, AHEAD, MOST_BYTES);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gathers_and_undoes() {
        let x: Vec<f32> = (0..15).map(|v| v as f32).collect();
        let order = [3u32, 0, 4, 1, 2];
        let mut y = vec![0.0; 15];
        gather_rows(&x, 3, &order, &mut y);
        assert_eq!(y[..6], [9.0, 10.0, 11.0, 0.0, 1.0, 2.0]);
        let mut back = vec![0.0; 15];
        gather_rows(&y, 3, &crate::serialization::invert(&order), &mut back);
        assert_eq!(back, x);
    }

    #[test]
    fn two_to_the_31_rows_do_not_overflow() {
        assert_eq!(row_start(1 << 31, 768), 1_649_267_441_664);
        assert_eq!(row_start(u32::MAX - 1, 3072), 13_194_139_527_168);
    }
}
