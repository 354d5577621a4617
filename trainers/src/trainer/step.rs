//! One optimizer step.

use super::share::{Bits, Share};
use super::{Run, Trainer};
use crate::collective::{InPairs, StepPeers};
use crate::event::Progress;
use crate::gradients::{add_gradients, check_gradients};
use crate::module::{AfterStep, StepContext, TrainingModule};
use crate::optim::{clip_grad_norm, grad_norm};
use crate::{Tally, TrainError};
use candle_core::Tensor;
use candle_core::backprop::GradStore;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::DataError;
use scenesplat_models::Forward;
use scenesplat_models::layers::{StatisticsUpdate, record_statistics};
use scenesplat_models::peers::{Peers, with_peers};
use std::collections::BTreeMap;
use std::rc::Rc;

/// Scenes of an epoch that a message can name.
const NAMED_SCENES: usize = 64;

/// What one optimizer step did.
#[derive(Default)]
pub(super) struct StepReport {
    pub(super) loss: f64,
    pub(super) terms: BTreeMap<String, TermMean>,
    pub(super) grad_norm: f64,
    pub(super) lr_factor: f64,
    pub(super) tally: Tally,
    pub(super) features: Option<Tensor>,
}

/// Mean of a term over the batches of a step in which it was on.
#[derive(Default)]
pub(super) struct TermMean {
    sum: f64,
    batches: u64,
}

impl StepReport {
    /// Adds what one of the step's batches gave, in their order.
    fn add(&mut self, share: Share, weight: f64) {
        self.tally.batches += 1;
        let Some(Bits(value)) = share.loss else {
            self.tally.empty_batches += 1;
            return;
        };
        self.loss += value * weight;
        for (name, Bits(value)) in share.terms {
            let term = self.terms.entry(name).or_default();
            term.sum += value;
            term.batches += 1;
        }
        self.tally.rows += share.rows;
        self.tally.counted_rows += share.counted_rows;
        self.features = share.features.or_else(|| self.features.take());
    }
}

impl TermMean {
    pub(super) fn value(&self) -> f64 {
        self.sum / self.batches as f64
    }
}

/// A share with what its batch does to remembered statistics.
fn with_statistics<M: TrainingModule>(
    module: &M,
    (done, updates): (Result<(GradStore, Share), TrainError>, Vec<StatisticsUpdate>),
) -> Result<(GradStore, Share), TrainError> {
    let (grads, share) = done?;
    Ok((grads, share.with_statistics(module, updates)?))
}

impl Trainer {
    /// Forward and backward of `accumulate` batches, then the update.
    pub(super) fn step<M: TrainingModule>(
        &mut self,
        run: &mut Run<'_, M>,
        stream: &mut dyn Iterator<Item = Result<M::Batch, DataError>>,
        place: &mut u64,
        at: Progress,
    ) -> Result<StepReport, TrainError> {
        let mut report = StepReport::default();
        let mut batches = Vec::new();
        let done = self.gradients(run, stream, place, at, &mut batches, &mut report);
        self.tally.add(report.tally);
        for scene in batches.iter().flat_map(|b| run.module.scenes(b)) {
            if run.scenes.len() < NAMED_SCENES {
                run.scenes.insert(scene);
            }
        }
        let updated = done.and_then(|grads| self.update(run, grads, at, &mut report));
        updated.map_err(|error| {
            let scenes = batches.iter().flat_map(|b| run.module.scenes(b)).collect();
            let suspects = batches.iter().flat_map(|b| run.module.suspects(b)).collect();
            error.in_step(at.step, scenes, suspects)
        })?;
        Ok(report)
    }

    /// The mean gradient of the next `accumulate` batches; those of this rank are put into `batches`. An empty one
    /// counts as a gradient of zeros.
    fn gradients<M: TrainingModule>(
        &mut self,
        run: &mut Run<'_, M>,
        stream: &mut dyn Iterator<Item = Result<M::Batch, DataError>>,
        place: &mut u64,
        at: Progress,
        batches: &mut Vec<M::Batch>,
        report: &mut StepReport,
    ) -> Result<GradStore, TrainError> {
        let part = self.part();
        let first = *place + part.first as u64;
        // An empty batch has its place among them: which are added first shall not depend on who has it.
        let add = |sum: Option<GradStore>, new: Option<GradStore>| match (sum, new) {
            (Some(mut sum), Some(mut new)) => {
                add_gradients(&mut sum, &mut new, &run.params).map(|()| Some(sum))
            }
            (sum, new) => Ok(sum.or(new)),
        };
        let (mut grads, mut shares) = (InPairs::new(), Vec::with_capacity(part.count));
        for place in first..first + part.count as u64 {
            let Some(batch) = stream.next().transpose()? else {
                return Err(TrainError::ShortEpoch { epoch: at.epoch, expected: place + 1 });
            };
            batches.push(batch);
            let batch = &batches[batches.len() - 1];
            let Some((mut new, share)) = self.share_of(run, batch, place, at)? else {
                shares.push(Share::default());
                grads.push(None, add)?;
                continue;
            };
            if !run.checked {
                check_gradients(&run.params, &new, &self.config.idle)?;
                run.checked = true;
            }
            // Only those of parameters, and none that points into the graph.
            let mut own = GradStore::default();
            add_gradients(&mut own, &mut new, &run.params)?;
            grads.push(Some(own), add)?;
            shares.push(share);
        }
        let grads = grads.finish(add)?.flatten().unwrap_or_default();
        *place += self.config.accumulate;
        let (grads, shares) = self.together(run, grads, shares, at)?;
        let weight = 1.0 / self.config.accumulate as f64;
        for share in shares {
            report.add(share, weight);
        }
        Ok(grads)
    }

    /// What one batch gives; nothing if it is empty.
    fn share_of<M: TrainingModule>(
        &mut self,
        run: &Run<'_, M>,
        batch: &M::Batch,
        place: u64,
        at: Progress,
    ) -> Result<Option<(GradStore, Share)>, TrainError> {
        let is_empty = run.module.is_empty(batch);
        if self.is_alone() {
            return (!is_empty).then(|| self.micro_step(run, batch, place, at)).transpose();
        }
        // The batches of all ranks are remembered in one order.
        let work = || record_statistics(|| self.micro_step(run, batch, place, at));
        if !self.config.sync_batch_norm {
            return (!is_empty).then(|| with_statistics(run.module, work())).transpose();
        }
        let peers = Rc::new(StepPeers::new(Rc::clone(&self.collective)));
        let shared: Rc<dyn Peers> = Rc::clone(&peers) as _;
        let done = (!is_empty).then(|| with_peers(shared, work));
        let done = done.map(|done| with_statistics(run.module, done)).transpose()?;
        let (bytes, seconds) = peers.finish()?;
        self.together_bytes += bytes;
        self.together_seconds += seconds;
        Ok(done)
    }

    /// What follows from the gradients: clipping, the optimizer's step, the average, the module's own.
    fn update<M: TrainingModule>(
        &mut self,
        run: &Run<'_, M>,
        mut grads: GradStore,
        at: Progress,
        report: &mut StepReport,
    ) -> Result<(), TrainError> {
        let hyperparameters = self.schedule.hyperparameters(at.step, at.total_steps);
        report.lr_factor = hyperparameters.lr_scale;
        report.grad_norm = match self.config.clip_norm {
            Some(max) => clip_grad_norm(&run.params, &mut grads, max)?,
            None => grad_norm(&run.params, &grads)?,
        };
        self.optimizer.step(&grads, &hyperparameters)?;
        if let Some(average) = &self.average {
            average.update(&run.params, at.step)?;
        }
        let (step, total_steps) = (at.step, at.total_steps);
        run.module.after_step(&AfterStep { step, total_steps, trained: &run.params })
    }

    fn micro_step<M: TrainingModule>(
        &self,
        run: &Run<'_, M>,
        batch: &M::Batch,
        place: u64,
        at: Progress,
    ) -> Result<(GradStore, Share), TrainError> {
        let tensor = |source| TrainError::Forward { source };
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        rng.set_stream(at.epoch << 32 | place);
        let (recompute, frozen) = (run.recompute.clone(), run.freeze.statistics());
        let forward = Forward { recompute, frozen, ..Forward::train(&mut rng) };
        let progress = at.step as f64 / at.total_steps as f64;
        let seed = self.config.seed ^ (at.epoch << 32 | place).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let (step, total_steps) = (at.step, at.total_steps);
        let mut cx = StepContext { forward, progress, step, total_steps, seed };
        let out = run.module.training_step(batch, &mut cx).map_err(tensor)?;
        run.freeze.hold()?;
        let value = f64::from(out.loss.to_scalar::<f32>().map_err(tensor)?);
        let terms = out.terms.iter().map(|(n, v)| (n.as_str(), *v));
        // A term says more than their sum.
        if let Some((term, value)) = terms.chain([("loss", value)]).find(|(_, v)| !v.is_finite()) {
            return Err(TrainError::NonFiniteLoss { term: term.to_owned(), value });
        }
        let share = 1.0 / self.config.accumulate as f64;
        let mut grads =
            out.loss.affine(share, 0.0).and_then(|loss| loss.backward()).map_err(tensor)?;
        if let Some(recompute) = &run.recompute {
            recompute.drain_into(&mut grads).map_err(tensor)?;
        }
        let share = Share {
            loss: Some(Bits(value)),
            terms: out.terms.into_iter().map(|(name, value)| (name, Bits(value))).collect(),
            rows: out.rows as u64,
            counted_rows: out.counted_rows as u64,
            has_features: out.features.is_some(),
            features: out.features,
            statistics: Vec::new(),
        };
        Ok((grads, share))
    }
}
