//! Opacities and standard deviations of Gaussians, with the same bits in a browser.
//!
//! Orientations are drawn by the bits of opacities ([`drawn_axes`](scenesplat_scene::quaternion::drawn_axes)). Where there is
//! no C library, the exponential of an f32 differs in the last bit now and then, and another orientation would be drawn. So a
//! browser computes it as the C library of Linux does.

use scenesplat_scene::GaussianScene;

#[cfg(not(target_family = "wasm"))]
pub(super) fn opacity(scene: &GaussianScene, row: usize) -> f32 {
    scene.opacity(row)
}

#[cfg(not(target_family = "wasm"))]
pub(super) fn scale(scene: &GaussianScene, row: usize) -> [f32; 3] {
    scene.scale(row)
}

/// `eˣ` by a polynomial of degree 3 in f64 between 32 powers of two, in the order of operations of glibc's `expf`
/// (2.28, from Arm's optimized routines) on processors with fused multiply–add.
#[cfg(any(test, target_family = "wasm"))]
fn exp(x: f32) -> f32 {
    const PARTS: f64 = 32.0;
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    const PER_LN2: f64 = std::f64::consts::LOG2_E * PARTS;
    const CUBIC: f64 = 0.055_503_615_593_415_35 / PARTS / PARTS / PARTS;
    const SQUARE: f64 = 0.240_228_452_244_572_2 / PARTS / PARTS;
    const LINEAR: f64 = 0.693_147_180_691_620_3 / PARTS;
    // Beyond, the result is 0, infinite, NaN, or too small for f64 to matter.
    if !(-87.0..88.0).contains(&x) {
        return f64::from(x).exp() as f32;
    }
    let z = PER_LN2 * f64::from(x);
    let whole = (z + SHIFT) - SHIFT;
    let r = z - whole;
    let power = (whole / PARTS).exp2();
    let high = CUBIC.mul_add(r, SQUARE);
    let low = LINEAR.mul_add(r, 1.0);
    (high.mul_add(r * r, low) * power) as f32
}

#[cfg(target_family = "wasm")]
pub(super) fn opacity(scene: &GaussianScene, row: usize) -> f32 {
    1.0 / (1.0 + exp(-scene.opacity_logit[row]))
}

#[cfg(target_family = "wasm")]
pub(super) fn scale(scene: &GaussianScene, row: usize) -> [f32; 3] {
    scene.log_scale[row].map(exp)
}

#[cfg(test)]
mod tests {
    use super::exp;

    #[test]
    fn a_browser_computes_as_the_library_here_does() {
        let x = (0..200_000).map(|i| -20.0 + i as f32 * 1.7e-4);
        let other = x.filter(|x| exp(*x).to_bits() != x.exp().to_bits()).count();
        // None with fused multiply–add.
        assert!(other < 200, "{other} of 200000 differ");
    }
}
