//! L1 and SSIM of a rendered picture, with their gradient, in two passes over the rows.
//!
//! The metrics crate has the same numbers in f64 for single pictures; a training step needs them in
//! the time of a few renders and without reserving memory. The window is separable: a row of the
//! result reads eleven rows, down first, then across, so nothing but three maps of derivatives has
//! the size of the picture.

use crate::error::{OptimiseError, expect};
use crate::window::{Across, Axis, TAPS, fma};
use rayon::prelude::*;
use scenesplat_kernels::simd::{Isa, compiled_for};
pub use scenesplat_metrics::image::SsimPadding;

/// Stabilize the two quotients where means and variances vanish: `(0.01)²`, `(0.03)²`.
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

/// What a picture is compared by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageWeights {
    /// λ of `(1 − λ) · L1 + λ · (1 − SSIM)`, 0 to 1.
    pub ssim: f32,
    /// How SSIM treats the border.
    pub padding: SsimPadding,
}

/// Numbers of one comparison.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ImageLoss {
    /// `(1 − λ) · L1 + λ · (1 − SSIM)`.
    pub loss: f64,
    /// Mean of the absolute differences, of the pixels that count.
    pub l1: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// Mean squared difference of the pixels that count, of values as they are.
    pub mse: f64,
}

/// Compares pictures of one size; keeps its memory from one to the next.
#[derive(Debug)]
pub struct ImageComparison {
    width: usize,
    height: usize,
    weights: ImageWeights,
    /// Weights of the window down the picture.
    down: Axis,
    across: Across,
    /// By how much the mean, the mean square and the mean product raise the SSIM of a pixel. `[H, 3 W]`
    slopes: [Vec<f32>; 3],
    /// Sums of the rows: SSIM, L1, squares, pixels that count.
    sums: Vec<[f64; 4]>,
    /// Pictures with what is masked set to 0, if there is a mask.
    masked: [Vec<f32>; 2],
    /// Of each band of rows.
    rows: Vec<Rows>,
    isa: Isa,
}

/// Most bands of rows, each a task with memory of its own; more than threads, so that none waits long.
const BANDS: usize = 64;

impl ImageComparison {
    /// For pictures of that size.
    ///
    /// # Errors
    /// If the window does not fit the picture, or λ is not in 0 to 1.
    pub fn new(width: usize, height: usize, weights: ImageWeights) -> Result<Self, OptimiseError> {
        let least = weights.padding.least_side();
        if width.min(height) < least {
            let border = weights.padding.name();
            return Err(OptimiseError::Picture { width, height, least, border });
        }
        let (value, range) = (f64::from(weights.ssim), "from 0 to 1");
        if !(0.0..=1.0).contains(&weights.ssim) {
            return Err(OptimiseError::Number { field: "weight of SSIM", value, range });
        }
        let len = 3 * width * height;
        Ok(Self {
            width,
            height,
            weights,
            down: Axis::new(height, weights.padding),
            across: Across::new(width, weights.padding),
            slopes: [0, 1, 2].map(|_| vec![0.0; len]),
            sums: vec![[0.0; 4]; height],
            masked: [Vec::new(), Vec::new()],
            rows: (0..height.min(BANDS)).map(|_| Rows::new(3 * width)).collect(),
            isa: Isa::current(),
        })
    }

    /// Width and height of the pictures.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// The loss of `pred`, and its derivative with respect to each of its values in `gradient`.
    ///
    /// Where values are equal the derivative of L1 is 0. With a mask, L1 is the mean over the pixels
    /// that count, and SSIM that of both pictures with the others black.
    ///
    /// # Shapes
    /// `pred`, `truth`, `gradient`: `[H, W, 3]`, any values · `mask`: `[H, W]`, 0 = does not count
    ///
    /// # Errors
    /// If an array has another length.
    pub fn compare(
        &mut self,
        pred: &[f32],
        truth: &[f32],
        mask: Option<&[u8]>,
        gradient: &mut [f32],
    ) -> Result<ImageLoss, OptimiseError> {
        let len = 3 * self.width * self.height;
        expect("rendered picture", len, pred.len())?;
        expect("picture of the frame", len, truth.len())?;
        expect("gradient of the picture", len, gradient.len())?;
        let counted = match mask {
            Some(mask) => {
                expect("mask", self.width * self.height, mask.len())?;
                mask.iter().filter(|m| **m != 0).count()
            }
            None => self.width * self.height,
        };
        let mut masked = std::mem::take(&mut self.masked);
        let [pred, truth] = match mask {
            Some(mask) => {
                put_masked(&mut masked[0], pred, mask);
                put_masked(&mut masked[1], truth, mask);
                [&masked[0][..], &masked[1][..]]
            }
            None => [pred, truth],
        };
        let loss = self.both_passes(pred, truth, mask, counted, gradient);
        self.masked = masked;
        Ok(loss)
    }

    fn both_passes(
        &mut self,
        pred: &[f32],
        truth: &[f32],
        mask: Option<&[u8]>,
        counted: usize,
        gradient: &mut [f32],
    ) -> ImageLoss {
        let windows = self.down.results() * self.across.results() * 3;
        // With a mask that leaves out every pixel, the loss is that of equal pictures.
        let l1_slope = (1.0 - self.weights.ssim) / (3 * counted.max(1)) as f32;
        self.first_pass([pred, truth], -self.weights.ssim / windows as f32);
        self.second_pass([pred, truth], mask, l1_slope, gradient);
        let sum = |k: usize| self.sums.iter().map(|s| s[k]).sum::<f64>();
        let values = (3 * counted.max(1)) as f64;
        let (l1, mse, ssim) = (sum(1) / values, sum(2) / values, sum(0) / windows as f64);
        let weight = f64::from(self.weights.ssim);
        ImageLoss { loss: (1.0 - weight) * l1 + weight * (1.0 - ssim), l1, ssim, mse }
    }

    /// From the pictures to SSIM and the slopes.
    fn first_pass(&mut self, [pred, truth]: [&[f32]; 2], ssim_slope: f32) {
        let (stride, band) = (3 * self.width, self.height.div_ceil(self.rows.len()));
        let (down, across, isa) = (&self.down, &self.across, self.isa);
        let [mean, square, product] = &mut self.slopes;
        mean.par_chunks_mut(band * stride)
            .zip(square.par_chunks_mut(band * stride))
            .zip(product.par_chunks_mut(band * stride))
            .zip(self.sums.par_chunks_mut(band))
            .zip(&mut self.rows)
            .enumerate()
            .for_each(|(i, ((((mean, square), product), sums), rows))| {
                let mean = mean.chunks_exact_mut(stride);
                let square = square.chunks_exact_mut(stride);
                let product = product.chunks_exact_mut(stride);
                let lines = mean.zip(square).zip(product).zip(sums);
                for (k, (((mean, square), product), sums)) in lines.enumerate() {
                    let (y, slopes) = (i * band + k, [mean, square, product]);
                    let work = Forward { pred, truth, stride, down, across };
                    let ssim = compiled_for(
                        isa,
                        #[inline(always)]
                        |ran| {
                            if ran >= Isa::Avx2 {
                                work.row::<true>(y, rows, slopes, ssim_slope)
                            } else {
                                work.row::<false>(y, rows, slopes, ssim_slope)
                            }
                        },
                    );
                    sums[0] = ssim;
                }
            });
    }

    /// From the slopes to the gradient, and L1.
    fn second_pass(
        &mut self,
        [pred, truth]: [&[f32]; 2],
        mask: Option<&[u8]>,
        l1_slope: f32,
        gradient: &mut [f32],
    ) {
        let (stride, band) = (3 * self.width, self.height.div_ceil(self.rows.len()));
        let (down, across, isa) = (&self.down, &self.across, self.isa);
        let slopes = [&self.slopes[0][..], &self.slopes[1], &self.slopes[2]];
        let bands = gradient.par_chunks_mut(band * stride).zip(self.sums.par_chunks_mut(band));
        bands.zip(&mut self.rows).enumerate().for_each(|(i, ((out, sums), rows))| {
            let lines = out.chunks_exact_mut(stride).zip(sums).enumerate();
            for (k, (out, sums)) in lines {
                let y = i * band + k;
                let at = y * stride..(y + 1) * stride;
                let mask = mask.map(|m| &m[y * stride / 3..(y + 1) * stride / 3]);
                let work = Backward { slopes, stride, down, across };
                let pair = (&pred[at.clone()], &truth[at]);
                compiled_for(
                    isa,
                    #[inline(always)]
                    |ran| {
                        if ran >= Isa::Avx2 {
                            work.row::<true>(y, rows, pair, out);
                        } else {
                            work.row::<false>(y, rows, pair, out);
                        }
                    },
                );
                add_l1(pair, mask, l1_slope, out, sums);
            }
        });
    }
}

/// Copies the pixels that count, and 0 for the others.
fn put_masked(to: &mut Vec<f32>, from: &[f32], mask: &[u8]) {
    to.clear();
    to.extend(from.as_chunks().0.iter().zip(mask).flat_map(|(pixel, &on)| -> [f32; 3] {
        if on == 0 { [0.0; 3] } else { *pixel }
    }));
}

/// Adds the derivative of L1 of a row, and takes its sums.
fn add_l1(
    (pred, truth): (&[f32], &[f32]),
    mask: Option<&[u8]>,
    slope: f32,
    out: &mut [f32],
    sums: &mut [f64; 4],
) {
    let (mut l1, mut squares) = (0.0f64, 0.0f64);
    for ((x, y), out) in pred.iter().zip(truth).zip(out.iter_mut()) {
        let d = x - y;
        l1 += f64::from(d.abs());
        squares += f64::from(d) * f64::from(d);
        // Not `signum`, which is ±1 at 0.
        *out += if d > 0.0 {
            slope
        } else if d < 0.0 {
            -slope
        } else {
            0.0
        };
    }
    (sums[1], sums[2]) = (l1, squares);
    if let Some(mask) = mask {
        for (pixel, on) in out.as_chunks_mut::<3>().0.iter_mut().zip(mask) {
            if *on == 0 {
                *pixel = [0.0; 3];
            }
        }
    }
}

/// Rows at hand.
#[derive(Debug)]
struct Rows {
    down: [Vec<f32>; 5],
    across: [Vec<f32>; 5],
}

impl Rows {
    fn new(stride: usize) -> Self {
        let row = || vec![0.0; stride];
        Self { down: [(); 5].map(|()| row()), across: [(); 5].map(|()| row()) }
    }
}

/// From the pictures to the slopes.
struct Forward<'a> {
    pred: &'a [f32],
    truth: &'a [f32],
    stride: usize,
    down: &'a Axis,
    across: &'a Across,
}

impl Forward<'_> {
    /// One row; gives the sum of its SSIM.
    #[inline(always)]
    fn row<const FUSED: bool>(
        &self,
        y: usize,
        rows: &mut Rows,
        slopes: [&mut [f32]; 3],
        scale: f32,
    ) -> f64 {
        let [mean, square, product] = slopes;
        if !self.down.has_result(y) {
            mean.fill(0.0);
            square.fill(0.0);
            product.fill(0.0);
            return 0.0;
        }
        self.gather::<FUSED>(y, &mut rows.down);
        for (from, to) in rows.down.iter().zip(&mut rows.across) {
            self.across.forward::<FUSED>(from, to);
        }
        let [x, y, xx, yy, xy] = &rows.across;
        let mut values = 0.0f64;
        let range = self.across.result_range();
        for i in 0..self.stride {
            let local = slope(x[i], y[i], [xx[i], yy[i], xy[i]], self.across.clamps());
            if range.contains(&i) {
                values += f64::from(local[3]);
                mean[i] = scale * local[0];
                square[i] = scale * local[1];
                product[i] = scale * local[2];
            } else {
                mean[i] = 0.0;
                square[i] = 0.0;
                product[i] = 0.0;
            }
        }
        values
    }

    /// Sums down the window of both pictures, their squares and their product.
    #[inline(always)]
    fn gather<const FUSED: bool>(&self, y: usize, down: &mut [Vec<f32>; 5]) {
        let [sx, sy, sxx, syy, sxy] = down;
        let n = self.stride;
        for row in [&mut *sx, sy, sxx, syy, sxy] {
            row.fill(0.0);
        }
        let (sx, sy, sxx, syy, sxy) =
            (&mut sx[..n], &mut sy[..n], &mut sxx[..n], &mut syy[..n], &mut sxy[..n]);
        let first = y as isize - (TAPS / 2) as isize;
        for (k, &weight) in self.down.forward(y).iter().enumerate() {
            if weight == 0.0 {
                continue;
            }
            let at = (first + k as isize) as usize * n;
            let (a, b) = (&self.pred[at..at + n], &self.truth[at..at + n]);
            for i in 0..n {
                let (wa, wb) = (weight * a[i], weight * b[i]);
                sx[i] += wa;
                sy[i] += wb;
                sxx[i] = fma::<FUSED>(wa, a[i], sxx[i]);
                syy[i] = fma::<FUSED>(wb, b[i], syy[i]);
                sxy[i] = fma::<FUSED>(wa, b[i], sxy[i]);
            }
        }
    }
}

/// Derivatives of the SSIM of a pixel by mean, mean square and mean product of the first picture, and
/// the SSIM.
#[inline(always)]
fn slope(x: f32, y: f32, [xx, yy, xy]: [f32; 3], clamps: bool) -> [f32; 4] {
    let (mut vx, mut vy, cov) = (xx - x * x, yy - y * y, xy - x * y);
    if clamps {
        // Rounding alone makes a variance negative.
        vx = if vx < 0.0 { 0.0 } else { vx };
        vy = if vy < 0.0 { 0.0 } else { vy };
    }
    let (a1, a2) = (2.0 * x * y + C1, 2.0 * cov + C2);
    let (b1, b2) = (x * x + y * y + C1, vx + vy + C2);
    let below = 1.0 / (b1 * b2);
    let s = a1 * a2 * below;
    let by_square = -s * b1 * below;
    let by_product = 2.0 * a1 * below;
    let by_mean = 2.0 * y * (a2 - a1) * below - 2.0 * x * s * (b2 - b1) * below;
    [by_mean, by_square, by_product, s]
}

/// From the slopes to the gradient.
struct Backward<'a> {
    slopes: [&'a [f32]; 3],
    stride: usize,
    down: &'a Axis,
    across: &'a Across,
}

impl Backward<'_> {
    /// One row.
    #[inline(always)]
    fn row<const FUSED: bool>(
        &self,
        y: usize,
        rows: &mut Rows,
        (pred, truth): (&[f32], &[f32]),
        out: &mut [f32],
    ) {
        let n = self.stride;
        let [d0, d1, d2, ..] = &mut rows.down;
        let (d0, d1, d2) = (&mut d0[..n], &mut d1[..n], &mut d2[..n]);
        d0.fill(0.0);
        d1.fill(0.0);
        d2.fill(0.0);
        let first = y as isize - (TAPS / 2) as isize;
        for (k, &weight) in self.down.backward(y).iter().enumerate() {
            if weight == 0.0 {
                continue;
            }
            let at = (first + k as isize) as usize * n;
            let [a, b, c] = self.slopes.map(|s| &s[at..at + n]);
            for i in 0..n {
                d0[i] = fma::<FUSED>(weight, a[i], d0[i]);
                d1[i] = fma::<FUSED>(weight, b[i], d1[i]);
                d2[i] = fma::<FUSED>(weight, c[i], d2[i]);
            }
        }
        for (from, to) in rows.down.iter().zip(&mut rows.across).take(3) {
            self.across.backward::<FUSED>(from, to);
        }
        let [a0, a1, a2, ..] = &rows.across;
        let (a0, a1, a2) = (&a0[..n], &a1[..n], &a2[..n]);
        let (pred, truth, out) = (&pred[..n], &truth[..n], &mut out[..n]);
        for i in 0..n {
            let rest = fma::<FUSED>(truth[i], a2[i], a0[i]);
            out[i] = fma::<FUSED>(2.0 * pred[i], a1[i], rest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against differences of the loss: with and without a mask, L1 alone, SSIM alone, both.
    #[test]
    fn the_derivative_is_that_of_the_loss() {
        let (width, height) = (14, 13);
        let value = |i: usize, by: f32| (0.5 + 0.3 * (i as f32 * by).sin()).clamp(0.05, 0.95);
        let truth: Vec<f32> = (0..3 * width * height).map(|i| value(i, 0.7)).collect();
        let mut pred: Vec<f32> = (0..3 * width * height).map(|i| value(i, 0.37)).collect();
        let mask: Vec<u8> = (0..width * height).map(|i| u8::from(i % 5 != 0)).collect();
        for share in [0.0, 0.2, 1.0] {
            for mask in [None, Some(&mask[..])] {
                let weights =
                    ImageWeights { ssim: share, ..crate::OptimiseSettings::scenesplat().image() };
                let mut comparison = ImageComparison::new(width, height, weights).unwrap();
                let mut gradient = vec![0.0; pred.len()];
                comparison.compare(&pred, &truth, mask, &mut gradient).unwrap();
                for at in [0, 7, 100, 301, 3 * width * height - 1] {
                    let (kept, step) = (pred[at], 2e-3);
                    let mut loss = |v: f32| {
                        pred[at] = v;
                        comparison
                            .compare(&pred, &truth, mask, &mut vec![0.0; truth.len()])
                            .unwrap()
                            .loss
                    };
                    let want = (loss(kept + step) - loss(kept - step)) / (2.0 * f64::from(step));
                    pred[at] = kept;
                    let found = f64::from(gradient[at]);
                    let most = 2e-2 * want.abs() + 2e-5;
                    assert!(
                        (found - want).abs() < most,
                        "{share} {}: {at}: {found} {want}",
                        mask.is_some()
                    );
                }
            }
        }
    }
}
