//! Batch normalization.

use super::{Array, Operation, Pass, apply, frozen, here, read};
use crate::device::launches::{Input, Launched, matrix, room};
use crate::peers::Together;
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::{Launcher, ops::batch_norm as device};
use scenesplat_kernels::batch_norm::{
    Statistics, apply as apply_scale, backward, gradient_sums, input_gradient, merge,
    parameter_gradients, statistics,
};
use std::sync::Arc;

/// What a batch is normalized with.
#[derive(Debug, Clone)]
pub struct BatchStatistics {
    /// `[C]`
    pub mean: Vec<f64>,
    /// Biased variance. `[C]`
    pub var: Vec<f64>,
    /// Where they come from.
    pub source: StatisticsSource,
}

/// Where statistics come from, and so where the gradient flows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StatisticsSource {
    /// Elsewhere: constants, which have no gradient.
    Constant,
    /// The rows that are normalized.
    Batch,
    /// The rows of all [`Peers`](crate::peers::Peers).
    Peers {
        /// How many they are.
        rows: f64,
        /// Place of the layer among those of the pass.
        norm: u64,
    },
}

impl BatchStatistics {
    /// Those that no gradient flows through.
    pub fn constant(mean: Vec<f64>, var: Vec<f64>) -> Self {
        Self { mean, var, source: StatisticsSource::Constant }
    }
}

/// Mean and biased variance of each channel of `x` (`[N, C]`), in f64.
///
/// # Errors
/// If there are fewer than two rows: the variance to remember would be undefined.
pub fn batch_statistics(x: &Tensor) -> Result<BatchStatistics> {
    let (n, c) = x.dims2()?;
    if n < 2 {
        bail!("batch_norm: training needs at least 2 rows, got {n}; use larger scenes or batches");
    }
    let (mean, var) = moments(x, c)?;
    Ok(BatchStatistics { mean, var, source: StatisticsSource::Batch })
}

/// Mean and biased variance, where the rows are.
fn moments(x: &Tensor, c: usize) -> Result<(Vec<f64>, Vec<f64>)> {
    #[cfg(feature = "cuda")]
    if x.device().is_cuda() {
        return crate::device::launcher::batch_statistics(x);
    }
    #[cfg(feature = "emulation")]
    if let Some(found) =
        read("batch_norm", x, |values| crate::device::emulated::batch_statistics(values, x.dims()))?
    {
        return Ok(found);
    }
    here("batch_statistics", Pass::Forward, x);
    let s = read("batch_norm", x, |x| Ok(statistics(x, c)))?;
    Ok((s.mean, s.var))
}

/// As [`batch_statistics`], of the rows (`[N, C]`) of all peers together; every peer gets the same bits. Nothing if there
/// are fewer than two rows.
///
/// # Errors
/// If a peer is gone, or goes through other layers.
pub(crate) fn shared_batch_statistics(
    x: &Tensor,
    together: &Together,
) -> Result<Option<BatchStatistics>> {
    let (n, c) = x.dims2()?;
    here("batch_statistics", Pass::Forward, x);
    let mine = read("batch_norm", x, |x| Ok(statistics(x, c)))?;
    let mine = [&[n as f64][..], &mine.mean, &mine.var].concat();
    let norm = together.next_norm();
    let part = |mut said: Vec<f64>| {
        let var = said.split_off(1 + c);
        let mean = said.split_off(1);
        (said[0], Statistics { mean, var })
    };
    let said = together.gather(Pass::Forward, norm, mine)?;
    let parts: Vec<_> = said.into_iter().map(part).collect();
    let (rows, Statistics { mean, var }) = merge(&parts, c);
    let source = StatisticsSource::Peers { rows, norm };
    Ok((rows > 1.0).then_some(BatchStatistics { mean, var, source }))
}

struct BatchNorm {
    statistics: Arc<BatchStatistics>,
    inverse: Vec<f64>,
}

impl Operation for BatchNorm {
    const NAME: &'static str = "batch_norm";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let ((_, c), channels) = (inputs[0].dims2()?, inputs[1].elem_count());
        if c != channels || c != self.inverse.len() {
            bail!("batch_norm: input {:?} does not fit {channels} channels", inputs[0]);
        }
        Ok(inputs[0].clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let (x, weight, bias) = (inputs[0].0, inputs[1].0, inputs[2].0);
        let (scale, shift) = scale_shift(weight, bias, &self.statistics.mean, &self.inverse);
        let mut out = vec![0f32; x.len()];
        apply_scale(x, &scale, &shift, false, &mut out);
        Ok(out)
    }
    /// With peers the gradient of the input goes through the statistics of all. Those of weight and bias are of the rows of
    /// this process: who trains adds them over the processes like those of other parameters.
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let ((x, _), (weight, _)) = (inputs[0], inputs[1]);
        let (mean, inverse) = (&self.statistics.mean, &self.inverse);
        let mut dx = vec![0.0; x.len()];
        let StatisticsSource::Peers { rows, norm } = self.statistics.source else {
            let from_batch = self.statistics.source == StatisticsSource::Batch;
            let (dw, db) = backward(x, grad, weight, mean, inverse, from_batch, &mut dx);
            return Ok(vec![dx, dw, db]);
        };
        let Some(together) = Together::here() else {
            bail!(
                "batch_norm: statistics of several processes, and a backward pass outside of with_peers"
            );
        };
        let mine = gradient_sums(x, grad, mean);
        let (dw, db) = parameter_gradients(&mine, inverse);
        let mut sums = vec![0.0; 2 * mean.len()];
        for said in together.gather(Pass::Backward, norm, mine)? {
            sums.iter_mut().zip(said).for_each(|(sum, part)| *sum += part);
        }
        input_gradient(x, grad, weight, mean, inverse, Some((&sums, rows)), &mut dx);
        Ok(vec![dx, dw, db])
    }
    /// Weight and bias go to the host, where scale and shift are f64.
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((x, dims), (weight, _), (bias, _)) = (inputs[0], inputs[1], inputs[2]);
        let (n, c) = matrix::<L>(dims)?;
        let weight = l.download_values::<f32>(weight, c as usize)?;
        let bias = l.download_values::<f32>(bias, c as usize)?;
        let (scale, shift) = scale_shift(&weight, &bias, &self.statistics.mean, &self.inverse);
        let (scale, shift) = (l.upload_values(&scale)?, l.upload_values(&shift)?);
        let mut out = room(l, dims)?;
        device::apply(l, x, &scale, &shift, n, c, false, &mut out)?;
        Ok(Some(vec![(out, dims.into())]))
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let from_batch = match self.statistics.source {
            StatisticsSource::Peers { .. } => return Ok(None),
            source => source == StatisticsSource::Batch,
        };
        let ((x, dims), (weight, of_weight), (grad, _)) = (inputs[0], inputs[1], inputs[3]);
        let (n, c) = matrix::<L>(dims)?;
        let mean = l.upload_values(&self.statistics.mean)?;
        let inverse = l.upload_values(&self.inverse)?;
        let mut dx = room(l, dims)?;
        let found =
            device::backward(l, x, grad, weight, &mean, &inverse, n, c, from_batch, &mut dx)?;
        let parameters = [found.weight, found.bias].map(|of| (of, of_weight.into()));
        Ok(Some([(dx, dims.into())].into_iter().chain(parameters).collect()))
    }
}

/// `(scale, shift)` so that `x · scale + shift` is the normalization; `inverse = 1/√(var + ε)`.
pub fn scale_shift(
    weight: &[f32],
    bias: &[f32],
    mean: &[f64],
    inverse: &[f64],
) -> (Vec<f32>, Vec<f32>) {
    let scale: Vec<f64> = weight.iter().zip(inverse).map(|(w, i)| f64::from(*w) * i).collect();
    let shift = bias.iter().zip(&scale).zip(mean).map(|((b, s), m)| (f64::from(*b) - m * s) as f32);
    let shift = shift.collect();
    (scale.into_iter().map(|s| s as f32).collect(), shift)
}

/// `(x − mean) / √(var + ε) · weight + bias` with the given statistics.
///
/// # Shapes
/// `x`: `[N, C]` · `weight`, `bias`: `[C]` · returns `[N, C]`
///
/// # Errors
/// If shapes do not fit or a tensor is not f32.
pub fn batch_norm(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    statistics: BatchStatistics,
    eps: f64,
) -> Result<Tensor> {
    let inverse = statistics.var.iter().map(|v| 1.0 / (v + eps).sqrt()).collect();
    let norm = BatchNorm { statistics: Arc::new(statistics), inverse };
    apply(norm, &[x, weight, bias])
}

/// The refusal of a batch norm with frozen statistics to train.
pub(crate) fn frozen_cannot_train() -> Result<Tensor> {
    bail!("batch_norm: frozen weights cannot train; load them into a trainable store")
}

/// `x · scale + shift` per channel, then the exact GELU if asked for; without gradient.
///
/// # Errors
/// If shapes do not fit or `x` requires a gradient.
pub(crate) fn scale_shift_frozen(
    x: &Tensor,
    scale: &[f32],
    shift: &[f32],
    gelu: bool,
) -> Result<Tensor> {
    let (_, c) = x.dims2()?;
    if c != scale.len() {
        bail!("batch_norm: input {:?} does not fit {} channels", x.shape(), scale.len());
    }
    // SAFETY: the kernel writes all of it and reads none before.
    unsafe {
        frozen("batch_norm", x, None, x.shape(), |x, _, out| {
            apply_scale(x, scale, shift, gelu, out);
        })
    }
}
