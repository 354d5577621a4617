//! Sums of columns.

use super::kernels;
use crate::launch::{Items::PerThread, KernelEntry, Launcher, Scalar::U32};

kernels! { "columns":
    /// Sums over stretches of rows.
    COLUMN_PARTS = column_parts, 256, PerThread;
    /// Sums of the parts.
    ADD_PARTS = add_parts, 256, PerThread;
}

/// Rows of one partial sum.
const PART_ROWS: u32 = 1024;

/// Sum of the rows: the gradient of a bias. Summed in f64 in fixed stretches.
///
/// # Shapes
/// `x`: `[N, C]` · `out`: `[C]`
///
/// # Errors
/// Those of the launcher.
pub fn column_sums<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    n: u32,
    channels: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    l.expect::<f32>("rows to add up", x, u64::from(n) * u64::from(channels));
    let sums = parts::<f64, L>(l, &COLUMN_PARTS, &[x], n, channels)?;
    add_parts(l, &sums, n, channels, out)
}

/// What a kernel sums over each stretch of rows of `inputs`. Returns `[parts, C]` of `T`
pub(super) fn parts<T: bytemuck::Pod, L: Launcher>(
    l: &L,
    kernel: &'static KernelEntry,
    inputs: &[&L::Buffer],
    n: u32,
    channels: u32,
) -> Result<L::Buffer, L::Error> {
    let count = u64::from(n.div_ceil(PART_ROWS)) * u64::from(channels);
    let mut sums = l.alloc_values::<T>(count as usize)?;
    l.run(kernel, count, inputs, &mut [&mut sums], &[U32(n), U32(channels)])?;
    Ok(sums)
}

/// Sums of the [`parts`] of `n` rows in f64, in their order. `parts`: `[parts, C]` of `f64` · `out`: `[C]`
pub(super) fn add_parts<L: Launcher>(
    l: &L,
    parts: &L::Buffer,
    n: u32,
    channels: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    l.expect::<f32>("sums of columns", out, channels.into());
    let count = n.div_ceil(PART_ROWS);
    l.run(&ADD_PARTS, channels.into(), &[parts], &mut [out], &[U32(count), U32(channels)])
}

/// Panics unless rows of `C` values, their gradient and the gradient of the input have `count` values.
pub(super) fn expect_gradients<L: Launcher>(
    l: &L,
    count: u64,
    x: &L::Buffer,
    grad: &L::Buffer,
    dx: &L::Buffer,
) {
    for (what, buffer) in [("input", x), ("gradient", grad), ("gradient of the input", dx)] {
        l.expect::<f32>(what, buffer, count);
    }
}
