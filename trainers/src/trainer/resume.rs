//! Leaving a run on the disk, and taking it up again.

use super::{Run, Trainer};
use crate::average::Average;
use crate::checkpoint::{
    self, AVERAGE, BestCheckpoint, CheckpointState, Contents, OPTIMIZER, PARAMS,
};
use crate::event::{Event, Progress};
use crate::freeze::Freeze;
use crate::module::TrainingModule;
use crate::{Change, Identity, TrainError, TrainerConfig};
use std::path::{Path, PathBuf};

impl Trainer {
    /// The settings that a run must share to go on from a checkpoint of this one: the trainer's,
    /// optimizer's and schedule's, and those given by [`with_identity`](Self::with_identity).
    ///
    /// # Errors
    /// If a setting cannot be written as JSON.
    pub fn identity(&self) -> Result<Identity, TrainError> {
        let own = Identity::new()
            .with_settings("trainer", &self.config)?
            .with_settings("optimizer", &self.optimizer.settings())?
            .with_settings("schedule", &self.schedule.settings())?;
        let may_change = TrainerConfig::MAY_CHANGE.map(|name| format!("trainer.{name}"));
        Ok(own.without(may_change.iter().map(String::as_str)).and(self.identity.clone()))
    }

    /// Writes the run as it stands to `root/step-…`, complete or not at all; gives the folder.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save_checkpoint<M: TrainingModule>(
        &self,
        root: &Path,
        module: &M,
        batches_per_epoch: usize,
        at: Progress,
    ) -> Result<PathBuf, TrainError> {
        let states = self.callbacks.iter().filter_map(|c| c.state());
        let callbacks = states.map(|(name, state)| (name.to_owned(), state)).collect();
        let experiment = self.identity()?;
        let state = CheckpointState {
            format: checkpoint::FORMAT,
            progress: at,
            batches_per_epoch,
            experiment_hash: experiment.hash(),
            experiment,
            files: Default::default(),
            tally: self.tally,
            evaluation_due: self.evaluation_due,
            best: self.best,
            callbacks,
        };
        let contents = Contents {
            params: module.params(),
            stores: checked_stores(module)?,
            optimizer: self.optimizer.state()?,
            average: self.average.as_ref().map(Average::values),
            state,
        };
        checkpoint::write(root, contents)
    }

    /// Takes up a run where a checkpoint left it.
    ///
    /// # Errors
    /// If the folder is no checkpoint of this run (settings that differ are named with both values),
    /// a file of it is missing, was changed or holds a value that is not finite, or it does not fit
    /// the network and optimizer.
    pub fn load_checkpoint<M: TrainingModule>(
        &mut self,
        dir: &Path,
        module: &M,
    ) -> Result<Progress, TrainError> {
        let state = checkpoint::read_state(dir)?;
        state.check(&self.identity()?)?;
        // All files are read and checked before anything is set.
        let read = |name: &str| checkpoint::read_tensors(dir, &state, name);
        let params = read(PARAMS)?;
        let optimizer = read(OPTIMIZER)?;
        let average = self.config.ema.map(|decay| Ok::<_, TrainError>((decay, read(AVERAGE)?)));
        let average = average.transpose()?;
        let mut stores = Vec::new();
        for (name, store) in checked_stores(module)? {
            let file = checkpoint::store_file(name);
            stores.push((store, read(&file)?, file));
        }
        stores.push((module.params(), params, PARAMS.to_owned()));
        for (store, values, file) in stores {
            let origin = dir.join(file).display().to_string();
            store.restore_from(values, &origin).map_err(|source| TrainError::Forward { source })?;
        }
        self.optimizer.load_state(&optimizer)?;
        if let Some((decay, values)) = average {
            let freeze = Freeze::new(&self.config, module.params())?;
            let average = Average::new(&freeze.trained(module.params()), decay)?;
            average.load(&values)?;
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
        self.tally = state.tally;
        self.evaluation_due = state.evaluation_due;
        let progress = state.progress;
        self.resumed = Some(state);
        Ok(progress)
    }

    /// Checks that the data still come in as many batches.
    pub(super) fn check_batches(&mut self, batches: usize) -> Result<(), TrainError> {
        let Some(state) = self.resumed.take() else { return Ok(()) };
        if state.batches_per_epoch == batches {
            return Ok(());
        }
        let setting = "batches of an epoch".to_owned();
        let (was, is) = (state.batches_per_epoch.to_string(), batches.to_string());
        Err(TrainError::Resume { changes: vec![Change { setting, was, is }] })
    }

    pub(super) fn checkpoint<M: TrainingModule>(
        &mut self,
        run: &mut Run<'_, M>,
        at: Progress,
        best: Option<f64>,
    ) -> Result<(), TrainError> {
        run.saved = at.step;
        if self.collective.rank() != 0 {
            return Ok(());
        }
        let Some(root) = self.config.checkpoint.dir.clone() else { return Ok(()) };
        let dir = self.save_checkpoint(&root, run.module, run.batches_per_epoch, at)?;
        if let (Some(value), Some(name)) = (best, dir.file_name().and_then(|n| n.to_str())) {
            let measurement = self.config.checkpoint.best.as_ref();
            let measurement = measurement.map(ToString::to_string).unwrap_or_default();
            let checkpoint = name.to_owned();
            checkpoint::mark_best(&root, &BestCheckpoint { checkpoint, measurement, value })?;
        }
        checkpoint::prune(&root, self.config.checkpoint.keep)?;
        self.emit(&Event::Checkpoint { dir: &dir, best: best.is_some() }, at).map(|_| ())
    }
}

/// The further stores of a module, whose names must do for files.
fn checked_stores<M: TrainingModule>(
    module: &M,
) -> Result<Vec<(&'static str, &scenesplat_models::ParamStore)>, TrainError> {
    let stores = module.stores();
    for (i, (name, _)) in stores.iter().enumerate() {
        let taken = [PARAMS, OPTIMIZER, AVERAGE].contains(&checkpoint::store_file(name).as_str())
            || stores[..i].iter().any(|(other, _)| other == name);
        let plain = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
        if taken || name.is_empty() || !plain {
            let (what, name) = ("stores of the module", (*name).to_owned());
            return Err(TrainError::DuplicateName { what, name });
        }
    }
    Ok(stores)
}
