//! The training loop.

use crate::average::Average;
use crate::checkpoint::{self, BestCheckpoint, CheckpointState, Contents};
use crate::event::{Callback, End, Evaluator, Event, Flow, Progress};
use crate::gradients::{add_gradients, check_gradients};
use crate::module::{StepContext, TrainingModule};
use crate::optim::{Optimizer, Schedule, clip_grad_norm, grad_norm};
use crate::{TrainError, TrainerConfig};
use candle_core::{Var, backprop::GradStore};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::BatchLoader;
use scenesplat_metrics::Measurement;
use scenesplat_models::{Forward, ParamStore, Recompute};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Runs the loop: batches in, better parameters out.
///
/// A run is a function of its settings, data and seed: what happens in step `n` depends on `n` and
/// the parameters alone. So a run that was interrupted and goes on from a checkpoint ends with the
/// same bits as one that was not.
pub struct Trainer {
    config: TrainerConfig,
    optimizer: Box<dyn Optimizer>,
    schedule: Box<dyn Schedule>,
    callbacks: Vec<Box<dyn Callback>>,
    stop: Option<Arc<AtomicBool>>,
    average: Option<Average>,
    best: Option<f64>,
    resumed: Option<CheckpointState>,
}

/// What one optimizer step did.
struct StepReport {
    loss: f64,
    terms: BTreeMap<String, f64>,
    grad_norm: f64,
    lr_factor: f64,
    features: Option<candle_core::Tensor>,
}

impl Trainer {
    /// A trainer without callbacks.
    ///
    /// # Errors
    /// If a setting is out of its range.
    pub fn new(
        config: TrainerConfig,
        optimizer: Box<dyn Optimizer>,
        schedule: Box<dyn Schedule>,
    ) -> Result<Self, TrainError> {
        config.check()?;
        Ok(Self {
            config,
            optimizer,
            schedule,
            callbacks: Vec::new(),
            stop: None,
            average: None,
            best: None,
            resumed: None,
        })
    }

    /// Adds a callback.
    #[must_use]
    pub fn with_callback(mut self, callback: impl Callback + 'static) -> Self {
        self.callbacks.push(Box::new(callback));
        self
    }

    /// Once the flag is set, the run saves and stops after the step under way.
    #[must_use]
    pub fn with_stop(mut self, stop: Arc<AtomicBool>) -> Self {
        self.stop = Some(stop);
        self
    }

    /// Trains from `start`: `Progress::default()`, or what [`load_checkpoint`](Self::load_checkpoint)
    /// gave. Returns where it stopped; `step == total_steps` if nothing asked it to stop before.
    ///
    /// # Errors
    /// If data cannot be read, a number is not finite, a parameter has no gradient, or a callback,
    /// evaluator or checkpoint fails. What the parameters are then is not defined; the last
    /// checkpoint is.
    pub fn fit<M: TrainingModule>(
        &mut self,
        module: &M,
        data: &mut dyn BatchLoader<M::Batch>,
        evaluators: &mut [Box<dyn Evaluator<M>>],
        start: Progress,
    ) -> Result<Progress, TrainError> {
        let batches = data.batches_per_epoch();
        let steps_per_epoch = batches as u64 / self.config.accumulate;
        if steps_per_epoch == 0 {
            return Err(TrainError::ShortEpoch { epoch: 0, expected: self.config.accumulate });
        }
        if let Some(state) = self.resumed.take() {
            state.check(&self.config, batches)?;
        }
        let params = self.trained(module.params());
        if let (Some(decay), None) = (self.config.ema, &self.average) {
            self.average = Some(Average::new(&params, decay)?);
        }
        let recompute = self.config.recompute.then(|| Recompute::new(params.clone()));
        let mut at = Progress { total_steps: self.config.epochs * steps_per_epoch, ..start };
        let parameters = params.values().map(|v| v.elem_count()).sum();
        let mut flow = self.emit(&Event::FitStart { parameters, steps_per_epoch }, at)?;
        let mut saved = start.step;
        while at.step < at.total_steps && flow == Flow::Continue {
            at.epoch = at.step / steps_per_epoch;
            let skip = at.step % steps_per_epoch * self.config.accumulate;
            let last = steps_per_epoch * self.config.accumulate;
            let mut stream = data.epoch(at.epoch, skip as usize);
            let mut place = skip;
            while place < last && flow == Flow::Continue {
                let began = Instant::now();
                let first_step = at.step == start.step;
                let report = self.step(
                    module,
                    &params,
                    recompute.as_ref(),
                    &mut *stream,
                    &mut place,
                    at,
                    first_step,
                )?;
                at.step += 1;
                flow = self.report(module, &report, at, began.elapsed().as_secs_f64())?;
                if self.stop.as_ref().is_some_and(|s| s.load(Ordering::SeqCst)) {
                    flow = Flow::Stop;
                }
                let every = self.config.checkpoint.every_steps;
                if every > 0 && at.step.is_multiple_of(every) && at.step < at.total_steps {
                    self.checkpoint(module.params(), batches, at, None)?;
                    saved = at.step;
                }
            }
            drop(stream);
            let complete = at.step == (at.epoch + 1) * steps_per_epoch;
            if complete && flow == Flow::Continue {
                let (found, asked) = self.evaluate(module, &params, evaluators, at)?;
                flow = asked;
                let better = self.better(&found);
                if better.is_some() || self.config.checkpoint.every_steps == 0 {
                    self.checkpoint(module.params(), batches, at, better)?;
                    saved = at.step;
                }
            }
        }
        if saved != at.step {
            self.checkpoint(module.params(), batches, at, None)?;
        }
        let end = if at.step == at.total_steps { End::Finished } else { End::Stopped };
        self.emit(&Event::FitEnd { end }, at)?;
        Ok(at)
    }

    /// One optimizer step: forward and backward of `accumulate` batches, then the update.
    #[expect(clippy::too_many_arguments, reason = "the state of the loop above, used once")]
    fn step<M: TrainingModule>(
        &mut self,
        module: &M,
        params: &BTreeMap<String, Var>,
        recompute: Option<&Recompute>,
        stream: &mut dyn Iterator<Item = Result<M::Batch, scenesplat_datasets::DataError>>,
        place: &mut u64,
        at: Progress,
        first_step: bool,
    ) -> Result<StepReport, TrainError> {
        let mut grads = GradStore::default();
        let mut report = StepReport {
            loss: 0.0,
            terms: BTreeMap::new(),
            grad_norm: 0.0,
            lr_factor: 0.0,
            features: None,
        };
        let mut batches = Vec::new();
        let mut gradients = || {
            for _ in 0..self.config.accumulate {
                let Some(batch) = stream.next().transpose()? else {
                    return Err(TrainError::ShortEpoch { epoch: at.epoch, expected: *place + 1 });
                };
                batches.push(batch);
                let batch = &batches[batches.len() - 1];
                if module.is_empty(batch) {
                    *place += 1;
                    continue;
                }
                let mut new = self.micro_step(module, recompute, batch, *place, at, &mut report)?;
                if first_step {
                    check_gradients(params, &new, &self.config.idle)?;
                }
                add_gradients(&mut grads, &mut new, params)?;
                *place += 1;
            }
            Ok(())
        };
        let done = gradients();
        let controls = self.schedule.controls(at.step, at.total_steps);
        let updated = done.and_then(|()| {
            let norm = match self.config.clip_norm {
                Some(max) => clip_grad_norm(params, &mut grads, max)?,
                None => grad_norm(params, &grads)?,
            };
            self.optimizer.step(&grads, &controls)?;
            if let Some(average) = &self.average {
                average.update(params, at.step)?;
            }
            Ok(norm)
        });
        report.grad_norm = updated.map_err(|error: TrainError| {
            let scenes = batches.iter().flat_map(|b| module.scenes(b)).collect();
            let suspects = batches.iter().flat_map(|b| module.suspects(b)).collect();
            error.in_step(at.step, scenes, suspects)
        })?;
        report.lr_factor = controls.lr_scale;
        Ok(report)
    }

    fn micro_step<M: TrainingModule>(
        &self,
        module: &M,
        recompute: Option<&Recompute>,
        batch: &M::Batch,
        place: u64,
        at: Progress,
        report: &mut StepReport,
    ) -> Result<GradStore, TrainError> {
        let tensor = |source| TrainError::Forward { source };
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        rng.set_stream(at.epoch << 32 | place);
        let forward = Forward { recompute: recompute.cloned(), ..Forward::train(&mut rng) };
        let progress = at.step as f64 / at.total_steps as f64;
        let seed = self.config.seed ^ (at.epoch << 32 | place).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut cx = StepContext { forward, progress, seed };
        let out = module.training_step(batch, &mut cx).map_err(tensor)?;
        let value = f64::from(out.loss.to_scalar::<f32>().map_err(tensor)?);
        let terms = out.terms.iter().map(|(n, v)| (n.as_str(), *v));
        // A term says more than their sum.
        if let Some((term, value)) = terms.chain([("loss", value)]).find(|(_, v)| !v.is_finite()) {
            return Err(TrainError::NonFiniteLoss { term: term.to_owned(), value });
        }
        let share = 1.0 / self.config.accumulate as f64;
        let mut grads =
            out.loss.affine(share, 0.0).and_then(|loss| loss.backward()).map_err(tensor)?;
        if let Some(recompute) = recompute {
            recompute.drain_into(&mut grads).map_err(tensor)?;
        }
        report.loss += value * share;
        for (name, value) in out.terms {
            *report.terms.entry(name).or_default() += value * share;
        }
        report.features = out.features;
        Ok(grads)
    }

    /// The parameters that are not frozen.
    fn trained(&self, store: &ParamStore) -> BTreeMap<String, Var> {
        let mut params = store.parameters();
        params.retain(|name, _| !self.config.freeze.iter().any(|part| name.contains(part)));
        params
    }

    fn report<M: TrainingModule>(
        &mut self,
        module: &M,
        report: &StepReport,
        at: Progress,
        seconds: f64,
    ) -> Result<Flow, TrainError> {
        let mut flow = Flow::Continue;
        let mut measurements = Vec::new();
        let last = at.step == at.total_steps;
        if at.step.is_multiple_of(self.config.log_every) || last {
            let entry = |name: &str, value| Measurement::new(format!("train/{name}"), value);
            measurements.push(entry("loss", report.loss));
            measurements.extend(report.terms.iter().map(|(name, value)| entry(name, *value)));
            measurements.push(entry("lr_factor", report.lr_factor));
            measurements.push(entry("grad_norm", report.grad_norm));
            measurements.push(entry("seconds_per_step", seconds));
        }
        let every = self.config.health.every_steps;
        let mut alarms = Vec::new();
        if every > 0 && (at.step.is_multiple_of(every) || last) {
            let health = crate::health::look(
                &self.config.health,
                report.features.as_ref(),
                module.params(),
                self.config.seed ^ at.step,
            )?;
            measurements.extend(health.measurements);
            alarms = health.alarms;
        }
        if !measurements.is_empty() {
            flow = self.emit(&Event::Step { measurements: &measurements }, at)?;
        }
        for message in &alarms {
            if self.emit(&Event::Alarm { message }, at)? == Flow::Stop {
                flow = Flow::Stop;
            }
        }
        Ok(flow)
    }

    /// Runs the evaluators if it is their time; their measurements, and whether someone asks to stop.
    fn evaluate<M: TrainingModule>(
        &mut self,
        module: &M,
        params: &BTreeMap<String, Var>,
        evaluators: &mut [Box<dyn Evaluator<M>>],
        at: Progress,
    ) -> Result<(Vec<Measurement>, Flow), TrainError> {
        let every = self.config.eval_every;
        let due = every > 0 && (at.epoch + 1).is_multiple_of(every);
        if !due && at.step != at.total_steps {
            return Ok((Vec::new(), Flow::Continue));
        }
        let (mut all, mut flow) = (Vec::new(), Flow::Continue);
        for evaluator in evaluators {
            let mut found = match &self.average {
                Some(average) => average.during(params, || evaluator.run(module, at))?,
                None => evaluator.run(module, at)?,
            };
            for measurement in &mut found {
                measurement.name = format!("{}/{}", evaluator.name(), measurement.name);
            }
            let event = Event::Eval { name: evaluator.name(), measurements: &found };
            if self.emit(&event, at)? == Flow::Stop {
                flow = Flow::Stop;
            }
            all.extend(found);
        }
        Ok((all, flow))
    }

    /// The deciding measurement, if it is the best so far.
    fn better(&mut self, found: &[Measurement]) -> Option<f64> {
        let name = self.config.checkpoint.best.as_ref()?;
        let value = found.iter().find(|m| &m.name == name)?.value;
        let smaller = self.config.checkpoint.smaller_is_better;
        let better = self.best.is_none_or(|b| if smaller { value < b } else { value > b });
        (better && value.is_finite()).then(|| *self.best.insert(value))
    }

    fn checkpoint(
        &mut self,
        params: &ParamStore,
        batches: usize,
        at: Progress,
        best: Option<f64>,
    ) -> Result<(), TrainError> {
        let Some(root) = self.config.checkpoint.dir.clone() else { return Ok(()) };
        let dir = self.save_checkpoint(&root, params, batches, at)?;
        if let (Some(value), Some(name)) = (best, dir.file_name().and_then(|n| n.to_str())) {
            let measurement = self.config.checkpoint.best.clone().unwrap_or_default();
            let checkpoint = name.to_owned();
            checkpoint::mark_best(&root, &BestCheckpoint { checkpoint, measurement, value })?;
        }
        checkpoint::prune(&root, self.config.checkpoint.keep)?;
        self.emit(&Event::Checkpoint { dir: &dir, best: best.is_some() }, at).map(|_| ())
    }

    /// Writes the run as it stands to `root/step-…`, complete or not at all; gives the folder.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save_checkpoint(
        &self,
        root: &Path,
        params: &ParamStore,
        batches_per_epoch: usize,
        at: Progress,
    ) -> Result<PathBuf, TrainError> {
        let states = self.callbacks.iter().filter_map(|c| c.state());
        let callbacks = states.map(|(name, state)| (name.to_owned(), state)).collect();
        let state = CheckpointState::new(at, batches_per_epoch, &self.config, self.best, callbacks);
        let contents = Contents {
            params,
            optimizer: self.optimizer.state()?,
            average: self.average.as_ref().map(Average::values),
            state,
        };
        checkpoint::write(root, &contents)
    }

    /// Takes up a run where a checkpoint left it.
    ///
    /// # Errors
    /// If the folder is no checkpoint of this network and optimizer.
    pub fn load_checkpoint(
        &mut self,
        dir: &Path,
        params: &ParamStore,
    ) -> Result<Progress, TrainError> {
        let state = checkpoint::read_state(dir)?;
        let optimizer = checkpoint::read_tensors(&dir.join("optimizer.safetensors"))?;
        params
            .restore(&dir.join("params.safetensors"))
            .map_err(|source| TrainError::Forward { source })?;
        self.optimizer.load_state(&optimizer)?;
        if let Some(decay) = self.config.ema {
            let average = Average::new(&self.trained(params), decay)?;
            let path = dir.join("average.safetensors");
            if path.is_file() {
                average.load(&checkpoint::read_tensors(&path)?)?;
            }
            self.average = Some(average);
        }
        for callback in &mut self.callbacks {
            if let Some((name, _)) = callback.state()
                && let Some(saved) = state.callbacks.get(name)
            {
                callback.load_state(saved)?;
            }
        }
        self.best = state.best;
        let progress = state.progress;
        self.resumed = Some(state);
        Ok(progress)
    }

    /// Runs `f` with the averaged parameters, if there is an average: for exports.
    ///
    /// # Errors
    /// That of `f`.
    pub fn with_average<R>(
        &self,
        params: &ParamStore,
        f: impl FnOnce() -> Result<R, TrainError>,
    ) -> Result<R, TrainError> {
        match &self.average {
            Some(average) => average.during(&self.trained(params), f),
            None => f(),
        }
    }

    fn emit(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let mut flow = Flow::Continue;
        for callback in &mut self.callbacks {
            if callback.on_event(event, at)? == Flow::Stop {
                flow = Flow::Stop;
            }
        }
        Ok(flow)
    }
}
