//! The weighted sum of losses.

use crate::error::{LossError, check_setting};
use crate::loss::{Loss, LossInput};
use crate::scalar_op::{Zero, scalar_loss};
use candle_core::{DType, Result, Tensor};

pub(crate) const OBJECTIVE: &str = "objective";

/// Checks the weight of a term.
pub(crate) fn check_weight(weight: f64) -> std::result::Result<(), LossError> {
    check_setting(OBJECTIVE, "weight", weight, weight.is_finite(), "a finite number")
}

/// `Σ wᵢ · lossᵢ`, and each term for the log.
///
/// ```
/// use candle_core::{Device, Tensor, Var};
/// use scenesplat_losses::{CosineLoss, L2Loss, LossInput, Objective};
///
/// let objective = Objective::new().with(1.0, CosineLoss::default()).with(0.5, L2Loss::default());
/// let pred = Var::new(&[[1.0_f32, 0.0], [0.0, 2.0]], &Device::Cpu)?;
/// let target = Tensor::new(&[[1.0_f32, 0.0], [0.0, 1.0]], &Device::Cpu)?;
/// let input = LossInput {
///     pred: &pred, target: Some(&target), label: None, valid: None, progress: 0.0, seed: 0,
/// };
/// let output = objective.forward(&input)?;
/// assert_eq!(output.total.to_scalar::<f32>()?, 0.25); // both directions are right
/// assert_eq!(output.terms[1].value.to_scalar::<f32>()?, 0.5); // half of the rows is 1 too long
/// let gradient = output.total.backward()?.get(&pred).map(Tensor::to_vec2::<f32>);
/// assert_eq!(gradient.transpose()?, Some(vec![vec![0.0, 0.0], vec![0.0, 0.5]]));
/// # Ok::<(), candle_core::Error>(())
/// ```
#[derive(Default)]
pub struct Objective {
    terms: Vec<(f64, Box<dyn Loss>)>,
}

/// One term of one step.
#[derive(Debug, Clone)]
pub struct Term {
    /// Of the loss.
    pub name: String,
    /// Factor of its value in the total.
    pub weight: f64,
    /// The loss as it is, **not** multiplied with the weight; a scalar without gradient, left on
    /// its device: copy it when you log, not in every step.
    pub value: Tensor,
}

/// A term that had no value in a step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OffTerm {
    /// Of the loss.
    pub name: String,
    /// For the log.
    pub reason: String,
}

/// The total and its terms.
#[derive(Debug, Clone)]
pub struct ObjectiveOutput {
    /// To call `backward` on: a scalar, f32, or f64 if the predictions are.
    pub total: Tensor,
    /// Terms that were on, in the order of [`Objective::with`].
    pub terms: Vec<Term>,
    /// Terms that were off. If all were, the total is 0 with a gradient of zeros.
    pub off: Vec<OffTerm>,
}

impl Objective {
    /// Without any term.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a term.
    #[must_use]
    pub fn with(mut self, weight: f64, loss: impl Loss + 'static) -> Self {
        self.terms.push((weight, Box::new(loss)));
        self
    }

    /// Names, weights and settings of the terms, for the record of a run: one line each.
    pub fn settings(&self) -> Vec<String> {
        let line = |(weight, loss): &(f64, Box<dyn Loss>)| {
            let settings = loss.settings();
            let bracket = if settings.is_empty() { settings } else { format!(" ({settings})") };
            format!("{weight} · {}{bracket}", loss.name())
        };
        self.terms.iter().map(line).collect()
    }

    /// Evaluates every term, except those of weight 0.
    ///
    /// # Errors
    /// If a term fails (its name is in the message), a weight is not finite, or the progress is not
    /// in 0..=1.
    pub fn forward(&self, input: &LossInput<'_>) -> Result<ObjectiveOutput> {
        let share = (0.0..=1.0).contains(&input.progress);
        check_setting(OBJECTIVE, "progress", input.progress, share, "0..=1")?;
        let dtype = if input.pred.dtype() == DType::F64 { DType::F64 } else { DType::F32 };
        let mut total: Option<Tensor> = None;
        let (mut terms, mut off) = (Vec::new(), Vec::new());
        for (weight, loss) in &self.terms {
            check_weight(*weight)?;
            let name = loss.name().to_owned();
            if *weight == 0.0 {
                // Zero times an infinite loss would be NaN.
                off.push(OffTerm { name, reason: "its weight is 0".to_owned() });
                continue;
            }
            let failed = |e: candle_core::Error| e.context(format!("in the loss term {name}"));
            let Some(value) = loss.forward(input).map_err(failed)? else {
                off.push(OffTerm { reason: loss.off_reason(input), name });
                continue;
            };
            if value.rank() != 0 {
                let wrong = LossError::shape(OBJECTIVE, "term", "a scalar", value.dims());
                return Err(failed(wrong.into()));
            }
            let value = value.to_dtype(dtype)?;
            let weighted = if *weight == 1.0 { value.clone() } else { (&value * *weight)? };
            terms.push(Term { name, weight: *weight, value: value.detach() });
            total = Some(match total {
                Some(total) => (total + weighted)?,
                None => weighted,
            });
        }
        let total = total.map_or_else(|| scalar_loss(input.pred, 0.0, Zero), Ok)?;
        Ok(ObjectiveOutput { total, terms, off })
    }
}
