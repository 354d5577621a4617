//! Batch normalisation.

use super::{
    Pass, composed, cpu_slice, emulated, forward_on_device, here, launched, launches, make,
    make_unwritten, read, refuse_gradient,
};
use crate::peers::Together;
use candle_core::{CpuStorage, CudaStorage, CustomOp3, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::batch_norm::{
    Statistics, apply, backward, gradient_sums, input_gradient, merge, parameter_gradients,
    statistics,
};
use std::sync::Arc;

/// What a batch is normalised with.
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
    /// The rows that are normalised.
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
    #[cfg(feature = "cuda")]
    if x.device().is_cuda() {
        let (mean, var) = crate::device::launcher::batch_statistics(x)?;
        return Ok(BatchStatistics { mean, var, source: StatisticsSource::Batch });
    }
    if composed::here("batch_statistics", x.device()) {
        let (mean, var) = composed::batch_statistics(x)?;
        return Ok(BatchStatistics { mean, var, source: StatisticsSource::Batch });
    }
    #[cfg(feature = "emulation")]
    if let Some((mean, var)) =
        read("batch_norm", x, |values| crate::device::emulated::batch_statistics(values, x.dims()))?
    {
        return Ok(BatchStatistics { mean, var, source: StatisticsSource::Batch });
    }
    here("batch_statistics", Pass::Forward, x);
    let s = read("batch_norm", x, |x| Ok(statistics(x, c)))?;
    Ok(BatchStatistics { mean: s.mean, var: s.var, source: StatisticsSource::Batch })
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

impl BatchNorm {
    fn check(&self, l: &Layout, channels: usize) -> Result<()> {
        let (_, c) = l.shape().dims2()?;
        if c != channels || c != self.inverse.len() {
            bail!("batch_norm: input {:?} does not fit {channels} channels", l.shape());
        }
        Ok(())
    }

    fn pass<'a>(&'a self, weight: &'a [f32], bias: &'a [f32]) -> launches::BatchNorm<'a> {
        let (mean, inverse) = (&self.statistics.mean, &self.inverse);
        launches::BatchNorm { weight, bias, mean, inverse }
    }
}

impl CustomOp3 for BatchNorm {
    fn name(&self) -> &'static str {
        "batch_norm"
    }
    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let x = cpu_slice("batch_norm", s1, l1)?;
        let weight = cpu_slice("batch_norm", s2, l2)?;
        let bias = cpu_slice("batch_norm", s3, l3)?;
        self.check(l1, weight.len())?;
        if let Some(made) = emulated([(s1, l1)], || Ok(Some(self.pass(weight, bias))))? {
            return Ok(made);
        }
        let (scale, shift) = scale_shift(weight, bias, &self.statistics.mean, &self.inverse);
        let mut out = vec![0f32; x.len()];
        apply(x, &scale, &shift, false, &mut out);
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }
    fn cuda_fwd(
        &self,
        s1: &CudaStorage,
        l1: &Layout,
        s2: &CudaStorage,
        l2: &Layout,
        s3: &CudaStorage,
        l3: &Layout,
    ) -> Result<(CudaStorage, Shape)> {
        #[cfg(feature = "cuda")]
        {
            use candle_core::backend::BackendStorage;
            let (weight, bias) = (s2.to_cpu_storage()?, s3.to_cpu_storage()?);
            let weight = cpu_slice("batch_norm", &weight, l2)?;
            let bias = cpu_slice("batch_norm", &bias, l3)?;
            self.check(l1, weight.len())?;
            crate::device::launcher::on_storages([(s1, l1)], &self.pass(weight, bias))
        }
        #[cfg(not(feature = "cuda"))]
        super::device::through_host("batch_norm", [(s1, l1), (s2, l2), (s3, l3)], |[a, b, c]| {
            self.cpu_fwd(a.0, a.1, b.0, b.1, c.0, c.1)
        })
    }
    forward_on_device!(@CustomOp3 metal_fwd MetalStorage);
    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        _: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (mean, inverse) = (&self.statistics.mean, &self.inverse);
        let source = self.statistics.source;
        if let StatisticsSource::Peers { rows, norm } = source {
            return self.backward_with_peers([x, weight, grad], rows, norm);
        }
        let from_batch = source == StatisticsSource::Batch;
        let pass = launches::BatchNormBackward { mean, inverse, from_batch };
        if let Some(made) = launched([x, weight, grad], &pass)? {
            let [dx, dw, db] = [0, 1, 2].map(|i| Some(made[i].clone()));
            return Ok((dx, dw, db));
        }
        let device = here("batch_norm", Pass::Backward, x);
        let shape = x.shape().clone();
        let mut parameters = (Vec::new(), Vec::new());
        let dx = read("batch_norm", x, |x| {
            read("batch_norm", grad, |g| {
                read("batch_norm", weight, |w| {
                    make(device, shape, |dx| {
                        parameters = backward(x, g, w, mean, inverse, from_batch, dx);
                    })
                })
            })
        })?;
        let c = weight.elem_count();
        let vector = |v: Vec<f32>| Tensor::from_vec(v, c, device);
        Ok((Some(dx), Some(vector(parameters.0)?), Some(vector(parameters.1)?)))
    }
}

impl BatchNorm {
    /// The gradients, of the input through the statistics of all peers. Those of weight and bias are of this
    /// process' rows: who trains adds them over the processes like those of other parameters.
    fn backward_with_peers(
        &self,
        [x, weight, grad]: [&Tensor; 3],
        rows: f64,
        norm: u64,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let Some(together) = Together::here() else {
            bail!(
                "batch_norm: statistics of several processes, and a backward pass outside of with_peers"
            );
        };
        let (mean, inverse) = (&self.statistics.mean, &self.inverse);
        let device = here("batch_norm", Pass::Backward, x);
        let (c, shape) = (mean.len(), x.shape().clone());
        let mut parameters = (Vec::new(), Vec::new());
        let dx = read("batch_norm", x, |x| {
            read("batch_norm", grad, |g| {
                read("batch_norm", weight, |w| {
                    let mine = gradient_sums(x, g, mean);
                    parameters = parameter_gradients(&mine, inverse);
                    let mut sums = vec![0.0; 2 * c];
                    for said in together.gather(Pass::Backward, norm, mine)? {
                        sums.iter_mut().zip(said).for_each(|(sum, part)| *sum += part);
                    }
                    make(device, shape, |dx| {
                        input_gradient(x, g, w, mean, inverse, Some((&sums, rows)), dx);
                    })
                })
            })
        })?;
        let vector = |v: Vec<f32>| Tensor::from_vec(v, c, device);
        Ok((Some(dx), Some(vector(parameters.0)?), Some(vector(parameters.1)?)))
    }
}

/// `(scale, shift)` so that `x · scale + shift` is the normalisation; `inverse = 1/√(var + ε)`.
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
    let source = norm.statistics.source;
    let alone = !matches!(source, StatisticsSource::Peers { .. });
    if alone && composed::here("batch_norm", x.device()) {
        norm.check(x.layout(), weight.elem_count())?;
        return match source {
            StatisticsSource::Batch => composed::batch_norm(x, weight, bias, eps),
            _ => composed::normalize_by(x, weight, bias, &norm.statistics.mean, &norm.inverse),
        };
    }
    x.contiguous()?.apply_op3(weight, bias, norm)
}

/// The refusal of a batch norm with frozen statistics to train.
pub(crate) fn frozen_cannot_train() -> Result<Tensor> {
    bail!("batch_norm: frozen weights cannot train; load them into a trainable store")
}

/// `x · scale + shift` per channel, then the exact GELU if asked for; without gradient.
///
/// # Errors
/// If shapes do not fit or `x` wants a gradient.
pub(crate) fn scale_shift_frozen(
    x: &Tensor,
    scale: &[f32],
    shift: &[f32],
    gelu: bool,
) -> Result<Tensor> {
    refuse_gradient("batch_norm", x)?;
    let (_, c) = x.dims2()?;
    if c != scale.len() {
        bail!("batch_norm: input {:?} does not fit {} channels", x.shape(), scale.len());
    }
    let (shape, device) = (x.shape().clone(), here("batch_norm", Pass::Forward, x));
    read("batch_norm", x, |x| {
        // SAFETY: the kernel writes all of it and reads none before.
        unsafe { make_unwritten(device, shape, |out| apply(x, scale, shift, gelu, out)) }
    })
}
