//! Labels of scenes in one mode, and what they are worth.

use super::super::SeverityError;
use super::super::measure::{Bench, VOTE_K};
use super::LABELS;
use super::report::Figures;
use crate::compensation::{Compensation, plan_of};
use crate::pareto::quality::sureness;
use crate::{Alignment, SceneEncoder};
use scenesplat::labels::{Classes, label_with_vote};
use scenesplat_datasets::effects::plan::EffectChoices;
use scenesplat_metrics::{ConfidenceBins, ConfusionMatrix, Metric, ZeroShotOptions};
use scenesplat_scene::GaussianScene;
use std::time::Instant;

/// What some scenes came out as; Gaussians with a true label alone.
#[derive(Debug, Clone, Default)]
pub(super) struct Score {
    labels: Vec<i32>,
    truth: Vec<i32>,
    confidence: Vec<f32>,
    seconds: f64,
    left_out: usize,
    withheld: usize,
}

impl Score {
    /// Labels a scene as `segment` does, with these choices about effects; choosing is a part of the time.
    pub(super) fn of(
        bench: &Bench,
        scene: &GaussianScene,
        choices: impl FnOnce(&GaussianScene) -> EffectChoices,
    ) -> Result<Self, SeverityError> {
        let began = Instant::now();
        let mut plan = plan_of(scene, 1.0, LABELS, &choices(scene))?;
        let about = Compensation::of(&mut plan, scene);
        let encoder = SceneEncoder::new(&bench.network);
        let alignment = Alignment::of(scene, &encoder.alignment);
        let kept = about.kept(scene.len());
        let features = encoder.encode_kept(scene, alignment, &kept, &mut |_| Ok(()))?;
        let (classes, options) = (Classes::Texts(&bench.texts), ZeroShotOptions::default());
        let mut found = label_with_vote(&features, classes, &options, &scene.coord, VOTE_K)?;
        found.withhold(about.withheld());
        let seconds = began.elapsed().as_secs_f64();
        let confidence = sureness(&features, &bench.texts, &found.labels)?.of_label;
        let truth = scene.segment.clone().unwrap_or_default();
        let (left_out, withheld) = (about.num_left_out(), about.num_withheld());
        let mut score = Self { seconds, left_out, withheld, ..Self::default() };
        for ((label, confidence), truth) in found.labels.iter().zip(confidence).zip(truth) {
            if truth >= 0 {
                score.labels.push(*label);
                score.confidence.push(confidence);
                score.truth.push(truth);
            }
        }
        Ok(score)
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.labels.extend(&other.labels);
        self.truth.extend(&other.truth);
        self.confidence.extend(&other.confidence);
        self.seconds += other.seconds;
        self.left_out += other.left_out;
        self.withheld += other.withheld;
    }

    /// The figures of all scenes together.
    pub(super) fn figures(&self, mode: &str, bench: &Bench) -> Result<Figures, SeverityError> {
        let mut matrix = ConfusionMatrix::new(bench.texts.len())?.with_excluded(&bench.excluded)?;
        matrix.update((&self.labels, &self.truth))?;
        let (mut calibration, mut unknown, mut right) = (ConfidenceBins::default(), 0usize, 0usize);
        for ((label, truth), confidence) in
            self.labels.iter().zip(&self.truth).zip(&self.confidence)
        {
            if *label < 0 {
                unknown += 1;
                continue;
            }
            right += usize::from(label == truth);
            calibration.add(f64::from(*confidence), label == truth);
        }
        let all = self.labels.len();
        Ok(Figures {
            mode: mode.to_owned(),
            f_miou: matrix.tester_report().foreground_mean_iou.unwrap_or_default(),
            ece: calibration.error().unwrap_or_default(),
            unknown: unknown as f64 / all.max(1) as f64,
            right: right as f64 / (all - unknown).max(1) as f64,
            seconds: self.seconds,
            left_out: self.left_out,
            withheld: self.withheld,
        })
    }
}
