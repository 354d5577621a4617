//! Rotary embedding of voxel coordinates.

use super::kernels;
use crate::launch::{Items::PerThread, Launcher, Scalar::U32};

kernels! { "point_rope":
    /// Cosines and sines of every row's angles.
    ROPE_ROTATIONS = rope_rotations, 256, PerThread;
    /// Queries and keys turned.
    ROPE_TURN = rope_turn, 256, PerThread;
}

/// Cosine and sine of each pair of channels of heads of `dim` channels; pair `i` of an axis turns by
/// `p · base^(−i / (dim/6))`.
///
/// # Shapes
/// `cells`: `[N, 3]` of `i32`, any values · returns `[N, dim/2, 2]`
///
/// # Errors
/// Those of the launcher.
///
/// # Panics
/// If `dim` is not a multiple of 6 above 0.
pub fn rotations<L: Launcher>(
    l: &L,
    cells: &L::Buffer,
    n: u32,
    dim: u32,
    base: f64,
) -> Result<L::Buffer, L::Error> {
    assert!(dim > 0 && dim.is_multiple_of(6), "rotary embedding: head width {dim}");
    l.expect::<[i32; 3]>("cells", cells, n.into());
    let count = dim / 6;
    let steps: Vec<f64> = (0..count).map(|i| base.powf(-f64::from(i) / f64::from(count))).collect();
    let steps = l.upload_values(&steps)?;
    let mut pairs = l.alloc_values::<f32>(n as usize * dim as usize)?;
    l.run(
        &ROPE_ROTATIONS,
        u64::from(n) * u64::from(dim / 2),
        &[cells, &steps],
        &mut [&mut pairs],
        &[U32(n), U32(dim)],
    )?;
    Ok(pairs)
}

/// Turns queries and keys in place and leaves values alone; `back` for the gradients of what was turned.
///
/// # Shapes
/// `qkv`: `[N, 3, heads, dim]` · `pairs`: `[N, dim/2, 2]`
///
/// # Errors
/// Those of the launcher.
pub fn turn<L: Launcher>(
    l: &L,
    qkv: &mut L::Buffer,
    pairs: &L::Buffer,
    n: u32,
    heads: u32,
    dim: u32,
    back: bool,
) -> Result<(), L::Error> {
    let (rows, width) = (u64::from(n), u64::from(heads) * u64::from(dim));
    l.expect::<f32>("qkv", qkv, rows * 3 * width);
    l.expect::<f32>("rotations", pairs, rows * u64::from(dim));
    l.run(
        &ROPE_TURN,
        rows * width,
        &[pairs],
        &mut [qkv],
        &[U32(n), U32(heads), U32(dim), U32(back.into())],
    )
}
