//! Changes of a sample on its way to the network: augmentation, sampling, cropping.
//!
//! Every step is a plain struct whose `Default` holds the parameters of the original's language
//! pipeline, and a variant of [`TransformConfig`]; [`language_pretraining`],
//! [`semantic_segmentation`] and [`validation`] are its pipelines, and [`self_supervised`] and its
//! relatives those that end in several [`Views`] of a scene.
//!
//! A step moves a Gaussian as a whole: position, orientation, size and normal go together, and
//! labeled points go along. Where the original forgets one of them, a field `exact` does what it
//! does; without it
//! - quaternions keep `w ≥ 0`, as in the data files ([`RandomRotate`], [`RandomFlip`]: the original
//!   leaves or makes other signs);
//! - [`ElasticDistortion`] stretches and turns Gaussians and normals by the local gradient of the
//!   distortion (the original moves centers only);
//! - [`GridSample`] draws evenly among the Gaussians of a cell, whatever the fullest cell holds.
//!
//! Positions are kept in f32; the original goes on in f64 after the first rotation, so a Gaussian
//! that lies on the border of a cell within rounding may be sampled into the other one.
//!
//! Colors become −1..1 where a batch is made ([`InputFeatures`](crate::InputFeatures)), so there is
//! no step for that, nor for choosing what is collected.

mod capture_effects;
mod center_shift;
mod chromatic;
mod color_jitter;
mod config;
mod elastic;
mod grid_sample;
mod limit_labels;
mod limit_values;
mod measured_effects;
mod presets;
pub(crate) mod quaternion;
mod random_dropout;
mod random_flip;
mod random_jitter;
mod random_rotate;
mod random_scale;
mod ratio_crop;
mod sphere_crop;
mod view_presets;
mod views;
mod voxel_blur;

pub use capture_effects::CaptureEffects;
pub use center_shift::CenterShift;
pub use chromatic::{ChromaticAutoContrast, ChromaticJitter, ChromaticTranslation};
pub use color_jitter::{ColorJitter, ColorSolarize, RandomGrayscale};
pub use config::{TransformConfig, build_transforms};
pub use elastic::ElasticDistortion;
pub use grid_sample::{GridSample, Keep};
pub use limit_labels::{KeptLabels, LimitLabels};
pub use limit_values::LimitValues;
pub use measured_effects::MeasuredEffects;
pub use presets::{language_pretraining, semantic_segmentation, validation};
pub use random_dropout::RandomDropout;
pub use random_flip::RandomFlip;
pub use random_jitter::RandomJitter;
pub use random_rotate::{Axis, RandomRotate, RandomRotateTargetAngle, RotationCenter};
pub use random_scale::RandomScale;
pub use ratio_crop::RatioCrop;
pub use sphere_crop::{CropCenter, SphereCrop};
pub use view_presets::{
    self_distillation, self_supervised, self_supervised_joint, self_supervised_joint_scannetpp,
    self_supervised_supplement,
};
pub use views::{CropOrigin, ViewCrop, ViewGroup, Views};
pub use voxel_blur::VoxelBlur;

#[cfg(test)]
pub(crate) mod testing {
    //! Samples for the tests of the steps.

    use crate::{Sample, Transform, sample_rng};
    use scenesplat_rooms::{SyntheticRoomSettings, generate};
    use scenesplat_scene::LabelledPoints;

    /// Part of a generated room, with labeled points.
    pub fn room(rows: usize) -> Sample {
        let settings = SyntheticRoomSettings::with_count(rows.max(1000), 3);
        let mut sample = Sample::from_scene("room", generate(&settings).unwrap().scene);
        sample.select_rows(&(0..rows as u32).collect::<Vec<_>>());
        let coord: Vec<[f32; 3]> = sample.coord.iter().step_by(7).copied().collect();
        let segment = Some((0..coord.len() as i32).map(|i| i % 3 - 1).collect());
        sample.labelled_points = Some(LabelledPoints { coord, segment, instance: None });
        sample
    }

    /// Gaussians at the given places.
    pub fn at(coord: &[[f32; 3]]) -> Sample {
        let n = coord.len();
        Sample {
            id: "points".to_owned(),
            coord: coord.to_vec(),
            color: vec![[10.0, 20.0, 30.0]; n],
            opacity: vec![0.5; n],
            scale: vec![[0.1, 0.2, 0.3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            normal: Some(vec![[0.0, 0.0, 1.0]; n]),
            ..Sample::default()
        }
    }

    /// The sample after the step, with the random numbers of a seed.
    pub fn applied(step: &dyn Transform, sample: &Sample, seed: u64) -> Sample {
        let mut sample = sample.clone();
        step.apply(&mut sample, &mut sample_rng(seed, 0, 0)).unwrap();
        sample.check().unwrap();
        sample
    }

    /// What is made with pools of so many threads, which is the same in all.
    pub fn on_threads<T: PartialEq + Send>(
        counts: impl IntoIterator<Item = usize>,
        make: impl Fn() -> T + Sync,
    ) -> T {
        let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        let mut made = counts.into_iter().map(|n| pool(n).install(&make));
        let first = made.next().unwrap();
        assert!(made.all(|other| other == first));
        first
    }

    /// Covariance of a Gaussian, in f64.
    pub fn covariance(quat: [f32; 4], scale: [f32; 3]) -> [[f64; 3]; 3] {
        let r = super::quaternion::matrix(quat.map(f64::from));
        let s = scale.map(f64::from);
        std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..3).map(|k| r[i][k] * s[k] * s[k] * r[j][k]).sum())
        })
    }

    /// The largest difference of two matrices.
    pub fn difference(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> f64 {
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// `m · a · mᵀ`
    pub fn congruent(m: [[f64; 3]; 3], a: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let terms = (0..9).map(|kl| m[i][kl / 3] * a[kl / 3][kl % 3] * m[j][kl % 3]);
                terms.sum()
            })
        })
    }
}
