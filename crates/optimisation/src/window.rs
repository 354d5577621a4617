//! The window of SSIM along one axis, and back, for each treatment of the border.

use scenesplat_metrics::image::SsimPadding;
use std::ops::Range;

/// Values of the window.
pub(crate) const TAPS: usize = 11;
const RADIUS: usize = TAPS / 2;
/// Channels of a pixel: neighbors along a row are so far apart.
const STEP: usize = 3;

/// `a · b + c`, fused where that is an instruction.
#[inline(always)]
pub(crate) fn fma<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// The window: `e^(−x²/2σ²)`, σ = 1.5 pixels, sum 1.
fn window() -> [f32; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|k| {
        let x = k as f64 - RADIUS as f64;
        (-x * x / (2.0 * 1.5 * 1.5)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|v| (v / sum) as f32)
}

/// For each place along an axis, the weights of the places from five before it to five after it.
///
/// Mirrored values are at most five away from where they are mirrored to, so they are in the same
/// range: a border is nothing but other weights. Outside of the picture weights are 0.
#[derive(Debug)]
pub(crate) struct Axis {
    forward: Vec<[f32; TAPS]>,
    backward: Vec<[f32; TAPS]>,
    results: Range<usize>,
}

impl Axis {
    pub(crate) fn new(len: usize, padding: SsimPadding) -> Self {
        let results = match padding {
            SsimPadding::Valid => RADIUS..len - RADIUS,
            SsimPadding::Reflect | SsimPadding::Zero => 0..len,
        };
        let window = window();
        // How much the result at `to` has of the value at `from`.
        let share = |to: usize, from: usize| {
            if !results.contains(&to) {
                return 0.0;
            }
            let tap =
                |distance: usize| if distance <= RADIUS { window[RADIUS + distance] } else { 0.0 };
            let mut sum = tap(to.abs_diff(from));
            if padding == SsimPadding::Reflect {
                if from > 0 {
                    sum += tap(to + from);
                }
                if from + 1 < len {
                    sum += tap(2 * (len - 1) - to - from);
                }
            }
            sum
        };
        let rows = |of: &dyn Fn(usize, usize) -> f32| {
            let row = |at: usize| {
                std::array::from_fn(|k| {
                    let other = (at + k).checked_sub(RADIUS).filter(|other| *other < len);
                    other.map_or(0.0, |other| of(at, other))
                })
            };
            (0..len).map(row).collect()
        };
        let (forward, backward) =
            (rows(&|at, other| share(at, other)), rows(&|at, other| share(other, at)));
        Self { forward, backward, results }
    }

    /// Weights that the result at a place has of the values around it.
    pub(crate) fn forward(&self, at: usize) -> &[f32; TAPS] {
        &self.forward[at]
    }

    /// Weights that the results around a place have of the value there.
    pub(crate) fn backward(&self, at: usize) -> &[f32; TAPS] {
        &self.backward[at]
    }

    /// Whether there is a result at that place.
    pub(crate) fn has_result(&self, at: usize) -> bool {
        self.results.contains(&at)
    }

    /// Number of results.
    pub(crate) fn results(&self) -> usize {
        self.results.len()
    }
}

/// The window along rows of pixels with three channels.
#[derive(Debug)]
pub(crate) struct Across {
    axis: Axis,
    window: [f32; TAPS],
    clamps: bool,
}

impl Across {
    pub(crate) fn new(width: usize, padding: SsimPadding) -> Self {
        let clamps = padding == SsimPadding::Reflect;
        Self { axis: Axis::new(width, padding), window: window(), clamps }
    }

    /// Number of results of a row and channel.
    pub(crate) fn results(&self) -> usize {
        self.axis.results()
    }

    /// Which values of a row are results.
    pub(crate) fn result_range(&self) -> Range<usize> {
        STEP * self.axis.results.start..STEP * self.axis.results.end
    }

    /// Whether variances are cut off below 0.
    pub(crate) fn clamps(&self) -> bool {
        self.clamps
    }

    /// Sums over the window.
    #[inline(always)]
    pub(crate) fn forward<const FUSED: bool>(&self, from: &[f32], to: &mut [f32]) {
        self.run::<FUSED>(&self.axis.forward, from, to);
    }

    /// The adjoint of [`forward`](Self::forward).
    #[inline(always)]
    pub(crate) fn backward<const FUSED: bool>(&self, from: &[f32], to: &mut [f32]) {
        self.run::<FUSED>(&self.axis.backward, from, to);
    }

    #[inline(always)]
    fn run<const FUSED: bool>(&self, weights: &[[f32; TAPS]], from: &[f32], to: &mut [f32]) {
        let width = weights.len();
        // Ten places at either end may have weights of their own.
        let edge = (2 * RADIUS).min(width.div_ceil(2));
        let inner = edge..width.saturating_sub(edge).max(edge);
        for x in (0..inner.start).chain(inner.end..width) {
            let mut sum = [0.0f32; STEP];
            for (k, weight) in weights[x].iter().enumerate() {
                let Some(other) = (x + k).checked_sub(RADIUS).filter(|o| *o < width) else {
                    continue;
                };
                for c in 0..STEP {
                    sum[c] = fma::<FUSED>(*weight, from[STEP * other + c], sum[c]);
                }
            }
            to[STEP * x..STEP * (x + 1)].copy_from_slice(&sum);
        }
        let (first, count) = (STEP * inner.start, STEP * inner.len());
        if count == 0 {
            return;
        }
        let to = &mut to[first..first + count];
        let reach = STEP * RADIUS;
        let from = &from[first - reach..first + count + reach];
        let parts: [&[f32]; TAPS] = std::array::from_fn(|k| &from[STEP * k..STEP * k + count]);
        for i in 0..count {
            let mut sum = self.window[0] * parts[0][i];
            for k in 1..TAPS {
                sum = fma::<FUSED>(self.window[k], parts[k][i], sum);
            }
            to[i] = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `⟨A x, y⟩ = ⟨x, Aᵀ y⟩` for each border, at sizes around the window.
    #[test]
    fn backward_is_the_adjoint() {
        for padding in SsimPadding::ALL {
            for width in [padding.least_side(), 11, 12, 19, 20, 21, 22, 40] {
                let width = width.max(padding.least_side());
                let across = Across::new(width, padding);
                let value = |i: usize, a: f32| ((i as f32 * a).sin() * 10.0).fract();
                let x: Vec<f32> = (0..3 * width).map(|i| value(i, 12.9)).collect();
                let y: Vec<f32> = (0..3 * width).map(|i| value(i, 78.2)).collect();
                let (mut ax, mut aty) = (vec![0.0; 3 * width], vec![0.0; 3 * width]);
                across.forward::<false>(&x, &mut ax);
                across.backward::<false>(&y, &mut aty);
                let dot = |a: &[f32], b: &[f32]| {
                    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
                };
                let (left, right) = (dot(&ax, &y), dot(&x, &aty));
                assert!((left - right).abs() < 1e-4, "{padding} {width}: {left} {right}");
            }
        }
    }

    /// A row with its border made by hand, in f64.
    #[test]
    fn forward_is_the_gaussian_window_over_the_padded_row() {
        let bell: Vec<f64> = (-5i32..=5).map(|x| (-f64::from(x * x) / 4.5).exp()).collect();
        let sum: f64 = bell.iter().sum();
        for padding in SsimPadding::ALL {
            for width in [padding.least_side().max(6), 11, 13, 27] {
                if padding == SsimPadding::Valid && width < 11 {
                    continue;
                }
                let across = Across::new(width, padding);
                let x: Vec<f32> = (0..3 * width).map(|i| ((i * i) as f32 * 0.37).sin()).collect();
                let (mut fused, mut plain) = (vec![0.0; 3 * width], vec![0.0; 3 * width]);
                across.forward::<true>(&x, &mut fused);
                across.forward::<false>(&x, &mut plain);
                let last = width as i32 - 1;
                let at = |place: i32, c: usize| {
                    let mirrored = if place < 0 {
                        -place
                    } else if place > last {
                        2 * last - place
                    } else {
                        place
                    };
                    let inside = (0..=last).contains(&place) || padding == SsimPadding::Reflect;
                    if inside { f64::from(x[3 * mirrored as usize + c]) } else { 0.0 }
                };
                let valid = 3 * 5..3 * (width - 5);
                let range = if padding == SsimPadding::Valid { valid } else { 0..3 * width };
                assert_eq!(
                    (across.result_range(), across.results()),
                    (range.clone(), range.len() / 3)
                );
                assert_eq!(across.clamps(), padding == SsimPadding::Reflect);
                for i in range {
                    let (place, c) = ((i / 3) as i32, i % 3);
                    let want: f64 =
                        (0..11).map(|k| bell[k] / sum * at(place + k as i32 - 5, c)).sum();
                    for got in [fused[i], plain[i]] {
                        assert!((f64::from(got) - want).abs() < 1e-6, "{padding} {width}: {i}");
                    }
                    // Down a column the same weights are looked up.
                    let axis = Axis::new(width, padding);
                    let down: f64 = (0..11)
                        .filter(|k| (0..=last).contains(&(place + *k as i32 - 5)))
                        .map(|k| f64::from(axis.forward(i / 3)[k]) * at(place + k as i32 - 5, c))
                        .sum();
                    assert!(
                        (down - want).abs() < 1e-6 && axis.has_result(i / 3),
                        "{padding} {width}: {i}"
                    );
                }
            }
        }
        let axis = Axis::new(20, SsimPadding::Valid);
        assert_eq!([4, 5, 14, 15].map(|at| axis.has_result(at)), [false, true, true, false]);
        assert_eq!(
            (axis.results(), axis.backward(2)[8] > 0.0, axis.backward(2)[7]),
            (10, true, 0.0)
        );
    }
}
