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
    gaussians: u64,
}

impl Disagreement {
    /// Nothing seen yet.
    pub fn new(dim: usize) -> Self {
        Self { within: 0.0, mean: vec![0.0; dim], gaussians: 0 }
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
            self.gaussians += 1;
        }
    }

    /// Gaussians that two pictures or more saw, of those looked at.
    pub fn gaussians(&self) -> u64 {
        self.gaussians
    }

    /// The disagreement, about `0..=1`; `None` if no Gaussian was seen by two pictures, or all
    /// segments have one feature.
    pub fn value(&self) -> Option<f64> {
        if self.gaussians == 0 {
            return None;
        }
        let count = self.gaussians as f64;
        let overall = 1.0 - self.mean.iter().map(|m| (m / count) * (m / count)).sum::<f64>();
        (overall > 1e-6).then(|| self.within / count / overall)
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
