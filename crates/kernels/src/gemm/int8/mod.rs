//! Products of 8-bit integers: rows and columns each as integers in −127..=127 and a scale.
//!
//! A row of the left-hand side is divided by its largest magnitude ÷ 127 and rounded to the nearest
//! integer, ties to even; a column of the right-hand side likewise. Products are summed in i32,
//! [`K_BLOCK`](super::K_BLOCK) steps of four values at a time; each such sum is exact, becomes
//! f32, is multiplied by the column's scale, then by the row's, and added in f32. No operation is fused,
//! so every version gives the same bits.
//!
//! Left-hand values are stored with 128 added, as bytes without sign: so the dot products of VNNI
//! want them. Sums start at −128 times the sum of the column's integers, which takes that out again.
//!
//! # Hard values
//! A row or column with a NaN or ±∞ has the scale NaN, so that all its results are NaN; one of zeros
//! has the scale 0. Rows of subnormal numbers are scaled up first: what a product loses is what f32
//! cannot hold.

mod dots;

pub(crate) use dots::Dots;
#[cfg(target_arch = "x86_64")]
pub(crate) use dots::{Avx2, Avx512Vnni, AvxVnni};
pub(crate) use dots::{ColumnScales, Plain};

use super::K_BLOCK;
use crate::simd::compiled;

/// Columns and rows of a matrix below which 8 bits do not pay: such layers compute in f32.
///
/// Rows are quantized for every product and sums brought to scale; for fewer than 64 channels that
/// takes as long as the products.
pub(crate) const LEAST_CHANNELS: usize = 64;

/// What the largest magnitude becomes.
const MOST: f32 = 127.0;
/// Added to left-hand integers.
const OFFSET: u8 = 0x80;

/// Scale of values, and what they are multiplied with, in two steps, to become integers.
#[inline(always)]
fn scale(values: &[f32]) -> (f32, f32, f32) {
    // As integers, magnitudes are in order, and ∞ and NaN above all finite ones.
    let most = values.iter().fold(0, |most: u32, x| most.max(x.to_bits() & 0x7fff_ffff));
    let most = f32::from_bits(most);
    if !most.is_finite() {
        return (f32::NAN, 0.0, 0.0);
    }
    if most == 0.0 {
        return (0.0, 0.0, 0.0);
    }
    // Below this, 127 ÷ most could be ∞.
    const SMALL: f32 = f32::from_bits((127 - 100) << 23);
    const UP: f32 = f32::from_bits((127 + 100) << 23);
    if most < SMALL {
        (most * UP / MOST / UP, UP, MOST / (most * UP))
    } else {
        (most / MOST, 1.0, MOST / most)
    }
}

/// The integers of `from` with 128 added, four to a word in memory order; the rest of `to` is left
/// alone. Returns the scale.
pub(crate) fn quantize(from: &[f32], to: &mut [u32]) -> f32 {
    assert!(from.len() <= 4 * to.len(), "quantize: lengths");
    // SAFETY: bytes of the words, with the words' lifetime.
    let to = unsafe { std::slice::from_raw_parts_mut(to.as_mut_ptr().cast::<u8>(), from.len()) };
    // The register type plays no part: the loops are compiled for the instruction set.
    compiled(
        #[inline(always)]
        || {
            let (scale, up, factor) = scale(from);
            // 1.5 · 2²³: the sum's lowest bits are the nearest integer in two's complement.
            const MAGIC: f32 = 12_582_912.0;
            for (to, from) in to.iter_mut().zip(from) {
                *to = (from * up * factor + MAGIC).to_bits() as u8 ^ OFFSET;
            }
            scale
        },
    )
}

/// A right-hand side in 8 bits.
#[derive(Debug, Clone, Default)]
pub(crate) struct Quads {
    /// Four neighbors along k to a word, in panels as of pairs.
    pub words: Vec<u32>,
    /// `[padded n]`
    pub scales: Vec<f32>,
    /// What sums start with. `[blocks of k, padded n]`
    pub starts: Vec<i32>,
}

impl Quads {
    /// Packs element `(p, j)`, `values[p·k_stride + j·n_stride]`, in `steps` steps.
    pub(crate) fn fill(
        &mut self,
        steps: usize,
        (k, n): (usize, usize),
        (values, k_stride, n_stride): (&[f32], usize, usize),
    ) {
        let padded_n = n.next_multiple_of(16);
        let Self { words, scales, starts } = self;
        words.clear();
        words.resize(steps * padded_n, 0);
        scales.clear();
        scales.resize(padded_n, 0.0);
        starts.clear();
        starts.resize(steps.div_ceil(K_BLOCK) * padded_n, 0);
        // Zeros after the last value, and after it was made unsigned.
        let zeros = u32::from_ne_bytes([OFFSET; 4]);
        let mut column = vec![0.0; k];
        let mut integers = vec![zeros; steps];
        for j in 0..n {
            if k_stride == 1 {
                column.copy_from_slice(&values[j * n_stride..][..k]);
            } else {
                for (p, to) in column.iter_mut().enumerate() {
                    *to = values[p * k_stride + j * n_stride];
                }
            }
            scales[j] = quantize(&column, &mut integers);
            let panel = j / super::micro::PANEL * super::micro::PANEL;
            let width = super::micro::PANEL.min(padded_n - panel);
            let to = &mut words[panel * steps..(panel + width) * steps];
            for (block, integers) in integers.chunks(K_BLOCK).enumerate() {
                let mut sum = 0;
                for (p, word) in integers.iter().enumerate() {
                    let signed = word ^ zeros;
                    sum += signed
                        .to_ne_bytes()
                        .map(|b| i32::from(b.cast_signed()))
                        .iter()
                        .sum::<i32>();
                    to[(block * K_BLOCK + p) * width + j - panel] = signed;
                }
                starts[block * padded_n + j] = -i32::from(OFFSET) * sum;
            }
        }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        4 * (self.words.len() + self.scales.len() + self.starts.len())
    }

    /// What belongs to the columns from `column` on, for the steps from `step` on, the first of a
    /// block.
    ///
    /// # Safety
    /// The result points into this and must not outlive it.
    #[inline(always)]
    pub(crate) unsafe fn columns(&self, step: usize, column: usize) -> ColumnScales {
        let starts = step / K_BLOCK * self.scales.len() + column;
        // SAFETY: columns and steps of the matrix.
        unsafe {
            ColumnScales {
                scales: self.scales.as_ptr().add(column),
                starts: self.starts.as_ptr().add(starts),
            }
        }
    }
}

#[cfg(test)]
mod tests;
