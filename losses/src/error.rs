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
    let (expected, got) = (format!("[{rows}]"), format!("[{got}]"));
    Err(LossError::Shape { loss, field, expected, got })
}
