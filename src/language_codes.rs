//! From wide language features to short codes that travel with a scene.

use half::f16;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use scenesplat_kernels::eigenvectors::{Iteration, leading_eigenvectors};
use scenesplat_kernels::gemm::gemm_tn;
use scenesplat_scene::{LanguageCode, LanguageCodebook, LanguageFeatures};

/// Rows that the axes are found from.
const SAMPLE: usize = 30_000;
/// Rows of one task.
const BLOCK: usize = 1024;
/// Widest code: beyond, it is no shorter than features, and its axes take hours.
const MAX_CODE_WIDTH: usize = 256;
/// Widest features that axes are found for: their covariance is that squared.
const MAX_FEATURE_WIDTH: usize = 4096;
/// Codes are kept below this, well within 16 bits.
const LARGEST_CODE: f32 = 1024.0;

/// Language codes and how much of the features they keep.
#[derive(Debug, Clone)]
pub struct EncodedFeatures {
    /// One code per row; rows without a feature have the code 0.
    pub code: LanguageCode,
    /// Mean cosine between a feature and what its code decodes to, over the rows with a feature.
    pub mean_cosine: f64,
    /// The lowest of these cosines.
    pub lowest_cosine: f64,
    /// Rows with a feature.
    pub valid: usize,
    /// Rows whose feature holds NaN or infinity; they count as having none.
    pub not_finite: usize,
}

/// Why features cannot be encoded.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum CodeError {
    /// The width asked for makes no sense.
    #[error(
        "codes of {asked} numbers cannot be made from features of {width} (choose 1 to {}; features \
         have up to {MAX_FEATURE_WIDTH} numbers)",
        (*width).min(MAX_CODE_WIDTH)
    )]
    Width {
        /// Width asked for.
        asked: usize,
        /// Width of the features.
        width: usize,
    },
    /// Nothing to learn the axes from.
    #[error("no row has a language feature that is finite and not 0")]
    NoFeatures,
    /// The caller canceled.
    #[error("stopped; nothing was written")]
    Stopped,
}

/// Finds the `k` directions in which the features vary most and writes every feature in them.
///
/// A principal component analysis of a seeded sample; sums in a fixed order, so the result is the
/// same for any number of threads. `valid` marks the rows that have a feature, `None` = those that
/// are not 0; one with a value that is not finite counts as having none. `progress` gets the fraction
/// done; returning `false` cancels.
///
/// # Errors
/// If `k` is 0, above 256 or wider than the features, those are wider than 4096, no row has a feature, or `progress` stops it.
pub fn compress_features(
    features: &LanguageFeatures,
    valid: Option<&[bool]>,
    k: usize,
    seed: u64,
    progress: &mut dyn FnMut(f64) -> bool,
) -> Result<EncodedFeatures, CodeError> {
    let width = features.dim;
    if k == 0 || k > width.min(MAX_CODE_WIDTH) || width > MAX_FEATURE_WIDTH {
        return Err(CodeError::Width { asked: k, width });
    }
    let row = |i: usize| &features.values[i * width..(i + 1) * width];
    let count = features.values.len() / width;
    let claims = |i: &usize| match valid {
        Some(valid) => valid[*i],
        None => row(*i).iter().any(|v| *v != f16::ZERO),
    };
    let finite = |i: usize| row(i).iter().all(|v| v.is_finite());
    let not_finite = (0..count).into_par_iter().filter(|&i| claims(&i) && !finite(i)).count();
    let has = |i: &usize| claims(i) && finite(*i);
    let rows: Vec<usize> = (0..count).into_par_iter().filter(has).collect();
    if rows.is_empty() {
        return Err(CodeError::NoFeatures);
    }
    let codebook = find_codebook(features, &rows, k, seed, progress)?;
    let code = write_codes(features, &rows, k, codebook);
    // Blocks are summed one after the other, whoever computed them.
    let per_block: Vec<(f64, f64)> = rows
        .par_chunks(BLOCK)
        .map(|rows| {
            let mut decoded = vec![0f32; width];
            let (mut sum, mut lowest) = (0.0, f64::INFINITY);
            for &at in rows {
                code.decode(at, &mut decoded);
                let cosine = cosine(row(at), &decoded);
                sum += cosine;
                lowest = lowest.min(cosine);
            }
            (sum, lowest)
        })
        .collect();
    let sum: f64 = per_block.iter().map(|(sum, _)| sum).sum();
    let lowest_cosine = per_block.iter().map(|(_, low)| *low).fold(f64::INFINITY, f64::min);
    Ok(EncodedFeatures {
        code,
        mean_cosine: sum / rows.len() as f64,
        lowest_cosine,
        valid: rows.len(),
        not_finite,
    })
}

/// Mean and leading axes of a sample of some rows.
fn find_codebook(
    features: &LanguageFeatures,
    rows: &[usize],
    k: usize,
    seed: u64,
    progress: &mut dyn FnMut(f64) -> bool,
) -> Result<LanguageCodebook, CodeError> {
    let width = features.dim;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut chosen = sample(&mut rng, rows.len(), rows.len().min(SAMPLE)).into_vec();
    chosen.sort_unstable();
    let mut table = vec![0f32; chosen.len() * width];
    for (out, &at) in table.chunks_exact_mut(width).zip(&chosen) {
        let row = &features.values[rows[at] * width..][..width];
        out.iter_mut().zip(row).for_each(|(o, v)| *o = v.to_f32());
    }
    let mut mean = vec![0f64; width];
    for row in table.chunks_exact(width) {
        mean.iter_mut().zip(row).for_each(|(m, v)| *m += f64::from(*v));
    }
    mean.iter_mut().for_each(|m| *m /= chosen.len() as f64);
    let mean: Vec<f32> = mean.into_iter().map(|m| m as f32).collect();
    for row in table.chunks_exact_mut(width) {
        row.iter_mut().zip(&mean).for_each(|(v, m)| *v -= m);
    }
    let mut covariance = vec![0f32; width * width];
    gemm_tn(&table, width, &table, width, None, &mut covariance);
    let axes = leading_eigenvectors(&covariance, width, k, Iteration::default(), progress)
        .ok_or(CodeError::Stopped)?;
    let axes = axes.iter().flatten().map(|v| *v as f32).collect();
    Ok(LanguageCodebook { mean, axes })
}

/// The codes of some rows; the others have the code 0.
fn write_codes(
    features: &LanguageFeatures,
    rows: &[usize],
    k: usize,
    mut codebook: LanguageCodebook,
) -> LanguageCode {
    let width = features.dim;
    let mut has_feature = vec![false; features.values.len() / width];
    rows.iter().for_each(|&i| has_feature[i] = true);
    let mut dots = vec![0f32; has_feature.len() * k];
    dots.par_chunks_mut(BLOCK * k).enumerate().for_each(|(block, out)| {
        let mut centred = vec![0f32; width];
        for (i, code) in out.chunks_exact_mut(k).enumerate() {
            let at = block * BLOCK + i;
            if !has_feature[at] {
                continue;
            }
            let row = &features.values[at * width..][..width];
            for ((c, v), m) in centred.iter_mut().zip(row).zip(&codebook.mean) {
                *c = v.to_f32() - m;
            }
            for (value, axis) in code.iter_mut().zip(codebook.axes.chunks_exact(width)) {
                *value = axis.iter().zip(&centred).map(|(a, c)| a * c).sum();
            }
        }
    });
    // Unit features have codes below 2. Much larger ones would not fit into 16 bits: then the axes
    // take the factor.
    let largest = dots.par_iter().map(|v| v.abs()).reduce(|| 0.0, f32::max);
    let factor = if largest > LARGEST_CODE { largest / LARGEST_CODE } else { 1.0 };
    codebook.axes.iter_mut().for_each(|v| *v *= factor);
    let mut values: Vec<f16> = dots.par_iter().map(|v| f16::from_f32(v / factor)).collect();
    for (code, has) in values.chunks_exact_mut(k).zip(&has_feature) {
        if *has && code.iter().all(|v| *v == f16::ZERO) {
            // Zeros would mean that there is no feature.
            code[0] = f16::from_bits(1);
        }
    }
    LanguageCode { values, codebook }
}

/// The cosine of two vectors; 0 if one of them has no length.
fn cosine(a: &[f16], b: &[f32]) -> f64 {
    let (mut dot, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (f64::from(a.to_f32()), f64::from(*b));
        dot += a * b;
        aa += a * a;
        bb += b * b;
    }
    if aa > 0.0 && bb > 0.0 { dot / (aa.sqrt() * bb.sqrt()) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Features on a plane of three dimensions in twelve.
    fn plane(rows: usize) -> LanguageFeatures {
        let mut values = Vec::new();
        for i in 0..rows {
            let t = [(i as f32 * 0.37).sin(), (i as f32 * 0.73).cos(), (i as f32 * 1.1).sin()];
            for d in 0..12 {
                let v: f32 = (0..3).map(|j| t[j] * ((d * (j + 1)) as f32).sin()).sum();
                values.push(f16::from_f32(0.3 + 0.5 * v));
            }
        }
        LanguageFeatures { values, dim: 12 }
    }

    #[test]
    fn features_of_low_rank_come_back() {
        let features = plane(3000);
        let done = compress_features(&features, None, 3, 0, &mut |_| true).unwrap();
        assert!(done.lowest_cosine > 0.9999, "{}", done.lowest_cosine);
        assert_eq!(done.valid, 3000);
        let fewer = compress_features(&features, None, 2, 0, &mut |_| true).unwrap();
        assert!(fewer.mean_cosine < done.mean_cosine);
        // More axes than the features have are 0 and harm nothing.
        let more = compress_features(&features, None, 12, 0, &mut |_| true).unwrap();
        assert!(more.lowest_cosine > 0.9999);
        more.code.codebook.check().unwrap();
    }

    #[test]
    fn rows_without_a_feature_have_the_code_0() {
        let mut features = plane(100);
        features.values[..12].fill(f16::ZERO);
        let done = compress_features(&features, None, 3, 0, &mut |_| true).unwrap();
        assert_eq!(done.valid, 99);
        assert_eq!(done.code.values[..3], [f16::ZERO; 3]);
        let masked = vec![false; 100];
        assert_eq!(
            compress_features(&features, Some(&masked), 3, 0, &mut |_| true).unwrap_err(),
            CodeError::NoFeatures
        );
        assert!(compress_features(&features, None, 0, 0, &mut |_| true).is_err());
        assert!(compress_features(&features, None, 13, 0, &mut |_| true).is_err());
    }

    #[test]
    fn rows_that_are_not_finite_harm_no_other() {
        let mut features = plane(500);
        features.values[12 * 7] = f16::NAN;
        features.values[12 * 9 + 3] = f16::INFINITY;
        let done = compress_features(&features, None, 3, 0, &mut |_| true).unwrap();
        assert_eq!((done.valid, done.not_finite), (498, 2));
        assert!(done.lowest_cosine > 0.999, "{}", done.lowest_cosine);
        assert_eq!(done.code.values[21..24], [f16::ZERO; 3]);
        done.code.codebook.check().unwrap();
    }

    #[test]
    fn huge_features_fit_into_their_codes() {
        let mut features = plane(500);
        let scale = |v: f16| f16::from_f32(v.to_f32() * 30_000.0);
        features.values.iter_mut().for_each(|v| *v = scale(*v));
        let done = compress_features(&features, None, 3, 0, &mut |_| true).unwrap();
        assert!(done.lowest_cosine > 0.999, "{}", done.lowest_cosine);
        assert!(done.code.values.iter().all(|v| v.is_finite()));
    }

    #[test]
    fn widths_that_would_never_end_are_refused() {
        for (width, k) in [(5000, 300), (5000, 3), (4096, 257)] {
            let features = LanguageFeatures { values: vec![f16::ONE; width], dim: width };
            let error = compress_features(&features, None, k, 0, &mut |_| true).unwrap_err();
            assert_eq!(error, CodeError::Width { asked: k, width });
            assert!(error.to_string().contains("choose 1 to 256"), "{error}");
        }
    }

    #[test]
    fn it_stops_when_told_to() {
        let stopped = compress_features(&plane(500), None, 3, 0, &mut |_| false);
        assert_eq!(stopped.unwrap_err(), CodeError::Stopped);
    }

    #[test]
    fn one_row_is_its_own_mean() {
        let features = plane(1);
        let done = compress_features(&features, None, 1, 0, &mut |_| true).unwrap();
        assert!(done.lowest_cosine > 0.9999);
    }
}
