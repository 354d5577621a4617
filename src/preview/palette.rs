//! Colors of classes.

use scenesplat_scene::linear_light::display;

/// Color of rows without a class.
pub const UNLABELLED_COLOR: [u8; 3] = [96, 98, 104];

/// Colors of the first classes: more than the 41 of the network inside the program.
///
/// The first five are those that were always used; each further one was chosen as the color farthest
/// from all before it, from rows without a class, and from ground and ink of the pictures, in OKLab
/// (in which equal steps look equal), among those of chroma up to 0.19 and lightness 0.42 to 0.95.
/// No two are nearer than 0.092; with hues a golden angle apart it was 0.042, and wall and radiator
/// could not be told apart.
#[rustfmt::skip]
const DISTINCT: [[u8; 3]; 48] = [
    [93, 173, 252], [193, 61, 53], [53, 243, 181], [161, 110, 224], [243, 176, 29], [0, 168, 60],
    [132, 0, 120], [252, 132, 168], [48, 60, 180], [228, 252, 84], [168, 144, 108], [0, 96, 0],
    [0, 120, 228], [24, 156, 156], [216, 180, 252], [144, 204, 48], [240, 108, 0], [132, 48, 0],
    [120, 120, 0], [132, 192, 180], [180, 60, 144], [120, 72, 180], [36, 228, 252], [228, 180, 168],
    [144, 120, 156], [192, 216, 144], [216, 132, 252], [228, 84, 120], [0, 84, 120], [180, 156, 192],
    [108, 60, 96], [0, 132, 0], [168, 0, 72], [0, 120, 156], [144, 156, 24], [180, 108, 0],
    [96, 84, 12], [216, 96, 192], [0, 204, 144], [144, 252, 240], [0, 120, 96], [84, 144, 204],
    [180, 180, 108], [156, 204, 252], [216, 216, 0], [156, 96, 96], [252, 144, 108], [216, 252, 180],
];

/// The color of a class: fixed, and apart from those of other classes, as far as there are no more
/// than 48; beyond, hues come close to each other again.
pub fn class_color(index: usize) -> [u8; 3] {
    DISTINCT.get(index).copied().unwrap_or_else(|| golden_color(index))
}

/// Hues step by the golden angle, so that any number of classes spreads over the circle; lightness
/// takes turns among five values (hues come close again after 8, 13, 21, 34 steps, none of which is a
/// multiple of five). The space is OKLCH, in which equal steps look equal.
fn golden_color(index: usize) -> [u8; 3] {
    // 360° · (1 − 1/φ); starts at a blue, since the first class often is the wall.
    let hue = (250.0 + 137.507_764_05 * (index % 100_000) as f64).to_radians();
    let lightness = [0.73, 0.55, 0.86, 0.64, 0.80][index % 5];
    let mut chroma = 0.17;
    loop {
        let rgb = oklch_to_rgb(lightness, chroma, hue);
        let inside = rgb.iter().all(|c| (0.0..=1.0).contains(c));
        if inside || chroma < 0.01 {
            return rgb.map(|c| (display(c.clamp(0.0, 1.0)) * 255.0).round() as u8);
        }
        chroma -= 0.01;
    }
}

/// Linear sRGB of a color in OKLCH (Ottosson 2020).
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

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::linear_light::linear;

    /// OKLab of sRGB (Ottosson 2020).
    fn oklab(color: [u8; 3]) -> [f64; 3] {
        let [r, g, b] = color.map(|v| linear(f64::from(v) / 255.0));
        let [l, m, s] = [
            0.412_221_470_8 * r + 0.536_332_536_3 * g + 0.051_445_992_9 * b,
            0.211_903_498_2 * r + 0.680_699_545_1 * g + 0.107_396_956_6 * b,
            0.088_302_461_9 * r + 0.281_718_837_6 * g + 0.629_978_700_5 * b,
        ]
        .map(f64::cbrt);
        [
            0.210_454_255_3 * l + 0.793_617_785_0 * m - 0.004_072_046_8 * s,
            1.977_998_495_1 * l - 2.428_592_205_0 * m + 0.450_593_709_9 * s,
            0.025_904_037_1 * l + 0.782_771_766_2 * m - 0.808_675_766_0 * s,
        ]
    }

    fn distance(a: [u8; 3], b: [u8; 3]) -> f64 {
        let (a, b) = (oklab(a), oklab(b));
        (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn classes_of_rooms_can_be_told_apart() {
        let classes = scenesplat_rooms::CLASSES.len();
        assert!(classes <= DISTINCT.len(), "{classes} classes need as many distinct colors");
        let colors: Vec<[u8; 3]> = (0..DISTINCT.len()).map(class_color).collect();
        for a in 0..colors.len() {
            let apart = distance(colors[a], UNLABELLED_COLOR);
            assert!(apart > 0.09, "{a}: {apart} from rows without a class");
            for b in 0..a {
                let apart = distance(colors[a], colors[b]);
                assert!(apart > 0.09, "{a} {b}: {:?} {:?} are {apart} apart", colors[a], colors[b]);
            }
        }
        // What it was: the test can fail.
        assert!(distance(golden_color(22), golden_color(27)) < 0.05);
    }

    #[test]
    fn any_number_of_classes_has_colors() {
        for index in 48..1000 {
            assert_ne!(class_color(index), class_color(index - 1));
        }
        class_color(usize::MAX);
    }
}
