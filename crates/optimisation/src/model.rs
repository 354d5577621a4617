//! The Gaussians that are optimised: what is stored, and what is drawn, side by side.

use crate::error::OptimiseError;
use scenesplat_rasterizer::Gaussians;
use scenesplat_scene::GaussianScene;

/// Gaussians with their stored and their activated values.
///
/// Centers, quaternions and harmonics are stored as they are drawn, so they exist once, in
/// [`gaussians`](Self::gaussians); scales and opacities are stored as logarithm and logit.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Model {
    pub(crate) gaussians: Gaussians,
    pub(crate) log_scales: Vec<[f32; 3]>,
    pub(crate) logits: Vec<f32>,
}

/// `1 / (1 + e^−x)`.
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// The inverse of [`sigmoid`], of a number between 0 and 1.
pub(crate) fn logit(p: f32) -> f32 {
    let p = f64::from(p);
    (p / (1.0 - p)).ln() as f32
}

/// One Gaussian as it is stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stored {
    /// Center, units of the world.
    pub mean: [f32; 3],
    /// Natural logarithms of the standard deviations.
    pub log_scale: [f32; 3],
    /// `w, x, y, z`, any norm.
    pub quat: [f32; 4],
    /// Opacity before the sigmoid.
    pub logit: f32,
}

impl Model {
    /// No Gaussian, harmonics of that degree, 0 to 3.
    pub fn new(sh_degree: u8) -> Self {
        Self { gaussians: Gaussians { sh_degree, ..Gaussians::default() }, ..Self::default() }
    }

    /// From a scene; harmonics are cut, or filled with 0, to `sh_degree`.
    ///
    /// # Errors
    /// If arrays differ in length or a degree is above 3.
    pub fn from_scene(scene: &GaussianScene, sh_degree: u8) -> Result<Self, OptimiseError> {
        let drawn = Gaussians::from_scene(scene)?;
        let mut model = Self::new(sh_degree);
        let (from, to) = (3 * drawn.sh_len(), 3 * model.gaussians.sh_len());
        let both = from.min(to);
        let mut sh = vec![0.0; to * drawn.len()];
        for (to, from) in sh.chunks_exact_mut(to).zip(drawn.sh.chunks_exact(from)) {
            to[..both].copy_from_slice(&from[..both]);
        }
        model.gaussians = Gaussians { sh, sh_degree, ..drawn };
        model.gaussians.check()?;
        model.log_scales.clone_from(&scene.log_scale);
        model.logits.clone_from(&scene.opacity_logit);
        model.activate();
        Ok(model)
    }

    /// Puts all arrays together; harmonics are `[N, K, 3]`.
    ///
    /// # Errors
    /// If arrays differ in length or the degree is above 3.
    pub fn from_arrays(
        rows: &[Stored],
        sh: Vec<f32>,
        sh_degree: u8,
    ) -> Result<Self, OptimiseError> {
        let mut model = Self::new(sh_degree);
        for row in rows {
            model.push(row, &[]);
        }
        model.gaussians.sh = sh;
        model.gaussians.check()?;
        Ok(model)
    }

    /// Activated values.
    pub fn gaussians(&self) -> &Gaussians {
        &self.gaussians
    }

    /// Natural logarithms of the standard deviations. `[N, 3]`
    pub fn log_scales(&self) -> &[[f32; 3]] {
        &self.log_scales
    }

    /// Opacities before the sigmoid. `[N]`
    pub fn logits(&self) -> &[f32] {
        &self.logits
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.logits.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.logits.is_empty()
    }

    /// One Gaussian as it is stored.
    pub fn row(&self, i: usize) -> Stored {
        Stored {
            mean: self.gaussians.means[i],
            log_scale: self.log_scales[i],
            quat: self.gaussians.quats[i],
            logit: self.logits[i],
        }
    }

    /// Values of the harmonics of one Gaussian: `3 (degree + 1)²`.
    pub(crate) fn sh_stride(&self) -> usize {
        3 * self.gaussians.sh_len()
    }

    pub(crate) fn push(&mut self, row: &Stored, sh: &[f32]) {
        let g = &mut self.gaussians;
        g.means.push(row.mean);
        g.quats.push(row.quat);
        g.scales.push(row.log_scale.map(f32::exp));
        g.opacities.push(sigmoid(row.logit));
        g.sh.extend_from_slice(sh);
        self.log_scales.push(row.log_scale);
        self.logits.push(row.logit);
    }

    /// Appends a copy of a row.
    pub(crate) fn push_copy(&mut self, i: usize) {
        let (row, width) = (self.row(i), self.sh_stride());
        self.push(&row, &[]);
        self.gaussians.sh.extend_from_within(i * width..(i + 1) * width);
    }

    /// Puts a copy of row `from` at row `to`.
    pub(crate) fn copy_row(&mut self, from: usize, to: usize) {
        let width = self.sh_stride();
        let g = &mut self.gaussians;
        g.means[to] = g.means[from];
        g.quats[to] = g.quats[from];
        g.scales[to] = g.scales[from];
        g.opacities[to] = g.opacities[from];
        g.sh.copy_within(from * width..(from + 1) * width, to * width);
        self.log_scales[to] = self.log_scales[from];
        self.logits[to] = self.logits[from];
    }

    /// Sets opacity and scales of a row, all from activated values.
    pub(crate) fn set_shape(&mut self, i: usize, opacity: f32, scale: [f32; 3]) {
        self.logits[i] = logit(opacity);
        self.log_scales[i] = scale.map(f32::ln);
        self.gaussians.opacities[i] = sigmoid(self.logits[i]);
        self.gaussians.scales[i] = self.log_scales[i].map(f32::exp);
    }

    /// Keeps some rows, in their order.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        let width = self.sh_stride();
        let g = &mut self.gaussians;
        retain_rows(&mut g.means, keep, 1);
        retain_rows(&mut g.quats, keep, 1);
        retain_rows(&mut g.scales, keep, 1);
        retain_rows(&mut g.opacities, keep, 1);
        retain_rows(&mut g.sh, keep, width);
        retain_rows(&mut self.log_scales, keep, 1);
        retain_rows(&mut self.logits, keep, 1);
    }

    /// Whether every stored value of a row is finite.
    pub(crate) fn is_finite(&self, i: usize) -> bool {
        let (row, width) = (self.row(i), self.sh_stride());
        let all = |v: &[f32]| v.iter().all(|v| v.is_finite());
        all(&row.mean)
            && all(&row.log_scale)
            && all(&row.quat)
            && row.logit.is_finite()
            && all(&self.gaussians.sh[i * width..(i + 1) * width])
    }

    /// Computes the activated values anew.
    pub(crate) fn activate(&mut self) {
        let g = &mut self.gaussians;
        g.scales = self.log_scales.iter().map(|s| s.map(f32::exp)).collect();
        g.opacities = self.logits.iter().map(|l| sigmoid(*l)).collect();
    }

    /// As a scene: quaternions of norm 1 with `w ≥ 0`.
    pub fn to_scene(&self) -> GaussianScene {
        let g = &self.gaussians;
        let width = self.sh_stride();
        let quat = |q: &[f32; 4]| {
            let norm = q.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            // Without a direction it is not drawn either.
            let factor = if norm > 0.0 { 1.0 / norm } else { 1.0 };
            let factor = if q[0] < 0.0 { -factor } else { factor };
            q.map(|v| (f64::from(v) * factor) as f32)
        };
        GaussianScene {
            coord: g.means.clone(),
            log_scale: self.log_scales.clone(),
            quat: g.quats.iter().map(quat).collect(),
            opacity_logit: self.logits.clone(),
            sh_dc: g.sh.chunks_exact(width).map(|r| [r[0], r[1], r[2]]).collect(),
            sh_rest: g.sh.chunks_exact(width).flat_map(|r| r[3..].iter().copied()).collect(),
            sh_degree: g.sh_degree,
            ..GaussianScene::default()
        }
    }
}

/// Keeps some rows of `width` values.
pub(crate) fn retain_rows<T: Copy>(values: &mut Vec<T>, keep: &[bool], width: usize) {
    let mut to = 0;
    for (i, keep) in keep.iter().enumerate() {
        if *keep {
            values.copy_within(i * width..(i + 1) * width, to * width);
            to += 1;
        }
    }
    values.truncate(to * width);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Model {
        let row = |k: f32| Stored {
            mean: [k, 0.0, 0.0],
            log_scale: [-k, -1.0, -2.0],
            quat: [1.0, 0.0, 0.0, k],
            logit: k,
        };
        let sh = (0..24).map(|v| v as f32).collect();
        Model::from_arrays(&[row(0.0), row(1.0)], sh, 1).unwrap()
    }

    #[test]
    fn a_copied_row_is_the_same_in_all_its_values() {
        let mut model = two();
        model.copy_row(1, 0);
        assert_eq!(model.row(0), model.row(1));
        assert_eq!(model.gaussians.sh[..12], model.gaussians.sh[12..]);
        // What is stored says the same as what is drawn.
        let drawn = model.clone();
        model.activate();
        assert_eq!(model, drawn);
        model.push_copy(1);
        assert_eq!((model.len(), model.row(2)), (3, model.row(1)));
        assert_eq!(model.gaussians.sh[24..], model.gaussians.sh[12..24]);
    }

    #[test]
    fn one_value_that_is_not_finite_is_seen_wherever_it_is() {
        let place = |set: &dyn Fn(&mut Model)| {
            let mut model = two();
            set(&mut model);
            (model.is_finite(0), model.is_finite(1))
        };
        assert_eq!(place(&|_| ()), (true, true));
        assert_eq!(place(&|m| m.gaussians.means[1][2] = f32::NAN), (true, false));
        assert_eq!(place(&|m| m.log_scales[0][1] = f32::INFINITY), (false, true));
        assert_eq!(place(&|m| m.gaussians.quats[1][3] = f32::NAN), (true, false));
        assert_eq!(place(&|m| m.logits[0] = f32::NEG_INFINITY), (false, true));
        // The first and the last value of the harmonics.
        assert_eq!(place(&|m| m.gaussians.sh[12] = f32::NAN), (true, false));
        assert_eq!(place(&|m| m.gaussians.sh[11] = f32::NAN), (false, true));
    }

    #[test]
    fn harmonics_of_a_scene_are_cut_or_filled() {
        let scene = GaussianScene {
            coord: vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
            log_scale: vec![[-1.0, -2.0, 0.5], [0.0, 1.0, -3.0]],
            quat: vec![[0.6, 0.0, -0.8, 0.0], [1.0, 0.0, 0.0, 0.0]],
            opacity_logit: vec![1.5, -0.5],
            sh_dc: vec![[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]],
            sh_rest: (1..=18).map(|v| v as f32).collect(),
            sh_degree: 1,
            ..GaussianScene::default()
        };
        for (degree, width, kept) in [(0u8, 3, 3), (1, 12, 12), (2, 27, 12)] {
            let model = Model::from_scene(&scene, degree).unwrap();
            assert_eq!(
                (model.gaussians.sh_degree, model.sh_stride(), model.len()),
                (degree, width, 2)
            );
            for i in 0..2 {
                let mut want = scene.sh_dc[i].to_vec();
                want.extend(&scene.sh_rest[9 * i..9 * (i + 1)]);
                want.truncate(kept);
                want.resize(width, 0.0);
                assert_eq!(model.gaussians.sh[width * i..width * (i + 1)], want, "{degree} {i}");
                let row = model.row(i);
                assert_eq!((row.mean, row.quat), (scene.coord[i], scene.quat[i]));
                assert_eq!(
                    (row.log_scale, row.logit),
                    (scene.log_scale[i], scene.opacity_logit[i])
                );
                let opacity = 1.0 / (1.0 + (-f64::from(row.logit)).exp());
                assert!((f64::from(model.gaussians.opacities[i]) - opacity).abs() < 1e-7);
                assert_eq!(model.gaussians.scales[i], row.log_scale.map(f32::exp));
            }
        }
        assert_eq!(Model::from_scene(&scene, 1).unwrap().to_scene(), scene);
        let cut = GaussianScene { opacity_logit: vec![1.5], ..scene };
        assert!(Model::from_scene(&cut, 1).is_err());
        assert!(Model::from_arrays(&[], vec![0.0], 0).is_err() && Model::new(3).is_empty());
        assert_eq!(Model::new(3).sh_stride(), 48);
    }

    #[test]
    fn a_scene_has_quaternions_of_length_one_with_w_at_least_0() {
        let mut model = two();
        model.gaussians.quats = vec![[-1.2, 0.0, 1.6, 0.0], [0.0, 0.0, 0.0, 0.0]];
        let scene = model.to_scene();
        for (got, want) in scene.quat[0].into_iter().zip([0.6, 0.0, -0.8, 0.0]) {
            assert!((got - want).abs() < 1e-6, "{:?}", scene.quat);
        }
        assert_eq!(scene.quat[1], [0.0; 4]);
        assert_eq!((scene.sh_dc[1], scene.sh_degree), ([12.0, 13.0, 14.0], 1));
        assert_eq!(scene.sh_rest[9..], (15..24).map(|v| v as f32).collect::<Vec<_>>());
    }

    #[test]
    fn a_shape_is_set_in_both_forms_and_rows_are_kept_in_order() {
        let mut model = two();
        model.push(&Stored { mean: [7.0; 3], ..two().row(1) }, &[9.0; 12]);
        model.set_shape(1, 0.9, [0.5, 2.0, 3.0]);
        // logit(0.9) = ln 9.
        assert!(
            (model.logits[1] - 9f32.ln()).abs() < 1e-6
                && (model.gaussians.opacities[1] - 0.9).abs() < 1e-6
        );
        for (k, scale) in [0.5f32, 2.0, 3.0].into_iter().enumerate() {
            assert_eq!(model.log_scales[1][k], scale.ln());
            assert!((model.gaussians.scales[1][k] - scale).abs() < 1e-6);
        }
        let rows = [model.row(1), model.row(2)];
        model.retain(&[false, true, true]);
        assert_eq!((model.len(), [model.row(0), model.row(1)]), (2, rows));
        let sh: Vec<f32> = (12..24).map(|v| v as f32).chain([9.0; 12]).collect();
        assert_eq!(model.gaussians.sh, sh);
        let drawn = model.clone();
        model.activate();
        assert_eq!(model, drawn);
        model.gaussians.check().unwrap();
    }
}
