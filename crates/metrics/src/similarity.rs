//! Cosines of feature rows against the text table.
//!
//! One dot product is always summed in the same order: 16 running sums, one per channel modulo 16,
//! which are then added pairwise. Multiplications and additions stay separate (no fused
//! multiply-add). So a score has the same bits for any thread count, chunk size, position of the
//! row, and instruction set; wider registers only work on more rows and classes at once.

use crate::{FeatureRows, MetricError, TextRows};
use rayon::prelude::*;
use scenesplat_kernels::simd::{Isa, compiled_for};

/// Running sums per dot product: one AVX-512 register, two AVX2, four SSE or NEON.
const LANES: usize = 16;

/// Rows handled together: 64 rows of 768 channels stay in the second-level cache.
pub(crate) const CHUNK_ROWS: usize = 64;

/// Bound of the rounding error of a score: each lane adds `dim/16` products, 4 additions join the
/// lanes, and the products, the unit row and the final division round, too. The absolute values of
/// the products of two unit rows add up to at most 1.
pub(crate) fn score_error(dim: usize) -> f64 {
    (dim / LANES + 9) as f64 * f64::from(f32::EPSILON) / 2.0
}

/// What one chunk needs besides its result; kept between chunks.
#[derive(Default)]
pub(crate) struct Scratch {
    rows: Vec<f32>,
    scaled: Vec<f32>,
    norms: Vec<Option<f64>>,
    dots: Vec<f32>,
}

/// Dot products of a chunk of rows with all text rows, and the rows' norms.
pub(crate) struct ChunkDots<'a> {
    /// `[rows]`, the norm that turns a dot product into a cosine; `None` if the row has no
    /// direction (a NaN, an infinity, or only zeros).
    pub norms: &'a [Option<f64>],
    /// `[rows, C]`; meaningless where the norm is `None`.
    pub dots: &'a [f32],
}

/// Reads the rows `start..end` and multiplies them with the text table.
pub(crate) fn chunk_dots<'a>(
    features: &dyn FeatureRows,
    text: TextRows<'_>,
    range: std::ops::Range<usize>,
    scratch: &'a mut Scratch,
) -> Result<ChunkDots<'a>, MetricError> {
    let (dim, num_rows) = (text.dim(), range.len());
    let rows = features.read(range, &mut scratch.rows)?;
    if rows.len() != num_rows * dim {
        return Err(MetricError::RowCount {
            what: "features that were read",
            expected: num_rows,
            got: rows.len() / dim,
        });
    }
    scratch.norms.clear();
    scratch.norms.extend(rows.chunks_exact(dim).map(norm));
    let rows = match scratch.norms.iter().flatten().all(|norm| is_tame(*norm)) {
        true => rows,
        false => {
            rescale(rows, dim, &mut scratch.norms, &mut scratch.scaled);
            &scratch.scaled
        }
    };
    scratch.dots.clear();
    scratch.dots.resize(num_rows * text.num_classes(), 0.0);
    dots(rows, text.rows(), dim, &mut scratch.dots);
    Ok(ChunkDots { norms: &scratch.norms, dots: &scratch.dots })
}

/// A dot product as a cosine in -1..=1.
pub(crate) fn cosine(dot: f32, norm: f64) -> f32 {
    ((f64::from(dot) / norm) as f32).clamp(-1.0, 1.0)
}

/// Cosine of every feature row with every text row.
///
/// For tests and small inputs: the result is held as a whole. Use [`classify`](crate::classify)
/// for scenes.
///
/// # Shapes
/// - `features`: `[N, D]`, any norm · `text`: `[C, D]` · returns `[N, C]`, row-major, in -1..=1
///
/// A row without a direction (a NaN, an infinity, only zeros) scores 0 for each class.
///
/// # Errors
/// If the channel counts differ or rows cannot be read.
pub fn cosine_scores(
    features: &dyn FeatureRows,
    text: TextRows<'_>,
) -> Result<Vec<f32>, MetricError> {
    rows_by_dots(features, text, |scores, dots, norm| {
        for (score, &dot) in scores.iter_mut().zip(dots) {
            *score = cosine(dot, norm);
        }
    })
}

/// A value of each class for each feature row, `[N, C]`, that `fill` writes from the dot products and the norm; 0 in
/// rows without a direction.
pub(crate) fn rows_by_dots(
    features: &dyn FeatureRows,
    text: TextRows<'_>,
    fill: impl Fn(&mut [f32], &[f32], f64) + Sync,
) -> Result<Vec<f32>, MetricError> {
    check_channels(features, text)?;
    let (n, c) = (features.num_rows(), text.num_classes());
    let mut values = vec![0.0; n * c];
    let results: Vec<Result<(), MetricError>> = values
        .par_chunks_mut(CHUNK_ROWS * c)
        .enumerate()
        .map_init(Scratch::default, |scratch, (chunk, out)| {
            let start = chunk * CHUNK_ROWS;
            let found = chunk_dots(features, text, start..start + out.len() / c, scratch)?;
            let rows = out.chunks_exact_mut(c).zip(found.dots.chunks_exact(c));
            for ((out, dots), norm) in rows.zip(found.norms) {
                if let Some(norm) = *norm {
                    fill(out, dots, norm);
                }
            }
            Ok(())
        })
        .collect();
    results.into_iter().collect::<Result<(), _>>()?;
    Ok(values)
}

pub(crate) fn check_channels(
    features: &dyn FeatureRows,
    text: TextRows<'_>,
) -> Result<(), MetricError> {
    let (features, text) = (features.dim(), text.dim());
    (features == text).then_some(()).ok_or(MetricError::ChannelCount { features, text })
}

/// Euclidean norm; `None` for rows without a direction. The square of an f32 fits in an f64.
fn norm(row: &[f32]) -> Option<f64> {
    let mut lanes = [0.0_f64; 8];
    let (blocks, tail) = row.as_chunks::<8>();
    for block in blocks {
        for (lane, &v) in lanes.iter_mut().zip(block) {
            *lane += f64::from(v) * f64::from(v);
        }
    }
    for (lane, &v) in lanes.iter_mut().zip(tail) {
        *lane += f64::from(v) * f64::from(v);
    }
    let norm = lanes.iter().sum::<f64>().sqrt();
    (norm.is_finite() && norm > 0.0).then_some(norm)
}

/// Whether f32 dot products with a unit row neither overflow nor lose bits to underflow.
fn is_tame(norm: f64) -> bool {
    const LIMIT: f64 = (1_u64 << 60) as f64;
    (1.0 / LIMIT..=LIMIT).contains(&norm)
}

/// Copies rows, dividing those of extreme norm by a power of two. Rows without direction become 0.
fn rescale(rows: &[f32], dim: usize, norms: &mut [Option<f64>], out: &mut Vec<f32>) {
    out.clear();
    for (row, norm) in rows.chunks_exact(dim).zip(norms) {
        match norm {
            Some(value) if is_tame(*value) => out.extend_from_slice(row),
            Some(value) => {
                let factor = (-value.log2().floor()).exp2();
                out.extend(row.iter().map(|&v| (f64::from(v) * factor) as f32));
                *value *= factor;
            }
            None => out.resize(out.len() + dim, 0.0),
        }
    }
}

/// `out[r, c] = rows[r] · text[c]`.
fn dots(rows: &[f32], text: &[f32], dim: usize, out: &mut [f32]) {
    dots_with(Isa::current(), rows, text, dim, out);
}

fn dots_with(isa: Isa, rows: &[f32], text: &[f32], dim: usize, out: &mut [f32]) {
    // The tile sizes fill each instruction set's registers with running sums.
    compiled_for(
        isa,
        #[inline(always)]
        |isa| match isa {
            Isa::Portable => tiled::<1, 2>(rows, text, dim, out),
            Isa::Avx2 => tiled::<2, 3>(rows, text, dim, out),
            _ => tiled::<4, 4>(rows, text, dim, out),
        },
    );
}

#[inline(always)]
fn tiled<const R: usize, const C: usize>(rows: &[f32], text: &[f32], dim: usize, out: &mut [f32]) {
    let num_classes = text.len() / dim;
    let row = |i: usize| &rows[i * dim..(i + 1) * dim];
    let num_rows = rows.len() / dim;
    let full = num_rows - num_rows % R;
    for first in (0..full).step_by(R) {
        let tile: [&[f32]; R] = std::array::from_fn(|r| row(first + r));
        tile_row::<R, C>(tile, text, dim, &mut out[first * num_classes..], num_classes);
    }
    for i in full..num_rows {
        tile_row::<1, C>([row(i)], text, dim, &mut out[i * num_classes..], num_classes);
    }
}

#[inline(always)]
fn tile_row<const R: usize, const C: usize>(
    rows: [&[f32]; R],
    text: &[f32],
    dim: usize,
    out: &mut [f32],
    num_classes: usize,
) {
    let class = |i: usize| &text[i * dim..(i + 1) * dim];
    let full = num_classes - num_classes % C;
    for first in (0..full).step_by(C) {
        let tile: [&[f32]; C] = std::array::from_fn(|c| class(first + c));
        for (r, sums) in tile_dots(rows, tile).iter().enumerate() {
            out[r * num_classes + first..][..C].copy_from_slice(sums);
        }
    }
    for c in full..num_classes {
        for (r, sum) in tile_dots(rows, [class(c)]).iter().enumerate() {
            out[r * num_classes + c] = sum[0];
        }
    }
}

#[inline(always)]
fn tile_dots<const R: usize, const C: usize>(a: [&[f32]; R], b: [&[f32]; C]) -> [[f32; C]; R] {
    let a = a.map(|row| row.as_chunks::<LANES>());
    let b = b.map(|row| row.as_chunks::<LANES>());
    let num_blocks = a[0].0.len();
    // Equal lengths, said once, let the compiler drop the bounds checks in the loop.
    let a_blocks: [&[[f32; LANES]]; R] = a.map(|(blocks, _)| &blocks[..num_blocks]);
    let b_blocks: [&[[f32; LANES]]; C] = b.map(|(blocks, _)| &blocks[..num_blocks]);
    let mut sums = [[[0.0; LANES]; C]; R];
    for i in 0..num_blocks {
        sums = add_block(sums, a_blocks.map(|blocks| blocks[i]), b_blocks.map(|blocks| blocks[i]));
    }
    // A last, shorter block counts as one filled up with zeros.
    sums = add_block(sums, a.map(|(_, tail)| padded(tail)), b.map(|(_, tail)| padded(tail)));
    sums.map(|row| row.map(add_lanes))
}

/// Takes and returns the sums by value: by reference they would be stored in every round.
#[inline(always)]
fn add_block<const R: usize, const C: usize>(
    mut sums: [[[f32; LANES]; C]; R],
    a: [[f32; LANES]; R],
    b: [[f32; LANES]; C],
) -> [[[f32; LANES]; C]; R] {
    for r in 0..R {
        for c in 0..C {
            for lane in 0..LANES {
                sums[r][c][lane] += a[r][lane] * b[c][lane];
            }
        }
    }
    sums
}

#[inline(always)]
fn padded(tail: &[f32]) -> [f32; LANES] {
    let mut block = [0.0; LANES];
    block[..tail.len()].copy_from_slice(tail);
    block
}

#[inline(always)]
fn add_lanes(mut lanes: [f32; LANES]) -> f32 {
    let mut width = LANES / 2;
    while width > 0 {
        for i in 0..width {
            lanes[i] += lanes[i + width];
        }
        width /= 2;
    }
    lanes[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize, step: f32) -> Vec<f32> {
        (0..n).map(|i| (i as f32 * step).sin()).collect()
    }

    #[test]
    fn instruction_sets_agree_bit_for_bit() {
        for (num_rows, num_classes, dim) in [(1, 1, 1), (5, 7, 15), (9, 21, 48), (6, 5, 777)] {
            let rows = wave(num_rows * dim, 0.37);
            let text = wave(num_classes * dim, 0.73);
            let with = |isa: Isa| {
                let mut out = vec![0.0; num_rows * num_classes];
                dots_with(isa, &rows, &text, dim, &mut out);
                out
            };
            for isa in Isa::ALL {
                assert_eq!(with(isa), with(Isa::Portable), "{isa:?}");
            }
        }
    }

    #[test]
    fn norms_at_the_ends_of_the_range() {
        assert_eq!(norm(&[3.0, 4.0]), Some(5.0));
        assert_eq!(norm(&[0.0; 9]), None);
        assert_eq!(norm(&[f32::NAN, 1.0]), None);
        assert_eq!(norm(&[f32::NEG_INFINITY]), None);
        assert!(norm(&[f32::MAX; 4]).unwrap().is_finite());
        assert!(norm(&[f32::from_bits(1)]).unwrap() > 0.0);
    }
}
