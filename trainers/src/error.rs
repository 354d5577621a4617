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
    /// A checkpoint belongs to another run.
    #[error(
        "the checkpoint cannot be continued: {field} was {expected} and is {got}; set it back, or \
         start a new run from its params.safetensors"
    )]
    Resume {
        /// Which setting.
        field: &'static str,
        /// Its value in the checkpoint.
        expected: String,
        /// Its value now.
        got: String,
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
            Self::Data(_) | Self::ShortEpoch { .. } | Self::DeadParameters { .. } => self,
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

    /// For `map_err`: names the parameter of a failed tensor operation.
    pub(crate) fn tensor(name: &str) -> impl Fn(candle_core::Error) -> Self + '_ {
        move |source| Self::Tensor { name: name.to_owned(), source }
    }
}

fn hints(suspects: &[String]) -> String {
    if suspects.is_empty() { String::new() } else { format!(" ({})", suspects.join("; ")) }
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
