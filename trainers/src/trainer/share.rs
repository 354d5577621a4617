//! The result of one batch of a step, and how the ranks combine theirs.

use super::{Run, Trainer};
use crate::TrainError;
use crate::collective::CollectiveError;
use crate::event::Progress;
use crate::module::TrainingModule;
use candle_core::backprop::GradStore;
use candle_core::{DType, Device, Tensor, Var};
use scenesplat_models::ParamStore;
use scenesplat_models::layers::StatisticsUpdate;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Values that are sent at a time, 16 MiB of them: what is copied meanwhile stays small.
const BUCKET: usize = 4 << 20;

/// A number that keeps its bits on the way, NaN too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "u64", into = "u64")]
pub(super) struct Bits(pub(super) f64);

impl From<u64> for Bits {
    fn from(bits: u64) -> Self {
        Self(f64::from_bits(bits))
    }
}

impl From<Bits> for u64 {
    fn from(value: Bits) -> Self {
        value.0.to_bits()
    }
}

/// What one batch gives besides its gradient. Nothing if it is empty.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Share {
    pub(super) loss: Option<Bits>,
    pub(super) terms: Vec<(String, Bits)>,
    pub(super) rows: u64,
    pub(super) counted_rows: u64,
    pub(super) has_features: bool,
    /// They stay on the rank that has them.
    #[serde(skip)]
    pub(super) features: Option<Tensor>,
    /// The update of the running statistics, where it waits for the other ranks.
    pub(super) statistics: Vec<Statistics>,
}

/// The update by a batch of the statistics of the batch norm of that name.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Statistics {
    name: String,
    mean: Vec<Bits>,
    var: Vec<Bits>,
    unbias: Bits,
    momentum: Bits,
}

/// What a rank sends the others in a step.
#[derive(Serialize, Deserialize)]
struct Told {
    step: u64,
    stop: bool,
    /// Which of the parameters have a gradient.
    has_gradient: Vec<bool>,
    shares: Vec<Share>,
}

/// The stores of a module, each with what stands before its names.
fn stores<M: TrainingModule>(module: &M) -> Vec<(String, &ParamStore)> {
    let further = module.stores().into_iter().map(|(name, store)| (format!("{name}/"), store));
    std::iter::once((String::new(), module.params())).chain(further).collect()
}

/// All buffers of a module by name.
fn buffers<M: TrainingModule>(module: &M) -> BTreeMap<String, Var> {
    let of = |(prefix, store): (String, &ParamStore)| {
        let named = move |(name, var): (String, Var)| (format!("{prefix}{name}"), var);
        store.buffers().into_iter().map(named).collect::<Vec<_>>()
    };
    stores(module).into_iter().flat_map(of).collect()
}

const MEAN: &str = "running_mean";

impl Share {
    /// With the batch's updates of running statistics.
    pub(super) fn with_statistics<M: TrainingModule>(
        self,
        module: &M,
        updates: Vec<StatisticsUpdate>,
    ) -> Result<Self, TrainError> {
        if updates.is_empty() {
            return Ok(self);
        }
        let buffers = buffers(module);
        let names: std::collections::HashMap<_, &String> =
            buffers.iter().map(|(name, var)| (var.id(), name)).collect();
        let statistics = updates.into_iter().map(|update| {
            let name = names.get(&update.running_mean().id()).and_then(|n| n.strip_suffix(MEAN));
            let name = name.ok_or_else(|| TrainError::UnknownStatistics)?.to_owned();
            Ok(Statistics {
                name,
                mean: update.mean.into_iter().map(Bits).collect(),
                var: update.var.into_iter().map(Bits).collect(),
                unbias: Bits(update.unbias),
                momentum: Bits(update.momentum),
            })
        });
        Ok(Self { statistics: statistics.collect::<Result<_, TrainError>>()?, ..self })
    }
}

impl Trainer {
    /// The sum of all ranks' gradients, and the shares of all batches in their order; running statistics are
    /// updated. On one rank, its arguments.
    pub(super) fn together<M: TrainingModule>(
        &mut self,
        run: &Run<'_, M>,
        mut grads: GradStore,
        mut shares: Vec<Share>,
        at: Progress,
    ) -> Result<(GradStore, Vec<Share>), TrainError> {
        if self.is_alone() {
            return Ok((grads, shares));
        }
        let began = Instant::now();
        let features = shares.iter_mut().rev().find_map(|share| share.features.take());
        let told = Told {
            step: at.step,
            stop: self.stop.as_ref().is_some_and(|stop| stop.load(Ordering::SeqCst)),
            has_gradient: run.params.values().map(|var| grads.get(var).is_some()).collect(),
            shares,
        };
        let all = self.tell(&told)?;
        self.agreed_stop = all.iter().any(|told| told.stop);
        let any = |i: usize| all.iter().any(|told| told.has_gradient[i]);
        let trained: Vec<(&String, &Var)> = run.params.iter().collect();
        let trained: Vec<_> = (0..trained.len()).filter(|i| any(*i)).map(|i| trained[i]).collect();
        self.sum(&trained, &mut grads)?;
        let features = self.last_features(&all, features.as_ref(), at)?;
        let mut shares: Vec<Share> = all.into_iter().flat_map(|told| told.shares).collect();
        let buffers = buffers(run.module);
        // Those of all batches together are one update, which every rank with a batch has.
        let updates = match self.config.sync_batch_norm {
            true => shares.iter().find(|share| !share.statistics.is_empty()).into_iter().collect(),
            false => shares.iter().collect::<Vec<_>>(),
        };
        for statistics in updates.into_iter().flat_map(|share| &share.statistics) {
            move_statistics(&buffers, statistics)?;
        }
        if let Some(last) = shares.iter_mut().rev().find(|share| share.loss.is_some()) {
            last.features = features;
        }
        self.together_seconds += began.elapsed().as_secs_f64();
        Ok((grads, shares))
    }

    /// What each rank sends of its step.
    fn tell(&self, told: &Told) -> Result<Vec<Told>, TrainError> {
        let mine = serde_json::to_vec(told).map_err(|_| TrainError::UnknownStatistics)?;
        let all = self.collective.all_gather(&mine)?;
        let read = |(rank, bytes): (usize, &Vec<u8>)| {
            let disagree = |problem| CollectiveError::Disagreement { rank, problem };
            let other: Told = serde_json::from_slice(bytes)
                .map_err(|error| disagree(format!("tells no step: {error}")))?;
            if other.step != told.step || other.has_gradient.len() != told.has_gradient.len() {
                let problem = format!(
                    "is at step {} with {} parameters, this rank at step {} with {}",
                    other.step,
                    other.has_gradient.len(),
                    told.step,
                    told.has_gradient.len()
                );
                return Err(disagree(problem).into());
            }
            Ok(other)
        };
        all.iter().enumerate().map(read).collect()
    }

    /// Replaces gradients by their sums over the ranks, bucket by bucket.
    fn sum(
        &mut self,
        trained: &[(&String, &Var)],
        grads: &mut GradStore,
    ) -> Result<(), TrainError> {
        let mut rest = trained;
        while !rest.is_empty() {
            let (mut count, mut len) = (0, 0);
            while count < rest.len() && (count == 0 || len < BUCKET) {
                len += rest[count].1.elem_count();
                count += 1;
            }
            let (bucket, after) = rest.split_at(count);
            rest = after;
            let mut parts = Vec::with_capacity(count);
            for (name, var) in bucket {
                if var.dtype() != DType::F32 {
                    let (name, dtype) = ((*name).clone(), var.dtype());
                    return Err(TrainError::DType { name, dtype });
                }
                let part = match grads.get(var) {
                    Some(grad) => grad.flatten_all(),
                    None => Tensor::zeros(var.elem_count(), DType::F32, var.device()),
                };
                parts.push(part.map_err(TrainError::tensor(name))?);
            }
            self.together_bytes += 4 * len as u64;
            let (first, device) = (bucket[0].0, bucket[0].1.device());
            let mine = Tensor::cat(&parts, 0).map_err(TrainError::tensor(first))?;
            let sums = match self.collective.all_reduce_tensor(&mine)? {
                Some(sums) => sums,
                None => {
                    let mut sums = mine.to_vec1::<f32>().map_err(TrainError::tensor(first))?;
                    self.collective.all_reduce(&mut sums)?;
                    Tensor::from_vec(sums, len, device).map_err(TrainError::tensor(first))?
                }
            };
            let mut from = 0;
            for (name, var) in bucket {
                // A copy of its own: what is left of a gradient must not keep the whole bucket.
                let grad = sums.narrow(0, from, var.elem_count());
                let grad = grad.and_then(|g| g.reshape(var.shape())?.force_contiguous());
                grads.insert(var, grad.map_err(TrainError::tensor(name))?);
                from += var.elem_count();
            }
        }
        Ok(())
    }

    /// The output rows of the last batch that has some, where they are looked at after this step.
    fn last_features(
        &self,
        all: &[Told],
        mine: Option<&Tensor>,
        at: Progress,
    ) -> Result<Option<Tensor>, TrainError> {
        let holder = all.iter().rposition(|told| told.shares.iter().any(|s| s.has_features));
        let due = self.looks_at_features(at.step + 1, at.total_steps);
        let Some(holder) = holder.filter(|_| due) else { return Ok(None) };
        let tensor = |source| TrainError::Forward { source };
        let mut bytes = Vec::new();
        if let (Some(rows), true) = (mine, self.collective.rank() == holder) {
            let (count, width) = rows.dims2().map_err(tensor)?;
            bytes.extend([count, width].map(|n| n as u64).iter().flat_map(|n| n.to_le_bytes()));
            let rows = rows.to_dtype(DType::F32).and_then(|r| r.flatten_all());
            let values = rows.and_then(|r| r.to_vec1::<f32>()).map_err(tensor)?;
            bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        }
        let bytes = self.collective.broadcast(holder, &bytes)?;
        let problem = || CollectiveError::Disagreement {
            rank: holder,
            problem: "sent no rows of features".to_owned(),
        };
        let (head, rest) = bytes.split_at_checked(16).ok_or_else(problem)?;
        let (sizes, _) = head.as_chunks::<8>();
        let [count, width] = [0, 1].map(|i| u64::from_le_bytes(sizes[i]) as usize);
        let (values, _) = rest.as_chunks::<4>();
        let values: Vec<f32> = values.iter().map(|v| f32::from_le_bytes(*v)).collect();
        if values.len() != count.saturating_mul(width) {
            return Err(problem().into());
        }
        Tensor::from_vec(values, (count, width), &Device::Cpu).map(Some).map_err(tensor)
    }
}

fn move_statistics(
    buffers: &BTreeMap<String, Var>,
    statistics: &Statistics,
) -> Result<(), TrainError> {
    let buffer = |name: &str| {
        let found = buffers.get(&format!("{}{name}", statistics.name));
        found.cloned().ok_or(TrainError::UnknownStatistics)
    };
    let values = |bits: &[Bits]| bits.iter().map(|v| v.0).collect();
    let update = StatisticsUpdate::new(
        [buffer(MEAN)?, buffer("running_var")?, buffer("num_batches_tracked")?],
        values(&statistics.mean),
        values(&statistics.var),
        statistics.unbias.0,
        statistics.momentum.0,
    );
    update.apply().map_err(|source| TrainError::Forward { source })
}
