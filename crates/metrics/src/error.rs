use crate::OracleFailure;
use scenesplat_kernels::neighbors::NeighborError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MetricError {
    /// Arrays that belong together differ in length.
    #[error("{what}: expected {expected} rows, got {got}")]
    RowCount {
        /// Which array.
        what: &'static str,
        /// Rows expected.
        expected: usize,
        /// Rows found.
        got: usize,
    },
    /// A flat array does not divide into rows, or its rows have the wrong width.
    #[error("{what}: {len} values cannot be rows of {dim} channels")]
    RowShape {
        /// Which array.
        what: &'static str,
        /// Values found.
        len: usize,
        /// Channels per row.
        dim: usize,
    },
    /// Features and text rows have different widths.
    #[error("features have {features} channels, the text table has {text}")]
    ChannelCount {
        /// Channels of a feature row.
        features: usize,
        /// Channels of a text row.
        text: usize,
    },
    /// A label is neither a class nor -1.
    #[error("{what}[{row}] is {value}, expected -1 or a class below {num_classes}")]
    LabelRange {
        /// Which array.
        what: &'static str,
        /// Its first offending row.
        row: usize,
        /// The label found.
        value: i32,
        /// Number of classes.
        num_classes: usize,
    },
    /// A class id given as a setting does not exist.
    #[error("{what}: class {class} does not exist, there are {num_classes}")]
    ClassRange {
        /// Which setting.
        what: &'static str,
        /// The class id found.
        class: usize,
        /// Number of classes.
        num_classes: usize,
    },
    /// Two parts disagree about the number of classes.
    #[error("{what}: expected {expected} classes, got {got}")]
    ClassCount {
        /// Which part.
        what: &'static str,
        /// Classes expected.
        expected: usize,
        /// Classes found.
        got: usize,
    },
    /// There is no class to choose from, or more than this crate can count.
    #[error("{num_classes} classes: must be at least 1 and at most {max}")]
    NumClasses {
        /// Number of classes asked for.
        num_classes: usize,
        /// The most that are supported.
        max: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("{what}[{row}] is not finite: {value:?}")]
    NonFinite {
        /// Which array.
        what: &'static str,
        /// Its first offending row.
        row: usize,
        /// The coordinate found, meters.
        value: [f32; 3],
    },
    /// More rows than a 32-bit row number can tell apart.
    #[error("{what}: {rows} rows, at most {max} are supported")]
    TooManyRows {
        /// Which array.
        what: &'static str,
        /// Rows found.
        rows: usize,
        /// The most that are supported.
        max: usize,
    },
    /// A text embedding does not have unit length, or no length at all: a value is NaN or infinite.
    #[error("text embedding of class {class} has norm {norm}, expected 1: divide it by its norm")]
    TextRow {
        /// Row of the table.
        class: usize,
        /// Euclidean norm of that row.
        norm: f64,
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
    /// A row provider failed.
    #[error("feature rows {start}..{end} could not be read")]
    Rows {
        /// First row of the request.
        start: usize,
        /// One past its last row.
        end: usize,
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The oracle cannot tell in advance which class rounding would pick.
    #[error(
        "classes {class} and {other} are too similar for the oracle: their scores differ by \
         {gap:e}, less than the rounding error of a score"
    )]
    AmbiguousText {
        /// The class whose own text row was scored.
        class: usize,
        /// The class that comes too close, or the class itself when a threshold does.
        other: usize,
        /// Difference of the two scores.
        gap: f64,
    },
    /// The evaluation chain got a known answer wrong.
    #[error("the evaluation chain fails on known truth")]
    Oracle(#[source] Box<OracleFailure>),
}

impl From<NeighborError> for MetricError {
    /// The points of a search are the reference of a vote.
    fn from(error: NeighborError) -> Self {
        let what = "reference coord";
        match error {
            NeighborError::NotFinite { row, value } => Self::NonFinite { what, row, value },
            NeighborError::TooManyRows { rows } => Self::TooManyRows { what, rows, max: MAX_ROWS },
        }
    }
}

/// Checks that every label is -1 or a class.
pub(crate) fn check_labels(
    what: &'static str,
    labels: &[i32],
    num_classes: usize,
) -> Result<(), MetricError> {
    let valid = |label: i32| label == -1 || usize::try_from(label).is_ok_and(|l| l < num_classes);
    match labels.iter().position(|&label| !valid(label)) {
        None => Ok(()),
        Some(row) => Err(MetricError::LabelRange { what, row, value: labels[row], num_classes }),
    }
}

/// Checks a setting.
pub(crate) fn check_setting(
    field: &'static str,
    value: impl Into<f64>,
    expected: &'static str,
    fits: bool,
) -> Result<(), MetricError> {
    fits.then_some(()).ok_or_else(|| MetricError::Setting { field, value: value.into(), expected })
}

/// Checks that `len` values are rows of `dim` channels; returns their number.
pub(crate) fn check_shape(
    what: &'static str,
    len: usize,
    dim: usize,
) -> Result<usize, MetricError> {
    let rows = len.checked_div(dim).filter(|rows| rows * dim == len);
    rows.ok_or(MetricError::RowShape { what, len, dim })
}

/// Checks the length of an array that runs parallel to another.
pub(crate) fn check_rows(
    what: &'static str,
    got: usize,
    expected: usize,
) -> Result<(), MetricError> {
    (got == expected).then_some(()).ok_or(MetricError::RowCount { what, expected, got })
}

/// The most classes for which a confusion matrix is still sensible (134 MB of counts).
pub(crate) const MAX_CLASSES: usize = 4096;

/// Checks a number of classes.
pub(crate) fn check_num_classes(num_classes: usize) -> Result<(), MetricError> {
    let fits = (1..=MAX_CLASSES).contains(&num_classes);
    fits.then_some(()).ok_or(MetricError::NumClasses { num_classes, max: MAX_CLASSES })
}

/// The most rows this crate numbers with 32 bits; one number is kept free.
pub(crate) const MAX_ROWS: usize = u32::MAX as usize - 1;

/// Checks a number of rows that no array vouches for.
pub(crate) fn check_num_rows(what: &'static str, rows: usize) -> Result<(), MetricError> {
    (rows <= MAX_ROWS).then_some(()).ok_or(MetricError::TooManyRows { what, rows, max: MAX_ROWS })
}
