//! Colors in which distances are about those that people see.

use rayon::prelude::*;
use std::sync::LazyLock;

/// D65, as sRGB has it.
const WHITE: [f32; 3] = [0.950_47, 1.0, 1.088_83];

/// Light of each value of an 8-bit channel, 0 to 1.
static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|v| {
        let v = v as f32 / 255.0;
        if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    })
});

/// sRGB of 8 bits → CIE L*a*b* (D65): L 0 to 100, a and b about −110 to 110.
pub(crate) fn lab(pixels: &[[u8; 3]]) -> Vec<[f32; 3]> {
    pixels.par_iter().map(|p| lab_of(*p)).collect()
}

/// [`lab`] of one color.
pub(crate) fn lab_of(color: [u8; 3]) -> [f32; 3] {
    of_linear(color.map(|v| LINEAR[usize::from(v)]))
}

fn of_linear([r, g, b]: [f32; 3]) -> [f32; 3] {
    let xyz = [
        0.412_456_4 * r + 0.357_576_1 * g + 0.180_437_5 * b,
        0.212_672_9 * r + 0.715_152_2 * g + 0.072_175 * b,
        0.019_333_9 * r + 0.119_192 * g + 0.950_304_1 * b,
    ];
    let f = |k: usize| {
        let t = xyz[k] / WHITE[k];
        if t > 216.0 / 24_389.0 { t.cbrt() } else { (24_389.0 / 27.0 * t + 16.0) / 116.0 }
    };
    let [x, y, z] = [f(0), f(1), f(2)];
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_colours() {
        // Of the CIE formulas in f64 for sRGB, D65.
        let known = [
            ([255, 255, 255], [100.0, 0.0, 0.0]),
            ([0, 0, 0], [0.0, 0.0, 0.0]),
            ([255, 0, 0], [53.2408, 80.0925, 67.2032]),
            ([0, 255, 0], [87.7347, -86.1827, 83.1793]),
            ([0, 0, 255], [32.2970, 79.1875, -107.8602]),
            ([12, 200, 77], [70.8155, -66.5429, 48.8715]),
            ([130, 60, 220], [42.9801, 60.6450, -70.0839]),
            // Dark ones are on the straight parts of both curves.
            ([10, 10, 10], [2.7417, 0.0, 0.0]),
            ([10, 2, 8], [1.1336, 2.9264, -1.5336]),
            ([11, 11, 11], [3.0229, 0.0, 0.0]),
        ];
        for (rgb, want) in known {
            let got = lab(&[rgb])[0];
            assert!((0..3).all(|k| (got[k] - want[k]).abs() < 0.005), "{rgb:?}: {got:?}");
        }
    }
}
