//! The training loop.

mod report;
mod resume;
mod share;
mod step;

use crate::average::Average;
use crate::checkpoint::CheckpointState;
use crate::collective::{Alone, Collective};
use crate::event::{Callback, End, Event, Flow, Progress};
use crate::freeze::Freeze;
use crate::module::TrainingModule;
use crate::optim::{Optimizer, Schedule};
use crate::{DataModule, Identity, Tally, TrainError, TrainerConfig};
use candle_core::Var;
use scenesplat_datasets::{BatchPart, LeftOut};
use scenesplat_models::{ParamStore, Recompute};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
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
    identity: Identity,
    average: Option<Average>,
    best: Option<f64>,
    tally: Tally,
    /// Looks in a row that found collapsed features.
    collapsed_looks: u64,
    /// Whether the epoch that ends here has not been evaluated yet.
    evaluation_due: bool,
    /// What was said of the data, by the name of who reads them.
    said: BTreeMap<String, LeftOut>,
    resumed: Option<CheckpointState>,
    collective: Rc<dyn Collective>,
    /// Whether a rank was asked to stop, as all know.
    agreed_stop: bool,
    /// Since the last line of the log: time that putting gradients and statistics together took, and their bytes.
    together_seconds: f64,
    together_bytes: u64,
}

/// What every step of a run shares.
struct Run<'a, M> {
    module: &'a M,
    /// The parameters that are not frozen.
    params: BTreeMap<String, Var>,
    freeze: Freeze,
    recompute: Option<Recompute>,
    /// Whether each parameter has been seen to get a gradient.
    checked: bool,
    /// Names of scenes of the epoch under way, for messages; only a few.
    scenes: BTreeSet<String>,
    batches_per_epoch: usize,
    steps_per_epoch: u64,
    /// Step of the last checkpoint.
    saved: u64,
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
            identity: Identity::new(),
            average: None,
            best: None,
            tally: Tally::default(),
            collapsed_looks: 0,
            evaluation_due: false,
            said: BTreeMap::new(),
            resumed: None,
            collective: Rc::new(Alone),
            agreed_stop: false,
            together_seconds: 0.0,
            together_bytes: 0,
        })
    }

    /// Adds a callback.
    #[must_use]
    pub fn with_callback(mut self, callback: impl Callback + 'static) -> Self {
        self.callbacks.push(Box::new(callback));
        self
    }

    /// Adds several callbacks.
    #[must_use]
    pub fn with_callbacks(mut self, callbacks: Vec<Box<dyn Callback>>) -> Self {
        self.callbacks.extend(callbacks);
        self
    }

    /// Once the flag is set, the run saves and stops after the step under way.
    #[must_use]
    pub fn with_stop(mut self, stop: Arc<AtomicBool>) -> Self {
        self.stop = Some(stop);
        self
    }

    /// Trains as one of several ranks, on each of which the same is called. Each takes an equal part of the batches of
    /// a step (`accumulate`); so the number of ranks changes no result, to the bit where the part is a power of two
    /// (with `sync_batch_norm` there are as many ranks as batches). Rank 0 evaluates, and writes checkpoints; callbacks
    /// are called on every rank that has some, and if one asks to stop, it has to do so on all.
    #[must_use]
    pub fn with_collective(mut self, collective: Rc<dyn Collective>) -> Self {
        self.collective = collective;
        self
    }

    /// Whether there is one process only.
    fn is_alone(&self) -> bool {
        self.collective.size() == 1
    }

    /// The batches of a step that this rank takes.
    fn part(&self) -> BatchPart {
        let group = self.config.accumulate as usize;
        let count = group / self.collective.size();
        BatchPart { group, first: count * self.collective.rank(), count }
    }

    fn asked_to_stop(&self) -> bool {
        match self.is_alone() {
            true => self.stop.as_ref().is_some_and(|s| s.load(Ordering::SeqCst)),
            false => self.agreed_stop,
        }
    }

    /// Adds what a checkpoint shall remember of the run besides the trainer's own settings (model,
    /// data, losses): only a run of the same identity goes on from it.
    #[must_use]
    pub fn with_identity(mut self, identity: Identity) -> Self {
        self.identity = self.identity.and(identity);
        self
    }

    /// Trains from `start`: `Progress::default()`, or what [`load_checkpoint`](Self::load_checkpoint)
    /// gave. Returns where it stopped; `step == total_steps` if nothing asked it to stop before.
    ///
    /// # Errors
    /// If a setting names a measurement or parameter that does not exist, data cannot be read or hold
    /// nothing to learn from for a whole epoch, a number is not finite, a parameter has no gradient, or
    /// a callback, evaluator or checkpoint fails. What the parameters are then is not defined; the last
    /// checkpoint is.
    pub fn fit<M: TrainingModule>(
        &mut self,
        module: &M,
        data: &mut DataModule<'_, M>,
        start: Progress,
    ) -> Result<Progress, TrainError> {
        let mut run = self.begin(module, data, start)?;
        let total_steps = self.config.total_steps(run.steps_per_epoch);
        let mut at = Progress { total_steps, ..start };
        let event = Event::FitStart {
            parameters: run.params.values().map(|v| v.elem_count()).sum(),
            steps_per_epoch: run.steps_per_epoch,
            leftover_batches: run.batches_per_epoch as u64 % self.config.accumulate,
        };
        let mut flow = self.emit(&event, at)?;
        if self.evaluation_due && flow == Flow::Continue {
            // Stopped at the very end of an epoch, before its evaluation.
            flow = self.end_epoch(&mut run, data, at)?;
        }
        while at.step < at.total_steps && flow == Flow::Continue {
            flow = self.epoch(&mut run, data, &mut at)?;
        }
        if run.saved != at.step {
            self.checkpoint(&mut run, at, None)?;
        }
        let end = if at.step == at.total_steps { End::Finished } else { End::Stopped };
        self.emit(&Event::FitEnd { end }, at)?;
        Ok(at)
    }

    /// Checks that settings, module and data fit together.
    fn begin<'a, M: TrainingModule>(
        &mut self,
        module: &'a M,
        data: &DataModule<'_, M>,
        start: Progress,
    ) -> Result<Run<'a, M>, TrainError> {
        let batches_per_epoch = data.train.batches_per_epoch();
        let (accumulate, ranks) = (self.config.accumulate, self.collective.size() as u64);
        let steps_per_epoch = batches_per_epoch as u64 / accumulate;
        if steps_per_epoch == 0 {
            return Err(TrainError::ShortEpoch { epoch: 0, expected: accumulate });
        }
        if !accumulate.is_multiple_of(ranks) {
            return Err(TrainError::Ranks { accumulate, ranks });
        }
        if self.config.sync_batch_norm && accumulate != ranks {
            return Err(TrainError::SyncBatchNorm { accumulate, ranks });
        }
        self.check_batches(batches_per_epoch)?;
        self.check_names(&data.evaluators)?;
        let freeze = Freeze::new(&self.config, module.params())?;
        let params = freeze.trained(module.params());
        if let (Some(decay), None) = (self.config.ema, &self.average) {
            self.average = Some(Average::new(&params, decay)?);
        }
        let recompute = self.config.recompute.then(|| Recompute::new(params.clone()));
        Ok(Run {
            module,
            params,
            freeze,
            recompute,
            checked: false,
            scenes: BTreeSet::new(),
            batches_per_epoch,
            steps_per_epoch,
            saved: start.step,
        })
    }

    /// Trains to the end of the epoch under way, or until something asks to stop.
    fn epoch<M: TrainingModule>(
        &mut self,
        run: &mut Run<'_, M>,
        data: &mut DataModule<'_, M>,
        at: &mut Progress,
    ) -> Result<Flow, TrainError> {
        at.epoch = at.step / run.steps_per_epoch;
        let mut place = at.step % run.steps_per_epoch * self.config.accumulate;
        let last = run.steps_per_epoch * self.config.accumulate;
        let mut stream = match self.is_alone() {
            true => data.train.epoch(at.epoch, place as usize),
            false => data.train.epoch_part(at.epoch, place as usize, self.part()),
        };
        let mut flow = Flow::Continue;
        let is_under_way = |place, at: &Progress| place < last && at.step < at.total_steps;
        while is_under_way(place, at) && flow == Flow::Continue {
            let began = Instant::now();
            let report = self.step(run, &mut *stream, &mut place, *at)?;
            at.step += 1;
            flow = self.report(run.module, &report, *at, began.elapsed().as_secs_f64())?;
            if self.asked_to_stop() {
                flow = Flow::Stop;
            }
            let every = self.config.checkpoint.every_steps;
            // The one at the end of an epoch follows its evaluation.
            if every > 0 && at.step.is_multiple_of(every) && is_under_way(place, at) {
                self.checkpoint(run, *at, None)?;
            }
        }
        drop(stream);
        self.check_data("train", data.train.left_out(), *at, &mut flow)?;
        if !is_under_way(place, at) {
            if place == last {
                self.check_epoch(run, *at)?;
            }
            self.evaluation_due = true;
            if flow == Flow::Continue {
                flow = self.end_epoch(run, data, *at)?;
            }
        }
        Ok(flow)
    }

    /// Evaluates, and saves if it is time or the state is the best so far.
    fn end_epoch<M: TrainingModule>(
        &mut self,
        run: &mut Run<'_, M>,
        data: &mut DataModule<'_, M>,
        at: Progress,
    ) -> Result<Flow, TrainError> {
        let (found, mut flow) = self.evaluate(run, &mut data.evaluators, at)?;
        self.evaluation_due = false;
        let better = self.better(found.as_deref(), at, &mut flow)?;
        let every = self.config.checkpoint.every_steps;
        if better.is_some() || every == 0 || at.step.is_multiple_of(every) {
            self.checkpoint(run, at, better)?;
        }
        Ok(flow)
    }

    /// Ends the run if a whole epoch held nothing to learn from.
    fn check_epoch<M>(&mut self, run: &mut Run<'_, M>, at: Progress) -> Result<(), TrainError> {
        let tally = std::mem::take(&mut self.tally);
        let scenes = std::mem::take(&mut run.scenes);
        if tally.counted_rows > 0 {
            return Ok(());
        }
        let scenes = scenes.into_iter().collect();
        Err(TrainError::NothingCounted { epoch: at.epoch, tally, scenes })
    }

    /// Runs `f` with the averaged parameters, if there is an average: for exports.
    ///
    /// # Errors
    /// That of `f`, or if a frozen part does not exist.
    pub fn with_average<R>(
        &self,
        params: &ParamStore,
        f: impl FnOnce() -> Result<R, TrainError>,
    ) -> Result<R, TrainError> {
        match &self.average {
            Some(average) => average.during(&Freeze::new(&self.config, params)?.trained(params), f),
            None => f(),
        }
    }
}
