//! From an experiment to the module that learns, with its data and optimizer.

use super::compression;
use super::config::{
    EvaluationConfig, ExperimentConfig, OptimizerConfig, ScheduleConfig, TargetChoice, Task,
};
use super::data;
use super::error::{ExperimentError, Place};
use super::teacher::Teacher;
use crate::NetworkConfig;
use candle_core::Device;
use scenesplat_datasets::{Dataset, TrainBatch};
use scenesplat_losses::{Objective, TextColumns, build_objective};
use scenesplat_models::weights::{SourceOptions, WeightSource, resolve};
use scenesplat_models::{LoadPolicy, ParamStore};
use scenesplat_trainers::evaluators::{
    DistillationEvaluator, SceneEvaluator, SegmentationEvaluator, ZeroShotEvaluator,
};
use scenesplat_trainers::tasks::self_supervised::SelfSupervised;
use scenesplat_trainers::tasks::{
    Distillation, LanguagePretraining, SemanticSegmentation, TargetSource, TaskModule,
};
use scenesplat_trainers::{
    AdamW, DataModule, Evaluator, Optimizer, Schedule, TrainingModule, WithWeightDecay,
    group_by_keyword,
};
use std::sync::Arc;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// What is done with the module of an experiment, whatever its task.
pub(super) trait Work {
    /// What comes of it.
    type Out;

    /// Does it.
    fn with<M: TrainingModule<Batch = TrainBatch>>(
        &self,
        module: &M,
        data: DataModule<'_, M>,
    ) -> Result<Self::Out>;
}

/// What the module of an experiment is made of.
pub(super) struct Opened {
    pub(super) text: Option<data::ClassTexts>,
    pub(super) teacher: Option<Teacher>,
    pub(super) params: ParamStore,
    /// What was taken of the weights to start from.
    pub(super) remarks: Vec<String>,
    pub(super) objective: Objective,
}

impl Opened {
    /// Reads texts, teacher and first values, and checks that they fit together.
    pub(super) fn of(config: &ExperimentConfig, device: &Device) -> Result<Self> {
        let text = config.text.as_ref().map(data::text_table).transpose()?;
        data::check_classes(config, text.as_ref())?;
        let teacher = Teacher::open(config)?;
        check_texts(config, text.as_ref())?;
        let (params, remarks) = parameters(config, device)?;
        let loss_texts = match &text {
            Some(t) => Some(TextColumns::new(&t.table.values, t.table.dim)?),
            None => None,
        };
        let objective = match config.task {
            Task::SelfSupervised | Task::Autoencoder => Objective::new(),
            _ => build_objective(&config.losses, loss_texts.as_ref())?,
        };
        Ok(Self { text, teacher, params, remarks, objective })
    }

    /// Builds the module of the task, which takes the objective, and does the work with it.
    pub(super) fn with_module<W: Work>(
        &mut self,
        config: &ExperimentConfig,
        work: &W,
    ) -> Result<W::Out> {
        let objective = std::mem::replace(&mut self.objective, Objective::new());
        let (text, teacher) = (self.text.as_ref(), self.teacher.as_ref());
        let params = self.params.clone();
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
                work.with(&module, DataModule { train, evaluators: boxed(evaluators) })
            }
            Task::Distillation => {
                let network = network()?;
                let module = TaskModule::new(params, network, objective, Distillation);
                let evaluators = zero_shot(config, text, teacher)?.into_iter();
                let evaluators = evaluators.map(DistillationEvaluator::new);
                work.with(&module, DataModule { train, evaluators: boxed(evaluators) })
            }
            Task::Autoencoder => {
                let module = compression::module(config, params)?;
                let evaluators = compression::evaluators(config, text)?;
                work.with(&module, DataModule { train, evaluators })
            }
            Task::SelfSupervised => {
                let none =
                    || ExperimentError::setting("self_supervised", "the task needs this table");
                let settings = config.self_supervised.as_ref().ok_or_else(none)?;
                let NetworkConfig { model, input } = config.network()?;
                let seed = config.model_seed;
                let module = SelfSupervised::new(settings, &model, &input, params, seed)?;
                work.with(&module, DataModule { train, evaluators: Vec::new() })
            }
            Task::SemanticSegmentation => {
                let network = network()?;
                let module = TaskModule::new(params, network, objective, SemanticSegmentation);
                let evaluators = boxed(segmentation(config, text)?.into_iter());
                work.with(&module, DataModule { train, evaluators })
            }
        }
    }
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
    config.evaluations().iter().map(evaluator).collect()
}

/// The optimizer of parameters.
pub(super) fn optimizer(
    config: &OptimizerConfig,
    params: &ParamStore,
) -> Result<Box<dyn Optimizer>> {
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

/// How the rate varies.
pub(super) fn schedule(config: &ExperimentConfig) -> Result<Box<dyn Schedule>> {
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
