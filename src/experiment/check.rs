//! Checks of an experiment that need no data.

use super::config::{ExperimentConfig, TargetChoice, Task};
use super::error::{ExperimentError, Place};
use super::limited::check_limits;
use scenesplat_datasets::TransformConfig;
use scenesplat_losses::{ClassSourceConfig, LossConfig};
use scenesplat_metrics::MAX_VOTERS;
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
            (
                self.early_stopping
                    .as_ref()
                    .is_some_and(|e| !(e.min_delta >= 0.0 && e.min_delta.is_finite())),
                "early_stopping.min_delta",
                "expected 0 or more",
            ),
        ])?;
        check_limits(self)?;
        check_views(self)?;
        check_self_supervised(self)?;
        check_autoencoder(self)?;
        let own_terms = matches!(self.task, Task::SelfSupervised | Task::Autoencoder);
        let (reads, takes) = (self.input.width(), self.model.in_channels());
        let unequal =
            format!("its channels are {reads} together, but model.in_channels is {takes}");
        refuse(&[
            (self.losses.is_empty() && !own_terms, "losses", "at least one term is needed"),
            (reads != takes, "input", &unequal),
        ])?;
        check_teacher(self)?;
        check_votes(self)?;
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

/// Few enough neighbors vote.
fn check_votes(c: &ExperimentConfig) -> Result<()> {
    for (i, entry) in c.evaluate.iter().enumerate() {
        let problem = format!("at most {MAX_VOTERS} neighbors vote");
        let too_many = entry.vote_k.is_some_and(|k| k > MAX_VOTERS);
        refuse(&[(too_many, &format!("evaluate[{i}].vote_k"), &problem)])?;
    }
    Ok(())
}

/// Scenes to learn from have no points to score, and labels only where something reads them.
fn check_training_data(c: &ExperimentConfig) -> Result<()> {
    let points = c.train.iter().position(|t| t.source.asks_for_labelled_points());
    let by_classes = |loss: &LossConfig| match loss {
        LossConfig::AggregatedContrastive(c) => c.classes == ClassSourceConfig::Labels,
        _ => false,
    };
    let unread = !c.reads_labels() && !c.losses.iter().any(by_classes);
    if let Some(i) = points {
        let field = format!("train[{i}].source.labelled_points");
        refuse(&[(true, &field, "points are scored, not learned from; leave it out")])?;
    }
    for (i, entry) in c.train.iter().enumerate() {
        let Some(labels) = &entry.labels else { continue };
        labels.check().at(|| format!("train[{i}]"))?;
        let problem = "nothing that is trained reads labels; leave it out";
        refuse(&[(unread, &format!("train[{i}].labels"), problem)])?;
    }
    Ok(())
}

fn check_task(c: &ExperimentConfig) -> Result<()> {
    let head = c.model.num_classes().is_some();
    let language = c.task == Task::LanguagePretraining;
    let segmentation = c.task == Task::SemanticSegmentation;
    let by_text = c.targets == TargetChoice::ClassText;
    let no_text = by_text && c.text.is_none();
    let dir = c.trainer.checkpoint.dir.as_ref().map(|dir| dir.display().to_string());
    let own_dir = "the checkpoints of a run are in its folder; leave it out";
    let own_dir = format!("{}: {own_dir}", dir.as_deref().unwrap_or_default());
    let no_target = "segmentation learns labels and has none; leave it out";
    refuse(&[
        (dir.is_some(), "trainer.checkpoint.dir", &own_dir),
        (language && head, "model.num_classes", "language pretraining has no classifier"),
        (language && no_text, "text", "targets = \"class_text\" needs it"),
        (segmentation && by_text, "targets", no_target),
        (segmentation && !head, "model.num_classes", "segmentation needs it"),
    ])
}

/// Views are made exactly if they are compared.
fn check_views(c: &ExperimentConfig) -> Result<()> {
    let is_task = c.task == Task::SelfSupervised;
    for (i, entry) in c.train.iter().enumerate() {
        let steps = entry.transforms.steps(c.model.grid_size)?;
        let at = steps.iter().position(|step| matches!(step, TransformConfig::Views(_)));
        let field = &format!("train[{i}].transforms");
        let missing = "self-supervised training compares views: end with a `views` step";
        let order = "`views` comes last; give other steps before it or to its views";
        refuse(&[
            (is_task && at.is_none(), field, missing),
            (!is_task && at.is_some(), field, "only task = \"self_supervised\" compares views"),
            (at.is_some_and(|at| at + 1 < steps.len()), field, order),
        ])?;
    }
    Ok(())
}

/// A table of a task is there exactly if the task is this one. Gives the table of the task.
fn own_table<'a, T>(
    (name, parts): (&str, &str),
    table: &'a Option<T>,
    is_task: bool,
) -> Result<Option<&'a T>> {
    let missing = format!("the task needs this table, with its {parts}");
    let foreign = format!("only task = {name:?} has it");
    refuse(&[
        (is_task && table.is_none(), name, &missing),
        (!is_task && table.is_some(), name, &foreign),
    ])?;
    Ok(table.as_ref())
}

fn check_self_supervised(c: &ExperimentConfig) -> Result<()> {
    let (name, is_task) = ("self_supervised", c.task == Task::SelfSupervised);
    let table = own_table((name, "terms"), &c.self_supervised, is_task)?;
    let Some(settings) = table else { return Ok(()) };
    settings.check().at(|| name.to_owned())?;
    let terms = "the terms are those of self_supervised.terms; leave them out";
    let labels = "there are no labels to score; use `scenesplat probe` on the model";
    let has_text = c.text.is_some() || c.targets != TargetChoice::Features;
    let texts = "the task has neither texts nor targets; leave text and targets out";
    let mixes = c.loader.mix_probability != 0.0;
    let averages = c.trainer.ema.is_some() && settings.export == Export::Teacher;
    let average = "it averages the student; export that, or leave it out";
    refuse(&[
        (!c.losses.is_empty(), "losses", terms),
        (!c.evaluate.is_empty(), "evaluate", labels),
        (has_text, "text", texts),
        (mixes, "loader.mix_probability", "two scenes share no view; set it to 0"),
        (averages, "trainer.ema", average),
    ])
}

fn check_autoencoder(c: &ExperimentConfig) -> Result<()> {
    let (name, is_task) = ("autoencoder", c.task == Task::Autoencoder);
    let table = own_table((name, "widths"), &c.autoencoder, is_task)?;
    let Some(settings) = table else { return Ok(()) };
    settings.check().at(|| name.to_owned())?;
    let plain = ModelConfig { grid_size: c.model.grid_size, ..ModelConfig::default() };
    let widths = "an autoencoder has its own widths; of [model] only grid_size counts";
    let terms = "the terms are autoencoder.l2 and autoencoder.cosine; leave them out";
    let targets = "the targets are the features themselves; leave it out";
    let values = "an autoencoder begins with its own values; leave it out";
    let voting = c.evaluate.iter().position(|entry| entry.vote_k.is_some());
    let vote = format!("evaluate[{}].vote_k", voting.unwrap_or_default());
    refuse(&[
        (c.model != plain, "model", widths),
        (!c.losses.is_empty(), "losses", terms),
        (c.targets != TargetChoice::Features, "targets", targets),
        (c.init_from.is_some(), "init_from", values),
        (c.precision != "f32", "precision", "an autoencoder is trained in f32; leave it out"),
        (voting.is_some(), &vote, "features are compared row by row; leave it out"),
    ])
}

/// There is a teacher exactly if the task is distillation, and nothing besides would have no effect.
fn check_teacher(c: &ExperimentConfig) -> Result<()> {
    let distills = c.task == Task::Distillation;
    let missing = distills && c.teacher.is_none();
    let foreign = !distills && c.teacher.is_some();
    refuse(&[
        (missing, "teacher", "distillation needs one; see docs/training.md"),
        (foreign, "teacher", "only task = \"distillation\" has one"),
    ])?;
    let Some(teacher) = &c.teacher else { return Ok(()) };
    teacher.check()?;
    let head = c.model.num_classes().is_some();
    let has_targets = c.targets != TargetChoice::Features;
    let compares = |loss: &LossConfig| loss.has_target() && loss.weight() != 0.0;
    let none = "none compares with the teacher: add cosine, l2, smooth_l1 or text_distillation";
    refuse(&[
        (head, "model.num_classes", "a student has features, no classifier"),
        (has_targets, "targets", "the targets of distillation are the teacher's rows"),
        (!c.losses.iter().any(compares), "losses", none),
    ])
}
