//! Batch normalization, alone or with an activation behind it.

use super::vector;
use crate::device::off_host;
use crate::ops::StatisticsSource;
use crate::peers::Together;
use crate::scoped::with_value;
use crate::{Forward, Mode, ops};
use candle_core::{DType, Result, Tensor, Var, bail};
use candle_nn::{Init, VarBuilder};
use std::cell::RefCell;

/// Normalization of each channel over all rows (the remembered variance is unbiased).
#[derive(Debug, Clone)]
pub struct BatchNorm {
    form: Form,
    constants: BatchNormConstants,
}

/// BatchNormConstants of a batch norm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatchNormConstants {
    /// Added to the variance.
    pub eps: f64,
    /// Part of the new statistics in the remembered ones.
    pub momentum: f64,
}

impl BatchNormConstants {
    /// Those of Point Transformer V3.
    pub const POINT_TRANSFORMER_V3: Self = Self { eps: 1e-3, momentum: 0.01 };
    /// PyTorch's.
    pub const PYTORCH: Self = Self { eps: 1e-5, momentum: 0.1 };
}

#[derive(Debug, Clone)]
enum Form {
    Trainable {
        weight: Tensor,
        bias: Tensor,
        mean: Var,
        var: Var,
        batches: Var,
    },
    Frozen {
        scale: Vec<f32>,
        shift: Vec<f32>,
    },
    /// Frozen, on another device than the CPU. `[1, C]`
    Elsewhere {
        scale: Tensor,
        shift: Tensor,
    },
}

impl BatchNorm {
    /// Parameters `weight` (1), `bias` (0); buffers `running_mean` (0), `running_var` (1),
    /// `num_batches_tracked` (0).
    ///
    /// # Errors
    /// If they exist with another shape.
    pub fn new(channels: usize, vb: VarBuilder<'_>) -> Result<Self> {
        Self::with(BatchNormConstants::POINT_TRANSFORMER_V3, channels, vb)
    }

    /// [`BatchNorm::new`] with other constants than those of Point Transformer V3.
    ///
    /// # Errors
    /// As [`BatchNorm::new`].
    pub fn with(
        constants: BatchNormConstants,
        channels: usize,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let weight = vb.get_with_hints(channels, "weight", Init::Const(1.0))?;
        let bias = vb.get_with_hints(channels, "bias", Init::Const(0.0))?;
        let mean = vb.get_with_hints(channels, "running_mean", Init::Const(0.0))?;
        let var = vb.get_with_hints(channels, "running_var", Init::Const(1.0))?;
        let batches =
            vb.get_with_hints_dtype((), "num_batches_tracked", Init::Const(0.0), DType::I64)?;
        if weight.is_variable() {
            // `Var::from_tensor` of a variable shares its storage.
            let [mean, var, batches] = [mean, var, batches].map(|t| Var::from_tensor(&t));
            let (mean, var, batches) = (mean?, var?, batches?);
            return Ok(Self {
                form: Form::Trainable { weight, bias, mean, var, batches },
                constants,
            });
        }
        let var = vector(&var)?;
        if let Some((channel, v)) = var.iter().enumerate().find(|(_, v)| v.is_nan() || **v < 0.0) {
            bail!("{}: running_var[{channel}] is {v}, must be ≥ 0", vb.prefix());
        }
        let inverse: Vec<f64> =
            var.iter().map(|v| 1.0 / (f64::from(*v) + constants.eps).sqrt()).collect();
        let mean: Vec<f64> = vector(&mean)?.into_iter().map(f64::from).collect();
        let (scale, shift) = ops::scale_shift(&vector(&weight)?, &vector(&bias)?, &mean, &inverse);
        let form = if !off_host(weight.device()) {
            Form::Frozen { scale, shift }
        } else {
            let row = |values: Vec<f32>| Tensor::from_vec(values, (1, channels), weight.device());
            Form::Elsewhere { scale: row(scale)?, shift: row(shift)? }
        };
        Ok(Self { form, constants })
    }

    /// The mode of a forward pass, evaluation if the statistics are frozen.
    pub fn mode(&self, cx: &Forward<'_>) -> Mode {
        match &self.form {
            Form::Trainable { mean, .. } if cx.frozen.contains(mean) => Mode::Eval,
            _ => cx.mode,
        }
    }

    /// Factor and summand per channel, if frozen.
    pub(crate) fn scale_shift(&self) -> Option<(&[f32], &[f32])> {
        match &self.form {
            Form::Frozen { scale, shift } => Some((scale, shift)),
            Form::Trainable { .. } | Form::Elsewhere { .. } => None,
        }
    }

    /// `[N, C] → [N, C]`. In training the statistics come from the batch, and the remembered ones
    /// move toward them. A single row has no variance: it is normalized by the remembered
    /// statistics, which stay as they are (PyTorch raises there, which would end a run at the first
    /// batch that pools down to one voxel). Under [`with_peers`](crate::peers::with_peers) the batch is that of
    /// all peers.
    ///
    /// # Errors
    /// If the input does not fit, another process is gone, or when training with frozen weights.
    pub fn forward(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        match (&self.form, mode) {
            (Form::Frozen { scale, shift }, Mode::Eval) => {
                ops::scale_shift_frozen(x, scale, shift, false)
            }
            (Form::Elsewhere { scale, shift }, Mode::Eval) => {
                x.broadcast_mul(scale)?.broadcast_add(shift)
            }
            (Form::Frozen { .. } | Form::Elsewhere { .. }, Mode::Train) => {
                ops::frozen_cannot_train()
            }
            (Form::Trainable { weight, bias, mean, var, batches }, mode) => {
                let to_f64 = |v: &Var| -> Result<Vec<f64>> {
                    Ok(vector(v.as_tensor())?.into_iter().map(f64::from).collect())
                };
                let BatchNormConstants { eps, momentum } = self.constants;
                let now = match (mode, Together::here()) {
                    (Mode::Train, Some(all)) => ops::shared_batch_statistics(x, &all)?,
                    (Mode::Train, None) if x.dim(0)? > 1 => Some(ops::batch_statistics(x)?),
                    _ => None,
                };
                let statistics = match now {
                    Some(now) => {
                        let n = match now.source {
                            StatisticsSource::Peers { rows, .. } => rows,
                            _ => x.dim(0)? as f64,
                        };
                        StatisticsUpdate {
                            buffers: [mean.clone(), var.clone(), batches.clone()],
                            mean: now.mean.clone(),
                            var: now.var.clone(),
                            unbias: n / (n - 1.0),
                            momentum,
                        }
                        .apply_or_record()?;
                        now
                    }
                    None => ops::BatchStatistics::constant(to_f64(mean)?, to_f64(var)?),
                };
                ops::batch_norm(x, weight, bias, statistics, eps)
            }
        }
    }

    /// `gelu(forward(x))`
    ///
    /// # Errors
    /// As [`forward`](Self::forward).
    pub fn forward_gelu(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        match (&self.form, mode) {
            (Form::Frozen { scale, shift }, Mode::Eval) => {
                ops::scale_shift_frozen(x, scale, shift, true)
            }
            _ => ops::gelu(&self.forward(x, mode)?),
        }
    }

    /// `relu(forward(x))`
    ///
    /// # Errors
    /// As [`forward`](Self::forward).
    pub fn forward_relu(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        self.forward(x, mode)?.relu()
    }
}

/// What one batch does to the remembered statistics of one batch norm.
#[derive(Debug, Clone)]
pub struct StatisticsUpdate {
    /// Mean, variance, number of batches.
    buffers: [Var; 3],
    /// Mean of the batch. `[C]`
    pub mean: Vec<f64>,
    /// Biased variance of the batch. `[C]`
    pub var: Vec<f64>,
    /// `n / (n − 1)` of its rows.
    pub unbias: f64,
    /// Part of the new statistics in the remembered ones.
    pub momentum: f64,
}

thread_local! {
    /// Updates that wait, where they are recorded.
    static RECORDED: RefCell<Option<Vec<StatisticsUpdate>>> = const { RefCell::new(None) };
}

/// Runs `work`; remembered statistics stay as they are meanwhile, and what this thread's forward passes would have
/// done to them is given in their order. [`StatisticsUpdate::apply`] makes up for it, to the bit: so batches that
/// several processes look at can be remembered in one order.
pub fn record_statistics<R>(work: impl FnOnce() -> R) -> (R, Vec<StatisticsUpdate>) {
    let (done, found) = with_value(&RECORDED, Vec::new(), work);
    (done, found.unwrap_or_default())
}

impl StatisticsUpdate {
    /// That of a batch norm with these buffers: `running_mean`, `running_var`, `num_batches_tracked`.
    pub fn new(
        buffers: [Var; 3],
        mean: Vec<f64>,
        var: Vec<f64>,
        unbias: f64,
        momentum: f64,
    ) -> Self {
        Self { buffers, mean, var, unbias, momentum }
    }

    /// The buffer `running_mean`, by which the batch norm is known.
    pub fn running_mean(&self) -> &Var {
        &self.buffers[0]
    }

    /// Moves the remembered statistics.
    ///
    /// # Errors
    /// If the lengths do not fit.
    pub fn apply(&self) -> Result<()> {
        let [mean, var, batches] = &self.buffers;
        remember(mean, &self.mean, 1.0, self.momentum)?;
        remember(var, &self.var, self.unbias, self.momentum)?;
        batches.set(&(batches.as_tensor().detach() + 1.0)?)
    }

    fn apply_or_record(self) -> Result<()> {
        let kept = RECORDED.with_borrow_mut(|list| match list {
            Some(list) => {
                list.push(self);
                None
            }
            None => Some(self),
        });
        kept.map_or(Ok(()), |update| update.apply())
    }
}

/// `old ← (1 − momentum)·old + momentum·factor·new`
fn remember(old: &Var, new: &[f64], factor: f64, momentum: f64) -> Result<()> {
    let mixed: Vec<f32> = vector(old.as_tensor())?
        .into_iter()
        .zip(new)
        .map(|(o, n)| ((1.0 - momentum) * f64::from(o) + momentum * factor * n) as f32)
        .collect();
    old.set(&Tensor::from_vec(mixed, new.len(), old.device())?)
}
