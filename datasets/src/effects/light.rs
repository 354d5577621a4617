//! Effects on colors, in linear light: drifting exposure and white balance, noise of the sensor.

use super::strength::{LIGHT_BALANCE, LIGHT_STOPS, NOISE_READ, NOISE_SHOT};
use super::{Effect, Simulated, rng};
use crate::rng::normals;
use rayon::prelude::*;
use scenesplat_kernels::random::direction;
use scenesplat_scene::GaussianScene;
use scenesplat_scene::bounds::robust_bounds;
use scenesplat_scene::gaussian_scene::SH_C0;
use scenesplat_scene::linear_light::{display, linear};
use scenesplat_scene::vector::dot;

/// Changes the linear light of a Gaussian's color, which a sensor cuts at 0 and 1. The harmonics
/// grow with the color. Values that are not finite stay.
pub(super) fn change(dc: &mut [f32; 3], rest: &mut [f32], mut to: impl FnMut(usize, f64) -> f64) {
    for i in 0..3 {
        let before = 0.5 + f64::from(SH_C0) * f64::from(dc[i]);
        if !before.is_finite() {
            continue;
        }
        let before = before.clamp(0.0, 1.0);
        let after = display(to(i, linear(before)).clamp(0.0, 1.0));
        dc[i] = ((after - 0.5) / f64::from(SH_C0)) as f32;
        // Below a step of a display the ratio says nothing.
        let ratio = if before < 1.0 / 255.0 { 1.0 } else { after / before };
        rest.iter_mut().skip(i).step_by(3).for_each(|v| *v = (f64::from(*v) * ratio) as f32);
    }
}

/// Each Gaussian's color and harmonics, on all threads.
fn for_each_color(
    scene: &mut GaussianScene,
    run: impl Fn(usize, [f32; 3], &mut [f32; 3], &mut [f32]) + Sync,
) {
    let rest = scene.sh_rest_len() * 3;
    let coord = &scene.coord;
    if rest == 0 {
        let colors = scene.sh_dc.par_iter_mut().enumerate();
        return colors.for_each(|(row, dc)| run(row, coord[row], dc, &mut []));
    }
    let rows = scene.sh_dc.par_iter_mut().zip(scene.sh_rest.par_chunks_mut(rest)).enumerate();
    rows.for_each(|(row, (dc, rest))| run(row, coord[row], dc, rest));
}

/// Exposure and white balance that drift along a direction.
pub(super) fn light(scene: &mut GaussianScene, severity: f64, seed: u64) -> (usize, String) {
    let along = direction(&mut rng(seed, Effect::Light, 0));
    let bounds = robust_bounds(&scene.coord);
    let half = 0.5 * bounds.diagonal();
    let middle: [f64; 3] = std::array::from_fn(|i| 0.5 * (bounds.low[i] + bounds.high[i]));
    let (stops, balance) = (LIGHT_STOPS * severity, LIGHT_BALANCE * severity);
    for_each_color(scene, |_, coord, dc, rest| {
        let from: [f64; 3] = std::array::from_fn(|i| f64::from(coord[i]) - middle[i]);
        let place = dot(from, along) / half;
        // Of a single point, or of one that is nowhere, there is no drift.
        let place = if place.is_finite() { place.clamp(-1.0, 1.0) } else { 0.0 };
        let gain = (stops * place).exp2();
        let gains = [gain * (1.0 + balance * place), gain, gain * (1.0 - balance * place)];
        change(dc, rest, |i, light| light * gains[i]);
    });
    let text = format!(
        "exposure drifts by ±{stops:.2} stops and red against blue by ±{:.0} % over the scene",
        200.0 * balance
    );
    (scene.len(), text)
}

/// Noise of the sensor.
pub(super) fn noise(out: &mut Simulated, severity: f64, seed: u64) -> (usize, String) {
    let (read, shot) = (NOISE_READ * severity, NOISE_SHOT * severity);
    let keys = out.keys();
    for_each_color(&mut out.scene, |row, _, dc, rest| {
        let mut draws = [0.0; 6];
        normals(&mut rng(seed, Effect::Noise, keys[row]), 6, |i, x| draws[i] = x);
        change(dc, rest, |i, light| {
            light + read * draws[2 * i] + shot * light.sqrt() * draws[2 * i + 1]
        });
    });
    let text = format!(
        "noise of {:.1} % of full scale, and {:.1} % at full light",
        100.0 * read,
        100.0 * shot
    );
    (out.scene.len(), text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_light_by_hand() {
        let mut dc = [0.0; 3];
        let mut rest = [1.0; 9];
        change(&mut dc, &mut rest, |_, light| light / 2.0);
        // Half the light of mid gray.
        let after = 0.5 + f64::from(SH_C0) * f64::from(dc[0]);
        assert!((after - 0.360_78).abs() < 1e-4, "{after}");
        assert!(rest.iter().all(|v| (f64::from(*v) - after / 0.5).abs() < 1e-6));
    }
}
