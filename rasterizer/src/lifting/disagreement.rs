//! How far the labels of different pictures contradict each other.

use super::finalise::of_each_view;
use super::spool::BlockWeights;
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
        let step = step.max(1);
        let mut sum = vec![0.0; self.mean.len()];
        let mut named: Vec<Label> = Vec::new();
        for i in 0..block.len() {
            if !(block.first + i).is_multiple_of(step) {
                continue;
            }
            named.clear();
            for view in of_each_view(block.of(i), tables) {
                let mut heaviest = view[0];
                for weight in view {
                    if weight.weight > heaviest.weight {
                        heaviest = *weight;
                    }
                }
                // Pictures that hardly saw it count less, near ones do not drown the others.
                named.push((heaviest.segment, heaviest.weight.sqrt()));
            }
            let total: f64 = named.iter().map(|&(_, w)| f64::from(w)).sum();
            let squares: f64 = named.iter().map(|&(_, w)| f64::from(w) * f64::from(w)).sum();
            // Of one picture nothing can be learnt.
            let freedom = 1.0 - squares / (total * total);
            if named.len() < 2 || !(freedom > 0.0) {
                continue;
            }
            weighted_sum(tables, &named, &mut sum);
            let length: f64 = sum.iter().map(|v| (v / total) * (v / total)).sum();
            self.within += (1.0 - length).max(0.0) / freedom;
            self.mean.iter_mut().zip(&sum).for_each(|(m, v)| *m += v / total);
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
