//! Labels of a damaged room, and what they are worth.

use super::SeverityError;
use super::report::SeverityPoint;
use crate::pareto::quality::{Sureness, sureness};
use scenesplat::evaluation::background;
use scenesplat::labels::{Classes, label_with_vote};
use scenesplat::{Network, SceneEncoder, WeightOptions, Weights, embedded};
use scenesplat_datasets::Anchor;
use scenesplat_datasets::effects::Simulated;
use scenesplat_metrics::{ConfidenceBins, ConfusionMatrix, Metric, ZeroShotOptions};
use scenesplat_scene::{GaussianScene, LabelSet, TextTable};

/// Neighbors that vote, as in the paper.
const VOTE_K: usize = 25;
/// Share of the Gaussians of undamaged rooms that may count as unknown.
const UNKNOWN_UNDAMAGED: f64 = 0.05;
/// Side of a damaged corner, meters.
const CORNER: f32 = 1.0;
/// What is farther from the corner than this is far away, meters.
const FAR: f32 = 1.5;

/// Labels of a scene with the probability of each.
pub(super) struct Labelled {
    pub(super) labels: Vec<i32>,
    pub(super) sure: Sureness,
}

/// The network with its classes.
pub(super) struct Bench {
    network: Network,
    texts: TextTable,
    excluded: Vec<usize>,
    /// Probability of the likeliest class below which a Gaussian counts as unknown.
    pub(super) threshold: f32,
}

impl Bench {
    pub(super) fn new(weights: &Weights) -> Result<Self, SeverityError> {
        let network = Network::load(embedded::config()?, weights, WeightOptions::default())?;
        let texts = embedded::vocabulary()?.class_table();
        let excluded = background(&LabelSet::new(texts.names.clone())?);
        Ok(Self { network, texts, excluded, threshold: 0.0 })
    }

    /// Labels as `segment` gives them.
    pub(super) fn label(&self, scene: &GaussianScene) -> Result<Labelled, SeverityError> {
        self.label_by(&SceneEncoder::new(&self.network), scene)
    }

    /// As [`label`](Self::label), with voxels that are counted from the scene's origin.
    pub(super) fn label_anchored(&self, scene: &GaussianScene) -> Result<Labelled, SeverityError> {
        let encoder = SceneEncoder { anchor: Anchor::World, ..SceneEncoder::new(&self.network) };
        self.label_by(&encoder, scene)
    }

    fn label_by(
        &self,
        encoder: &SceneEncoder<'_>,
        scene: &GaussianScene,
    ) -> Result<Labelled, SeverityError> {
        let features = encoder.encode(scene, &mut |_| Ok(()))?;
        let (classes, options) = (Classes::Texts(&self.texts), ZeroShotOptions::default());
        let labels = label_with_vote(&features, classes, &options, &scene.coord, VOTE_K)?.labels;
        let sure = sureness(&features, &self.texts, &labels)?;
        Ok(Labelled { labels, sure })
    }

    /// What undamaged rooms leave unknown is the same share everywhere.
    pub(super) fn set_threshold(&mut self, undamaged: &[Labelled]) {
        let mut all: Vec<f32> = undamaged.iter().flat_map(|l| l.sure.highest.clone()).collect();
        if all.is_empty() {
            return;
        }
        let at = ((all.len() as f64 * UNKNOWN_UNDAMAGED) as usize).min(all.len() - 1);
        self.threshold = *all.select_nth_unstable_by(at, f32::total_cmp).1;
    }

    /// The figures of all rooms together. Added Gaussians have no label, and are not scored.
    pub(super) fn point<'a>(
        &self,
        severity: f64,
        rooms: impl Iterator<Item = (&'a GaussianScene, &'a Labelled)>,
    ) -> Result<SeverityPoint, SeverityError> {
        let mut matrix = ConfusionMatrix::new(self.texts.len())?.with_excluded(&self.excluded)?;
        let mut calibration = ConfidenceBins::default();
        let (mut sum, mut unknown, mut count) = (0.0, 0u32, 0u32);
        let mut others = [0.0; SeverityPoint::OTHERS.len()];
        for (scene, Labelled { labels, sure }) in rooms {
            let truth = scene.segment.clone().unwrap_or_default();
            matrix.update((labels, &truth))?;
            for (row, (label, truth)) in labels.iter().zip(&truth).enumerate() {
                if *truth < 0 {
                    continue;
                }
                let confidence = f64::from(sure.of_label[row]);
                calibration.add(confidence, label == truth);
                sum += confidence;
                unknown += u32::from(sure.highest[row] < self.threshold);
                count += 1;
                let other = [&sure.margin, &sure.order, &sure.tempered, &sure.agrees];
                others.iter_mut().zip(other).for_each(|(sum, v)| *sum += f64::from(v[row]));
            }
        }
        let scored = f64::from(count.max(1));
        Ok(SeverityPoint {
            severity,
            f_miou: matrix.tester_report().foreground_mean_iou.unwrap_or_default(),
            ece: calibration.error().unwrap_or_default(),
            confidence: sum / scored,
            unknown: f64::from(unknown) / scored,
            others: others.map(|sum| sum / scored),
            scored: count as usize,
        })
    }
}

/// A room that is damaged in one corner alone.
pub(super) struct Damaged {
    pub(super) scene: GaussianScene,
    /// Row in the undamaged room; `None` for what was added.
    source: Vec<Option<usize>>,
    edge: [f32; 2],
}

impl Damaged {
    /// Takes from a damaged room what lies in the corner at its largest x and y, and the rest from the
    /// undamaged one.
    pub(super) fn in_a_corner(
        room: &GaussianScene,
        simulated: &Simulated,
    ) -> Result<Self, SeverityError> {
        let edge = [0, 1].map(|axis| room.coord.iter().map(|p| p[axis]).fold(f32::MIN, f32::max));
        let inside = |p: &[f32; 3]| (0..2).all(|axis| p[axis] > edge[axis] - CORNER);
        let (mut source, mut taken) = (Vec::new(), Vec::new());
        let mut there = vec![None; room.len()];
        for (row, of) in simulated.source.iter().enumerate() {
            match of {
                Some(of) => there[*of] = Some(row),
                None if inside(&simulated.scene.coord[row]) => {
                    source.push(None);
                    taken.push(Some(row));
                }
                None => {}
            }
        }
        let added = source.len();
        for (row, p) in room.coord.iter().enumerate() {
            match (inside(p), there[row]) {
                (false, _) => (source.push(Some(row)), taken.push(None)),
                (true, Some(now)) => (source.push(Some(row)), taken.push(Some(now))),
                (true, None) => continue,
            };
        }
        // What was there first, then what was added.
        source.rotate_left(added);
        taken.rotate_left(added);
        let rows: Vec<usize> = source.iter().map(|row| row.unwrap_or(0)).collect();
        let mut scene = room.select_rows(&rows)?;
        let rest = scene.sh_rest_len() * 3;
        for (row, now) in taken.iter().enumerate() {
            let (Some(now), from) = (*now, &simulated.scene) else { continue };
            scene.coord[row] = from.coord[now];
            scene.log_scale[row] = from.log_scale[now];
            scene.quat[row] = from.quat[now];
            scene.opacity_logit[row] = from.opacity_logit[now];
            scene.sh_dc[row] = from.sh_dc[now];
            scene.sh_rest[row * rest..(row + 1) * rest]
                .copy_from_slice(&from.sh_rest[now * rest..(now + 1) * rest]);
            if let (Some(to), Some(from)) = (&mut scene.normal, &from.normal) {
                to[row] = from[now];
            }
            if let (Some(to), Some(from)) = (&mut scene.segment, &from.segment) {
                to[row] = from[now];
            }
        }
        Ok(Self { scene, source, edge })
    }

    /// Gaussians far from the corner, and how many of them have another label than before.
    pub(super) fn far_labels(
        &self,
        room: &GaussianScene,
        before: &[i32],
        after: &[i32],
    ) -> (u32, u32) {
        let (mut all, mut changed) = (0, 0);
        for (row, source) in self.source.iter().enumerate() {
            let Some(source) = *source else { continue };
            let p = room.coord[source];
            if (0..2).all(|axis| p[axis] > self.edge[axis] - CORNER - FAR) {
                continue;
            }
            all += 1;
            changed += u32::from(before[source] != after[row]);
        }
        (all, changed)
    }
}
