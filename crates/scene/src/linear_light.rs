//! Values of a display, and linear light (IEC 61966-2-1).

/// Values of a display to linear light. Above 1 the curve goes on; below 0 it is a line.
pub fn linear(srgb: f64) -> f64 {
    if srgb <= 0.040_45 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

/// Linear light to values of a display.
pub fn display(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// How much values of a display change with linear light, there.
pub fn display_slope(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * linear.powf(1.0 / 2.4) / linear }
}

/// How bright linear light is (ITU-R BT.709).
pub fn luminance([red, green, blue]: [f64; 3]) -> f64 {
    0.2126 * red + 0.7152 * green + 0.0722 * blue
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_linear_by_the_standard() {
        // Values of the standard's two branches and their inverse.
        for (srgb, want) in [(0.0, 0.0), (0.04, 0.003_095_975), (0.5, 0.214_041_14), (1.0, 1.0)] {
            assert!((linear(srgb) - want).abs() < 1e-8, "{srgb}: {}", linear(srgb));
            assert!((display(want) - srgb).abs() < 1e-7);
            let step = 1e-6;
            let slope = (display(want + step) - display(want)) / step;
            assert!((display_slope(want) / slope - 1.0).abs() < 1e-3, "{slope}");
        }
        // Half of the light is about 73.5 % of the code; the curve goes on below 0 and above 1.
        assert!((display(0.5) - 0.735_356_9).abs() < 1e-6);
        for at in [-0.2, 0.001, 0.1, 0.5, 1.3] {
            let slope = (display(at + 1e-6) - display(at - 1e-6)) / 2e-6;
            assert!((display_slope(at) - slope).abs() < 1e-4 * slope, "{at}");
        }
        assert!((luminance([1.0; 3]) - 1.0).abs() < 1e-12);
    }
}
