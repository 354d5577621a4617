//! Checks of an experiment that need no data.

use super::config::{ExperimentConfig, TargetChoice, Task};
use super::error::{ExperimentError, Place};
use scenesplat_datasets::TransformConfig;
use scenesplat_losses::{ClassSourceConfig, LossConfig};
use scenesplat_models::ModelConfig;
use scenesplat_trainers::tasks::self_supervised::Export;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// A setting is refused where this holds: condition, field, problem.
type Rule<'a> = (bool, &'a str, &'a str);

/// Refuses the first setting whose condition holds.
fn refuse(rules: &[Rule<'_>]) -> Result<()> {
    match rules.iter().find(|(holds, ..)| *holds) {
        Some((_, field, problem)) => Err(ExperimentError::setting(*field, *problem)),
        None => Ok(()),
    }
}

impl ExperimentConfig {
    /// Checks what can be checked without data.
    ///
    /// # Errors
    /// Names the first field that does not fit.
    pub fn check(&self) -> Result<()> {
        self.model.check().at(|| "model".to_owned())?;
        self.trainer.check().at(|| "trainer".to_owned())?;
        self.loader.check().at(|| "loader".to_owned())?;
        self.precision()?;
        let patience = self.early_stopping.as_ref().map(|stopping| stopping.patience);
        refuse(&[
            (patience == Some(0), "early_stopping.patience", "0, expected 1 or more"),
            (self.train.is_empty(), "train", "at least one dataset is needed"),
        ])?;
        check_views(self)?;
        check_self_supervised(self)?;
        check_autoencoder(self)?;
        let own_terms = matches!(self.task, Task::SelfSupervised | Task::Autoencoder);
        let (reads, takes) = (self.input.width(), self.model.in_channels());
        refuse(&[
            (self.losses.is_empty() && !own_terms, "losses", "at least one term is needed"),
            (
                reads != takes,
                "input",
                &format!("its channels are {reads} together, but model.in_channels is {takes}"),
            ),
        ])?;
        check_teacher(self)?;
        check_training_data(self)?;
        check_task(self)
    }

    /// Whether training reads labels.
    pub(super) fn reads_labels(&self) -> bool {
        let asks = |loss: &LossConfig| matches!(loss, LossConfig::TextClassification(_));
        match self.task {
            Task::SemanticSegmentation => true,
            Task::LanguagePretraining => {
                self.targets == TargetChoice::ClassText || self.losses.iter().any(asks)
            }
            Task::Distillation => self.losses.iter().any(asks),
            Task::SelfSupervised | Task::Autoencoder => false,
        }
    }
}

/// Scenes to learn from have no points to score, and labels only where something reads them.
fn check_training_data(config: &ExperimentConfig) -> Result<()> {
    let points = config.train.iter().position(|t| t.source.asks_for_labelled_points());
    let by_classes = |loss: &LossConfig| match loss {
        LossConfig::AggregatedContrastive(c) => c.classes == ClassSourceConfig::Labels,
        _ => false,
    };
    let unread = !config.reads_labels() && !config.losses.iter().any(by_classes);
    if let Some(i) = points {
        let field = format!("train[{i}].source.labelled_points");
        refuse(&[(true, &field, "points are scored, not learned from; leave it out")])?;
    }
    for (i, entry) in config.train.iter().enumerate() {
        let Some(labels) = &entry.labels else { continue };
        labels.check().at(|| format!("train[{i}]"))?;
        let problem = "nothing that is trained reads labels; leave it out";
        refuse(&[(unread, &format!("train[{i}].labels"), problem)])?;
    }
    Ok(())
}

fn check_task(config: &ExperimentConfig) -> Result<()> {
    let head = config.model.num_classes().is_some();
    let is = |task| config.task == task;
    let by_text = config.targets == TargetChoice::ClassText;
    let dir = config.trainer.checkpoint.dir.as_ref().map(|dir| dir.display().to_string());
    refuse(&[
        (
            dir.is_some(),
            "trainer.checkpoint.dir",
            &format!(
                "{}: the checkpoints of a run are in its folder; leave it out",
                dir.unwrap_or_default()
            ),
        ),
        (
            is(Task::LanguagePretraining) && head,
            "model.num_classes",
            "language pretraining has no classifier",
        ),
        (
            is(Task::LanguagePretraining) && by_text && config.text.is_none(),
            "text",
            "targets = \"class_text\" needs it",
        ),
        (
            is(Task::SemanticSegmentation) && by_text,
            "targets",
            "segmentation learns labels and has none; leave it out",
        ),
        (is(Task::SemanticSegmentation) && !head, "model.num_classes", "segmentation needs it"),
    ])
}

/// Views are made exactly if they are compared.
fn check_views(config: &ExperimentConfig) -> Result<()> {
    let is_task = config.task == Task::SelfSupervised;
    for (i, entry) in config.train.iter().enumerate() {
        let steps = entry.transforms.steps(config.model.grid_size)?;
        let at = steps.iter().position(|step| matches!(step, TransformConfig::Views(_)));
        let field = &format!("train[{i}].transforms");
        refuse(&[
            (
                is_task && at.is_none(),
                field,
                "self-supervised training compares views: end with a `views` step",
            ),
            (!is_task && at.is_some(), field, "only task = \"self_supervised\" compares views"),
            (
                at.is_some_and(|at| at + 1 < steps.len()),
                field,
                "`views` comes last; give other steps before it or to its views",
            ),
        ])?;
    }
    Ok(())
}

/// The table is there exactly if the task is this one, and nothing besides would have no effect.
fn check_self_supervised(config: &ExperimentConfig) -> Result<()> {
    let is_task = config.task == Task::SelfSupervised;
    let Some(settings) = config.self_supervised.as_ref().filter(|_| is_task) else {
        let problem = match is_task {
            true => "the task needs this table, with its terms",
            false => "only task = \"self_supervised\" has it",
        };
        return refuse(&[(
            is_task != config.self_supervised.is_some(),
            "self_supervised",
            problem,
        )]);
    };
    settings.check().at(|| "self_supervised".to_owned())?;
    refuse(&[
        (
            !config.losses.is_empty(),
            "losses",
            "the terms are those of self_supervised.terms; leave them out",
        ),
        (
            !config.evaluate.is_empty(),
            "evaluate",
            "there are no labels to score; use `scenesplat probe` on the model",
        ),
        (
            config.text.is_some() || config.targets != TargetChoice::Features,
            "text",
            "the task has neither texts nor targets; leave text and targets out",
        ),
        (
            config.loader.mix_probability != 0.0,
            "loader.mix_probability",
            "two scenes share no view; set it to 0",
        ),
        (
            config.trainer.ema.is_some() && settings.export == Export::Teacher,
            "trainer.ema",
            "it averages the student; export that, or leave it out",
        ),
    ])
}

/// The table is there exactly if the task is this one, and nothing besides would have no effect.
fn check_autoencoder(config: &ExperimentConfig) -> Result<()> {
    let is_task = config.task == Task::Autoencoder;
    let Some(settings) = config.autoencoder.as_ref().filter(|_| is_task) else {
        let problem = match is_task {
            true => "the task needs this table, with its widths",
            false => "only task = \"autoencoder\" has it",
        };
        return refuse(&[(is_task != config.autoencoder.is_some(), "autoencoder", problem)]);
    };
    settings.check().at(|| "autoencoder".to_owned())?;
    let plain = ModelConfig { grid_size: config.model.grid_size, ..ModelConfig::default() };
    let voting = config.evaluate.iter().position(|entry| entry.vote_k.is_some());
    refuse(&[
        (
            config.model != plain,
            "model",
            "an autoencoder has its own widths; of [model] only grid_size counts",
        ),
        (
            !config.losses.is_empty(),
            "losses",
            "the terms are autoencoder.l2 and autoencoder.cosine; leave them out",
        ),
        (
            config.targets != TargetChoice::Features,
            "targets",
            "the targets are the features themselves; leave it out",
        ),
        (
            config.init_from.is_some(),
            "init_from",
            "an autoencoder begins with its own values; leave it out",
        ),
        (config.precision != "f32", "precision", "an autoencoder is trained in f32; leave it out"),
        (
            voting.is_some(),
            &format!("evaluate[{}].vote_k", voting.unwrap_or_default()),
            "features are compared row by row; leave it out",
        ),
    ])
}

/// There is a teacher exactly if the task is distillation, and nothing besides would have no effect.
fn check_teacher(config: &ExperimentConfig) -> Result<()> {
    let distills = config.task == Task::Distillation;
    refuse(&[
        (
            distills && config.teacher.is_none(),
            "teacher",
            "distillation needs one; see docs/training.md",
        ),
        (!distills && config.teacher.is_some(), "teacher", "only task = \"distillation\" has one"),
    ])?;
    let Some(teacher) = &config.teacher else { return Ok(()) };
    teacher.check()?;
    let compares = |loss: &LossConfig| loss.has_target() && loss.weight() != 0.0;
    refuse(&[
        (
            config.model.num_classes().is_some(),
            "model.num_classes",
            "a student has features, no classifier",
        ),
        (
            config.targets != TargetChoice::Features,
            "targets",
            "the targets of distillation are the teacher's rows",
        ),
        (
            !config.losses.iter().any(compares),
            "losses",
            "none compares with the teacher: add cosine, l2, smooth_l1 or text_distillation",
        ),
    ])
}
