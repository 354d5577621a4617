use crate::MetricError;

/// One named number of an evaluation.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Measurement {
    /// Slash-separated path, e.g. `scannet200/mIoU`; the unit belongs to the name.
    pub name: String,
    /// The value.
    pub value: f64,
}

impl Measurement {
    /// A measurement from its parts.
    pub fn new(name: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), value }
    }
}

/// A metric that is fed piece by piece.
///
/// An evaluation sees one scene at a time and may see several at once on different threads or
/// machines. So a metric is state that can be updated and merged: any split of the rows into
/// updates and workers gives the same numbers. What an update borrows differs between metrics and
/// is the one associated type.
pub trait Metric: Send {
    /// What one update borrows, e.g. predictions and labels.
    type Update<'a>;

    /// Adds one piece of evidence.
    ///
    /// # Errors
    /// If the piece is malformed; the state is then unchanged.
    fn update(&mut self, update: Self::Update<'_>) -> Result<(), MetricError>;

    /// Adds what another worker has seen.
    ///
    /// # Errors
    /// If the other metric measures something else (another number of classes, say).
    fn merge(&mut self, other: &Self) -> Result<(), MetricError>;

    /// Names of the numbers that [`measure`](Self::measure) may give.
    fn names(&self) -> Vec<String>;

    /// The numbers so far. Undefined ones are left out. The state is kept.
    fn measure(&self) -> Vec<Measurement>;
}
