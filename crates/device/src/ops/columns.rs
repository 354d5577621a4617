//! Sums of columns.

use super::kernels;
use crate::launch::{Items::PerThread, Launcher, Scalar::U32};

kernels! { "columns":
    /// Sums over stretches of rows.
    COLUMN_PARTS = column_parts, 256, PerThread;
    /// Sums of the parts.
    ADD_PARTS = add_parts, 256, PerThread;
}

/// Rows of one partial sum.
pub(super) const PART_ROWS: u32 = 1024;

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
    let parts = n.div_ceil(PART_ROWS);
    let count = u64::from(parts) * u64::from(channels);
    l.expect::<f32>("rows to add up", x, u64::from(n) * u64::from(channels));
    let mut sums = l.alloc_values::<f64>(count as usize)?;
    l.run(&COLUMN_PARTS, count, &[x], &mut [&mut sums], &[U32(n), U32(channels)])?;
    add_parts(l, &sums, parts, channels, out)
}

/// Sums of parts in f64, in their order. `parts`: `[parts, C]` of `f64` · `out`: `[C]`
pub(super) fn add_parts<L: Launcher>(
    l: &L,
    parts: &L::Buffer,
    count: u32,
    channels: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    l.expect::<f32>("sums of columns", out, channels.into());
    l.run(&ADD_PARTS, channels.into(), &[parts], &mut [out], &[U32(count), U32(channels)])
}
