//! The interface of a loss.

use crate::error::LossError;
use candle_core::{Result, Tensor};

/// The label of a row that no loss counts.
pub const IGNORE: i32 = -1;

/// Input of a loss in one step. Fields that a task does not have are `None`.
///
/// Labels and masks are on the host: they come from there, and tables are built from them.
#[derive(Debug, Clone, Copy)]
pub struct LossInput<'a> {
    /// Predicted features or logits. `[N, D]`, f32, f64, bf16 or f16
    pub pred: &'a Tensor,
    /// Target features; they get no gradient. `[N, D]`
    pub target: Option<&'a Tensor>,
    /// Class of each row, [`IGNORE`] for none. `[N]`
    pub label: Option<&'a [i32]>,
    /// Whether the row has a target feature; all have one if `None`. `[N]`
    pub valid: Option<&'a [bool]>,
    /// Share of the training that is done, 0..=1, for terms with a schedule.
    pub progress: f64,
    /// Randomness of this step: the same seed gives the same bits.
    pub seed: u64,
}

impl<'a> LossInput<'a> {
    pub(crate) fn needs_target(
        &self,
        loss: &'static str,
    ) -> std::result::Result<&'a Tensor, LossError> {
        self.target.ok_or(LossError::Missing { loss, field: "target" })
    }
    pub(crate) fn needs_label(
        &self,
        loss: &'static str,
    ) -> std::result::Result<&'a [i32], LossError> {
        self.label.ok_or(LossError::Missing { loss, field: "label" })
    }
}

/// One term of an [`Objective`](crate::Objective).
///
/// Your own terms implement it as the crate's do. Weights belong to the objective, which logs each term
/// without its weight.
pub trait Loss: Send + Sync {
    /// Name in logs, `snake_case`.
    fn name(&self) -> &str;

    /// The scalar to minimize, f32 (f64 if `pred` is), with its gradient to `pred`; `None` when the
    /// term is off in this step: its schedule says so, or no row counts.
    ///
    /// # Errors
    /// If a field is missing, shapes do not fit, or a value that counts is not finite.
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>>;

    /// Why [`Loss::forward`] gave `None` for this input, for the log.
    fn off_reason(&self, _input: &LossInput<'_>) -> String {
        "no row counts".to_owned()
    }

    /// Settings for the record of a run, on one line; empty if there are none.
    fn settings(&self) -> String {
        String::new()
    }
}

impl<L: Loss + ?Sized> Loss for Box<L> {
    fn name(&self) -> &str {
        (**self).name()
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        (**self).forward(input)
    }
    fn off_reason(&self, input: &LossInput<'_>) -> String {
        (**self).off_reason(input)
    }
    fn settings(&self) -> String {
        (**self).settings()
    }
}
