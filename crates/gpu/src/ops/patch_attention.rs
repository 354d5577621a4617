//! Attention inside patches of slots.

use super::{Rows, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::patches::Patch;

const TEXT: &str = include_str!("../../wgsl/patch_attention.wgsl");
/// Slots that a workgroup answers.
const QUERIES: usize = 64;
/// Values of a tile of keys.
const TILE: u32 = 2048;
/// The widest head.
pub const MAX_DIM: usize = 64;

/// A patch as a workgroup takes it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct Item {
    start: u32,
    len: u32,
    query: u32,
    own: u32,
}

/// The workgroups of patches, whose slots are counted from `first`.
///
/// # Errors
/// If a slot's number is not below 2³².
pub fn items(patches: &[Patch], first: usize) -> Result<Vec<Item>> {
    let mut items = Vec::new();
    for patch in patches {
        let (start, len) = (number(patch.start - first)?, number(patch.len)?);
        for query in (0..patch.own).step_by(QUERIES) {
            items.push(Item { start, len, query: number(query)?, own: number(patch.own)? });
        }
    }
    Ok(items)
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    heads: u32,
    items: u32,
    scale: f32,
    pad: u32,
}

/// `softmax(q·k / √D)·v` of each slot among those of its patch. Rows of borrowed slots are not filled.
///
/// # Shapes
/// `qkv`: `[slots, 3·C]`, a row's channels being q, k, v, each `[heads, D]` → `[slots, C]`
///
/// # Errors
/// If sizes do not fit together, a head is wider than [`MAX_DIM`], or the device has no room.
pub fn patch_attention(
    commands: &mut Commands,
    qkv: &Rows,
    heads: Heads,
    items: &Array<Item>,
) -> Result<Rows> {
    let (channels, stored) = (heads.channels(), qkv.stored());
    if qkv.channels != 3 * channels || !(1..=MAX_DIM).contains(&heads.dim) {
        return shape(format!(
            "attention: rows of {} for {} heads of {} (at most {MAX_DIM})",
            qkv.channels, heads.count, heads.dim
        ));
    }
    let out = Rows::new(commands, "attention", qkv.rows, channels, stored)?;
    let dim = number(heads.dim)?;
    let fours = dim.div_ceil(4);
    let keys = (TILE / (4 * fours)).clamp(1, 64);
    let kernel = commands.gpu().kernel(
        "patch_attention",
        TEXT,
        &stored.with(None),
        &[("DIM", dim), ("FOURS", fours), ("KEYS", keys)],
    );
    let scale = (1.0 / (heads.dim as f64).sqrt()) as f32;
    let params = Params { heads: number(heads.count)?, items: number(items.len())?, scale, pad: 0 };
    let arrays: [(u32, &dyn Bound); 3] = [(1, qkv), (2, items), (3, &out)];
    commands.run(&kernel, &params, &arrays, items.len() as u64 * heads.count as u64)?;
    Ok(out)
}
