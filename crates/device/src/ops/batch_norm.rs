//! Batch normalization over the rows of each channel.

use super::columns::{expect_gradients, parts};
use super::kernels;
use crate::launch::{Items::PerThread, Launcher, Scalar::U32};

kernels! { "batch_norm":
    /// Sums and squares of stretches of rows.
    BATCH_MOMENTS = batch_moments, 256, PerThread;
    /// Mean and variance.
    BATCH_STATISTICS = batch_statistics, 256, PerThread;
    /// Scale, shift, GELU.
    BATCH_APPLY = batch_apply, 256, PerThread;
    /// Sums of the gradients of stretches of rows.
    BATCH_GRADIENT_PARTS = batch_gradient_parts, 256, PerThread;
    /// Gradients of weight and bias.
    BATCH_PARAMETERS = batch_parameters, 256, PerThread;
    /// Gradient of the input.
    BATCH_INPUT = batch_input, 256, PerThread;
}

/// Mean and biased variance of each channel; zeros when there is no row.
///
/// # Shapes
/// `x`: `[N, C]` · returns `[2, C]` of `f64`
///
/// # Errors
/// Those of the launcher.
pub fn statistics<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    n: u32,
    channels: u32,
) -> Result<L::Buffer, L::Error> {
    l.expect::<f32>("input", x, u64::from(n) * u64::from(channels));
    let moments = parts::<[f64; 2], L>(l, &BATCH_MOMENTS, &[x], n, channels)?;
    let mut statistics = l.alloc_values::<[f64; 2]>(channels as usize)?;
    l.run(
        &BATCH_STATISTICS,
        channels.into(),
        &[&moments],
        &mut [&mut statistics],
        &[U32(n), U32(channels)],
    )?;
    Ok(statistics)
}

/// `out = x · scale + shift` per channel, then the exact GELU if asked for.
///
/// # Shapes
/// `x`, `out`: `[N, C]` · `scale`, `shift`: `[C]`
///
/// # Errors
/// Those of the launcher.
#[allow(clippy::too_many_arguments)]
pub fn apply<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    scale: &L::Buffer,
    shift: &L::Buffer,
    n: u32,
    channels: u32,
    gelu: bool,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    let count = u64::from(n) * u64::from(channels);
    l.expect::<f32>("input", x, count);
    l.expect::<f32>("output", out, count);
    l.expect::<f32>("scale", scale, channels.into());
    l.expect::<f32>("shift", shift, channels.into());
    l.run(
        &BATCH_APPLY,
        count,
        &[x, scale, shift],
        &mut [out],
        &[U32(n), U32(channels), U32(gelu.into())],
    )
}

/// Gradients of weight and bias, `[C]` each.
#[derive(Debug)]
pub struct ParameterGradients<B> {
    /// `[C]`
    pub weight: B,
    /// `[C]`
    pub bias: B,
}

/// Gradients of `y = (x − mean)·inverse·weight + bias`. `batch` says whether mean and `inverse = 1/√(var + ε)`
/// came from this very batch (training) or are constants (evaluation).
///
/// # Shapes
/// `x`, `grad`, `dx`: `[N, C]` · `weight`: `[C]` · `mean`, `inverse`: `[C]` of `f64`
///
/// # Errors
/// Those of the launcher.
#[allow(clippy::too_many_arguments)]
pub fn backward<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    grad: &L::Buffer,
    weight: &L::Buffer,
    mean: &L::Buffer,
    inverse: &L::Buffer,
    n: u32,
    channels: u32,
    batch: bool,
    dx: &mut L::Buffer,
) -> Result<ParameterGradients<L::Buffer>, L::Error> {
    let count = u64::from(n) * u64::from(channels);
    expect_gradients(l, count, x, grad, dx);
    l.expect::<f32>("weight", weight, channels.into());
    l.expect::<f64>("mean", mean, channels.into());
    l.expect::<f64>("inverse", inverse, channels.into());
    let sums = parts::<[f64; 2], L>(l, &BATCH_GRADIENT_PARTS, &[x, grad, mean], n, channels)?;
    let mut gradients = ParameterGradients {
        weight: l.alloc_values::<f32>(channels as usize)?,
        bias: l.alloc_values::<f32>(channels as usize)?,
    };
    let mut channel = l.alloc_values::<[f64; 3]>(channels as usize)?;
    l.run(
        &BATCH_PARAMETERS,
        channels.into(),
        &[&sums, weight, inverse],
        &mut [&mut gradients.weight, &mut gradients.bias, &mut channel],
        &[U32(n), U32(channels), U32(batch.into())],
    )?;
    l.run(
        &BATCH_INPUT,
        count,
        &[x, grad, mean, &channel],
        &mut [dx],
        &[U32(n), U32(channels), U32(batch.into())],
    )?;
    Ok(gradients)
}
