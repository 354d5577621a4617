//! Several datasets in one training, each batch from one of them.

use crate::error::{bad_setting, check_length, require};
use crate::loader::SceneBatches;
use crate::{BatchLoader, DataError, LeftOut, SceneLoader, TrainBatch};
use serde::{Deserialize, Serialize};

/// In which order, and how often, datasets give a batch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MixRule {
    /// An epoch holds every batch of dataset `i` `weight[i]` times (an epoch of its own each time),
    /// and the batches of each dataset are spread evenly over it.
    #[default]
    Proportional,
    /// The original's: `weight[0]` batches of the first dataset, `weight[1]` of the second, …, again
    /// and again; the epoch ends when the first dataset is through. The others begin anew whenever
    /// they are through.
    ///
    /// An epoch has `len₀ / weight₀` such rounds (rounded down), and the `len₀ mod weight₀` batches
    /// of the first dataset that are left.
    MainFirst,
}

/// Batches of several loaders, one dataset a batch.
///
/// Whenever a dataset begins anew, in the same epoch or in a later one, it has an order and random
/// numbers of its own. Each loader keeps its own workers, as many as its settings say.
///
/// # Source
/// `MultiDatasetDataloader` in `pointcept/datasets/dataloader.py`, SceneSplat be9d5e1. Differs: there
/// a dataset that begins anew in one epoch has its old order again.
#[derive(Clone)]
pub struct WeightedMix {
    loaders: Vec<SceneLoader>,
    weights: Vec<usize>,
    rule: MixRule,
}

impl WeightedMix {
    /// Mixes loaders by weight; the first is the main one.
    ///
    /// # Errors
    /// If there is no loader, not one weight for each, or a weight of 0.
    pub fn new(
        loaders: Vec<SceneLoader>,
        weights: Vec<usize>,
        rule: MixRule,
    ) -> Result<Self, DataError> {
        require(!loaders.is_empty(), "datasets", 0, "one or more")?;
        check_length("weights", loaders.len(), weights.len())?;
        let named = format!("{weights:?}");
        let expected = "numbers of 1 or more; leave the dataset out";
        require(!weights.contains(&0), "weights", &named, expected)?;
        let batches = loaders.iter().zip(&weights).try_fold(0_usize, |sum, (loader, weight)| {
            sum.checked_add(loader.batches_per_epoch().checked_mul(*weight)?)
        });
        // A plan holds eight bytes a batch.
        let ok = batches.is_some_and(|n| n as u64 <= 1 << 32);
        require(ok, "weights", named, "fewer batches an epoch")?;
        Ok(Self { loaders, weights, rule })
    }

    /// The loaders, in order; for the scenes they left out.
    pub fn loaders(&self) -> &[SceneLoader] {
        &self.loaders
    }

    /// Which dataset gives each batch of an epoch.
    pub fn plan(&self) -> Vec<usize> {
        match self.rule {
            MixRule::Proportional => self.spread_evenly(),
            MixRule::MainFirst => {
                let main = self.loaders[0].batches_per_epoch();
                let round = self.weights.iter().enumerate();
                let round: Vec<usize> =
                    round.flat_map(|(dataset, &n)| std::iter::repeat_n(dataset, n)).collect();
                let mut plan = round.repeat(main / self.weights[0]);
                plan.extend(std::iter::repeat_n(0, main % self.weights[0]));
                plan
            }
        }
    }

    /// Batch `k` of the `n` of a dataset has its place at `(k + ½) / n` of the epoch.
    fn spread_evenly(&self) -> Vec<usize> {
        let mut places = Vec::new();
        for (dataset, (loader, weight)) in self.loaders.iter().zip(&self.weights).enumerate() {
            let n = (loader.batches_per_epoch() * weight) as u64;
            places.extend((0..n).map(|k| (2 * k + 1, n, dataset)));
        }
        // Fractions are compared by their cross product, exactly; the first dataset goes first.
        places.sort_by(|a, b| {
            let cross = |a: u64, n: u64| u128::from(a) * u128::from(n);
            cross(a.0, b.1).cmp(&cross(b.0, a.1)).then(a.2.cmp(&b.2))
        });
        places.into_iter().map(|(_, _, dataset)| dataset).collect()
    }
}

impl BatchLoader<TrainBatch> for WeightedMix {
    fn batches_per_epoch(&self) -> usize {
        let counts = self.loaders.iter().map(SceneLoader::batches_per_epoch);
        match self.rule {
            MixRule::Proportional => counts.zip(&self.weights).map(|(n, w)| n * w).sum(),
            MixRule::MainFirst => {
                let (main, weight) = (self.loaders[0].batches_per_epoch(), self.weights[0]);
                main / weight * self.weights.iter().sum::<usize>() + main % weight
            }
        }
    }

    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<TrainBatch, DataError>> + '_> {
        let plan = self.plan();
        let mut parts: Vec<Part> = (0..self.loaders.len())
            .map(|dataset| {
                let wanted = plan.iter().filter(|&&d| d == dataset).count();
                Part { wanted, epoch, taken: 0, batches: None }
            })
            .collect();
        for &dataset in plan.iter().take(skip) {
            parts[dataset].taken += 1;
        }
        let rest = plan.into_iter().skip(skip);
        let mut failed = false;
        Box::new(rest.map_while(move |dataset| {
            if failed {
                return None;
            }
            let batch = parts[dataset].next(&self.loaders[dataset]);
            failed = batch.is_err();
            Some(batch)
        }))
    }

    fn left_out(&self) -> LeftOut {
        let mut all = LeftOut::default();
        self.loaders.iter().for_each(|loader| all.add(BatchLoader::left_out(loader)));
        all
    }
}

/// What one dataset gives in an epoch.
struct Part {
    /// Batches it gives in an epoch.
    wanted: usize,
    epoch: u64,
    /// Batches it has given.
    taken: usize,
    batches: Option<SceneBatches>,
}

impl Part {
    fn next(&mut self, loader: &SceneLoader) -> Result<TrainBatch, DataError> {
        let length = loader.batches_per_epoch();
        let (pass, place) = (self.taken / length, self.taken % length);
        // Epochs of its own, so that no two passes are alike.
        let passes = self.wanted.div_ceil(length) as u64;
        let own_epoch = self.epoch.wrapping_mul(passes).wrapping_add(pass as u64);
        if place == 0 {
            self.batches = None;
        }
        let batches = self.batches.get_or_insert_with(|| loader.batches(own_epoch, place));
        self.taken += 1;
        batches.next().unwrap_or_else(|| {
            // An epoch gives as many batches as it says, or an error before.
            Err(bad_setting("batch", place, "a batch of the epoch"))
        })
    }
}
