//! Batch normalisation, alone or with an activation behind it.

use super::vector;
use crate::{Forward, Mode, ops};
use candle_core::{DType, Result, Tensor, Var, bail};
use candle_nn::{Init, VarBuilder};

/// Normalisation of each channel over all rows (the remembered variance is unbiased).
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
    Trainable { weight: Tensor, bias: Tensor, mean: Var, var: Var, batches: Var },
    Frozen { scale: Vec<f32>, shift: Vec<f32> },
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
        Ok(Self { form: Form::Frozen { scale, shift }, constants })
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
            Form::Trainable { .. } => None,
        }
    }

    /// `[N, C] → [N, C]`. In training the statistics come from the batch, and the remembered ones
    /// move towards them. A single row has no variance: it is normalised by the remembered
    /// statistics, which stay as they are (PyTorch raises there, which would end a run at the first
    /// batch that pools down to one voxel).
    ///
    /// # Errors
    /// If the input does not fit, or when training with frozen weights.
    pub fn forward(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        match (&self.form, mode) {
            (Form::Frozen { scale, shift }, Mode::Eval) => {
                ops::scale_shift_frozen(x, scale, shift, false)
            }
            (Form::Frozen { .. }, Mode::Train) => ops::frozen_cannot_train(),
            (Form::Trainable { weight, bias, mean, var, batches }, mode) => {
                let to_f64 = |v: &Var| -> Result<Vec<f64>> {
                    Ok(vector(v.as_tensor())?.into_iter().map(f64::from).collect())
                };
                let BatchNormConstants { eps, momentum } = self.constants;
                let statistics = match mode {
                    Mode::Train if x.dim(0)? > 1 => {
                        let now = ops::batch_statistics(x)?;
                        let n = x.dim(0)? as f64;
                        remember(mean, &now.mean, 1.0, momentum)?;
                        remember(var, &now.var, n / (n - 1.0), momentum)?;
                        batches.set(&(batches.as_tensor().detach() + 1.0)?)?;
                        now
                    }
                    _ => ops::BatchStatistics {
                        mean: to_f64(mean)?,
                        var: to_f64(var)?,
                        from_batch: false,
                    },
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

/// `old ← (1 − momentum)·old + momentum·factor·new`
fn remember(old: &Var, new: &[f64], factor: f64, momentum: f64) -> Result<()> {
    let mixed: Vec<f32> = vector(old.as_tensor())?
        .into_iter()
        .zip(new)
        .map(|(o, n)| ((1.0 - momentum) * f64::from(o) + momentum * factor * n) as f32)
        .collect();
    old.set(&Tensor::from_vec(mixed, new.len(), old.device())?)
}
