//! Differences pixel by pixel: mean squared error, PSNR, L1.

use super::view::check_pair;
use super::{ImageError, ImageView};
use rayon::prelude::*;

/// Values that are summed by one thread; fixed, so that no sum depends on the number of threads.
const BLOCK: usize = 1 << 16;

/// Mean of `(clamp(pred, 0, 1) − truth)²` over all values.
///
/// The first image is clamped because renderers overshoot where files cannot; the second is the
/// truth and taken as it is.
///
/// # Errors
/// If the sizes differ or a value is not finite.
pub fn mean_squared_error(pred: ImageView<'_>, truth: ImageView<'_>) -> Result<f64, ImageError> {
    check_pair(&pred, &truth)?;
    Ok(mean(pred.values(), truth.values(), |p, t| {
        let d = f64::from(p.clamp(0.0, 1.0)) - f64::from(t);
        d * d
    }))
}

/// Peak signal-to-noise ratio in dB for values that reach 1: `−10 log₁₀` of
/// [`mean_squared_error`]; [`f64::INFINITY`] for identical images.
///
/// Over a set of images, average these numbers; say how many were infinite and leave them out.
///
/// # Errors
/// As [`mean_squared_error`].
pub fn psnr(pred: ImageView<'_>, truth: ImageView<'_>) -> Result<f64, ImageError> {
    // Plus 0 turns the −0 of an error of exactly 1 into 0.
    Ok(-10.0 * mean_squared_error(pred, truth)?.log10() + 0.0)
}

/// Mean of `|pred − truth|` over all values, not clamped: the training loss.
///
/// # Errors
/// If the sizes differ or a value is not finite.
pub fn l1(pred: ImageView<'_>, truth: ImageView<'_>) -> Result<f64, ImageError> {
    check_pair(&pred, &truth)?;
    Ok(mean(pred.values(), truth.values(), |p, t| (f64::from(p) - f64::from(t)).abs()))
}

/// [`l1`] and its derivative with respect to every value of `pred`: `±1 / (H·W·C)`, 0 where the
/// images agree. `[H, W, C]`
///
/// # Errors
/// As [`l1`].
pub fn l1_with_gradient(
    pred: ImageView<'_>,
    truth: ImageView<'_>,
) -> Result<(f64, Vec<f32>), ImageError> {
    let value = l1(pred, truth)?;
    let step = (1.0 / pred.values().len() as f64) as f32;
    let sign = |(p, t): (&f32, &f32)| match p.total_cmp(t) {
        _ if p == t => 0.0,
        std::cmp::Ordering::Less => -step,
        _ => step,
    };
    let gradient = pred.values().par_iter().zip(truth.values()).map(sign).collect();
    Ok((value, gradient))
}

fn mean(pred: &[f32], truth: &[f32], error: impl Fn(f32, f32) -> f64 + Sync) -> f64 {
    let blocks: Vec<f64> = pred
        .par_chunks(BLOCK)
        .zip(truth.par_chunks(BLOCK))
        .map(|(p, t)| p.iter().zip(t).map(|(&p, &t)| error(p, t)).sum())
        .collect();
    blocks.iter().sum::<f64>() / pred.len() as f64
}
