//! Copies of rows: gathers, permutations and their inverse.

use super::kernels;
use crate::launch::{Items::PerThread, Launcher, Scalar::U32};

kernels! { "rows":
    /// Rows of values of 4 bytes.
    GATHER_ROWS_4 = gather_rows_4, 256, PerThread;
    /// Rows of values of 2 bytes.
    GATHER_ROWS_2 = gather_rows_2, 256, PerThread;
    /// The inverse of a permutation.
    INVERT = invert, 256, PerThread;
    /// The numbers 0, 1, 2 …
    COUNT_UP = count_up, 256, PerThread;
}

/// Size of the values of an array whose meaning does not matter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// bf16, f16
    Two,
    /// f32, u32, i32
    Four,
}

/// `out[i] = x[rows[i]]`. The backward of a permutation is the gather by its inverse.
///
/// # Shapes
/// `x`: `[M, C]` · `rows`: `[N]` of `u32`, each below M · `out`: `[N, C]`
///
/// # Errors
/// Those of the launcher.
pub fn gather_rows<L: Launcher>(
    l: &L,
    x: &L::Buffer,
    width: Width,
    channels: u32,
    rows: &L::Buffer,
    n: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    let count = u64::from(n) * u64::from(channels);
    l.expect::<u32>("rows", rows, n.into());
    let kernel = match width {
        Width::Two => {
            l.expect::<u16>("gathered rows", out, count);
            &GATHER_ROWS_2
        }
        Width::Four => {
            l.expect::<u32>("gathered rows", out, count);
            &GATHER_ROWS_4
        }
    };
    l.run(kernel, count, &[x, rows], &mut [out], &[U32(n), U32(channels)])
}

/// `inverse[order[i]] = i` for a permutation. `order`, `inverse`: `[N]` of `u32`
///
/// # Errors
/// Those of the launcher.
pub fn invert<L: Launcher>(
    l: &L,
    order: &L::Buffer,
    n: u32,
    inverse: &mut L::Buffer,
) -> Result<(), L::Error> {
    l.expect::<u32>("order", order, n.into());
    l.expect::<u32>("inverse", inverse, n.into());
    l.run(&INVERT, n.into(), &[order], &mut [inverse], &[U32(n)])
}

/// The numbers from 0 to N − 1. `[N]` of `u32`
///
/// # Errors
/// Those of the launcher.
pub fn count_up<L: Launcher>(l: &L, n: u32) -> Result<L::Buffer, L::Error> {
    let mut out = l.alloc_values::<u32>(n as usize)?;
    l.run(&COUNT_UP, n.into(), &[], &mut [&mut out], &[U32(n)])?;
    Ok(out)
}
