//! Opacities and standard deviations of Gaussians, with the same bits in a browser.
//!
//! Orientations are drawn by the bits of opacities ([`drawn_axes`](scenesplat_scene::quaternion::drawn_axes)). Where there is
//! no C library, the exponential of an f32 differs in the last bit now and then, and another orientation would be drawn; by way
//! of f64 it is rounded as C libraries round it.

use scenesplat_scene::GaussianScene;

#[cfg(not(target_family = "wasm"))]
pub(super) fn opacity(scene: &GaussianScene, row: usize) -> f32 {
    scene.opacity(row)
}

#[cfg(not(target_family = "wasm"))]
pub(super) fn scale(scene: &GaussianScene, row: usize) -> [f32; 3] {
    scene.scale(row)
}

#[cfg(target_family = "wasm")]
fn exp(x: f32) -> f32 {
    f64::from(x).exp() as f32
}

#[cfg(target_family = "wasm")]
pub(super) fn opacity(scene: &GaussianScene, row: usize) -> f32 {
    1.0 / (1.0 + exp(-scene.opacity_logit[row]))
}

#[cfg(target_family = "wasm")]
pub(super) fn scale(scene: &GaussianScene, row: usize) -> [f32; 3] {
    scene.log_scale[row].map(exp)
}
