//! [`CaptureEffects`]

use crate::effects::{EffectRanges, EffectSet, simulate_upright};
use crate::error::{check_probability, require};
use crate::rng::happens;
use crate::{DataError, Sample, SampleRng, Transform};
use half::f16;
use rand_chacha::rand_core::RngCore;
use scenesplat_scene::gaussian_scene::{SH_C0, probability_to_logit};
use scenesplat_scene::{GaussianScene, LanguageFeatures, Up};
use serde::{Deserialize, Serialize};

/// With `probability`, does to the scene what a bad capture would have done: holes, floaters, rough
/// surfaces, blur, glass, drifting light, noise, see [`effects`](crate::effects). It belongs before
/// [`GridSample`](super::GridSample), which puts Gaussians where they then are.
///
/// Labels, instances, features and a teacher's rows follow the Gaussians; added ones have none (−1, no
/// valid feature), and those of a pane of glass lose theirs. +z is up. Labeled points, which are no Gaussians, stay. What no effect touches keeps its bits.
///
/// # Source
/// Our own; the causes of failure are those of the supplement of SceneSplat (ICCV 2025).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureEffects {
    /// Which, and how severe, 0 to 5: `holes=2,floaters=0.5..3`; a range is drawn from evenly.
    pub effects: EffectRanges,
    /// How often it happens.
    #[serde(default = "always")]
    pub probability: f64,
}

pub(super) fn always() -> f64 {
    1.0
}

impl Transform for CaptureEffects {
    fn check(&self) -> Result<(), DataError> {
        check_probability("capture_effects.probability", self.probability)?;
        let expected = "effects with a severity above 0, such as holes=2,floaters=0.5..3";
        require(!self.effects.is_empty(), "capture_effects.effects", self.effects, expected)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        check_place(sample, "capture_effects")?;
        if !happens(rng, self.probability) || sample.is_empty() {
            return Ok(());
        }
        let effects = self.effects.draw(rng);
        damage(sample, &effects, rng.next_u64())
    }
}

/// Refuses a sample whose Gaussians are in cells already.
pub(super) fn check_place(sample: &Sample, step: &'static str) -> Result<(), DataError> {
    if sample.grid_coord.is_empty() {
        return Ok(());
    }
    let (missing, help) = ("Gaussians without cells", "put it before grid_sample");
    Err(DataError::Missing { step, missing, help })
}

/// Does to a sample what the effects do; +z is up.
pub(super) fn damage(sample: &mut Sample, effects: &EffectSet, seed: u64) -> Result<(), DataError> {
    let before = as_scene(sample);
    let after = simulate_upright(&before, effects, seed, Some(Up::PLUS_Z))?;
    // Added Gaussians begin as any row; everything of it is replaced.
    let rows: Vec<u32> = after.source.iter().map(|row| row.unwrap_or(0) as u32).collect();
    sample.select_rows(&rows);
    for (row, source) in after.source.iter().enumerate() {
        take_over(sample, row, &after.scene, source.map(|source| (&before, source)));
        if let (None, Some(origin)) = (source, &mut sample.origin_row) {
            origin[row] = Sample::ADDED;
        }
    }
    Ok(())
}

/// What the effects see. The mask says here whose labels and features stay.
fn as_scene(sample: &Sample) -> GaussianScene {
    GaussianScene {
        coord: sample.coord.clone(),
        log_scale: sample.scale.iter().map(|s| s.map(f32::ln)).collect(),
        quat: sample.quat.clone(),
        opacity_logit: sample.opacity.iter().map(|&p| probability_to_logit(p)).collect(),
        sh_dc: sample.color.iter().map(|c| c.map(|v| (v / 255.0 - 0.5) / SH_C0)).collect(),
        normal: sample.normal.clone(),
        valid_feat_mask: Some(vec![true; sample.len()]),
        ..GaussianScene::default()
    }
}

/// Gives a row the values of the scene that differ from those before; all, if it was not there before.
fn take_over(
    sample: &mut Sample,
    row: usize,
    scene: &GaussianScene,
    before: Option<(&GaussianScene, usize)>,
) {
    let same = |is: fn(&GaussianScene, usize, &GaussianScene, usize) -> bool| {
        before.is_some_and(|(before, source)| is(before, source, scene, row))
    };
    sample.coord[row] = scene.coord[row];
    if !same(|a, i, b, j| a.log_scale[i] == b.log_scale[j]) {
        sample.scale[row] = scene.scale(row);
    }
    sample.quat[row] = scene.quat[row];
    if !same(|a, i, b, j| a.opacity_logit[i] == b.opacity_logit[j]) {
        sample.opacity[row] = scene.opacity(row);
    }
    if !same(|a, i, b, j| a.sh_dc[i].map(f32::to_bits) == b.sh_dc[j].map(f32::to_bits)) {
        sample.color[row] =
            scene.sh_dc[row].map(|dc| ((dc * SH_C0 + 0.5) * 255.0).clamp(0.0, 255.0));
    }
    if let (Some(normals), Some(new)) = (&mut sample.normal, &scene.normal) {
        normals[row] = new[row];
    }
    if scene.valid_feat_mask.as_ref().is_some_and(|stays| !stays[row]) {
        strip(sample, row);
    }
}

/// Takes its label and feature from a Gaussian.
fn strip(sample: &mut Sample, row: usize) {
    for values in [&mut sample.segment, &mut sample.instance].into_iter().flatten() {
        values[row] = -1;
    }
    // Without a mask, rows of zeros are those without a feature.
    if let Some(LanguageFeatures { values, dim }) = &mut sample.lang_feat {
        values[row * *dim..(row + 1) * *dim].fill(f16::ZERO);
    }
    if let Some(valid) = &mut sample.valid_feat {
        valid[row] = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_rng;
    use crate::transforms::testing::{applied, at, room};
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn step(effects: &str) -> CaptureEffects {
        CaptureEffects { effects: effects.parse().unwrap(), probability: 1.0 }
    }

    /// Everything that a row carries, told by its number.
    fn numbered() -> Sample {
        let mut sample = room(1200);
        let n = sample.len();
        sample.segment = Some((0..n as i32).collect());
        sample.instance = Some((0..n as i32).map(|i| i + 5000).collect());
        let values = (0..2 * n).map(|i| f16::from_f32((i / 2 + 1) as f32)).collect();
        sample.lang_feat = Some(LanguageFeatures { values, dim: 2 });
        sample.valid_feat = Some(vec![true; n]);
        sample.origin_row = Some((0..n as u32).collect());
        sample
    }

    /// By hand: the scene through the simulator, and then as a sample; with the seed and severities that
    /// the step's own numbers give.
    #[test]
    fn it_is_the_simulator_with_the_numbers_of_the_step() {
        let scene = generate(&SyntheticRoomSettings::with_count(1000, 4)).unwrap().scene;
        let sample = Sample::from_scene("room", scene.clone());
        let step = step("holes=2..4,floaters=5,surface=1,blur=1,glass=3,light=2,noise=3");
        let mut rng = sample_rng(11, 3, 7);
        let mut got = sample;
        step.apply(&mut got, &mut { rng.clone() }).unwrap();
        got.check().unwrap();
        assert!(happens(&mut rng, 1.0));
        let drawn = step.effects.draw(&mut rng);
        let up = Some(Up::PLUS_Z);
        let simulated = simulate_upright(&scene, &drawn, rng.next_u64(), up).unwrap();
        assert!(simulated.source.iter().any(Option::is_none) && simulated.scene.len() < 1000);
        let want = Sample::from_scene("room", simulated.scene);
        assert_eq!((&got.segment, &got.instance), (&want.segment, &want.instance));
        assert_eq!(got.len(), want.len());
        for row in 0..want.len() {
            // Colors went through bytes once before, and once behind.
            for k in 0..3 {
                assert!((got.color[row][k] - want.color[row][k]).abs() < 3.0, "row {row}");
                assert!((got.coord[row][k] - want.coord[row][k]).abs() < 1e-5, "row {row}");
                assert!((got.scale[row][k] / want.scale[row][k] - 1.0).abs() < 1e-4, "row {row}");
            }
            assert!((got.opacity[row] - want.opacity[row]).abs() < 1e-5, "row {row}");
            let dot: f32 = got.quat[row].iter().zip(&want.quat[row]).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 1e-5, "row {row}");
        }
    }

    #[test]
    fn whatever_a_gaussian_carries_follows_it() {
        let before = numbered();
        let after = applied(&step("holes=3,floaters=3"), &before, 2);
        let (segment, origin) = (after.segment.clone().unwrap(), after.origin_row.clone().unwrap());
        let features = after.lang_feat.clone().unwrap();
        let mut added = 0;
        for row in 0..after.len() {
            let feature = features.values[2 * row].to_f32();
            if segment[row] < 0 {
                added += 1;
                let valid = after.valid_feat.as_ref().unwrap()[row];
                assert_eq!(
                    (after.instance.as_ref().unwrap()[row], valid, feature),
                    (-1, false, 0.0)
                );
                assert_eq!(origin[row], Sample::ADDED);
                continue;
            }
            // Untouched by either effect: the same bits.
            let was = segment[row] as usize;
            assert_eq!(
                (after.coord[row], after.scale[row]),
                (before.coord[was], before.scale[was])
            );
            assert_eq!((after.color[row], after.quat[row]), (before.color[was], before.quat[was]));
            assert_eq!(after.opacity[row], before.opacity[was]);
            assert_eq!(after.instance.as_ref().unwrap()[row], was as i32 + 5000);
            assert_eq!((origin[row] as usize, feature), (was, (was + 1) as f32));
        }
        assert!(added > 5 && after.len() - added < before.len());
        assert_eq!(after.labelled_points, before.labelled_points);
    }

    #[test]
    fn it_depends_on_its_numbers_alone_and_happens_as_often_as_it_says() {
        let sample = numbered();
        let all = step("holes=0..3,floaters=2,surface=1,blur=1,light=1,noise=1");
        assert_eq!(applied(&all, &sample, 5), applied(&all, &sample, 5));
        assert_ne!(applied(&all, &sample, 5), applied(&all, &sample, 6));
        let never = CaptureEffects { probability: 0.0, ..all };
        assert_eq!(applied(&never, &sample, 5), sample);
        assert!(applied(&all, &at(&[]), 1).is_empty());
        assert!(!applied(&all, &at(&[[1.0; 3]]), 1).is_empty());
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        assert!(step("none").check().unwrap_err().to_string().contains("capture_effects.effects"));
        assert!(CaptureEffects { probability: 1.5, ..step("holes=1") }.check().is_err());
        let read = |text: &str| serde_json::from_str::<CaptureEffects>(text);
        let error = read(r#"{"effects": "hole=1"}"#).unwrap_err().to_string();
        assert!(error.contains("\"hole\" is no effect"), "{error}");
        assert!(read("{}").is_err() && read(r#"{"effects": "holes=1", "p": 1}"#).is_err());
        assert_eq!(read(r#"{"effects": "holes=1"}"#).unwrap(), step("holes=1"));
        let mut sampled = numbered();
        sampled.grid_coord = vec![[0; 3]; sampled.len()];
        let error = step("holes=1").apply(&mut sampled, &mut sample_rng(0, 0, 0)).unwrap_err();
        assert!(error.to_string().contains("before grid_sample"), "{error}");
    }
}
