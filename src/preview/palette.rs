//! Colours of classes.

/// Colour of rows without a class.
pub const UNLABELLED_COLOR: [u8; 3] = [96, 98, 104];

/// The colour of a class: fixed, and well apart from the colours of its neighbours in the list.
///
/// Hues step by the golden angle, so that any number of classes spreads over the circle;
/// lightness takes turns among five values (hues come close again after 8, 13, 21, 34 steps, none
/// of which is a multiple of five). The space is OKLCH, in which equal steps look equal.
pub fn class_color(index: usize) -> [u8; 3] {
    // 360° · (1 − 1/φ); starts at a blue, since the first class often is the wall.
    let hue = (250.0 + 137.507_764_05 * (index % 100_000) as f64).to_radians();
    let lightness = [0.73, 0.55, 0.86, 0.64, 0.80][index % 5];
    let mut chroma = 0.17;
    loop {
        let rgb = oklch_to_rgb(lightness, chroma, hue);
        let inside = rgb.iter().all(|c| (0.0..=1.0).contains(c));
        if inside || chroma < 0.01 {
            return rgb.map(|c| (gamma(c.clamp(0.0, 1.0)) * 255.0).round() as u8);
        }
        chroma -= 0.01;
    }
}

/// Linear sRGB of a colour in OKLCH (Ottosson 2020).
fn oklch_to_rgb(lightness: f64, chroma: f64, hue: f64) -> [f64; 3] {
    let (a, b) = (chroma * hue.cos(), chroma * hue.sin());
    let [l, m, s] = [
        lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b,
        lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b,
        lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b,
    ]
    .map(|v| v * v * v);
    [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ]
}

fn gamma(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_apart() {
        let distance = |a: [u8; 3], b: [u8; 3]| {
            (0..3).map(|i| (i32::from(a[i]) - i32::from(b[i])).pow(2)).sum::<i32>()
        };
        let colors: Vec<[u8; 3]> = (0..40).map(class_color).collect();
        for a in 0..40 {
            assert!(distance(colors[a], UNLABELLED_COLOR) > 30 * 30);
            for b in 0..a {
                let apart = distance(colors[a], colors[b]);
                assert!(apart > 20 * 20, "{a} {b}: {:?} {:?}", colors[a], colors[b]);
                if a - b == 1 {
                    assert!(apart > 80 * 80, "neighbours {a} {b}");
                }
            }
        }
        class_color(usize::MAX);
    }
}
