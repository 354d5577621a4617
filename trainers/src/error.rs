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
    /// For `map_err`: names the parameter of a failed tensor operation.
    pub(crate) fn tensor(name: &str) -> impl Fn(candle_core::Error) -> Self + '_ {
        move |source| Self::Tensor { name: name.to_owned(), source }
    }
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
