//! The noise of MCMC: centers of nearly transparent Gaussians move along their own shape.

use crate::Model;
use crate::random::{Counter, Purpose};
use rayon::prelude::*;
use scenesplat_scene::vector::rotation;

/// Opacity at which the gate is half open, and how steep it is.
const GATE: [f32; 2] = [0.005, 100.0];
/// A gate that is open less than this moves nothing: with the largest rate there is (80 times the scene's
/// scale) a Gaussian of a meter by less than a micrometer.
const CLOSED: f32 = 1e-9;
/// Gaussians of one task.
const CHUNK: usize = 4096;

/// `Σ ξ · sigmoid(−100 (o − 0.005)) · strength`, `Σ = R S² Rᵀ`: how far a center moves.
pub fn displacement(
    quat: [f32; 4],
    scale: [f32; 3],
    opacity: f32,
    xi: [f32; 3],
    strength: f32,
) -> [f32; 3] {
    let gate = 1.0 / (1.0 + (GATE[1] * (opacity - GATE[0])).exp());
    let norm = quat.iter().map(|v| v * v).sum::<f32>().sqrt();
    if !(norm > 0.0) {
        return [0.0; 3];
    }
    let r = rotation(quat.map(|v| v / norm));
    let along = |k: usize| {
        let dot = r[0][k] * xi[0] + r[1][k] * xi[1] + r[2][k] * xi[2];
        dot * scale[k] * scale[k]
    };
    let along = [along(0), along(1), along(2)];
    let factor = gate * strength;
    r.map(|row| factor * (row[0] * along[0] + row[1] * along[1] + row[2] * along[2]))
}

/// Moves all centers; `strength` is the learning rate of the centers times 5e5.
pub(crate) fn add_noise(model: &mut Model, strength: f32, seed: u64, step: u64) {
    let counter = Counter::new(seed, Purpose::Noise, step);
    // The logistic function of more than this is closed.
    let open = GATE[0] + (1.0 / CLOSED).ln() / GATE[1];
    let g = &mut model.gaussians;
    let (quats, scales, opacities) = (&g.quats, &g.scales, &g.opacities);
    g.means.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, means)| {
        for (k, mean) in means.iter_mut().enumerate() {
            let i = chunk * CHUNK + k;
            if !(opacities[i] < open) {
                continue;
            }
            let by = displacement(quats[i], scales[i], opacities[i], counter.normals(i), strength);
            for (v, by) in mean.iter_mut().zip(by) {
                *v += by;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Stored;

    /// sigmoid(x)
    fn sigmoid(x: f64) -> f64 {
        1.0 / (1.0 + (-x).exp())
    }

    #[test]
    fn a_center_moves_along_the_squared_shape_behind_an_open_gate() {
        // By hand: a quarter turn about z brings the first axis (2) to y and the second (0.5) to −x.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let quat = [half, 0.0, 0.0, half];
        for opacity in [0.0f32, 0.005, 0.05] {
            let by = displacement(quat, [2.0, 0.5, 1.0], opacity, [1.0, 1.0, -1.0], 3.0);
            let gate = sigmoid(-100.0 * (f64::from(opacity) - 0.005));
            for (by, along) in by.into_iter().zip([0.25, 4.0, -1.0]) {
                let due = 3.0 * gate * along;
                assert!((f64::from(by) - due).abs() < 1e-5 * due.abs(), "{opacity}: {by}, {due}");
            }
        }
        // A quaternion of any length is the same rotation.
        let unit = displacement(quat, [2.0, 0.5, 1.0], 0.0, [1.0, 1.0, -1.0], 3.0);
        let long = displacement(quat.map(|v| 3.0 * v), [2.0, 0.5, 1.0], 0.0, [1.0, 1.0, -1.0], 3.0);
        assert!(unit.iter().zip(long).all(|(a, b)| (a - b).abs() < 1e-5), "{unit:?} {long:?}");
        assert_eq!(displacement([0.0; 4], [1.0; 3], 0.0, [1.0; 3], 1.0), [0.0; 3]);
    }

    #[test]
    fn every_gaussian_has_its_own_noise_and_opaque_ones_stay() {
        let n = 2 * CHUNK + 3;
        let row = |i: usize| Stored {
            mean: [0.0; 3],
            log_scale: [0.0; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            // The fourth row is opaque.
            logit: if i == 3 { 5.0 } else { -9.0 },
        };
        let rows: Vec<Stored> = (0..n).map(row).collect();
        let mut model = Model::from_arrays(&rows, vec![0.0; 3 * n], 0).unwrap();
        add_noise(&mut model, 1.0, 7, 11);
        let means = &model.gaussians.means;
        assert_eq!(means[3], [0.0; 3]);
        let mut seen: Vec<[u32; 3]> = means.iter().map(|m| m.map(f32::to_bits)).collect();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), n);
        let spread = means.iter().flatten().map(|v| f64::from(v * v)).sum::<f64>();
        let gate = sigmoid(-100.0 * (sigmoid(-9.0) - 0.005));
        let spread = (spread / (3 * n) as f64).sqrt() / gate;
        assert!((spread - 1.0).abs() < 0.02, "standard deviation {spread}");
    }

    #[test]
    fn any_rotation_moves_by_its_covariance() {
        let (quat, scale) = ([0.7f32, -0.4, 0.9, 0.2], [0.3f32, 1.1, 2.0]);
        let (xi, norm) = ([0.8f32, -1.3, 0.4], (0.49f64 + 0.16 + 0.81 + 0.04).sqrt());
        let r = rotation(quat.map(|v| f64::from(v) / norm));
        // Σ = R S² Rᵀ entry by entry.
        let sigma = |i: usize, j: usize| {
            (0..3).map(|k| r[i][k] * f64::from(scale[k]).powi(2) * r[j][k]).sum::<f64>()
        };
        let by = displacement(quat, scale, 0.02, xi, 5.0);
        for i in 0..3 {
            let along: f64 = (0..3).map(|j| sigma(i, j) * f64::from(xi[j])).sum();
            let want = 5.0 * along / (1.0 + 1.5f64.exp());
            assert!((f64::from(by[i]) - want).abs() < 1e-5, "{i}: {} {want}", by[i]);
        }
    }

    #[test]
    fn each_row_moves_by_its_own_numbers_shape_and_gate() {
        let n = CHUNK + 3;
        // The gate is closed from 0.005 + ln(1e9) / 100 = 0.2122 on.
        let opacity = |i: usize| [0.001, 0.2, 0.2105, 0.214, 0.05][i % 5];
        let row = |i: usize| Stored {
            mean: [i as f32, -2.0, 0.5],
            log_scale: [0.1 * (i % 3) as f32, -0.5, 1.0],
            quat: [1.0, 0.1 * (i % 7) as f32, -0.3, 0.2],
            logit: crate::model::logit(opacity(i)),
        };
        let rows: Vec<Stored> = (0..n).map(row).collect();
        let mut model = Model::from_arrays(&rows, vec![0.0; 3 * n], 0).unwrap();
        let before = model.gaussians.clone();
        add_noise(&mut model, 1e6, 7, 11);
        let counter = Counter::new(7, Purpose::Noise, 11);
        for i in [0, 1, 2, 3, 4, 8, CHUNK - 1, CHUNK, CHUNK + 1, CHUNK + 2] {
            let b = &before;
            let by = displacement(b.quats[i], b.scales[i], b.opacities[i], counter.normals(i), 1e6);
            let stays = i % 5 == 3;
            for k in 0..3 {
                let want = if stays { b.means[i][k] } else { b.means[i][k] + by[k] };
                assert_eq!(model.gaussians.means[i][k], want, "{i} {k}");
            }
            assert_eq!(model.gaussians.means[i] == b.means[i], stays, "{i}");
        }
    }
}
