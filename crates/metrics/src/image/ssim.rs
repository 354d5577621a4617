//! Structural similarity and its derivative.

use super::blur::{Axis, Border, RADIUS, TAPS, blur_rows};
use super::view::check_pair;
use super::{ImageError, ImageView};
use rayon::prelude::*;
use std::ops::Range;

/// Stabilize the two quotients where means and variances vanish: `(0.01)²`, `(0.03)²`.
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// Rows of the result that one thread computes at a time; fixed, as sums are taken per band.
const BAND: usize = 64;

/// How SSIM treats the border of the picture. Numbers of different treatments are not comparable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SsimPadding {
    /// The mean over the pixels whose window is inside the picture, 5 fewer on each side. What
    /// gsplat trains with on CUDA (`fused-ssim`, padding "valid").
    Valid,
    /// The picture is mirrored at its border, variances are cut off below 0, the mean is over all
    /// pixels. What gsplat reports when it evaluates (torchmetrics).
    Reflect,
    /// Zeros around the picture, the mean is over all pixels. What Inria, the authors of MCMC and
    /// Brush train with.
    Zero,
}

impl SsimPadding {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Valid, Self::Reflect, Self::Zero];

    /// Its name in tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Valid => "valid",
            Self::Reflect => "reflect",
            Self::Zero => "zero",
        }
    }

    /// Smallest width and height of a picture.
    pub fn least_side(self) -> usize {
        match self {
            Self::Valid => TAPS,
            Self::Reflect => RADIUS + 1,
            Self::Zero => 1,
        }
    }

    fn border(self) -> Border {
        match self {
            Self::Valid => Border::Valid,
            Self::Reflect => Border::Reflect,
            Self::Zero => Border::Zero,
        }
    }
}

impl std::fmt::Display for SsimPadding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Mean structural similarity, −1 to 1, 1 for identical images.
///
/// Window 11 × 11, Gaussian of σ = 1.5 pixels, normalized; per channel, for values that reach 1:
/// `(2μ₁μ₂ + 10⁻⁴)(2σ₁₂ + 9·10⁻⁴) / ((μ₁² + μ₂² + 10⁻⁴)(σ₁² + σ₂² + 9·10⁻⁴))`. Values are not
/// clamped.
///
/// # Errors
/// If the sizes differ, a value is not finite, or the picture is smaller than
/// [`SsimPadding::least_side`].
///
/// # Source
/// `losses.py` and `fused-ssim` of gsplat 1.6, torchmetrics. Differs: means and variances are f64,
/// so flat regions do not lose the variance to rounding.
pub fn ssim(
    pred: ImageView<'_>,
    truth: ImageView<'_>,
    padding: SsimPadding,
) -> Result<f64, ImageError> {
    let task = Task::new(pred, truth, padding)?;
    let bands = task.for_each_band(|rows| task.sum(rows, |_, _, _| {}));
    Ok(task.mean(&bands))
}

/// The map that [`ssim`] averages, `[H, W, C]`; for valid padding `[H − 10, W − 10, C]`.
///
/// # Errors
/// As [`ssim`].
pub fn ssim_map(
    pred: ImageView<'_>,
    truth: ImageView<'_>,
    padding: SsimPadding,
) -> Result<Vec<f32>, ImageError> {
    let task = Task::new(pred, truth, padding)?;
    let bands = task.for_each_band(|rows| {
        let mut map = Vec::with_capacity(rows.len() * pred.stride());
        task.sum(rows, |_, _, local| map.push(local.value as f32));
        map
    });
    Ok(bands.concat())
}

/// [`ssim`] and its derivative with respect to every value of `pred`. `[H, W, C]`
///
/// # Errors
/// As [`ssim`].
///
/// # Source
/// The derivatives of mean, variance and covariance are blurred once more, with the adjoint of the
/// border's treatment. Differs from torchmetrics under autograd: where rounding alone would make a
/// variance negative, its derivative is kept.
pub fn ssim_with_gradient(
    pred: ImageView<'_>,
    truth: ImageView<'_>,
    padding: SsimPadding,
) -> Result<(f64, Vec<f32>), ImageError> {
    let task = Task::new(pred, truth, padding)?;
    let stride = pred.stride();
    let len = stride * pred.height();
    // By how much the mean, the mean square and the mean product raise the SSIM of a pixel.
    let mut slopes: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; len]);
    let scale = 1.0 / task.count();
    let [mean, square, product] = &mut slopes;
    let chunks = mean
        .par_chunks_mut(BAND * stride)
        .zip(square.par_chunks_mut(BAND * stride))
        .zip(product.par_chunks_mut(BAND * stride));
    let bands: Vec<f64> = chunks
        .enumerate()
        .map(|(band, ((mean, square), product))| {
            let first = band * BAND;
            let rows = first..(first + BAND).min(pred.height());
            task.sum(rows, |y, x, local| {
                let at = (y - first) * stride + x;
                mean[at] = scale * local.by_mean;
                square[at] = scale * local.by_square;
                product[at] = scale * local.by_product;
            })
        })
        .collect();
    let value = task.mean(&bands);
    Ok((value, task.pull_back(&slopes)))
}

/// SSIM at one value and how it grows with the blurred arrays of the first image.
struct Local {
    value: f64,
    by_mean: f64,
    by_square: f64,
    by_product: f64,
}

impl Local {
    #[inline(always)]
    fn new(moments: [f64; 5], clamp: bool) -> Self {
        let [m1, m2, square1, square2, product] = moments;
        let (mut v1, mut v2) = (square1 - m1 * m1, square2 - m2 * m2);
        if clamp {
            (v1, v2) = (v1.max(0.0), v2.max(0.0));
        }
        let (a1, a2) = (2.0 * m1 * m2 + C1, 2.0 * (product - m1 * m2) + C2);
        let (b1, b2) = (m1 * m1 + m2 * m2 + C1, v1 + v2 + C2);
        let below = 1.0 / (b1 * b2);
        let value = a1 * a2 * below;
        Self {
            value,
            // 1/b₁ = b₂/(b₁b₂) and 1/b₂ likewise: one division serves all.
            by_mean: 2.0 * below * (m2 * (a2 - a1) - m1 * value * (b2 - b1)),
            by_square: -value * b1 * below,
            by_product: 2.0 * a1 * below,
        }
    }
}

/// Two pictures and how their windows end at the border.
struct Task<'a> {
    pred: ImageView<'a>,
    truth: ImageView<'a>,
    padding: SsimPadding,
    across: Axis,
    down: Axis,
}

impl<'a> Task<'a> {
    fn new(
        pred: ImageView<'a>,
        truth: ImageView<'a>,
        padding: SsimPadding,
    ) -> Result<Self, ImageError> {
        check_pair(&pred, &truth)?;
        let (width, height, least) = (pred.width(), pred.height(), padding.least_side());
        if width < least || height < least {
            return Err(ImageError::TooSmall { padding, least, width, height });
        }
        let across = Axis::new(width, padding.border());
        let down = Axis::new(height, padding.border());
        Ok(Self { pred, truth, padding, across, down })
    }

    /// Pixels at each border that do not count.
    fn cut(&self) -> usize {
        if self.padding == SsimPadding::Valid { RADIUS } else { 0 }
    }

    /// Number of values that the mean is over.
    fn count(&self) -> f64 {
        let cut = 2 * self.cut();
        let rows = self.pred.height() - cut;
        ((self.pred.width() - cut) * rows * self.pred.channels()) as f64
    }

    fn mean(&self, bands: &[f64]) -> f64 {
        bands.iter().sum::<f64>() / self.count()
    }

    fn for_each_band<T: Send>(&self, work: impl Fn(Range<usize>) -> T + Sync) -> Vec<T> {
        let height = self.pred.height();
        (0..height.div_ceil(BAND))
            .into_par_iter()
            .map(|band| work(band * BAND..((band + 1) * BAND).min(height)))
            .collect()
    }

    /// The sum of SSIM over the counted values of some rows; `each` gets every one of them with
    /// its row and its place in the row.
    fn sum(&self, rows: Range<usize>, mut each: impl FnMut(usize, usize, &Local)) -> f64 {
        let clamp = self.padding == SsimPadding::Reflect;
        let (cut, channels) = (self.cut(), self.pred.channels());
        let counted_rows = cut..self.pred.height() - cut;
        let counted = cut * channels..self.pred.stride() - cut * channels;
        let rows = rows.start.max(counted_rows.start)..rows.end.min(counted_rows.end);
        let mut sum = 0.0;
        let fill = |y: usize, lines: &mut [Vec<f64>; 5]| {
            let (pred, truth) = (self.pred.row(y), self.truth.row(y));
            let [p, t, pp, tt, pt] = lines;
            for (x, (a, b)) in pred.iter().zip(truth).enumerate() {
                let (a, b) = (f64::from(*a), f64::from(*b));
                (p[x], t[x], pp[x], tt[x], pt[x]) = (a, b, a * a, b * b, a * b);
            }
        };
        blur_rows([&self.across, &self.down], channels, rows, fill, |y, lines| {
            let mut row_sum = 0.0;
            for x in counted.clone() {
                let local = Local::new(std::array::from_fn(|q| lines[q][x]), clamp);
                row_sum += local.value;
                each(y, x, &local);
            }
            sum += row_sum;
        });
        sum
    }

    /// The derivative with respect to the values of the first image, from those with respect to
    /// its blurred mean, square and product with the second.
    fn pull_back(&self, slopes: &[Vec<f64>; 3]) -> Vec<f32> {
        let (across, down) = (self.across.transposed(), self.down.transposed());
        let stride = self.pred.stride();
        let mut gradient = vec![0.0; slopes[0].len()];
        gradient.par_chunks_mut(BAND * stride).enumerate().for_each(|(band, out)| {
            let first = band * BAND;
            let rows = first..first + out.len() / stride;
            let fill = |y: usize, lines: &mut [Vec<f64>; 3]| {
                for (line, slope) in lines.iter_mut().zip(slopes) {
                    line.copy_from_slice(&slope[y * stride..(y + 1) * stride]);
                }
            };
            let each = |y: usize, lines: &[Vec<f64>; 3]| {
                let out = &mut out[(y - first) * stride..][..stride];
                let (pred, truth) = (self.pred.row(y), self.truth.row(y));
                for x in 0..stride {
                    let (a, b) = (f64::from(pred[x]), f64::from(truth[x]));
                    let slope = lines[0][x] + 2.0 * a * lines[1][x] + b * lines[2][x];
                    out[x] = slope as f32;
                }
            };
            blur_rows([&across, &down], self.pred.channels(), rows, fill, each);
        });
        gradient
    }
}
