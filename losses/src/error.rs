//! What can be wrong with the input of a loss.

/// Errors of the losses. They reach callers as messages of [`candle_core::Error`], whose `Result`
/// operations share.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LossError {
    /// A field of the input is missing.
    #[error("{loss}: needs `{field}`, which this task does not give")]
    Missing {
        /// Which loss.
        loss: &'static str,
        /// Field of [`LossInput`](crate::LossInput).
        field: &'static str,
    },
    /// A field has the wrong shape.
    #[error("{loss}: {field}: expected {expected}, got {got}")]
    Shape {
        /// Which loss.
        loss: &'static str,
        /// Which field.
        field: &'static str,
        /// Shape expected.
        expected: String,
        /// Shape found.
        got: String,
    },
    /// A type that cannot be computed with.
    #[error("{loss}: {field}: expected f32, f64, bf16 or f16, got {got}")]
    Type {
        /// Which loss.
        loss: &'static str,
        /// Which field.
        field: &'static str,
        /// Type and device found.
        got: String,
    },
    /// A value that counts is NaN or infinite.
    #[error("{loss}: {field}[{row}, {column}] is {value}; the row counts, so it must be finite")]
    NotFinite {
        /// Which loss.
        loss: &'static str,
        /// Which field.
        field: &'static str,
        /// First row with such a value.
        row: usize,
        /// Its first such channel.
        column: usize,
        /// The value.
        value: f64,
    },
    /// A label is neither a class nor [`IGNORE`](crate::IGNORE).
    #[error("{loss}: label[{row}] is {value}, expected -1 (ignore) or a class in 0..{classes}")]
    Label {
        /// Which loss.
        loss: &'static str,
        /// First such row.
        row: usize,
        /// The label.
        value: i32,
        /// Number of classes.
        classes: usize,
    },
    /// A setting is outside its range.
    #[error("{loss}: {setting} is {value}, expected {expected}")]
    Setting {
        /// Which loss, or the objective.
        loss: &'static str,
        /// Which setting.
        setting: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
}

impl From<LossError> for candle_core::Error {
    fn from(error: LossError) -> Self {
        Self::wrap(error)
    }
}

impl LossError {
    /// A field whose shape is not the expected one.
    pub(crate) fn shape(
        loss: &'static str,
        field: &'static str,
        expected: impl Into<String>,
        got: &[usize],
    ) -> Self {
        Self::Shape { loss, field, expected: expected.into(), got: format!("{got:?}") }
    }
}

/// Checks a setting.
pub(crate) fn check_setting(
    loss: &'static str,
    setting: &'static str,
    value: f64,
    good: bool,
    expected: &'static str,
) -> Result<(), LossError> {
    if good {
        return Ok(());
    }
    Err(LossError::Setting { loss, setting, value: value.to_string(), expected })
}

/// Checks a setting that is finite and above 0.
pub(crate) fn check_positive(
    loss: &'static str,
    setting: &'static str,
    value: f64,
) -> Result<(), LossError> {
    let good = value > 0.0 && value.is_finite();
    check_setting(loss, setting, value, good, "a finite number above 0")
}

/// Checks label smoothing and weights of classes.
pub(crate) fn check_smoothing(
    loss: &'static str,
    smoothing: f64,
    class_weights: Option<&[f64]>,
) -> Result<(), LossError> {
    let share = (0.0..1.0).contains(&smoothing);
    check_setting(loss, "label_smoothing", smoothing, share, "0..1")?;
    class_weights.into_iter().flatten().try_for_each(|&weight| {
        let good = weight.is_finite() && weight >= 0.0;
        check_setting(loss, "class_weights", weight, good, "finite numbers ≥ 0")
    })
}

/// Checks that an array of the host has a value for each row.
pub(crate) fn check_len(
    loss: &'static str,
    field: &'static str,
    rows: usize,
    got: usize,
) -> Result<(), LossError> {
    if rows == got {
        return Ok(());
    }
    Err(LossError::shape(loss, field, format!("[{rows}]"), &[got]))
}
