//! Layer normalization over the channels of each row.

use super::columns::{add_parts, expect_gradients, parts};
use super::kernels;
use crate::launch::{
    Items::{PerThread, PerWarp},
    Launcher,
    Scalar::{F32, U32},
};

kernels! { "layer_norm":
    /// Rows normalized.
    LAYER_NORM = layer_norm, 256, PerWarp;
    /// Gradient of the rows.
    LAYER_NORM_BACKWARD = layer_norm_backward, 256, PerWarp;
    /// Parts of the gradients of weight and bias.
    LAYER_NORM_PARAMETERS = layer_norm_parameters, 256, PerThread;
}

/// `out = LayerNorm(x) [+ residual]`; a row whose variance overflows f32 is normalized in f64, one with NaN or
/// ±∞ is NaN.
///
/// # Shapes
/// `x`, `residual`, `out`: `[N, C]` · `weight`, `bias`: `[C]`
///
/// # Errors
/// Those of the launcher.
#[allow(clippy::too_many_arguments)]
pub fn forward<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    residual: Option<&L::Buffer>,
    weight: &L::Buffer,
    bias: &L::Buffer,
    n: u32,
    channels: u32,
    eps: f32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    let count = u64::from(n) * u64::from(channels);
    if count == 0 {
        return Ok(());
    }
    for (what, buffer) in [("input", x), ("residual", residual.unwrap_or(x)), ("output", out)] {
        l.expect::<f32>(what, buffer, count);
    }
    l.expect::<f32>("weight", weight, channels.into());
    l.expect::<f32>("bias", bias, channels.into());
    l.run(
        &LAYER_NORM,
        n.into(),
        &[x, residual.unwrap_or(x), weight, bias],
        &mut [out],
        &[U32(n), U32(channels), F32(eps), U32(residual.is_some().into())],
    )
}

/// Gradients of [`forward`] without residual: of `x`, and of weight and bias together, `[2, C]`.
///
/// # Shapes
/// `x`, `grad`, `dx`: `[N, C]` · `weight`: `[C]` · returns `[2, C]`
///
/// # Errors
/// Those of the launcher.
#[allow(clippy::too_many_arguments)]
pub fn backward<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    grad: &L::Buffer,
    weight: &L::Buffer,
    n: u32,
    channels: u32,
    eps: f32,
    dx: &mut L::Buffer,
) -> Result<L::Buffer, L::Error> {
    let count = u64::from(n) * u64::from(channels);
    expect_gradients(l, count, x, grad, dx);
    l.expect::<f32>("weight", weight, channels.into());
    let mut parameters = l.alloc_values::<f32>(2 * channels as usize)?;
    let mut statistics = l.alloc_values::<[f32; 2]>(n as usize)?;
    if channels > 0 {
        l.run(
            &LAYER_NORM_BACKWARD,
            n.into(),
            &[x, grad, weight],
            &mut [dx, &mut statistics],
            &[U32(n), U32(channels), F32(eps)],
        )?;
    }
    let inputs = [x, grad, &statistics];
    let sums = parts::<[f64; 2], L>(l, &LAYER_NORM_PARAMETERS, &inputs, n, channels)?;
    add_parts(l, &sums, n, 2 * channels, &mut parameters)?;
    Ok(parameters)
}
