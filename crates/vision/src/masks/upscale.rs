//! A mask at the resolution of its picture.

use super::mask::Mask;

/// Where a mask lies: the size of the picture, and left, top, width and height of the crop that was looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    pub picture: [u32; 2],
    pub left: u32,
    pub top: u32,
    pub width: u32,
    pub height: u32,
}

/// A mask and how much it depends on where it is cut.
pub(crate) struct Upscaled {
    pub mask: Mask,
    /// Pixels above `offset` over pixels above `−offset`; NaN where there are none.
    pub stability: f32,
}

/// The two sources of each target and the weight of the second: bilinear, corners not aligned, edges repeated.
fn sources(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let scale = from as f32 / to as f32;
    let source = |i: usize| {
        let at = ((i as f32 + 0.5) * scale - 0.5).max(0.0);
        let low = (at as usize).min(from - 1);
        (low, (low + 1).min(from - 1), at - low as f32)
    };
    (0..to).map(source).collect()
}

/// Brings logits to the resolution of a crop, cuts them at 0, and counts how stable that is. Rows are made one at a
/// time: the whole picture's logits are never in memory.
///
/// `logits`: `[side, side]`
pub(crate) fn upscale(logits: &[f32], side: usize, place: Place, offset: f32) -> Upscaled {
    let across = sources(side, place.width as usize);
    let down = sources(side, place.height as usize);
    let (mut sure, mut possible) = (0u64, 0u64);
    let mut between = vec![0f32; side];
    let mut row = vec![0f32; across.len()];
    let words = (place.width as usize).div_ceil(64);
    let rows: Vec<Vec<u64>> = down
        .iter()
        .map(|(low, high, t)| {
            let mut bits = vec![0u64; words];
            let (a, b) = (&logits[low * side..][..side], &logits[high * side..][..side]);
            let mut top = f32::MIN;
            for (out, (a, b)) in between.iter_mut().zip(a.iter().zip(b)) {
                *out = (1.0 - t) * a + t * b;
                top = out.max(top);
            }
            // Between neighbors there is nothing above the larger: most rows of most masks are empty.
            if top <= -offset.abs() {
                return bits;
            }
            for (out, (low, high, t)) in row.iter_mut().zip(&across) {
                *out = (1.0 - t) * between[*low] + t * between[*high];
            }
            sure += row.iter().filter(|v| **v > offset).count() as u64;
            possible += row.iter().filter(|v| **v > -offset).count() as u64;
            for (word, values) in bits.iter_mut().zip(row.chunks(64)) {
                let bit = |word, (i, v): (usize, &f32)| word | u64::from(*v > 0.0) << i;
                *word = values.iter().enumerate().fold(0, bit);
            }
            bits
        })
        .collect();
    let [width, height] = place.picture;
    Upscaled {
        mask: Mask::from_rows(width, height, place.left, place.top, place.width, rows.into_iter()),
        stability: (sure as f64 / possible as f64) as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whole(width: u32, height: u32) -> Place {
        Place { picture: [width, height], left: 0, top: 0, width, height }
    }

    /// The definition, pixel by pixel in f64.
    fn value(logits: &[f32], side: usize, x: u32, y: u32, place: Place) -> f64 {
        let at = |i: u32, n: u32| {
            let v = ((f64::from(i) + 0.5) * side as f64 / f64::from(n) - 0.5).max(0.0);
            (v.floor() as usize, (v.floor() as usize + 1).min(side - 1), v - v.floor())
        };
        let ((u, u1, s), (v, v1, t)) = (at(x, place.width), at(y, place.height));
        let get = |v: usize, u: usize| f64::from(logits[v * side + u]);
        (1.0 - t) * ((1.0 - s) * get(v, u) + s * get(v, u1))
            + t * ((1.0 - s) * get(v1, u) + s * get(v1, u1))
    }

    #[test]
    fn every_pixel_is_the_definitions() {
        let side = 16;
        let logits: Vec<f32> = scenesplat_models::weights::unit("logits", side * side, 1)
            .iter()
            .map(|v| 4.0 * v)
            .collect();
        for (width, height) in [(16, 16), (135, 119), (7, 90), (1, 1)] {
            let place = whole(width, height);
            let got = upscale(&logits, side, place, 1.0);
            let (mut sure, mut possible) = (0.0, 0.0);
            for y in 0..height {
                for x in 0..width {
                    let v = value(&logits, side, x, y, place);
                    assert_eq!(got.mask.contains(x, y), v > 0.0, "({x}, {y}): {v}");
                    sure += f64::from(u8::from(v > 1.0));
                    possible += f64::from(u8::from(v > -1.0));
                }
            }
            let want = (sure / possible) as f32;
            assert!(got.stability == want || want.is_nan(), "{} {want}", got.stability);
        }
    }

    #[test]
    fn a_crop_lies_where_it_was_cut() {
        let logits = vec![1.0; 16];
        let place = Place { picture: [100, 80], left: 70, top: 20, width: 30, height: 10 };
        let up = upscale(&logits, 4, place, 0.5);
        assert_eq!((up.mask.bounds(), up.mask.area()), (Some([70, 20, 99, 29]), 300));
        assert_eq!(up.stability, 1.0);
        let none = upscale(&[-1.0; 16], 4, place, 0.5);
        assert!(none.stability.is_nan() && none.mask.bounds().is_none());
    }

    #[test]
    fn a_soft_edge_is_as_stable_as_its_width_says() {
        // Two cells of +10 and −10 over 40 pixels: from the first middle at 10 to the second at 30 the logit falls by 1 a
        // pixel. It is 0 at 20, where no pixel's middle is: columns up to 19 are inside.
        let place = Place { picture: [50, 30], left: 3, top: 2, width: 40, height: 5 };
        let logits = [10.0, -10.0, 10.0, -10.0];
        // Above 1 are columns up to 18, above −1 those up to 20; above 2.6 up to 16, above −2.6 up to 22.
        for (offset, sure, possible) in [(1.0, 19.0, 21.0), (2.6, 17.0, 23.0), (0.0, 20.0, 20.0)] {
            let up = upscale(&logits, 2, place, offset);
            assert_eq!((up.mask.bounds(), up.mask.area()), (Some([3, 2, 22, 6]), 100));
            assert!((up.stability - (sure / possible) as f32).abs() < 1e-6, "{}", up.stability);
        }
        // Rows in which the logit is between −offset and 0 are possible and not inside.
        let faint = upscale(&[-0.5; 4], 2, place, 1.0);
        assert_eq!((faint.mask.area(), faint.stability), (0, 0.0));
        // Down, too: 10 above −10 in 8 rows is inside up to row 3.
        let tall = Place { picture: [3, 8], left: 0, top: 0, width: 3, height: 8 };
        let up = upscale(&[10.0, 10.0, -10.0, -10.0], 2, tall, 1.0);
        assert_eq!(up.mask.bounds(), Some([0, 0, 2, 3]));
    }
}
