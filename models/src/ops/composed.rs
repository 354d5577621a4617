//! Operations made of candle's own, for devices that have those and none of our kernels (Metal). Gradients are candle's.
//!
//! Slower than kernels: each step is an array. What is divided by a norm or a deviation is divided by the largest
//! magnitude first, so that no square overflows; that divisor has no gradient, for the result does not depend on it.

use candle_core::{D, DType, Device, Result, Tensor};
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::patches::Patches;
use scenesplat_kernels::point_rope::Rotations;
use scenesplat_kernels::segment::Groups;

/// Values of attention weights that exist at a time, 256 MB of them.
const WEIGHTS: usize = 64 << 20;

/// Whether operations on tensors there are composed.
pub(crate) fn applies(device: &Device) -> bool {
    #[cfg(feature = "emulation")]
    if crate::device::emulated::composes() {
        return true;
    }
    device.is_metal()
}

/// Tells tests that an operation is composed.
pub(crate) fn note(operation: &'static str) {
    #[cfg(feature = "emulation")]
    crate::device::emulated::note((operation, scenesplat_kernels::fallbacks::Pass::Forward));
    _ = operation;
}

/// Numbers of rows on a device.
fn rows_of(numbers: &[u32], device: &Device) -> Result<Tensor> {
    Tensor::from_slice(numbers, numbers.len(), device)
}

/// `x / √(mean(x²) + eps)` along a dimension.
fn over_deviation(x: &Tensor, dim: usize, eps: f64) -> Result<Tensor> {
    let largest = x.detach().abs()?.max_keepdim(dim)?.maximum(eps.sqrt())?;
    let x = x.broadcast_div(&largest)?;
    // One of the rounded squares may be too small to be seen beside the others, but never all of them.
    let eps = (largest.recip()? * eps.sqrt())?.sqr()?;
    x.broadcast_div(&x.sqr()?.mean_keepdim(dim)?.add(&eps)?.sqrt()?)
}

/// As [`layer_norm`](super::layer_norm).
pub(crate) fn layer_norm(x: &Tensor, weight: &Tensor, bias: &Tensor, eps: f64) -> Result<Tensor> {
    let x = over_deviation(&x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?, 1, eps)?;
    x.broadcast_mul(weight)?.broadcast_add(bias)
}

/// As [`batch_norm`](super::batch_norm) with the statistics of the rows, through which the gradient flows.
pub(crate) fn batch_norm(x: &Tensor, weight: &Tensor, bias: &Tensor, eps: f64) -> Result<Tensor> {
    let x = over_deviation(&x.broadcast_sub(&x.mean_keepdim(0)?)?, 0, eps)?;
    x.broadcast_mul(weight)?.broadcast_add(bias)
}

/// As [`batch_norm`](super::batch_norm) with constants. `[C]` each, the second `1/√(var + ε)`
pub(crate) fn normalize_by(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    mean: &[f64],
    inverse: &[f64],
) -> Result<Tensor> {
    let row = |values: &[f64]| {
        let values: Vec<f32> = values.iter().map(|v| *v as f32).collect();
        Tensor::from_vec(values, mean.len(), x.device())
    };
    let x = x.broadcast_sub(&row(mean)?)?.broadcast_mul(&row(inverse)?)?;
    x.broadcast_mul(weight)?.broadcast_add(bias)
}

/// As [`batch_statistics`](super::batch_statistics): mean and biased variance of each channel, sums in f32.
pub(crate) fn batch_statistics(x: &Tensor) -> Result<(Vec<f64>, Vec<f64>)> {
    let mean = x.mean_keepdim(0)?;
    let apart = x.broadcast_sub(&mean)?;
    let largest = apart.abs()?.max_keepdim(0)?.maximum(f64::from(f32::MIN_POSITIVE))?;
    let var = apart.broadcast_div(&largest)?.sqr()?.mean_keepdim(0)?;
    let values = |t: &Tensor| -> Result<Vec<f64>> {
        Ok(t.flatten_all()?.to_vec1::<f32>()?.into_iter().map(f64::from).collect())
    };
    let (mean, largest, mut var) = (values(&mean)?, values(&largest)?, values(&var)?);
    var.iter_mut().zip(largest).for_each(|(var, largest)| *var *= largest * largest);
    Ok((mean, var))
}

/// `x + bias`, by a product with a column of ones: its gradient is a product, which adds thousands of rows up in parts.
pub(crate) fn add_bias(x: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let (n, c) = x.dims2()?;
    let ones = Tensor::ones((n, 1), DType::F32, x.device())?;
    x + ones.matmul(&bias.reshape((1, c))?)?
}

/// As [`l2_normalize_above`](super::l2_normalize_above).
pub(crate) fn unit_rows(x: &Tensor, floor: f64) -> Result<Tensor> {
    let largest = x.detach().abs()?.max_keepdim(1)?.maximum(floor)?;
    let x = x.broadcast_div(&largest)?;
    let floor = (largest.recip()? * floor)?.sqr()?;
    // The floor goes under the root: at zero its gradient is infinite.
    x.broadcast_div(&x.sqr()?.sum_keepdim(1)?.maximum(&floor)?.sqrt()?)
}

/// Row `i` of the result is row `rows[i]`.
pub(crate) fn gather(x: &Tensor, rows: &[u32]) -> Result<Tensor> {
    x.index_select(&rows_of(rows, x.device())?, 0)
}

/// As [`segment_reduce`](super::segment_reduce), sums or means. Maxima are for the CPU: their gradient goes to one row, and
/// candle's to all that are equal.
pub(crate) fn segment_reduce(x: &Tensor, groups: &Groups, mean: bool) -> Result<Tensor> {
    let zeros = Tensor::zeros((groups.len(), x.dim(1)?), DType::F32, x.device())?;
    let sums = zeros.index_add(&rows_of(groups.inverse(), x.device())?, x, 0)?;
    if !mean {
        return Ok(sums);
    }
    let inverse: Vec<f32> =
        groups.offsets().windows(2).map(|o| 1.0 / (o[1] - o[0]).max(1) as f32).collect();
    let inverse = Tensor::from_vec(inverse, (groups.len(), 1), x.device())?;
    sums.broadcast_mul(&inverse)
}

/// As [`sparse_conv`](super::sparse_conv), tap by tap.
pub(crate) fn sparse_conv(
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    map: &KernelMap,
) -> Result<Tensor> {
    let (n, cin) = x.dims2()?;
    let (cout, taps) = (weight.dim(0)?, map.taps());
    let weight = weight.reshape((cout, taps, cin))?;
    let mut out = Tensor::zeros((n, cout), DType::F32, x.device())?;
    for tap in 0..taps {
        let (from, to) = map.tap_pairs(tap);
        if to.is_empty() {
            continue;
        }
        let weight = weight.narrow(1, tap, 1)?.squeeze(1)?.t()?;
        let products = gather(x, &from)?.matmul(&weight)?;
        out = out.index_add(&rows_of(&to, x.device())?, &products, 0)?;
    }
    match bias {
        Some(bias) => out.broadcast_add(bias),
        None => Ok(out),
    }
}

/// As [`point_rope`](super::point_rope).
pub(crate) fn point_rope(qkv: &Tensor, heads: Heads, rotations: &Rotations) -> Result<Tensor> {
    let (n, third) = (rotations.len(), heads.dim / 6);
    if n == 0 {
        return Ok(qkv.clone());
    }
    let table = |part: usize| {
        let values: Vec<f32> = rotations.pairs().iter().map(|pair| pair[part]).collect();
        Tensor::from_vec(values, (n, 1, 3, third), qkv.device())
    };
    let (cosine, sine) = (table(0)?, table(1)?);
    // Of each axis the first half of the channels turns with the second.
    let turning = 2 * heads.count;
    let both = qkv.narrow(1, 0, turning * heads.dim)?.reshape((n, turning, 3, 2, third))?;
    let half = |i: usize| both.narrow(3, i, 1)?.squeeze(3);
    let (u, v) = (half(0)?, half(1)?);
    let turned = [
        (u.broadcast_mul(&cosine)? - v.broadcast_mul(&sine)?)?,
        (v.broadcast_mul(&cosine)? + u.broadcast_mul(&sine)?)?,
    ];
    let turned = Tensor::stack(&turned, 3)?.reshape((n, turning * heads.dim))?;
    let values = qkv.narrow(1, turning * heads.dim, heads.channels())?;
    Tensor::cat(&[&turned, &values], 1)
}

/// As [`patch_attention`](super::patch_attention), in f32: patches of the same length together, as many at a time as memory
/// is meant for.
pub(crate) fn patch_attention(
    qkv: &Tensor,
    heads: Heads,
    patches: &Patches,
    order: &[u32],
) -> Result<Tensor> {
    let (count, dim) = (heads.count, heads.dim);
    if order.is_empty() {
        return qkv.narrow(1, 0, heads.channels());
    }
    let mut outputs = Vec::new();
    let mut all = patches.patches();
    while let Some(first) = all.first() {
        let most = (WEIGHTS / (first.len * first.len * count).max(1)).max(1);
        let same = all.iter().take(most).take_while(|p| p.len == first.len).count();
        let (len, slots) = (first.len, first.start..first.start + same * first.len);
        all = &all[same..];
        let rows: Vec<u32> =
            patches.pad()[slots].iter().map(|position| order[*position as usize]).collect();
        let shape = (same, len, 3, count, dim);
        let qkv = gather(qkv, &rows)?.reshape(shape)?.permute((2, 0, 3, 1, 4))?.contiguous()?;
        let (q, k, v) = (qkv.get(0)?, qkv.get(1)?, qkv.get(2)?);
        let logits = (q.matmul(&k.t()?)? * (1.0 / (dim as f64).sqrt()))?;
        // Taking the largest away changes nothing but what overflows.
        let logits = logits.broadcast_sub(&logits.detach().max_keepdim(D::Minus1)?)?;
        let weights = logits.exp()?;
        let weights = weights.broadcast_div(&weights.sum_keepdim(D::Minus1)?)?;
        let out = weights.matmul(&v.contiguous()?)?.transpose(1, 2)?;
        outputs.push(out.reshape((same * len, heads.channels()))?);
    }
    // What was borrowed has no position that shows it.
    let mut slot_of_row = vec![0; order.len()];
    for (row, slot) in order.iter().zip(patches.unpad()) {
        slot_of_row[*row as usize] = *slot;
    }
    gather(&Tensor::cat(&outputs, 0)?, &slot_of_row)
}
