//! Softmax attention inside patches of an order.

use super::kernels;
use crate::launch::{
    Items::{PerBlock, PerThread},
    KernelEntry, Launcher,
    Scalar::{F32, U32},
};

/// The kernels of one width of heads; their text is compiled once for each.
macro_rules! of_width {
    ($width:ident, $module:literal) => {
        /// Kernels of heads that are at most this wide.
        pub mod $width {
            use super::*;
            kernels! { $module:
                /// 64 queries of one patch and head a block.
                FORWARD = attention_forward, 64, PerBlock(1);
                /// `Σ grad · out` of each row and head.
                ROW_SUMS = attention_row_sums, 256, PerThread;
                /// Gradient of the queries.
                QUERIES = attention_queries, 64, PerBlock(1);
                /// Gradients of keys and values.
                KEYS = attention_keys, 64, PerBlock(1);
                /// Those of borrowed slots.
                ADD_BORROWED = attention_add_borrowed, 256, PerThread;
            }
            pub(super) const ALL: Kernels = Kernels {
                forward: &FORWARD,
                row_sums: &ROW_SUMS,
                queries: &QUERIES,
                keys: &KEYS,
                add_borrowed: &ADD_BORROWED,
            };
        }
    };
}
macro_rules! of_width_bf16 {
    ($width:ident, $module:literal) => {
        /// Kernels with products in bf16 of heads that are at most this wide.
        pub mod $width {
            use super::*;
            kernels! { $module:
                /// 64 queries of one patch and head a block, 16 a warp.
                FORWARD = attention_bf16, 128, PerBlock(1);
            }
        }
    };
}
of_width!(width_16, "patch_attention_16");
of_width!(width_24, "patch_attention_24");
of_width!(width_32, "patch_attention_32");
of_width!(width_48, "patch_attention_48");
of_width!(width_64, "patch_attention_64");
of_width_bf16!(bf16_width_16, "patch_attention_bf16_16");
of_width_bf16!(bf16_width_32, "patch_attention_bf16_32");
of_width_bf16!(bf16_width_48, "patch_attention_bf16_48");
of_width_bf16!(bf16_width_64, "patch_attention_bf16_64");

/// Widest head there are kernels for.
pub const MOST_DIM: u32 = 64;
/// Queries, or keys, of a block.
const QUERIES: u32 = 64;

struct Kernels {
    forward: &'static KernelEntry,
    row_sums: &'static KernelEntry,
    queries: &'static KernelEntry,
    keys: &'static KernelEntry,
    add_borrowed: &'static KernelEntry,
}

/// The narrowest kernels for heads of this width.
fn kernels_of(dim: u32) -> Kernels {
    match dim {
        0..=16 => width_16::ALL,
        17..=24 => width_24::ALL,
        25..=32 => width_32::ALL,
        33..=48 => width_48::ALL,
        _ => width_64::ALL,
    }
}

fn bf16_kernel_of(dim: u32) -> &'static KernelEntry {
    match dim {
        0..=16 => &bf16_width_16::FORWARD,
        17..=32 => &bf16_width_32::FORWARD,
        33..=48 => &bf16_width_48::FORWARD,
        _ => &bf16_width_64::FORWARD,
    }
}

/// Heads and their width.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heads {
    /// Number of heads.
    pub count: u32,
    /// Channels of one head, at most [`MOST_DIM`].
    pub dim: u32,
}

impl Heads {
    fn scale(self) -> f32 {
        (1.0 / f64::from(self.dim).sqrt()) as f32
    }

    fn channels(self) -> u64 {
        u64::from(self.count) * u64::from(self.dim)
    }

    fn check(self) {
        assert!(
            self.dim <= MOST_DIM,
            "attention: heads of {} channels, at most {MOST_DIM}",
            self.dim
        );
    }
}

/// One patch: a stretch of slots, of which the first `own` count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patch {
    /// First slot.
    pub start: u32,
    /// Number of slots.
    pub len: u32,
    /// Leading slots whose outputs count; the others are borrowed.
    pub own: u32,
}

/// The patches of a batch, on the device.
#[derive(Debug)]
pub struct Patches<B> {
    table: B,
    pad: B,
    borrowed: B,
    count: u32,
    positions: u32,
    num_borrowed: u32,
    /// Blocks of 64 slots of the longest patch.
    stretches: u32,
}

impl<B> Patches<B> {
    /// Copies patches to the device; they serve every attention of their size.
    ///
    /// # Shapes
    /// `pad`: position of each slot, each position in one own slot and at most one borrowed one
    ///
    /// # Errors
    /// Those of the launcher.
    ///
    /// # Panics
    /// If a patch has more own slots than slots, or lies outside `pad` (bugs of the caller).
    pub fn upload<L: Launcher<Buffer = B>>(
        l: &L,
        patches: &[Patch],
        pad: &[u32],
    ) -> Result<Self, L::Error> {
        let mut table = Vec::with_capacity(patches.len());
        let mut borrowed: Vec<u32> = Vec::new();
        for patch in patches {
            let Patch { start, len, own } = *patch;
            let inside = pad.len() as u64 >= u64::from(start) + u64::from(len);
            assert!(own <= len && inside, "attention: {patch:?} of {} slots", pad.len());
            table.push([start, len, own, borrowed.len() as u32]);
            borrowed.extend(start + own..start + len);
        }
        let longest = patches.iter().map(|p| p.len).max().unwrap_or(0);
        Ok(Self {
            table: l.upload_values(&table)?,
            pad: l.upload_values(pad)?,
            borrowed: l.upload_values(&borrowed)?,
            count: patches.len() as u32,
            positions: patches.iter().map(|p| p.own).sum(),
            num_borrowed: borrowed.len() as u32,
            stretches: longest.div_ceil(QUERIES),
        })
    }

    /// Positions of the sequence, N.
    pub fn positions(&self) -> u32 {
        self.positions
    }

    fn blocks(&self, heads: Heads) -> u64 {
        u64::from(self.count) * u64::from(heads.count) * u64::from(self.stretches)
    }
}

/// What [`forward`] leaves for [`backward`].
#[derive(Debug)]
pub struct Attended<B> {
    /// `[N, C]`
    pub out: B,
    /// Largest score and one over the sum of the weights. `[N, heads, 2]`
    pub statistics: B,
}

/// Attention of every row to the rows of its patch, in f32. `order[position]` is the row there.
///
/// # Shapes
/// `qkv`: `[N, 3, heads, dim]` · `order`: `[N]` of `u32`, a permutation
///
/// # Errors
/// Those of the launcher.
///
/// # Panics
/// If heads are wider than [`MOST_DIM`], or arrays too short.
pub fn forward<L: Launcher>(
    l: &L,
    qkv: &L::Buffer,
    heads: Heads,
    patches: &Patches<L::Buffer>,
    order: &L::Buffer,
) -> Result<Attended<L::Buffer>, L::Error> {
    heads.check();
    let rows = u64::from(patches.positions);
    l.expect::<f32>("qkv", qkv, rows * 3 * heads.channels());
    l.expect::<u32>("order", order, rows);
    let mut out = l.alloc_values::<f32>((rows * heads.channels()) as usize)?;
    let mut statistics = l.alloc_values::<[f32; 2]>((rows * u64::from(heads.count)) as usize)?;
    l.run(
        kernels_of(heads.dim).forward,
        patches.blocks(heads),
        &[qkv, &patches.table, &patches.pad, order],
        &mut [&mut out, &mut statistics],
        &[U32(heads.count), U32(heads.dim), F32(heads.scale()), U32(patches.stretches)],
    )?;
    Ok(Attended { out, statistics })
}

/// [`forward`] with products in bf16: scaled queries, keys, values and weights are rounded, scores, softmax and
/// sums are f32.
///
/// # Shapes
/// `qkv`: `[N, 3, heads, dim]` of bf16 · `out`: `[N, C]` of bf16
///
/// # Errors
/// Those of the launcher.
///
/// # Panics
/// As [`forward`].
pub fn forward_bf16<L: Launcher>(
    l: &L,
    qkv: &L::Buffer,
    heads: Heads,
    patches: &Patches<L::Buffer>,
    order: &L::Buffer,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    heads.check();
    let rows = u64::from(patches.positions);
    l.expect::<u16>("qkv", qkv, rows * 3 * heads.channels());
    l.expect::<u32>("order", order, rows);
    l.expect::<u16>("output", out, rows * heads.channels());
    l.run(
        bf16_kernel_of(heads.dim),
        patches.blocks(heads),
        &[qkv, &patches.table, &patches.pad, order],
        &mut [out],
        &[U32(heads.count), U32(heads.dim), F32(heads.scale()), U32(patches.stretches)],
    )
}

/// Gradient of [`forward`] with respect to `qkv`; the scores are computed again.
///
/// # Shapes
/// `qkv`, `dqkv`: `[N, 3, heads, dim]` · `grad`: `[N, C]`
///
/// # Errors
/// Those of the launcher.
///
/// # Panics
/// As [`forward`].
#[allow(clippy::too_many_arguments)]
pub fn backward<L: Launcher>(
    l: &L,
    qkv: &L::Buffer,
    heads: Heads,
    patches: &Patches<L::Buffer>,
    order: &L::Buffer,
    attended: &Attended<L::Buffer>,
    grad: &L::Buffer,
    dqkv: &mut L::Buffer,
) -> Result<(), L::Error> {
    heads.check();
    let rows = u64::from(patches.positions);
    l.expect::<f32>("qkv", qkv, rows * 3 * heads.channels());
    l.expect::<f32>("gradient", grad, rows * heads.channels());
    l.expect::<f32>("gradient of qkv", dqkv, rows * 3 * heads.channels());
    let kernels = kernels_of(heads.dim);
    let mut row_sums = l.alloc_values::<f32>((rows * u64::from(heads.count)) as usize)?;
    l.run(
        kernels.row_sums,
        rows * u64::from(heads.count),
        &[grad, &attended.out],
        &mut [&mut row_sums],
        &[U32(patches.positions), U32(heads.count), U32(heads.dim)],
    )?;
    l.run(
        kernels.queries,
        patches.blocks(heads),
        &[qkv, grad, &attended.statistics, &row_sums, &patches.table, &patches.pad, order],
        &mut [dqkv],
        &[U32(heads.count), U32(heads.dim), F32(heads.scale()), U32(patches.stretches)],
    )?;
    let of_borrowed = u64::from(patches.num_borrowed) * 2 * heads.channels();
    let mut borrowed = l.alloc_values::<f32>(of_borrowed as usize)?;
    l.run(
        kernels.keys,
        patches.blocks(heads),
        &[qkv, grad, &attended.statistics, &row_sums, &patches.table, &patches.pad, order],
        &mut [dqkv, &mut borrowed],
        &[U32(heads.count), U32(heads.dim), F32(heads.scale()), U32(patches.stretches)],
    )?;
    l.run(
        kernels.add_borrowed,
        of_borrowed,
        &[&borrowed, &patches.borrowed, &patches.pad, order],
        &mut [dqkv],
        &[U32(patches.num_borrowed), U32(heads.channels() as u32)],
    )
}
