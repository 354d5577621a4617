//! From an experiment's file to a trained network.

use super::compression;
use super::config::{
    EvaluationConfig, ExperimentConfig, OptimizerConfig, ScheduleConfig, TargetChoice, Task,
};
use super::curves::{write_curves, write_curves_page};
use super::data;
use super::error::{ExperimentError, Place};
use super::export::{export_model, export_self_supervised};
use super::furniture;
use super::identity::identity;
use super::measured::with_measured_effects;
use super::record::{RunRecord, write};
use super::teacher::{Teacher, TeacherRecord};
use crate::NetworkConfig;
use candle_core::Device;
use scenesplat_datasets::{Dataset, TrainBatch};
use scenesplat_losses::{Objective, TextColumns, build_objective};
use scenesplat_models::weights::{SourceOptions, WeightSource, resolve};
use scenesplat_models::{LoadPolicy, ParamStore};
use scenesplat_scene::FolderLock;
use scenesplat_trainers::callbacks::{
    Console, EarlyStopping, JsonLines, TensorBoard, read_json_lines,
};
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::evaluators::{
    DistillationEvaluator, SceneEvaluator, SegmentationEvaluator, ZeroShotEvaluator,
};
use scenesplat_trainers::tasks::self_supervised::SelfSupervised;
use scenesplat_trainers::tasks::{
    Distillation, LanguagePretraining, SemanticSegmentation, TargetSource, TaskModule,
};
use scenesplat_trainers::{
    AdamW, Alone, Callback, Collective, DataModule, Evaluator, Identity, Optimizer, Progress,
    Schedule, Trainer, TrainerConfig, TrainingModule, WithWeightDecay, group_by_keyword,
};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// How a run is started.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Folder of everything that the run writes.
    pub out: PathBuf,
    /// Goes on from the newest checkpoint in that folder.
    pub resume: bool,
    /// Shows nothing.
    pub quiet: bool,
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
    let text = config.text.as_ref().map(data::text_table).transpose()?;
    data::check_classes(config, text.as_ref())?;
    let teacher = Teacher::open(config)?;
    check_texts(config, text.as_ref())?;
    std::fs::create_dir_all(&options.out).map_err(ExperimentError::io(&options.out))?;
    // Held until the end, also against a run that found no folder a moment ago.
    let _lock = early.map_or_else(lock, |lock| Ok(Some(lock)))?;
    let (params, mut remarks) = parameters(config, &options.device)?;
    let loss_texts = match &text {
        Some(t) => Some(TextColumns::new(&t.table.values, t.table.dim)?),
        None => None,
    };
    let objective = match config.task {
        Task::SelfSupervised | Task::Autoencoder => Objective::new(),
        _ => build_objective(&config.losses, loss_texts.as_ref())?,
    };
    let run = Run {
        config,
        options,
        checkpoints: &checkpoints,
        newest: newest.as_deref(),
        identity: identity(config, text.as_ref(), &params, teacher.as_ref())?,
        losses: match &config.self_supervised {
            Some(settings) => settings.terms.iter().map(|term| format!("{term:?}")).collect(),
            None => objective.settings(),
        },
        classes: text.as_ref().map(|t| t.table.names.clone()),
        teacher: teacher.as_ref().map(|t| Arc::clone(&t.record)),
        collective,
        callbacks: RefCell::new(callbacks),
    };
    let objects = (text.as_ref(), teacher.as_ref());
    let (progress, (model, more)) = run.fit_task(params, objective, objects)?;
    let curves = options.out.join("curves.png");
    if leads {
        draw_curves(&options.out, &curves)?;
    }
    remarks.extend(more);
    remarks.extend(teacher.and_then(|teacher| teacher.record.remark()));
    Ok(RunReport { progress, model, curves, remarks })
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

/// Draws what was logged into a picture and a page beside it.
fn draw_curves(out: &Path, curves: &Path) -> Result<()> {
    let log = read_json_lines(&out.join("metrics.jsonl"))?;
    if !log.is_empty() {
        let title = out.file_name().map_or("run".into(), |n| n.to_string_lossy());
        write_curves(&log, &title, curves)?;
        write_curves_page(&log, &title, &curves.with_extension("html"))?;
    }
    Ok(())
}

/// First values of the parameters, with remarks.
fn parameters(config: &ExperimentConfig, device: &Device) -> Result<(ParamStore, Vec<String>)> {
    let Some(path) = &config.init_from else {
        return Ok((ParamStore::trainable(config.model_seed).on(device), Vec::new()));
    };
    let files = resolve(path).at(|| path.display().to_string())?.files;
    let source = WeightSource::files(files, SourceOptions::default())?;
    let source = source.unwrapped(|shapes| config.model.fits(shapes))?;
    let params = ParamStore::trainable_from(source, config.model_seed).on(device);
    // A trial build asks for every name, so that the report is complete before training begins.
    config.model.build(params.builder())?;
    let report = params.report();
    report.check(LoadPolicy::Partial, &path.display().to_string())?;
    Ok((params, vec![format!("{}: {report}", path.display())]))
}

/// Checks that a student's features can be compared with the texts.
fn check_texts(config: &ExperimentConfig, text: Option<&data::ClassTexts>) -> Result<()> {
    let width = config.model.out_channels();
    match text {
        Some(text) if config.task == Task::Distillation && text.table.dim != width => {
            let problem = format!(
                "the texts are {} wide and the features {width}; take the texts that the teacher was \
                 trained with",
                text.table.dim
            );
            Err(ExperimentError::setting("text", problem))
        }
        _ => Ok(()),
    }
}

fn boxed<E: Evaluator<TaskModule> + 'static>(
    evaluators: impl Iterator<Item = E>,
) -> Vec<Box<dyn Evaluator<TaskModule>>> {
    evaluators.map(|e| -> Box<dyn Evaluator<TaskModule>> { Box::new(e) }).collect()
}

fn zero_shot(
    config: &ExperimentConfig,
    text: Option<&data::ClassTexts>,
    teacher: Option<&Teacher>,
) -> Result<Vec<ZeroShotEvaluator>> {
    evaluators(config, text, teacher, |name, data, text, excluded| {
        let none = || ExperimentError::setting("text", "zero-shot evaluation needs it");
        let (table, input) = (text.ok_or_else(none)?.table.clone(), config.input.clone());
        Ok(ZeroShotEvaluator::new(name, data, input, table, excluded))
    })
}

fn segmentation(
    config: &ExperimentConfig,
    text: Option<&data::ClassTexts>,
) -> Result<Vec<SegmentationEvaluator>> {
    evaluators(config, text, None, |name, data, _, excluded| {
        Ok(SegmentationEvaluator::new(name, data, config.input.clone(), excluded))
    })
}

/// The evaluators of the experiment's scenes, each made of its name, its data, its texts, and the classes that do
/// not count.
fn evaluators<L>(
    config: &ExperimentConfig,
    text: Option<&data::ClassTexts>,
    teacher: Option<&Teacher>,
    new: impl Fn(
        &str,
        Arc<dyn Dataset>,
        Option<&data::ClassTexts>,
        Vec<usize>,
    ) -> Result<SceneEvaluator<L>>,
) -> Result<Vec<SceneEvaluator<L>>> {
    let evaluator = |entry: &EvaluationConfig| {
        let own = entry.text.as_ref().map(data::text_table).transpose()?;
        let text = own.as_ref().or(text);
        let excluded = data::excluded(&entry.source, text)?;
        let found = new(&entry.name, data::evaluation(entry, config, teacher)?, text, excluded)?;
        Ok(match entry.vote_k {
            Some(k) => found.with_vote(k),
            None => found,
        })
    };
    config.evaluate.iter().map(evaluator).collect()
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

impl Run<'_> {
    /// Trains the module of the task.
    fn fit_task(
        &self,
        params: ParamStore,
        objective: Objective,
        (text, teacher): (Option<&data::ClassTexts>, Option<&Teacher>),
    ) -> Result<(Progress, Exported)> {
        let config = self.config;
        let train = data::loader(config, teacher)?;
        let network =
            || config.network()?.model.build(params.builder()).map_err(ExperimentError::from);
        match config.task {
            Task::LanguagePretraining => {
                let targets = match (config.targets, text) {
                    (TargetChoice::ClassText, Some(t)) => TargetSource::class_text(&t.table)?,
                    _ => TargetSource::Features,
                };
                let (network, task) = (network()?, LanguagePretraining { targets });
                let module = TaskModule::new(params, network, objective, task);
                let evaluators = zero_shot(config, text, None)?.into_iter();
                self.fit(&module, DataModule { train, evaluators: boxed(evaluators) })
            }
            Task::Distillation => {
                let network = network()?;
                let module = TaskModule::new(params, network, objective, Distillation);
                let evaluators = zero_shot(config, text, teacher)?.into_iter();
                let evaluators = evaluators.map(DistillationEvaluator::new);
                self.fit(&module, DataModule { train, evaluators: boxed(evaluators) })
            }
            Task::Autoencoder => {
                let module = compression::module(config, params)?;
                let evaluators = compression::evaluators(config, text)?;
                self.fit(&module, DataModule { train, evaluators })
            }
            Task::SelfSupervised => {
                let none =
                    || ExperimentError::setting("self_supervised", "the task needs this table");
                let settings = config.self_supervised.as_ref().ok_or_else(none)?;
                let NetworkConfig { model, input } = config.network()?;
                let seed = config.model_seed;
                let module = SelfSupervised::new(settings, &model, &input, params, seed)?;
                self.fit(&module, DataModule { train, evaluators: Vec::new() })
            }
            Task::SemanticSegmentation => {
                let network = network()?;
                let module = TaskModule::new(params, network, objective, SemanticSegmentation);
                let evaluators = boxed(segmentation(config, text)?.into_iter());
                self.fit(&module, DataModule { train, evaluators })
            }
        }
    }

    fn fit<M: TrainingModule<Batch = TrainBatch>>(
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
        if leads && !self.options.quiet {
            trainer = trainer.with_callback(Console::new());
        }
        if leads {
            trainer = trainer.with_callbacks(self.callbacks.take());
        }
        if let Some(e) = &self.config.early_stopping {
            trainer = trainer.with_callback(EarlyStopping::new(
                e.measurement.clone(),
                e.patience,
                e.smaller_is_better,
            ));
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

fn optimizer(config: &OptimizerConfig, params: &ParamStore) -> Result<Box<dyn Optimizer>> {
    let groups =
        group_by_keyword(&params.parameters(), config.lr, config.weight_decay, &config.groups);
    for (rule, group) in config.groups.iter().zip(&groups[1..]) {
        if group.params.is_empty() {
            let problem = format!("no parameter's name contains {:?}", rule.keyword);
            return Err(ExperimentError::setting("optimizer.groups", problem));
        }
    }
    Ok(Box::new(AdamW::new(groups, config.adamw)?))
}

fn schedule(config: &ExperimentConfig) -> Result<Box<dyn Schedule>> {
    let rate: Box<dyn Schedule> = match &config.schedule {
        ScheduleConfig::OneCycle(cycle) => {
            cycle.check()?;
            Box::new(*cycle)
        }
        ScheduleConfig::Cosine(cosine) => {
            cosine.check()?;
            Box::new(*cosine)
        }
    };
    Ok(match config.optimizer.weight_decay_schedule {
        Some(decay) => {
            decay.check().at(|| "optimizer.weight_decay_schedule".to_owned())?;
            Box::new(WithWeightDecay { rate, decay })
        }
        None => rate,
    })
}
