//! How far the labels of different pictures contradict each other.

use super::finalise::of_each_view;
use super::spool::{BlockWeights, SegmentWeight};
use super::tables::SegmentTables;
use super::vector::{Label, weighted_sum};

/// Collects how far pictures disagree about the same Gaussians.
///
/// Each picture that saw a Gaussian names its heaviest segment there. The disagreement is the variance
/// of the named features within a Gaussian, averaged over Gaussians, divided by the variance over
/// all of them: 0 if all pictures agree, 1 if they might as well name anything. It does not depend on
/// how alike features of different objects are in general, which differs between networks.
#[derive(Debug, Clone)]
pub struct Disagreement {
    /// Sum of the variances within Gaussians.
    within: f64,
    /// Sum of the Gaussians' means. `[D]`
    mean: Vec<f64>,
    /// That of each Gaussian.
    variances: Vec<f32>,
}

/// A Gaussian's labels contradict each other from this part of the variance of all labels on.
const CONFLICT: f64 = 0.2;
/// Disagreement of true segments, and what each twentieth of wrong ones adds: see [`Robust`](super::Robust).
const SEVERITY: [f64; 2] = [0.08, 0.07];

impl Disagreement {
    /// Nothing seen yet.
    pub fn new(dim: usize) -> Self {
        Self { within: 0.0, mean: vec![0.0; dim], variances: Vec::new() }
    }

    /// Looks at every `step`-th Gaussian of a block, counted from the scene's first.
    pub fn add_block(&mut self, block: &BlockWeights, tables: &SegmentTables, step: usize) {
        let mut named: Vec<Label> = Vec::new();
        let mut consensus = Consensus::new(self.mean.len());
        for i in sampled(block, step) {
            named.clear();
            named.extend(of_each_view(block.of(i), tables).map(name_of));
            if !consensus.find(&named, tables) {
                continue;
            }
            self.within += consensus.variance;
            self.mean.iter_mut().zip(&consensus.mean).for_each(|(m, v)| *m += v);
            self.variances.push(consensus.variance as f32);
        }
    }

    /// Gaussians of the sample that two pictures or more saw.
    pub fn gaussians(&self) -> u64 {
        self.variances.len() as u64
    }

    /// The variance of the labels of all Gaussians together, `0..=1`; `None` if no Gaussian was seen by two
    /// pictures, or all segments have one feature.
    pub fn overall(&self) -> Option<f64> {
        let count = self.variances.len() as f64;
        let overall = 1.0 - self.mean.iter().map(|m| (m / count) * (m / count)).sum::<f64>();
        // Not so for NaN, which comes of no Gaussian.
        (overall > 1e-6).then_some(overall)
    }

    /// The disagreement, about `0..=1`; `None` where [`overall`](Self::overall) is.
    pub fn value(&self) -> Option<f64> {
        self.overall().map(|overall| self.within / self.variances.len() as f64 / overall)
    }

    /// The variance of a Gaussian's labels above which they contradict each other.
    pub fn conflict(&self) -> Option<f64> {
        self.overall().map(|overall| CONFLICT * overall)
    }

    /// Share of the Gaussians whose labels contradict each other, `0..=1`.
    pub fn conflicting(&self) -> Option<f64> {
        let limit = self.conflict()?;
        let count = self.variances.iter().filter(|v| f64::from(**v) > limit).count();
        Some(count as f64 / self.variances.len() as f64)
    }

    /// How strong it is, 0 to 5: a twentieth of the segments under wrong names for each step.
    pub fn severity(&self) -> f64 {
        let [none, step] = SEVERITY;
        self.value().map_or(0.0, |value| ((value - none) / step).clamp(0.0, 5.0))
    }
}

/// Every `step`-th Gaussian of the scene that is in the block.
pub(super) fn sampled(block: &BlockWeights, step: usize) -> impl Iterator<Item = usize> + use<> {
    let step = step.max(1);
    let first = block.first.next_multiple_of(step) - block.first;
    (first..block.len()).step_by(step)
}

/// The heaviest segment of a picture's weights of a Gaussian. Pictures that hardly saw it count less,
/// near ones do not drown the others.
pub(super) fn name_of(view: &[SegmentWeight]) -> Label {
    let mut heaviest = view[0];
    for weight in view {
        if weight.weight > heaviest.weight {
            heaviest = *weight;
        }
    }
    (heaviest.segment, heaviest.weight.sqrt())
}

/// What pictures agree on about one Gaussian.
pub(super) struct Consensus {
    /// Weighted mean of the labels. `[D]`
    pub(super) mean: Vec<f64>,
    /// Square of its length.
    pub(super) length: f64,
    /// Variance of one label, without bias.
    pub(super) variance: f64,
    /// Variance of the mean, in variances of a label.
    pub(super) of_mean: f64,
}

impl Consensus {
    pub(super) fn new(dim: usize) -> Self {
        Self { mean: vec![0.0; dim], length: 0.0, variance: 0.0, of_mean: 0.0 }
    }

    /// Finds it; of fewer than two labels nothing can be learnt.
    pub(super) fn find(&mut self, named: &[Label], tables: &SegmentTables) -> bool {
        let total: f64 = named.iter().map(|&(_, w)| f64::from(w)).sum();
        let squares: f64 = named.iter().map(|&(_, w)| f64::from(w) * f64::from(w)).sum();
        self.of_mean = squares / (total * total);
        let freedom = 1.0 - self.of_mean;
        if named.len() < 2 || !(freedom > 0.0) {
            return false;
        }
        weighted_sum(tables, named, &mut self.mean);
        self.mean.iter_mut().for_each(|v| *v /= total);
        self.length = self.mean.iter().map(|v| v * v).sum();
        self.variance = (1.0 - self.length).max(0.0) / freedom;
        true
    }
}
