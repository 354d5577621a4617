use crate::{Change, Tally};
use candle_core::DType;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A tensor operation failed.
    #[error("tensor operation on {name}")]
    Tensor {
        /// The parameter it was about.
        name: String,
        /// Why.
        #[source]
        source: candle_core::Error,
    },
    /// The processes of a training could not go on together.
    #[error(transparent)]
    Collective(#[from] crate::collective::CollectiveError),
    /// The batches of a step cannot be shared evenly.
    #[error(
        "accumulate = {accumulate}: {ranks} ranks share the batches of a step, so it has to be a multiple of {ranks}"
    )]
    Ranks {
        /// Batches of a step.
        accumulate: u64,
        /// Processes.
        ranks: u64,
    },
    /// Statistics over all batches of a step, where they are not all at hand at once.
    #[error(
        "sync_batch_norm: statistics of all batches of a step need a process for each of them, and there {} for \
         accumulate = {accumulate}: start as many, or set accumulate = {ranks}",
        if *ranks == 1 { "is one".to_owned() } else { format!("are {ranks}") }
    )]
    SyncBatchNorm {
        /// Batches of a step.
        accumulate: u64,
        /// Processes.
        ranks: u64,
    },
    /// A batch norm that is in no store of the module.
    #[error(
        "a batch norm has statistics that are in no store of the module; with several ranks all have to be in \
         `TrainingModule::params` or `stores`"
    )]
    UnknownStatistics,
    /// Features that collapsed, and stayed so.
    #[error(
        "step {step}: the features have collapsed at {looks} looks in a row (health.stop_after): {alarms}"
    )]
    Collapsed {
        /// Steps done.
        step: u64,
        /// Looks in a row.
        looks: u64,
        /// What was found last.
        alarms: String,
    },
    /// A setting of self-supervised training that cannot be used.
    #[error("self_supervised.{setting}: {problem}")]
    SelfSupervised {
        /// Which.
        setting: &'static str,
        /// What is wrong, and what would be right.
        problem: String,
    },
    /// A gradient has a NaN or an infinity.
    #[error("gradient of {name} is not finite")]
    NonFiniteGradient {
        /// The first such parameter, by name.
        name: String,
    },
    /// A gradient whose square overflows and would freeze its parameter for good.
    #[error("gradient of {name} has norm {norm:e}: clip it, its square overflows")]
    GradientTooLarge {
        /// The first such parameter, by name.
        name: String,
        /// Euclidean norm of the gradient.
        norm: f64,
    },
    /// Two tensors that belong together differ in shape or type.
    #[error("{what} of {name}: expected {expected}, got {got}")]
    Mismatch {
        /// Which tensor, e.g. "gradient".
        what: &'static str,
        /// Of which parameter.
        name: String,
        /// Shape and type expected.
        expected: String,
        /// Shape and type found.
        got: String,
    },
    /// Parameters of this type cannot be trained.
    #[error("parameter {name} is {dtype:?}: keep trained parameters in f32 or f64")]
    DType {
        /// Which parameter.
        name: String,
        /// Its type.
        dtype: DType,
    },
    /// One parameter would be updated twice per step.
    #[error("parameter {name} is given twice, the other time as {other}")]
    DuplicateParameter {
        /// Its name.
        name: String,
        /// Its other name, or the same one in another group.
        other: String,
    },
    /// A parameter has no counterpart.
    #[error("{what}: no parameter {name}")]
    MissingParameter {
        /// Where it was looked for.
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// A saved optimizer state does not fit.
    #[error("optimizer state: {problem} entry {key}")]
    State {
        /// Name of the entry.
        key: String,
        /// "missing", "unknown" or "negative".
        problem: &'static str,
    },
    /// Something failed in a step.
    #[error("step {step}, scenes {}{}", scenes.join(", "), hints(suspects))]
    Step {
        /// Optimizer steps done before.
        step: u64,
        /// Scenes of its batches.
        scenes: Vec<String>,
        /// What in the batches is not finite; empty if the data are.
        suspects: Vec<String>,
        /// What failed.
        #[source]
        source: Box<TrainError>,
    },
    /// Model or loss failed.
    #[error("forward or backward pass")]
    Forward {
        /// Why.
        #[source]
        source: candle_core::Error,
    },
    /// A callback or evaluator of one's own failed.
    #[error("a callback or an evaluator failed")]
    Own {
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A loss has become NaN or infinite.
    #[error("{term} is {value}: lower the learning rate, clip gradients, or look at the data")]
    NonFiniteLoss {
        /// Which term of the loss, or "loss" if each term is finite.
        term: String,
        /// Its value.
        value: f64,
    },
    /// No gradient reaches some parameters.
    #[error(
        "no gradient reaches {}: an operation on the way has none, or the parameters are not used \
         (then name them in `idle`)",
        names.join(", ")
    )]
    DeadParameters {
        /// Which.
        names: Vec<String>,
    },
    /// The data end before the epoch does.
    #[error("epoch {epoch} has fewer than {expected} batches")]
    ShortEpoch {
        /// Which epoch.
        epoch: u64,
        /// Batches that were needed at least.
        expected: u64,
    },
    /// A scene that shall be evaluated on has no labels.
    #[error("scene {scene} has no labels to evaluate on")]
    NoLabels {
        /// Which.
        scene: String,
    },
    /// A scene that a student and its teacher shall be compared on comes without rows of a teacher.
    #[error("scene {scene} comes without rows of a teacher")]
    NoTeacher {
        /// Which.
        scene: String,
    },
    /// A checkpoint belongs to another run.
    #[error(
        "the checkpoint cannot be continued: {}; set it back, or start a new run from its \
         params.safetensors",
        list_changes(changes)
    )]
    Resume {
        /// The settings that differ.
        changes: Vec<Change>,
    },
    /// A file of a checkpoint is not what was written.
    #[error(
        "{} {problem}; remove its folder to go on from the checkpoint before it",
        path.display()
    )]
    Damaged {
        /// Which file.
        path: std::path::PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// Something cannot be written down.
    #[error("{what}: {problem}")]
    Unwritable {
        /// What.
        what: String,
        /// Why.
        problem: String,
    },
    /// A measurement that decides something is given by no evaluation.
    #[error("{setting}: no evaluation gives {name:?}; {}", list_known(known))]
    UnknownMeasurement {
        /// Where the name stands.
        setting: &'static str,
        /// The name.
        name: String,
        /// Names that exist.
        known: Vec<String>,
    },
    /// An evaluator gave a measurement that it had not named beforehand.
    #[error("the evaluator {evaluator} measured {name:?}, which it does not list")]
    UnlistedMeasurement {
        /// Name of the evaluator.
        evaluator: String,
        /// Name of the measurement.
        name: String,
    },
    /// Two things have one name.
    #[error("two {what} are called {name:?}: give each a name of its own")]
    DuplicateName {
        /// What they are.
        what: &'static str,
        /// Their name.
        name: String,
    },
    /// A part of a parameter's name that no parameter has.
    #[error("{setting}: no parameter's name contains {part:?}; there are {}", sample(names))]
    NoSuchParameter {
        /// Where it stands.
        setting: &'static str,
        /// The part.
        part: String,
        /// Names of parameters.
        names: Vec<String>,
    },
    /// Every parameter is frozen.
    #[error("freeze leaves no parameter to train")]
    AllFrozen,
    /// A whole epoch held nothing to learn from.
    #[error(
        "nothing to train on: in epoch {epoch}, none of {} rows in {} batches ({} of them empty) \
         counts for the loss (no label, or no target feature); the scenes were {}",
        tally.rows, tally.batches, tally.empty_batches, sample(scenes)
    )]
    NothingCounted {
        /// Which epoch.
        epoch: u64,
        /// What was in it.
        tally: Tally,
        /// Scenes of its batches.
        scenes: Vec<String>,
    },
    /// More of the data was left out than a run may leave out.
    #[error(
        "{name}: {left_out} of {of} {what} were left out, more than max_left_out = {limit} allows; {}",
        sample(reasons)
    )]
    TooMuchLeftOut {
        /// `train`, or the name of an evaluator.
        name: String,
        /// "scenes" or "rows".
        what: &'static str,
        /// How many were left out.
        left_out: usize,
        /// How many there are.
        of: usize,
        /// Largest share.
        limit: f64,
        /// Reasons, one a scene.
        reasons: Vec<String>,
    },
    /// An evaluation saw no labeled row.
    #[error("evaluation {name}: none of its {scenes} scenes has a labeled row")]
    NothingMeasured {
        /// Which evaluation.
        name: String,
        /// Scenes that were looked at.
        scenes: usize,
    },
    /// A file of the run.
    #[error("{action} {}", path.display())]
    Io {
        /// Which file or folder.
        path: std::path::PathBuf,
        /// What was tried, e.g. "cannot write".
        action: &'static str,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A file of the run that could not be written.
    #[error(transparent)]
    Write(#[from] scenesplat_scene::WriteError),
    /// A file of the run that could not be read.
    #[error(transparent)]
    Read(#[from] scenesplat_scene::SceneError),
    /// Data.
    #[error(transparent)]
    Data(#[from] scenesplat_datasets::DataError),
    /// A metric.
    #[error(transparent)]
    Metric(#[from] scenesplat_metrics::MetricError),
    /// A setting lies outside its range.
    #[error("{field} is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        field: &'static str,
        /// Value found.
        value: f64,
        /// What would be valid.
        expected: &'static str,
    },
}

impl TrainError {
    /// Adds where it happened. `suspects`: what in the batch is not finite.
    pub(crate) fn in_step(self, step: u64, scenes: Vec<String>, suspects: Vec<String>) -> Self {
        match self {
            // Says itself what is missing where.
            Self::Data(_)
            | Self::ShortEpoch { .. }
            | Self::DeadParameters { .. }
            | Self::NothingCounted { .. } => self,
            source => Self::Step { step, scenes, suspects, source: Box::new(source) },
        }
    }

    /// For `map_err`: names the file, and what could not be done with it.
    pub(crate) fn io(
        path: &std::path::Path,
        action: &'static str,
    ) -> impl Fn(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Io { path: path.clone(), action, source }
    }

    /// For `map_err` in callbacks and evaluators of one's own: any error type will do. Errors of candle become this by `?`.
    pub fn own(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Own { source: error.into() }
    }

    /// For `map_err`: names the parameter of a failed tensor operation.
    pub(crate) fn tensor(name: &str) -> impl Fn(candle_core::Error) -> Self + '_ {
        move |source| Self::Tensor { name: name.to_owned(), source }
    }
}

impl From<candle_core::Error> for TrainError {
    fn from(error: candle_core::Error) -> Self {
        Self::own(error)
    }
}

fn hints(suspects: &[String]) -> String {
    if suspects.is_empty() { String::new() } else { format!(" ({})", suspects.join("; ")) }
}

/// The changes, most of them.
fn list_changes(changes: &[Change]) -> String {
    const SHOWN: usize = 6;
    let one = |c: &Change| format!("{} was {} and is {}", c.setting, c.was, c.is);
    // Another kind of thing explains that its settings are others.
    let (kinds, rest): (Vec<_>, Vec<_>) =
        changes.iter().partition(|c| c.setting == "task" || c.setting.ends_with(".type"));
    let mut text =
        kinds.into_iter().chain(rest).take(SHOWN).map(one).collect::<Vec<_>>().join(", ");
    if changes.len() > SHOWN {
        text.push_str(&format!(", and {} more", changes.len() - SHOWN));
    }
    text
}

fn list_known(known: &[String]) -> String {
    match known {
        [] => "there is no evaluation".to_owned(),
        known => format!("there are {}", known.join(", ")),
    }
}

/// Some of many names.
fn sample(names: &[String]) -> String {
    const SHOWN: usize = 8;
    let mut text = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > SHOWN {
        text.push_str(&format!(", … {} more", names.len() - SHOWN));
    }
    text
}

/// Checks a setting against a range.
pub(crate) fn check_setting(
    field: &'static str,
    value: f64,
    valid: bool,
    expected: &'static str,
) -> Result<(), TrainError> {
    if valid { Ok(()) } else { Err(TrainError::Setting { field, value, expected }) }
}
