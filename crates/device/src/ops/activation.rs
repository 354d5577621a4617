//! The exact GELU, and rows of unit length.

use super::kernels;
use crate::launch::{
    Arg,
    Items::{PerThread, PerWarp},
    Launcher,
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
    l.run(&GELU_FORWARD, count, &mut [Arg::In(x), Arg::Out(out), Arg::U64(count)])
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
    l.expect::<f32>("input", x, count);
    l.expect::<f32>("gradient", grad, count);
    l.expect::<f32>("gradient of the input", dx, count);
    l.run(&GELU_BACKWARD, count, &mut [Arg::In(x), Arg::In(grad), Arg::Out(dx), Arg::U64(count)])
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
    l.run(
        &NORMALIZE_ROWS,
        n.into(),
        &mut [Arg::In(x), Arg::Out(out), Arg::U32(n), Arg::U32(channels)],
    )
}
