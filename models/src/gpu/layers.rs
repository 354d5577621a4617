//! Layers of networks on a graphics processor, with the parameters that the CPU's layers have.

use super::scale::{KERNEL, Scale, SlotShape, piece_bytes};
use super::wrap;
use crate::Compute;
use crate::layers::linear::parameters as linear_parameters;
use crate::layers::sparse_conv::{join, parameters as conv_parameters};
use crate::layers::{BatchNorm, LayerNorm as HostLayerNorm, NormKind, vector};
use candle_core::{Result, Tensor, bail};
use candle_nn::VarBuilder;
use scenesplat_gpu::ops::layer_norm::{Ending, LayerNorm, layer_norm};
use scenesplat_gpu::ops::patch_attention::{MAX_DIM, patch_attention};
use scenesplat_gpu::ops::point_rope::point_rope;
use scenesplat_gpu::ops::pool::{Affine, DeviceGroups, pool};
use scenesplat_gpu::ops::product::{Product, Weights, product};
use scenesplat_gpu::ops::rows::add_gathered;
use scenesplat_gpu::ops::{Rows, Stored};
use scenesplat_gpu::{Array, Commands, Gpu};
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::segment::Reduce;
use std::ops::Range;

/// Taps along an axis of the convolution in front.
const STEM_KERNEL: usize = 5;

/// Where weights go, and how they are stored.
#[derive(Debug, Clone)]
pub(super) struct Place {
    pub gpu: Gpu,
    pub stored: Stored,
    pub compute: Compute,
}

impl Place {
    fn weights(&self, weight: &[f32], bias: Option<&[f32]>, shape: [usize; 3]) -> Result<Weights> {
        Weights::upload(&self.gpu, weight, bias, shape, self.stored).map_err(wrap)
    }

    pub fn linear(&self, inputs: usize, outputs: usize, vb: &VarBuilder<'_>) -> Result<Weights> {
        let (weight, bias) = linear_parameters(inputs, outputs, true, vb)?;
        let bias = bias.as_ref().map(vector).transpose()?;
        self.weights(&flat(&weight)?, bias.as_deref(), [outputs, 1, inputs])
    }

    pub fn layer_norm(&self, channels: usize, vb: &VarBuilder<'_>) -> Result<LayerNorm> {
        let (weight, bias) = HostLayerNorm::parameters(channels, vb)?;
        LayerNorm::upload(&self.gpu, &vector(&weight)?, &vector(&bias)?).map_err(wrap)
    }
}

/// Voxels whose widest whole rows fit into one array: of the result, of each scale of the encoder (`widths`, fine to
/// coarse) and of the layer that pools it. Scales have a quarter of the voxels of the finer one on average over scenes; half
/// is reckoned with.
pub(super) fn most_voxels(
    place: &Place,
    result: usize,
    widths: &[usize],
    decoder: &[usize],
) -> usize {
    let at_scale = |widths: &[usize], ahead: usize| {
        let share = |(scale, width): (usize, &usize)| *width >> scale.saturating_sub(ahead).min(31);
        widths.iter().enumerate().map(share).max().unwrap_or(0)
    };
    let widest = result.max(at_scale(widths, 1)).max(at_scale(decoder, 1)).max(1);
    (place.gpu.largest_array() / (widest * place.stored.bytes()) as u64) as usize
}

fn flat(t: &Tensor) -> Result<Vec<f32>> {
    t.flatten_all()?.to_vec1()
}

/// Factor and summand of a frozen batch norm.
fn scale_shift(channels: usize, vb: VarBuilder<'_>) -> Result<(Vec<f32>, Vec<f32>)> {
    let norm = BatchNorm::new(channels, vb)?;
    match norm.scale_shift() {
        Some((scale, shift)) => Ok((scale.to_vec(), shift.to_vec())),
        None => bail!("a network on a graphics processor cannot be trained"),
    }
}

/// Rows of weights multiplied by the factors of a norm behind them, and the bias that comes of it.
fn fold(
    weight: &mut [f32],
    bias: Option<Vec<f32>>,
    (scale, shift): (Vec<f32>, Vec<f32>),
) -> Vec<f32> {
    let width = weight.len() / scale.len().max(1);
    for (row, scale) in weight.chunks_exact_mut(width.max(1)).zip(&scale) {
        row.iter_mut().for_each(|w| *w *= scale);
    }
    let bias = bias.unwrap_or_else(|| vec![0.0; scale.len()]);
    bias.iter().zip(&scale).zip(&shift).map(|((b, s), t)| b.mul_add(*s, *t)).collect()
}

/// A linear layer, a norm, GELU. A batch norm is a part of the linear layer.
#[derive(Debug)]
pub(super) struct LinearNorm {
    linear: Weights,
    norm: Option<LayerNorm>,
}

impl LinearNorm {
    pub fn new(
        place: &Place,
        kind: NormKind,
        [inputs, outputs]: [usize; 2],
        linear: VarBuilder<'_>,
        norm: VarBuilder<'_>,
    ) -> Result<Self> {
        if kind == NormKind::Layer {
            let (linear, norm) =
                (place.linear(inputs, outputs, &linear)?, place.layer_norm(outputs, &norm)?);
            return Ok(Self { linear, norm: Some(norm) });
        }
        let (weight, bias) = linear_parameters(inputs, outputs, true, &linear)?;
        let (mut weight, bias) = (flat(&weight)?, bias.as_ref().map(vector).transpose()?);
        let bias = fold(&mut weight, bias, scale_shift(outputs, norm)?);
        let linear = place.weights(&weight, Some(&bias), [outputs, 1, inputs])?;
        Ok(Self { linear, norm: None })
    }

    pub fn forward(&self, commands: &mut Commands, x: &Rows) -> Result<Rows> {
        let how = Product { gelu: self.norm.is_none(), ..Product::default() };
        let y = product(commands, x, &self.linear, &how).map_err(wrap)?;
        match &self.norm {
            Some(norm) => layer_norm(commands, &y, norm, Ending::Gelu).map_err(wrap),
            None => Ok(y),
        }
    }

    /// `forward(x)` plus the row of `coarse` of each row's group.
    pub fn forward_add(
        &self,
        commands: &mut Commands,
        x: &Rows,
        coarse: &Rows,
        groups: &DeviceGroups,
    ) -> Result<Rows> {
        if self.norm.is_some() {
            let y = self.forward(commands, x)?;
            return add_gathered(commands, &y, coarse, &groups.inverse).map_err(wrap);
        }
        let how = Product {
            gelu: true,
            residual: Some(coarse),
            residual_rows: Some(&groups.inverse),
            ..Product::default()
        };
        product(commands, x, &self.linear, &how).map_err(wrap)
    }
}

/// The first layer, its norm, GELU.
#[derive(Debug)]
pub(super) enum Stem {
    Convolution(Weights),
    Linear(LinearNorm),
}

impl Stem {
    pub fn convolution(
        place: &Place,
        [inputs, channels]: [usize; 2],
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let (weight, _) =
            conv_parameters(inputs, channels, STEM_KERNEL, false, &vb.pp("stem.conv"))?;
        let mut weight = flat(&weight)?;
        let bias = fold(&mut weight, None, scale_shift(channels, vb.pp("stem.norm"))?);
        let shape = [channels, STEM_KERNEL.pow(3), inputs];
        Ok(Self::Convolution(place.weights(&weight, Some(&bias), shape)?))
    }

    pub fn linear(place: &Place, widths: [usize; 2], vb: &VarBuilder<'_>) -> Result<Self> {
        let (linear, norm) = (vb.pp("stem.linear"), vb.pp("stem.norm"));
        Ok(Self::Linear(LinearNorm::new(place, NormKind::Layer, widths, linear, norm)?))
    }

    pub fn forward(&self, commands: &mut Commands, x: &Rows, scale: &Scale) -> Result<Rows> {
        let weights = match self {
            Self::Convolution(weights) => weights,
            Self::Linear(layer) => return layer.forward(commands, x),
        };
        let gpu = commands.gpu().clone();
        let out = Rows::new(commands, "a convolution", x.rows(), weights.outputs(), x.stored());
        let out = out.map_err(wrap)?;
        // No other layer has this kernel size, so each piece of the table goes as soon as it was read.
        for range in scale.table_ranges(&gpu, STEM_KERNEL) {
            let table = scale.cloud.table(commands, STEM_KERNEL, range.clone()).map_err(wrap)?;
            convolve(commands, x, weights, (range, &table), &out, true)?;
        }
        Ok(out)
    }
}

/// A convolution at the rows of a table.
fn convolve(
    commands: &mut Commands,
    x: &Rows,
    weights: &Weights,
    (range, table): (Range<usize>, &Array<u32>),
    out: &Rows,
    gelu: bool,
) -> Result<()> {
    let how = Product {
        range: Some(range),
        table: Some(table),
        into: Some(out),
        gelu,
        ..Product::default()
    };
    product(commands, x, weights, &how).map_err(wrap)?;
    Ok(())
}

/// `x + LN(Linear(conv(input)))`
#[derive(Debug)]
pub(super) struct ResidualConv {
    conv: Weights,
    /// `None` if it is part of the convolution.
    linear: Option<Weights>,
    norm: LayerNorm,
}

impl ResidualConv {
    pub fn new(place: &Place, c: usize, vb: &VarBuilder<'_>) -> Result<Self> {
        let (conv, linear) = (vb.pp("0"), vb.pp("1"));
        let inner = conv_parameters(c, c, KERNEL, true, &conv)?;
        let taps = KERNEL.pow(3);
        let (conv, linear) = if place.compute.fold {
            let outer = linear_parameters(c, c, true, &linear)?;
            let (weight, bias) = join(inner, outer, c, KERNEL)?;
            (place.weights(&weight, Some(&bias), [c, taps, c])?, None)
        } else {
            let bias = inner.1.as_ref().map(vector).transpose()?;
            let conv = place.weights(&flat(&inner.0)?, bias.as_deref(), [c, taps, c])?;
            (conv, Some(place.linear(c, c, &linear)?))
        };
        Ok(Self { conv, linear, norm: place.layer_norm(c, &vb.pp("2"))? })
    }

    /// The convolution reads `input` where given, else `x`.
    pub fn forward(
        &self,
        commands: &mut Commands,
        x: &Rows,
        input: Option<Rows>,
        scale: &mut Scale,
    ) -> Result<Rows> {
        let out = Rows::new(commands, "a convolution", x.rows(), self.conv.outputs(), x.stored());
        let mut y = out.map_err(wrap)?;
        for (range, table) in scale.tables(commands)?.iter() {
            let read = input.as_ref().unwrap_or(x);
            convolve(commands, read, &self.conv, (range.clone(), table), &y, false)?;
        }
        drop(input);
        if let Some(linear) = &self.linear {
            y = product(commands, &y, linear, &Product::default()).map_err(wrap)?;
        }
        layer_norm(commands, &y, &self.norm, Ending::Residual(x)).map_err(wrap)
    }
}

/// `x + attention(LN(x))`, then `x + MLP(LN(x))`.
#[derive(Debug)]
pub(super) struct AttentionMlp {
    norm1: LayerNorm,
    qkv: Weights,
    proj: Weights,
    norm2: LayerNorm,
    fc1: Weights,
    fc2: Weights,
    shape: AttentionShape,
}

/// What attention of a block is like.
#[derive(Debug, Clone, Copy)]
pub(super) struct AttentionShape {
    pub channels: usize,
    pub heads: usize,
    pub patch_size: usize,
    pub order: usize,
    pub mlp_ratio: usize,
    /// Base of the angles of rotary embeddings, where there are any.
    pub rope_base: Option<f64>,
}

impl AttentionMlp {
    pub fn new(place: &Place, shape: AttentionShape, vb: &VarBuilder<'_>) -> Result<Self> {
        let (c, hidden) = (shape.channels, shape.mlp_ratio * shape.channels);
        if c / shape.heads > MAX_DIM {
            bail!(
                "heads of {} channels: graphics processors take {MAX_DIM} at most",
                c / shape.heads
            );
        }
        Ok(Self {
            norm1: place.layer_norm(c, &vb.pp("norm1.0"))?,
            qkv: place.linear(c, 3 * c, &vb.pp("attn.qkv"))?,
            proj: place.linear(c, c, &vb.pp("attn.proj"))?,
            norm2: place.layer_norm(c, &vb.pp("norm2.0"))?,
            fc1: place.linear(c, hidden, &vb.pp("mlp.0.fc1"))?,
            fc2: place.linear(hidden, c, &vb.pp("mlp.0.fc2"))?,
            shape,
        })
    }

    /// Points of a patch, of a scene that has so many.
    pub fn patch_size(&self) -> usize {
        self.shape.patch_size
    }

    /// `patch_size`: points of a patch in this pass.
    pub fn forward(
        &self,
        commands: &mut Commands,
        x: &Rows,
        scale: &mut Scale,
        patch_size: usize,
    ) -> Result<Rows> {
        let y = self.attend(commands, x, scale, patch_size)?;
        self.mlp(commands, &y)
    }

    /// Patches by pieces, so that queries, keys and values of all rows never exist at once.
    fn attend(
        &self,
        commands: &mut Commands,
        x: &Rows,
        scale: &mut Scale,
        patch_size: usize,
    ) -> Result<Rows> {
        let AttentionShape { channels, heads, order, rope_base, .. } = self.shape;
        let heads = Heads { count: heads, dim: channels / heads };
        let rotations =
            rope_base.map(|base| scale.rotations(commands, heads.dim, base)).transpose()?;
        let normed = layer_norm(commands, x, &self.norm1, Ending::None).map_err(wrap)?;
        let out = Rows::new(commands, "attention", x.rows(), channels, x.stored()).map_err(wrap)?;
        let bytes = 3 * channels * x.stored().bytes();
        let slots = scale.slots(commands, SlotShape { order, patch_size, bytes })?;
        for part in &slots.parts {
            let how = Product {
                range: Some(part.slots.clone()),
                at: Some(0),
                gather: Some(&slots.rows),
                ..Product::default()
            };
            let qkv = product(commands, &normed, &self.qkv, &how).map_err(wrap)?;
            if let Some(rotations) = &rotations {
                let first = part.slots.start;
                point_rope(commands, &qkv, heads, rotations, &slots.rows, first).map_err(wrap)?;
            }
            let attended = patch_attention(commands, &qkv, heads, &part.items).map_err(wrap)?;
            drop(qkv);
            let how = Product {
                range: Some(part.positions.clone()),
                gather: Some(&slots.of_positions),
                base: part.slots.start,
                scatter: Some(&slots.order),
                into: Some(&out),
                residual: Some(x),
                ..Product::default()
            };
            product(commands, &attended, &self.proj, &how).map_err(wrap)?;
        }
        Ok(out)
    }

    /// Rows by pieces, so that the hidden rows never exist at once.
    fn mlp(&self, commands: &mut Commands, x: &Rows) -> Result<Rows> {
        let normed = layer_norm(commands, x, &self.norm2, Ending::None).map_err(wrap)?;
        let n = x.rows();
        let out = Rows::new(commands, "an MLP", n, x.channels(), x.stored()).map_err(wrap)?;
        let bytes = self.fc1.outputs() * x.stored().bytes();
        let step = (piece_bytes(commands.gpu()) as usize / bytes.max(1)).max(1);
        for first in (0..n).step_by(step) {
            let range = first..(first + step).min(n);
            let how = Product { range: Some(range), at: Some(0), gelu: true, ..Product::default() };
            let hidden = product(commands, &normed, &self.fc1, &how).map_err(wrap)?;
            let how = Product {
                at: Some(first),
                into: Some(&out),
                residual: Some(x),
                ..Product::default()
            };
            product(commands, &hidden, &self.fc2, &how).map_err(wrap)?;
        }
        Ok(out)
    }
}

/// Linear, a row for each cell, norm, GELU.
#[derive(Debug)]
pub(super) struct CellPooling {
    proj: Weights,
    norm: PoolNorm,
    reduce: Reduce,
}

#[derive(Debug)]
enum PoolNorm {
    Batch(Affine),
    Layer(LayerNorm),
}

impl CellPooling {
    pub fn new(
        place: &Place,
        [inputs, channels]: [usize; 2],
        reduce: Reduce,
        kind: NormKind,
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let proj = place.linear(inputs, channels, &vb.pp("proj"))?;
        let norm = match kind {
            NormKind::Layer => PoolNorm::Layer(place.layer_norm(channels, &vb.pp("norm.0"))?),
            NormKind::Batch => {
                let (scale, shift) = scale_shift(channels, vb.pp("norm.0"))?;
                let upload = |values: &[f32]| place.gpu.upload("a norm", values).map_err(wrap);
                PoolNorm::Batch(Affine { factor: upload(&scale)?, summand: upload(&shift)? })
            }
        };
        Ok(Self { proj, norm, reduce })
    }

    pub fn forward(
        &self,
        commands: &mut Commands,
        x: &Rows,
        groups: &DeviceGroups,
    ) -> Result<Rows> {
        let y = product(commands, x, &self.proj, &Product::default()).map_err(wrap)?;
        match &self.norm {
            PoolNorm::Batch(affine) => {
                pool(commands, &y, groups, self.reduce, Some(affine), true).map_err(wrap)
            }
            PoolNorm::Layer(norm) => {
                let pooled = pool(commands, &y, groups, self.reduce, None, false).map_err(wrap)?;
                layer_norm(commands, &pooled, norm, Ending::Gelu).map_err(wrap)
            }
        }
    }
}

/// From a scale to the next finer one.
#[derive(Debug)]
pub(super) struct Unpooling {
    pub proj: LinearNorm,
    pub skip: LinearNorm,
}

impl Unpooling {
    /// Widths of the coarse rows, of the fine ones, and of the result.
    pub fn new(
        place: &Place,
        kind: NormKind,
        [coarse, fine, channels]: [usize; 3],
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let layer = |inputs, vb: VarBuilder<'_>| {
            LinearNorm::new(place, kind, [inputs, channels], vb.pp("0"), vb.pp("1"))
        };
        Ok(Self { proj: layer(coarse, vb.pp("proj"))?, skip: layer(fine, vb.pp("proj_skip"))? })
    }

    /// The sum of both branches.
    pub fn forward_sum(
        &self,
        commands: &mut Commands,
        coarse: &Rows,
        fine: &Rows,
        groups: &DeviceGroups,
    ) -> Result<Rows> {
        let up = self.proj.forward(commands, coarse)?;
        self.skip.forward_add(commands, fine, &up, groups)
    }

    /// The sum of both branches, and the skip branch alone.
    pub fn forward_both(
        &self,
        commands: &mut Commands,
        coarse: &Rows,
        fine: &Rows,
        groups: &DeviceGroups,
    ) -> Result<(Rows, Rows)> {
        let up = self.proj.forward(commands, coarse)?;
        let skip = self.skip.forward(commands, fine)?;
        Ok((add_gathered(commands, &skip, &up, &groups.inverse).map_err(wrap)?, skip))
    }
}
