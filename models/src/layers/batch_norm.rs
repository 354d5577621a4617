//! Batch normalisation followed by a GELU, as every batch norm of the network is.

use super::vector;
use crate::{Forward, Mode, ops};
use candle_core::{DType, Result, Tensor, Var, bail};
use candle_nn::{Init, VarBuilder};

/// `gelu(BatchNorm(x))` with ε = 1e-3 and momentum 0.01 (the remembered variance is unbiased).
#[derive(Debug, Clone)]
pub struct BatchNorm(Form);

const EPS: f64 = 1e-3;
const MOMENTUM: f64 = 0.01;

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
        let weight = vb.get_with_hints(channels, "weight", Init::Const(1.0))?;
        let bias = vb.get_with_hints(channels, "bias", Init::Const(0.0))?;
        let mean = vb.get_with_hints(channels, "running_mean", Init::Const(0.0))?;
        let var = vb.get_with_hints(channels, "running_var", Init::Const(1.0))?;
        let batches =
            vb.get_with_hints_dtype((), "num_batches_tracked", Init::Const(0.0), DType::I64)?;
        if weight.is_variable() {
            // `Var::from_tensor` of a variable shares its storage.
            let [mean, var, batches] = [mean, var, batches].map(|t| Var::from_tensor(&t));
            return Ok(Self(Form::Trainable {
                weight,
                bias,
                mean: mean?,
                var: var?,
                batches: batches?,
            }));
        }
        let var = vector(&var)?;
        if let Some((channel, v)) = var.iter().enumerate().find(|(_, v)| v.is_nan() || **v < 0.0) {
            bail!("{}: running_var[{channel}] is {v}, must be ≥ 0", vb.prefix());
        }
        let inverse: Vec<f64> = var.iter().map(|v| 1.0 / (f64::from(*v) + EPS).sqrt()).collect();
        let mean: Vec<f64> = vector(&mean)?.into_iter().map(f64::from).collect();
        let (scale, shift) = ops::scale_shift(&vector(&weight)?, &vector(&bias)?, &mean, &inverse);
        Ok(Self(Form::Frozen { scale, shift }))
    }

    /// The mode of a forward pass, evaluation if the statistics are frozen.
    pub fn mode(&self, cx: &Forward<'_>) -> Mode {
        match &self.0 {
            Form::Trainable { mean, .. } if cx.frozen.contains(mean) => Mode::Eval,
            _ => cx.mode,
        }
    }

    /// Factor and summand per channel, if frozen.
    pub(crate) fn scale_shift(&self) -> Option<(&[f32], &[f32])> {
        match &self.0 {
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
    pub fn forward_gelu(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        match (&self.0, mode) {
            (Form::Frozen { scale, shift }, Mode::Eval) => {
                ops::scale_shift_gelu_frozen(x, scale, shift)
            }
            (Form::Frozen { .. }, Mode::Train) => ops::frozen_cannot_train(),
            (Form::Trainable { weight, bias, mean, var, batches }, mode) => {
                let to_f64 = |v: &Var| -> Result<Vec<f64>> {
                    Ok(vector(v.as_tensor())?.into_iter().map(f64::from).collect())
                };
                let statistics = match mode {
                    Mode::Train if x.dim(0)? > 1 => {
                        let now = ops::batch_statistics(x)?;
                        let n = x.dim(0)? as f64;
                        remember(mean, &now.mean, 1.0)?;
                        remember(var, &now.var, n / (n - 1.0))?;
                        batches.set(&(batches.as_tensor().detach() + 1.0)?)?;
                        now
                    }
                    _ => ops::BatchStatistics {
                        mean: to_f64(mean)?,
                        var: to_f64(var)?,
                        from_batch: false,
                    },
                };
                ops::gelu(&ops::batch_norm(x, weight, bias, statistics, EPS)?)
            }
        }
    }
}

/// `old ← 0.99·old + 0.01·factor·new`
fn remember(old: &Var, new: &[f64], factor: f64) -> Result<()> {
    let mixed: Vec<f32> = vector(old.as_tensor())?
        .into_iter()
        .zip(new)
        .map(|(o, n)| ((1.0 - MOMENTUM) * f64::from(o) + MOMENTUM * factor * n) as f32)
        .collect();
    old.set(&Tensor::from_vec(mixed, new.len(), old.device())?)
}
