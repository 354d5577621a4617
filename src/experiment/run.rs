//! From an experiment's file to a trained network.

use super::compression;
use super::config::{ExperimentConfig, Task};
use super::curves::{write_curves, write_curves_page};
use super::error::{ExperimentError, Place};
use super::export::{export_model, export_self_supervised};
use super::furniture;
use super::identity::identity;
use super::measured::with_measured_effects;
use super::module::{Opened, Work, optimizer, schedule};
use super::record::{RunRecord, write};
use super::sweep::RunOutcome;
use super::teacher::TeacherRecord;
use candle_core::Device;
use scenesplat_datasets::TrainBatch;
use scenesplat_scene::FolderLock;
use scenesplat_trainers::callbacks::{JsonLines, TensorBoard, read_json_lines, write_csv};
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::{
    Alone, Callback, CheckpointConfig, Collective, DataModule, Identity, Progress, Trainer,
    TrainerConfig, TrainingModule,
};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// Makes a callback that shows a run.
pub type MakeConsole = fn() -> Box<dyn Callback>;

/// How a run is started.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Folder of everything that the run writes.
    pub out: PathBuf,
    /// Goes on from the newest checkpoint in that folder.
    pub resume: bool,
    /// Makes what shows the run, such as a [`Console`](scenesplat_trainers::callbacks::Console); nothing is shown without.
    pub console: Option<MakeConsole>,
    /// Once set, the run saves and stops.
    pub stop: Arc<AtomicBool>,
    /// Where the network is trained.
    pub device: Device,
    /// Commit that the program was built from, for the record; `None` if it is not known.
    pub commit: Option<String>,
}

/// Result of a run.
#[derive(Debug, Clone)]
pub struct RunReport {
    /// Where it stopped.
    pub progress: Progress,
    /// The last loss and the best measurement; empty on ranks that write nothing.
    pub outcome: RunOutcome,
    /// The network, as `--weights` takes it.
    pub model: PathBuf,
    /// The curves as a picture; beside it a page of the same name.
    pub curves: PathBuf,
    /// Things to know: what was loaded, scenes that were repaired or left out.
    pub remarks: Vec<String>,
}

/// Trains as the experiment says. Writes into `out`:
///
/// | file | what |
/// |---|---|
/// | `config.toml` | the experiment, files that it extends included |
/// | `run.json` | version and commit of the program, losses and classes as they were used, where it was resumed |
/// | `metrics.jsonl` | everything that was measured, one value a line |
/// | `metrics.csv` | the same as a table, one row a step; written at the end |
/// | `tensorboard/` | the same for TensorBoard |
/// | `checkpoints/` | the last ones and the best one |
/// | `curves.png`, `curves.html` | the same as a picture, and as a page that shows values |
/// | `model/` | the best network (the last, if none is marked), as `--weights` takes it |
///
/// # Errors
/// If the experiment does not fit together, data cannot be read, training fails, or another run is
/// writing to the same folder.
pub fn train(config: &ExperimentConfig, options: &RunOptions) -> Result<RunReport> {
    train_together(config, options, Rc::new(Alone))
}

/// As [`train`], as one of several ranks, on each of which the same is called: each takes an equal part of the batches
/// of a step, and rank 0 alone writes. The folder has to be one that all of them read.
///
/// # Errors
/// As [`train`]; also if the batches of a step (`trainer.accumulate`) cannot be shared evenly, or another rank is gone.
pub fn train_together(
    config: &ExperimentConfig,
    options: &RunOptions,
    collective: Rc<dyn Collective>,
) -> Result<RunReport> {
    train_with(config, options, collective, Vec::new())
}

/// As [`train_together`], with callbacks that rank 0 tells of every event.
///
/// # Errors
/// As [`train_together`]; also what a callback gives.
pub fn train_with(
    config: &ExperimentConfig,
    options: &RunOptions,
    collective: Rc<dyn Collective>,
    callbacks: Vec<Box<dyn Callback>>,
) -> Result<RunReport> {
    let leads = collective.rank() == 0;
    // Rank 0 holds it for all.
    let lock = || leads.then(|| FolderLock::acquire(&options.out)).transpose();
    let early = match options.out.is_dir() {
        true => lock()?,
        false => None,
    };
    let checkpoints = options.out.join("checkpoints");
    let newest = to_resume(options, &checkpoints)?;
    let measured = with_measured_effects(config)?;
    let config = &*measured;
    let mut opened = Opened::of(config, &options.device)?;
    std::fs::create_dir_all(&options.out).map_err(ExperimentError::io(&options.out))?;
    // Held until the end, also against a run that found no folder a moment ago.
    let _lock = early.map_or_else(lock, |lock| Ok(Some(lock)))?;
    let (text, teacher) = (opened.text.as_ref(), opened.teacher.as_ref());
    let run = Run {
        config,
        options,
        checkpoints: &checkpoints,
        newest: newest.as_deref(),
        identity: identity(config, text, &opened.params, teacher)?,
        losses: match &config.self_supervised {
            Some(settings) => settings.terms.iter().map(|term| format!("{term:?}")).collect(),
            None => opened.objective.settings(),
        },
        classes: text.map(|t| t.table.names.clone()),
        teacher: teacher.map(|t| Arc::clone(&t.record)),
        collective,
        callbacks: RefCell::new(callbacks),
    };
    let (progress, (model, more)) = opened.with_module(config, &run)?;
    let mut remarks = opened.remarks;
    let curves = options.out.join("curves.png");
    let selection = &config.trainer.checkpoint;
    let outcome = match leads {
        true => draw_curves(&options.out, &curves, selection)?,
        false => RunOutcome::default(),
    };
    remarks.extend(more);
    remarks.extend(opened.teacher.and_then(|teacher| teacher.record.remark()));
    Ok(RunReport { progress, outcome, model, curves, remarks })
}

/// The checkpoint that the run goes on from.
fn to_resume(options: &RunOptions, checkpoints: &Path) -> Result<Option<PathBuf>> {
    let newest = newest_checkpoint(checkpoints)?;
    match (options.resume, &newest) {
        (false, Some(_)) => Err(ExperimentError::HoldsRun { path: options.out.clone() }),
        (true, None) => Err(ExperimentError::NothingToResume { path: checkpoints.to_owned() }),
        _ => Ok(newest),
    }
}

/// Writes what was logged as a picture, as a page beside it, and as a table; gives what came of the training.
fn draw_curves(out: &Path, curves: &Path, selection: &CheckpointConfig) -> Result<RunOutcome> {
    let selected = selection.best.as_ref();
    let log = read_json_lines(&out.join("metrics.jsonl"))?;
    if !log.is_empty() {
        let title = out.file_name().map_or("run".into(), |n| n.to_string_lossy());
        write_curves(&log, selected, &title, curves)?;
        write_curves_page(&log, selected, &title, &curves.with_extension("html"))?;
        write_csv(&log, &out.join("metrics.csv"))?;
    }
    Ok(RunOutcome::of(&log, selection))
}

/// What `fit` needs of a run, whatever its task.
struct Run<'a> {
    config: &'a ExperimentConfig,
    options: &'a RunOptions,
    checkpoints: &'a Path,
    newest: Option<&'a Path>,
    identity: Identity,
    losses: Vec<String>,
    classes: Option<Vec<String>>,
    teacher: Option<Arc<TeacherRecord>>,
    collective: Rc<dyn Collective>,
    /// The caller's, until the training begins.
    callbacks: RefCell<Vec<Box<dyn Callback>>>,
}

/// The exported model, with remarks.
type Exported = (PathBuf, Vec<String>);

impl Work for Run<'_> {
    type Out = (Progress, Exported);

    fn with<M: TrainingModule<Batch = TrainBatch>>(
        &self,
        module: &M,
        mut data: DataModule<'_, M>,
    ) -> Result<(Progress, Exported)> {
        let mut settings: TrainerConfig = self.config.trainer.clone();
        settings.checkpoint.dir = Some(self.checkpoints.to_owned());
        let out = &self.options.out;
        let mut trainer = Trainer::new(
            settings,
            optimizer(&self.config.optimizer, module.params())?,
            schedule(self.config)?,
        )?
        .with_collective(Rc::clone(&self.collective))
        .with_identity(self.identity.clone())
        .with_stop(self.options.stop.clone());
        let leads = self.collective.rank() == 0;
        if leads {
            trainer = trainer
                .with_callback(JsonLines::new(&out.join("metrics.jsonl")))
                .with_callback(TensorBoard::new(&out.join("tensorboard")));
        }
        if let Some(console) = self.options.console.filter(|_| leads) {
            trainer = trainer.with_callback(console());
        }
        if leads {
            trainer = trainer.with_callbacks(self.callbacks.take());
        }
        if let Some(stopping) = &self.config.early_stopping {
            trainer = trainer.with_callback(stopping.callback());
        }
        let start = match self.newest {
            Some(dir) => trainer.load_checkpoint(dir, module).at(|| dir.display().to_string())?,
            None => Progress::default(),
        };
        if !leads {
            let progress = trainer.fit(module, &mut data, start)?;
            return Ok((progress, (out.join("model"), Vec::new())));
        }
        // Not before: a run that is refused leaves the record of the first one.
        let record = self.record(&trainer.identity()?.hash(), start);
        write(&out.join("config.toml"), &toml::to_string_pretty(self.config)?)?;
        record.write()?;
        let mut trainer = trainer.with_callback(record);
        let progress = trainer.fit(module, &mut data, start)?;
        let model = out.join("model");
        let network = self.config.network()?;
        let exported = self.config.self_supervised.as_ref().map(|settings| settings.export);
        let mut remarks = match exported {
            None if self.config.task == Task::Autoencoder => {
                compression::export(self.config, self.checkpoints, &model)?
            }
            None => export_model(self.checkpoints, &network, &model)?,
            Some(which) => export_self_supervised(self.checkpoints, &network, which, &model)?,
        };
        remarks.extend(furniture::attribute(self.config, &model)?);
        Ok((progress, (model, remarks)))
    }
}

impl Run<'_> {
    /// The record of the run, which begins at `start`.
    fn record(&self, experiment: &str, start: Progress) -> RunRecord {
        let commit = self.options.commit.as_deref().unwrap_or("unknown");
        let program =
            serde_json::json!({ "scenesplat": env!("CARGO_PKG_VERSION"), "commit": commit });
        let mut run = program.clone();
        run["experiment"] = experiment.into();
        run["losses"] = self.losses.clone().into();
        run["classes"] = self.classes.clone().into();
        RunRecord::new(&self.options.out, start.step, &program, run).with_teacher(&self.teacher)
    }
}
