//! The exact GELU, and rows of unit length.

use super::columns::expect_gradients;
use super::kernels;
use crate::launch::{
    Items::{PerThread, PerWarp},
    Launcher,
    Scalar::{U32, U64},
};

kernels! { "activation":
    /// `x · Φ(x)`
    GELU_FORWARD = gelu_forward, 256, PerThread;
    /// `grad · (Φ(x) + x·φ(x))`
    GELU_BACKWARD = gelu_backward, 256, PerThread;
    /// Rows divided by their norm.
    NORMALIZE_ROWS = normalize_rows, 256, PerWarp;
}

/// Exact GELU of every value.
///
/// # Errors
/// Those of the launcher.
pub fn gelu<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    count: u64,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    l.expect::<f32>("input", x, count);
    l.expect::<f32>("output", out, count);
    l.run(&GELU_FORWARD, count, &[x], &mut [out], &[U64(count)])
}

/// Gradient of [`gelu`].
///
/// # Errors
/// Those of the launcher.
pub fn gelu_backward<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    grad: &L::Buffer,
    count: u64,
    dx: &mut L::Buffer,
) -> Result<(), L::Error> {
    expect_gradients(l, count, x, grad, dx);
    l.run(&GELU_BACKWARD, count, &[x, grad], &mut [dx], &[U64(count)])
}

/// Divides each row by its norm; a zero row stays zero.
///
/// # Shapes
/// `x`, `out`: `[N, C]`
///
/// # Errors
/// Those of the launcher.
pub fn normalize_rows<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    n: u32,
    channels: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    let count = u64::from(n) * u64::from(channels);
    l.expect::<f32>("input", x, count);
    l.expect::<f32>("output", out, count);
    l.run(&NORMALIZE_ROWS, n.into(), &[x], &mut [out], &[U32(n), U32(channels)])
}
