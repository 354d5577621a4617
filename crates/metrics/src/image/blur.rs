//! The Gaussian window of SSIM, separable, with every treatment of the border and its adjoint.
//!
//! Along each axis the blur is a band matrix: row `i` holds the weights of the inputs `i − 5` to
//! `i + 5`. How the border is treated, and whether the blur or its adjoint is meant, changes only
//! the first and last few rows of it, so that one loop serves all.

use scenesplat_kernels::simd::{Isa, compiled_for};
use std::ops::Range;

pub(super) const RADIUS: usize = 5;
pub(super) const TAPS: usize = 2 * RADIUS + 1;

/// Standard deviation of the window, pixels.
const SIGMA: f64 = 1.5;

/// Values that a pass handles at a time: a whole number of registers on every instruction set.
const LANES: usize = 16;

/// The window, normalized to sum 1.
pub(super) fn window() -> [f64; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|k| {
        let d = k as f64 - RADIUS as f64;
        (-d * d / (2.0 * SIGMA * SIGMA)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}

/// What lies beyond the border.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Border {
    /// Nothing is computed there: outputs whose window leaves the image are 0.
    Valid,
    /// The image mirrored at its first and last pixel (which are not repeated).
    Reflect,
    /// Zeros.
    Zero,
}

/// The blur along one axis as a band matrix.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    /// `taps[i][k]` weighs the input `i + k − RADIUS`; 0 where there is none.
    taps: Vec<[f64; TAPS]>,
    /// Rows that hold exactly the window.
    plain: Range<usize>,
}

impl Axis {
    /// The blur of `len` values. `Reflect` needs more than [`RADIUS`] of them.
    pub(super) fn new(len: usize, border: Border) -> Self {
        let window = window();
        let mut taps = vec![[0.0; TAPS]; len];
        for (i, row) in taps.iter_mut().enumerate() {
            if border == Border::Valid && (i < RADIUS || i + RADIUS >= len) {
                continue;
            }
            for (k, w) in window.iter().enumerate() {
                // Position of the input, shifted by RADIUS to stay above 0.
                let at = i + k;
                let inside = match border {
                    _ if (RADIUS..len + RADIUS).contains(&at) => at - RADIUS,
                    Border::Valid | Border::Zero => continue,
                    Border::Reflect if at < RADIUS => RADIUS - at,
                    Border::Reflect => 2 * (len - 1) - (at - RADIUS),
                };
                row[inside + RADIUS - i] += w;
            }
        }
        Self::of(taps, &window)
    }

    /// The adjoint: what the derivative of a blurred array is blurred with.
    pub(super) fn transposed(&self) -> Self {
        let len = self.taps.len();
        let mut taps = vec![[0.0; TAPS]; len];
        for (i, row) in self.taps.iter().enumerate() {
            for (k, w) in row.iter().enumerate() {
                if (RADIUS..len + RADIUS).contains(&(i + k)) {
                    taps[i + k - RADIUS][TAPS - 1 - k] = *w;
                }
            }
        }
        Self::of(taps, &window())
    }

    fn of(taps: Vec<[f64; TAPS]>, window: &[f64; TAPS]) -> Self {
        let is_plain = |row: &[f64; TAPS]| row == window;
        let plain = match taps.iter().position(is_plain) {
            None => 0..0,
            Some(start) => start..taps.iter().rposition(is_plain).map_or(start, |end| end + 1),
        };
        Self { taps, plain }
    }

    pub(super) fn len(&self) -> usize {
        self.taps.len()
    }
}

/// Blurs `Q` arrays of one size and hands over the finished rows.
///
/// Rows `rows` of the result are computed from rows that `fill` provides: `fill(y, arrays)` writes
/// row `y` of each array (values of all channels side by side). `each(y, arrays)` gets the blurred
/// rows from top to bottom. Eleven rows are held at a time, so that they stay in the cache.
pub(super) fn blur_rows<const Q: usize>(
    axes: [&Axis; 2],
    channels: usize,
    rows: Range<usize>,
    mut fill: impl FnMut(usize, &mut [Vec<f64>; Q]),
    mut each: impl FnMut(usize, &[Vec<f64>; Q]),
) {
    let [across, down] = axes;
    let stride = across.len() * channels;
    let line = || -> [Vec<f64>; Q] { std::array::from_fn(|_| vec![0.0; stride]) };
    let (mut raw, mut done) = (line(), line());
    // Row y lives in slot y mod 11.
    let mut ring: [[Vec<f64>; Q]; TAPS] = std::array::from_fn(|_| line());
    let mut next = rows.start.saturating_sub(RADIUS);
    for y in rows {
        while next < (y + RADIUS + 1).min(down.len()) {
            fill(next, &mut raw);
            for q in 0..Q {
                blur_across(across, channels, &raw[q], &mut ring[next % TAPS][q]);
            }
            next += 1;
        }
        for q in 0..Q {
            let lines: [&[f64]; TAPS] = std::array::from_fn(|k| {
                // A line that does not exist has weight 0; any stands in for it.
                let line = (y + k).clamp(RADIUS, down.len() - 1 + RADIUS) - RADIUS;
                ring[line % TAPS][q].as_slice()
            });
            blur_down(&down.taps[y], &lines, &mut done[q]);
        }
        each(y, &done);
    }
}

/// Blurs a row whose pixels hold `channels` values each.
fn blur_across(axis: &Axis, channels: usize, row: &[f64], out: &mut [f64]) {
    let len = axis.len();
    for x in (0..axis.plain.start).chain(axis.plain.end..len) {
        for c in 0..channels {
            let taps = axis.taps[x].iter().enumerate();
            let inside = taps.filter(|(k, _)| (RADIUS..len + RADIUS).contains(&(x + k)));
            out[x * channels + c] =
                inside.map(|(k, w)| w * row[(x + k - RADIUS) * channels + c]).sum();
        }
    }
    if axis.plain.is_empty() {
        return;
    }
    // A neighbor pixel is `channels` values away: the row is blurred as one run of values.
    let count = axis.plain.len() * channels;
    let first = (axis.plain.start - RADIUS) * channels;
    let out = &mut out[axis.plain.start * channels..][..count];
    let lines: [&[f64]; TAPS] = std::array::from_fn(|k| &row[first + k * channels..][..count]);
    blur_down(&axis.taps[axis.plain.start], &lines, out);
}

/// `out = Σ taps[k] · lines[k]`, the sum in the order of the taps.
fn blur_down(taps: &[f64; TAPS], lines: &[&[f64]; TAPS], out: &mut [f64]) {
    compiled_for(
        Isa::current().min(Isa::Avx2),
        #[inline(always)]
        |isa| {
            if isa == Isa::Avx2 {
                weighted_sum::<true>(taps, lines, out);
            } else {
                weighted_sum::<false>(taps, lines, out);
            }
        },
    );
}

#[inline(always)]
fn weighted_sum<const FUSED: bool>(taps: &[f64; TAPS], lines: &[&[f64]; TAPS], out: &mut [f64]) {
    let len = out.len();
    let lines = lines.map(|line| &line[..len]);
    let add = |sum: f64, w: f64, v: f64| if FUSED { w.mul_add(v, sum) } else { sum + w * v };
    let whole = len - len % LANES;
    for start in (0..whole).step_by(LANES) {
        let mut sums = [0.0; LANES];
        for (w, line) in taps.iter().zip(&lines) {
            for (sum, v) in sums.iter_mut().zip(&line[start..start + LANES]) {
                *sum = add(*sum, *w, *v);
            }
        }
        out[start..start + LANES].copy_from_slice(&sums);
    }
    for i in whole..len {
        out[i] = taps.iter().zip(&lines).fold(0.0, |sum, (w, line)| add(sum, *w, line[i]));
    }
}
