//! The smoothing filter that Mip-Splatting keeps beside its Gaussians.

use crate::GaussianScene;
use rayon::prelude::*;

/// The column with the filter's standard deviation.
pub(super) const FILTER: &str = "filter_3D";

/// Makes the filter a part of the Gaussians: each is widened by it, `σ' = √(σ² + f²)` along every axis,
/// and its opacity times `√(Π σ² / Π σ'²)`. A filter of 0 changes nothing; one that is no number makes
/// the size none.
///
/// # Source
/// `create_fused_ply` of Mip-Splatting's `scene/gaussian_model.py`.
pub(super) fn fuse(scene: &mut GaussianScene, filter: &[f32]) {
    let rows = scene.log_scale.par_iter_mut().zip(&mut scene.opacity_logit).zip(filter);
    rows.filter(|(_, filter)| **filter != 0.0).for_each(|((log_scale, logit), &filter)| {
        let before = log_scale.map(|s| (2.0 * f64::from(s)).exp());
        let after = before.map(|v| v + f64::from(filter) * f64::from(filter));
        let share: f64 = [0, 1, 2].map(|i| (before[i] / after[i]).sqrt()).iter().product();
        let alpha = 1.0 / (1.0 + (-f64::from(*logit)).exp());
        *log_scale = after.map(|v| (0.5 * v.ln()) as f32);
        let alpha = alpha * share;
        *logit = (alpha / (1.0 - alpha)).ln() as f32;
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian_scene::probability_to_logit;

    #[test]
    fn a_filter_widens_and_thins() {
        let scene = |s: f32, logit: f32| GaussianScene {
            log_scale: vec![[s.ln(), s.ln(), (2.0 * s).ln()]],
            opacity_logit: vec![logit],
            ..GaussianScene::default()
        };
        let mut fused = scene(0.03, probability_to_logit(0.9));
        fuse(&mut fused, &[0.04]);
        // 3, 4, 5, and 6, 4, √52.
        let due = [0.05f32, 0.05, (0.0036f32 + 0.0016).sqrt()];
        for (got, due) in fused.scale(0).into_iter().zip(due) {
            assert!((got - due).abs() < 1e-6, "{got} instead of {due}");
        }
        let share = 0.6 * 0.6 * 0.06 / (0.0036f32 + 0.0016).sqrt();
        assert!((fused.opacity(0) - 0.9 * share).abs() < 1e-6, "{}", fused.opacity(0));
        let mut same = scene(0.03, f32::INFINITY);
        fuse(&mut same, &[0.0]);
        assert_eq!(same, scene(0.03, f32::INFINITY));
        fuse(&mut same, &[f32::NAN]);
        assert!(same.log_scale[0][0].is_nan());
    }
}
