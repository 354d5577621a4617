//! Noise that leaves the picture of a room what it was: faint Gaussians are moved within their own extent, and
//! some are as large and faint as early in an optimisation.

use crate::dice::{between, chance, noise};
use crate::splats::{opacity, rounded_ln, sizes};
use crate::vector::{V3, add_times, cross};
use scenesplat_kernels::random::SampleRng;
use scenesplat_scene::GaussianScene;

/// Gaussians move by up to this share of their size, the fainter the more.
const REACH: [f64; 2] = [0.1, 0.3];

/// Share of those that are larger, and the spread of the logarithm of how much.
const LARGER: [f64; 2] = [0.1, 0.3];
const GROWTH: f64 = 0.2;

pub(crate) fn jitter(scene: &mut GaussianScene, rng: &mut SampleRng) {
    let reach = between(rng, REACH[0], REACH[1]);
    let larger = between(rng, LARGER[0], LARGER[1]);
    for row in 0..scene.len() {
        let (opacity, sizes) = (opacity(scene, row), sizes(scene, row));
        let along: V3 = std::array::from_fn(|i| reach * sizes[i] * noise(rng) * (1.0 - opacity));
        let by = turned(scene.quat[row].map(f64::from), along);
        (0..3).for_each(|i| scene.coord[row][i] += by[i] as f32);
        if chance(rng, larger) {
            let growth = GROWTH * noise(rng).abs();
            // In steps, as libraries disagree about the last bit of exponentials.
            let factor = ((-growth).exp() * 4096.0).round() / 4096.0;
            let opacity = ((opacity * factor * 65536.0).round() / 65536.0).clamp(0.001, 0.999);
            scene.log_scale[row] =
                scene.log_scale[row].map(|s| (f64::from(s) + growth).min(-0.7) as f32);
            scene.opacity_logit[row] = rounded_ln(opacity / (1.0 - opacity)) as f32;
        }
    }
}

/// A vector turned by a unit quaternion.
fn turned([w, x, y, z]: [f64; 4], v: V3) -> V3 {
    let axis = [x, y, z];
    let twice = cross(axis, v).map(|c| 2.0 * c);
    let once = add_times(v, twice, w);
    let rest = cross(axis, twice);
    std::array::from_fn(|i| once[i] + rest[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn faint_gaussians_move_within_themselves_and_solid_ones_hardly() {
        // Long along z, by a quarter turn about x of what is long along y.
        let half = 0.5_f32.sqrt();
        let make = |opacity_logit| GaussianScene {
            coord: vec![[0.0; 3]; 2000],
            log_scale: vec![[-9.0, -2.0, -9.0]; 2000],
            quat: vec![[half, half, 0.0, 0.0]; 2000],
            opacity_logit: vec![opacity_logit; 2000],
            sh_dc: vec![[0.0; 3]; 2000],
            ..GaussianScene::default()
        };
        let spread = |scene: &GaussianScene, axis: usize| {
            let sum: f32 = scene.coord.iter().map(|p| p[axis] * p[axis]).sum();
            (sum / 2000.0).sqrt()
        };
        let [mut faint, mut solid] = [make(-4.0), make(6.0)];
        jitter(&mut faint, &mut sample_rng(1, 0, 0));
        jitter(&mut solid, &mut sample_rng(1, 0, 0));
        let size = (-2.0_f32).exp();
        assert!((0.09..0.31).contains(&(spread(&faint, 2) / size)), "{}", spread(&faint, 2));
        assert!(spread(&faint, 1) < 0.001 && spread(&solid, 2) < 0.01 * size);
        let larger = solid.log_scale.iter().zip(&solid.opacity_logit).filter(|(s, _)| s[1] > -2.0);
        let share = larger.clone().count() as f64 / 2000.0;
        assert!((0.08..0.32).contains(&share), "{share}");
        assert!(larger.clone().all(|(_, &o)| o < 6.01), "what grows is fainter");
    }
}
