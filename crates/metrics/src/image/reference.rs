//! Slow and obvious versions; only tests call them.

use super::{ImageView, SsimPadding};

/// SSIM by its definition: a 2-D window around each pixel, everything f64.
pub fn ssim(pred: ImageView<'_>, truth: ImageView<'_>, padding: SsimPadding) -> f64 {
    let (width, height, channels) =
        (pred.width() as i64, pred.height() as i64, pred.channels() as i64);
    let gauss = |d: i64| (-(d * d) as f64 / 4.5).exp();
    let norm: f64 = (-5..=5).map(gauss).sum();
    let mirror = |i: i64, len: i64| {
        if i < 0 {
            -i
        } else if i >= len {
            2 * (len - 1) - i
        } else {
            i
        }
    };
    let cut = if padding == SsimPadding::Valid { 5 } else { 0 };
    let (mut sum, mut count) = (0.0, 0.0);
    for y in cut..height - cut {
        for x in cut..width - cut {
            for c in 0..channels {
                let mut m = [0.0; 5];
                for dy in -5..=5 {
                    for dx in -5..=5 {
                        let (mut yy, mut xx) = (y + dy, x + dx);
                        if padding == SsimPadding::Reflect {
                            (yy, xx) = (mirror(yy, height), mirror(xx, width));
                        }
                        if !(0..height).contains(&yy) || !(0..width).contains(&xx) {
                            continue;
                        }
                        let at = ((yy * width + xx) * channels + c) as usize;
                        let (a, b) = (f64::from(pred.values()[at]), f64::from(truth.values()[at]));
                        let w = gauss(dy) * gauss(dx) / (norm * norm);
                        for (m, v) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                            *m += w * v;
                        }
                    }
                }
                let [m1, m2, aa, bb, ab] = m;
                let (mut v1, mut v2) = (aa - m1 * m1, bb - m2 * m2);
                if padding == SsimPadding::Reflect {
                    (v1, v2) = (v1.max(0.0), v2.max(0.0));
                }
                sum += (2.0 * m1 * m2 + 1e-4) * (2.0 * (ab - m1 * m2) + 9e-4)
                    / ((m1 * m1 + m2 * m2 + 1e-4) * (v1 + v2 + 9e-4));
                count += 1.0;
            }
        }
    }
    sum / count
}
