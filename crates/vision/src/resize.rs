//! Pictures in another size, as the networks were trained to see them.
//!
//! Three resamplers are in use around these networks, and they differ by more than rounding: Pillow's (antialiased, two
//! passes of 8 bits; [`resize`]), torchvision's on tensors (the same weights, without rounding;
//! [`resize_planes`]) and OpenCV's (not antialiased; not here).

use crate::VisionError;
use rayon::prelude::*;
use scenesplat_scene::picture::{MAX_PIXELS, RgbPicture};

/// How pixels are weighted. Stretched over the source pixels when a picture gets smaller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Filter {
    /// A triangle of one pixel to each side.
    Bilinear,
    /// A cubic of two pixels to each side, a = −0.5.
    Bicubic,
}

impl Filter {
    fn support(self) -> f64 {
        match self {
            Self::Bilinear => 1.0,
            Self::Bicubic => 2.0,
        }
    }

    fn weight(self, x: f64) -> f64 {
        let x = x.abs();
        match self {
            Self::Bilinear => (1.0 - x).max(0.0),
            Self::Bicubic => {
                const A: f64 = -0.5;
                if x < 1.0 {
                    ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
                } else if x < 2.0 {
                    (((x - 5.0) * x + 8.0) * x - 4.0) * A
                } else {
                    0.0
                }
            }
        }
    }
}

/// What each output pixel of a row or column is made of.
struct Taps<W> {
    /// First source pixel of each output pixel.
    first: Vec<usize>,
    /// Where the weights of each output pixel begin, closed by their number.
    start: Vec<usize>,
    weights: Vec<W>,
}

impl<W> Taps<W> {
    fn of(&self, out: usize) -> (usize, &[W]) {
        (self.first[out], &self.weights[self.start[out]..self.start[out + 1]])
    }
}

/// Weights in the order of Pillow's own arithmetic, so that their last bits are its last bits.
fn taps<W>(from: usize, to: usize, filter: Filter, round: impl Fn(f64) -> W) -> Taps<W> {
    let scale = from as f64 / to as f64;
    let stretch = scale.max(1.0);
    let (support, inverse) = (filter.support() * stretch, 1.0 / stretch);
    let mut taps = Taps { first: Vec::with_capacity(to), start: vec![0], weights: Vec::new() };
    let mut row = Vec::new();
    for out in 0..to {
        let center = (out as f64 + 0.5) * scale;
        // Truncation toward zero, then bounds: as in C.
        let first = (center - support + 0.5).max(0.0) as usize;
        let last = ((center + support + 0.5) as usize).min(from);
        row.clear();
        row.extend((first..last).map(|x| filter.weight((x as f64 - center + 0.5) * inverse)));
        let sum: f64 = row.iter().fold(0.0, |sum, w| sum + w);
        let unit = |w: &f64| if sum == 0.0 { *w } else { *w / sum };
        taps.first.push(first);
        taps.weights.extend(row.iter().map(|w| round(unit(w))));
        taps.start.push(taps.weights.len());
    }
    taps
}

/// Bits behind the point of Pillow's weights: sums of 8-bit pixels with two bits to spare fit an i32.
const BITS: u32 = 32 - 8 - 2;

fn fixed(weight: f64) -> i32 {
    let scaled = weight * f64::from(1 << BITS);
    (if weight < 0.0 { scaled - 0.5 } else { scaled + 0.5 }) as i32
}

fn clip(sum: i32) -> u8 {
    (sum >> BITS).clamp(0, 255) as u8
}

fn check(width: u32, height: u32) -> Result<(), VisionError> {
    if width == 0 || height == 0 || u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(VisionError::input(
            "resize",
            format!("{width} × {height} pixels; 1 to {MAX_PIXELS} are possible"),
        ));
    }
    Ok(())
}

/// The picture in another size, equal to Pillow's `Image.resize` to the bit.
///
/// The picture is squashed: its aspect is not kept. Rows first, rounded to 8 bits, then columns; a pass that changes
/// nothing is left out.
///
/// # Errors
/// If either size has no pixels, or more than [`MAX_PIXELS`].
///
/// # Source
/// `Resample.c` of Pillow 11.3. From 13 on Pillow resizes columns first where heights shrink much more than widths, which
/// changes roundings; networks and labels are older.
pub fn resize(
    picture: &RgbPicture,
    width: u32,
    height: u32,
    filter: Filter,
) -> Result<RgbPicture, VisionError> {
    check(picture.width(), picture.height())?;
    check(width, height)?;
    let (from_w, from_h) = (picture.width() as usize, picture.height() as usize);
    let (w, h) = (width as usize, height as usize);
    let half = 1 << (BITS - 1);
    let mut rows = picture.pixels().to_vec();
    if w != from_w {
        let taps = taps(from_w, w, filter, fixed);
        let mut out = vec![[0u8; 3]; w * from_h];
        out.par_chunks_mut(w).zip(rows.par_chunks(from_w)).for_each(|(out, row)| {
            for (x, out) in out.iter_mut().enumerate() {
                let (first, weights) = taps.of(x);
                let mut sums = [half; 3];
                for (pixel, weight) in row[first..].iter().zip(weights) {
                    for (sum, value) in sums.iter_mut().zip(pixel) {
                        *sum += i32::from(*value) * weight;
                    }
                }
                *out = sums.map(clip);
            }
        });
        rows = out;
    }
    if h != from_h {
        let taps = taps(from_h, h, filter, fixed);
        let bytes = rows.as_flattened();
        let mut out = vec![[0u8; 3]; w * h];
        out.par_chunks_mut(w).enumerate().for_each_init(
            || vec![0i32; 3 * w],
            |sums, (y, out)| {
                let (first, weights) = taps.of(y);
                sums.fill(half);
                for (row, weight) in bytes[first * 3 * w..].chunks_exact(3 * w).zip(weights) {
                    for (sum, value) in sums.iter_mut().zip(row) {
                        *sum += i32::from(*value) * weight;
                    }
                }
                for (out, sum) in out.as_flattened_mut().iter_mut().zip(&*sums) {
                    *out = clip(*sum);
                }
            },
        );
        rows = out;
    }
    RgbPicture::from_pixels(width, height, rows)
        .ok_or_else(|| VisionError::input("resize", "pixels were lost"))
}

/// The picture as planes of 0 to 1 in another size, with the same weights and without rounding: what torchvision's
/// `Resize` with antialias makes of a float tensor.
///
/// # Shapes
/// Returns `[3, height, width]`.
///
/// # Errors
/// As [`resize`].
pub fn resize_planes(
    picture: &RgbPicture,
    width: u32,
    height: u32,
    filter: Filter,
) -> Result<Vec<f32>, VisionError> {
    check(picture.width(), picture.height())?;
    check(width, height)?;
    let (from_w, from_h) = (picture.width() as usize, picture.height() as usize);
    let (w, h) = (width as usize, height as usize);
    let across = taps(from_w, w, filter, |weight| weight as f32);
    let mut rows = vec![0f32; 3 * w * from_h];
    rows.par_chunks_mut(w).enumerate().for_each(|(row, out)| {
        let (channel, y) = (row / from_h, row % from_h);
        let pixels = &picture.pixels()[y * from_w..(y + 1) * from_w];
        for (x, out) in out.iter_mut().enumerate() {
            let (first, weights) = across.of(x);
            let terms = pixels[first..].iter().zip(weights);
            *out = terms.map(|(p, weight)| f32::from(p[channel]) / 255.0 * weight).sum();
        }
    });
    let down = taps(from_h, h, filter, |weight| weight as f32);
    let mut planes = vec![0f32; 3 * w * h];
    planes.par_chunks_mut(w).enumerate().for_each(|(row, out)| {
        let (channel, y) = (row / h, row % h);
        let (first, weights) = down.of(y);
        let from = &rows[(channel * from_h + first) * w..];
        for (from, weight) in from.chunks_exact(w).zip(weights) {
            for (out, value) in out.iter_mut().zip(from) {
                *out += value * weight;
            }
        }
    });
    Ok(planes)
}

/// Shifts and scales planes of 0 to 1, channel by channel: `(v − mean) / std`.
///
/// # Shapes
/// `planes`: `[3, pixels]`
pub(crate) fn standardize(planes: &mut [f32], mean: [f32; 3], std: [f32; 3]) {
    let pixels = planes.len() / 3;
    if pixels == 0 {
        return;
    }
    for (channel, plane) in planes.chunks_exact_mut(pixels).enumerate() {
        plane.iter_mut().for_each(|v| *v = (*v - mean[channel]) / std[channel]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_channel_has_its_own_mean_and_spread() {
        let mut planes = [0.5, 1.0, 0.5, 1.0, 0.5, 1.0];
        standardize(&mut planes, [0.5, 0.25, 0.0], [0.5, 0.25, 2.0]);
        assert_eq!(planes, [0.0, 1.0, 1.0, 3.0, 0.25, 0.5]);
        standardize(&mut [], [0.0; 3], [1.0; 3]);
    }

    #[test]
    fn the_cubic_is_that_of_pillow() {
        // a = −½: 1 − 2.5 x² + 1.5 x³ below 1, 2 − 4 x + 2.5 x² − 0.5 x³ below 2.
        for (x, want) in [(0.0, 1.0), (-0.5, 0.5625), (1.0, 0.0), (1.5, -0.0625), (-2.0, 0.0)] {
            assert_eq!(Filter::Bicubic.weight(x), want, "{x}");
        }
        for (x, want) in [(0.0, 1.0), (-0.25, 0.75), (1.0, 0.0), (3.0, 0.0)] {
            assert_eq!(Filter::Bilinear.weight(x), want, "{x}");
        }
    }
}
