//! Queries and keys that turn with their voxel.

use super::{Rows, groups_of_256, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands, Gpu};
use bytemuck::{Pod, Zeroable};
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::point_rope::Rotations;

const TEXT: &str = include_str!("../../wgsl/point_rope.wgsl");

/// Sines and cosines of the angles of every row, on the device. The CPU computes them in f64: angles of a thousand
/// voxels lose their digits in f32.
#[derive(Debug, Clone)]
pub struct DeviceRotations {
    pairs: Array<[f32; 2]>,
    dim: usize,
}

impl DeviceRotations {
    /// Angles from the host.
    ///
    /// # Errors
    /// If the device has no room.
    pub fn upload(gpu: &Gpu, rotations: &Rotations) -> Result<Self> {
        Ok(Self { pairs: gpu.upload("rotations", rotations.pairs())?, dim: rotations.dim() })
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    slots: u32,
    heads: u32,
    first: u32,
    pad: u32,
}

/// Turns queries and keys in place, and leaves values alone. Slot `i` shows the row `list[first + i]`.
///
/// # Shapes
/// `qkv`: `[slots, 3·C]`, a row's channels being q, k, v, each `[heads, D]` · `list`: `[first + slots]` or longer
///
/// # Errors
/// If sizes do not fit together.
pub fn point_rope(
    commands: &mut Commands,
    qkv: &Rows,
    heads: Heads,
    rotations: &DeviceRotations,
    list: &Array<u32>,
    first: usize,
) -> Result<()> {
    let fits = list.len() >= first + qkv.rows;
    if heads.dim != rotations.dim || qkv.channels != 3 * heads.channels() || !fits {
        return shape(format!(
            "rotary embedding: heads of {} and angles for {}, rows of {}, {} of {} slots",
            heads.dim,
            rotations.dim,
            qkv.channels,
            list.len(),
            qkv.rows
        ));
    }
    let (dim, stored) = (number(heads.dim)?, qkv.stored());
    let constants = [("DIM", dim), ("THIRD", dim / 6)];
    let kernel = commands.gpu().kernel("point_rope", TEXT, &stored.with(None), &constants);
    let (slots, heads_count) = (number(qkv.rows)?, number(heads.count)?);
    let params = Params { slots, heads: heads_count, first: number(first)?, pad: 0 };
    let arrays: [(u32, &dyn Bound); 3] = [(1, qkv), (2, &rotations.pairs), (3, list)];
    commands.run(&kernel, &params, &arrays, groups_of_256(qkv.rows * heads.channels()))
}
