//! The pipelines of the original's configurations.

use super::{
    Axis, CenterShift, ChromaticAutoContrast, ChromaticJitter, ChromaticTranslation,
    ElasticDistortion, GridSample, Keep, RandomDropout, RandomFlip, RandomJitter, RandomRotate,
    RandomScale, RotationCenter, SphereCrop, TransformConfig,
};

/// Training of the language networks, with cells of `grid_size` meters (0.02 there; 0.005 for
/// HoliCity).
///
/// # Source
/// The `train` transforms of `configs/*/lang-pretrain-*.py`, SceneSplat be9d5e1.
pub fn language_pretraining(grid_size: f64) -> Vec<TransformConfig> {
    training(grid_size, 0.01, 192_000)
}

/// Training of semantic segmentation: as [`language_pretraining`], with a wider jitter and crop.
///
/// # Source
/// The `train` transforms of `configs/*/semseg-*.py`, SceneSplat be9d5e1.
pub fn semantic_segmentation(grid_size: f64) -> Vec<TransformConfig> {
    training(grid_size, 0.02, 204_800)
}

/// Evaluation during training: no randomness; of every cell the Gaussian nearest to its middle, as
/// [`FastPlan`](crate::FastPlan) reads a scene. Labeled points are thinned by the same cells.
///
/// # Source
/// The `val` transforms of the same files. Differs: they keep a random Gaussian of a cell; here the
/// whole scene is kept beside the sample, to be scored as the original's tester scores it.
pub fn validation(grid_size: f64) -> Vec<TransformConfig> {
    vec![
        CenterShift { apply_z: true }.into(),
        GridSample { grid_size, keep: Keep::Nearest, keep_full: true, ..GridSample::default() }
            .into(),
        CenterShift { apply_z: false }.into(),
    ]
}

fn training(grid_size: f64, jitter_clip: f64, point_max: usize) -> Vec<TransformConfig> {
    let mut steps = vec![CenterShift { apply_z: true }.into(), RandomDropout::default().into()];
    steps.extend(moves(jitter_clip));
    steps.push(ElasticDistortion::default().into());
    steps.extend(colors());
    steps.push(GridSample { grid_size, ..GridSample::default() }.into());
    steps.push(SphereCrop { point_max, ..SphereCrop::default() }.into());
    steps.push(CenterShift { apply_z: false }.into());
    steps
}

/// A turn, two tilts, a size, a mirror and a jitter.
pub(super) fn moves(jitter_clip: f64) -> [TransformConfig; 6] {
    let tilt = |axis| RandomRotate {
        angle: [-1.0 / 64.0, 1.0 / 64.0],
        axis,
        center: RotationCenter::BoundingBox,
        ..RandomRotate::default()
    };
    [
        RandomRotate::default().into(),
        tilt(Axis::X).into(),
        tilt(Axis::Y).into(),
        RandomScale::default().into(),
        RandomFlip::default().into(),
        RandomJitter { sigma: 0.005, clip: jitter_clip }.into(),
    ]
}

/// Contrast, shift and jitter of colors.
pub(super) fn colors() -> [TransformConfig; 3] {
    [
        ChromaticAutoContrast::default().into(),
        ChromaticTranslation::default().into(),
        ChromaticJitter::default().into(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::build_transforms;
    use crate::transforms::testing::{at, room};
    use crate::{InputFeatures, Sample, sample_rng};

    fn run(steps: &[TransformConfig], sample: &Sample, seed: u64) -> Sample {
        let mut sample = sample.clone();
        let mut rng = sample_rng(seed, 0, 0);
        for step in build_transforms(steps).unwrap() {
            step.apply(&mut sample, &mut rng).unwrap();
            sample.check().unwrap();
        }
        sample
    }

    #[test]
    fn whole_pipelines_give_what_a_network_can_read() {
        let scene = room(6_000);
        for steps in [language_pretraining(0.02), semantic_segmentation(0.02), validation(0.02)] {
            for seed in 0..4 {
                let sample = run(&steps, &scene, seed);
                assert!(!sample.is_empty() && sample.len() <= 6_000);
                let feat = InputFeatures::default().sample_rows(&sample).unwrap();
                assert!(feat.iter().all(|v| v.is_finite()));
                assert_eq!(sample, run(&steps, &scene, seed));
                assert!(sample.quat.iter().all(|q| q[0] >= 0.0));
                let [low, high] = sample.bounds().unwrap();
                assert!((low[0] + high[0]).abs() < 1e-4 && (low[1] + high[1]).abs() < 1e-4);
            }
        }
        assert_ne!(
            run(&language_pretraining(0.02), &scene, 0),
            run(&language_pretraining(0.02), &scene, 1)
        );
        assert_eq!(run(&validation(0.02), &scene, 0), run(&validation(0.02), &scene, 1));
    }

    #[test]
    fn pipelines_take_the_smallest_scenes() {
        for rows in 0..3 {
            let mut sample = at(&vec![[0.3; 3]; rows]);
            if let Some(quat) = sample.quat.first_mut() {
                *quat = [0.0; 4];
            }
            for steps in [language_pretraining(0.02), validation(0.02)] {
                for seed in 0..10 {
                    let out = run(&steps, &sample, seed);
                    assert!(out.len() <= rows && (rows == 0 || !out.is_empty()));
                    InputFeatures::default().sample_rows(&out).unwrap();
                }
            }
        }
    }
}
