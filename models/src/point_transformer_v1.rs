//! Point Transformer: vector attention over nearest neighbors, pooling to a part of the points.
//!
//! Stages of pooling and blocks, then a decoder that interpolates between the three nearest points of
//! the coarser scale. A weight of the attention is a vector whose entries channels share.
//!
//! # Source
//! "Point Transformer" (Zhao et al. 2021) as Pointcept has it (`PointTransformer-Seg50`, its
//! defaults). Differs: where the original takes a quarter of the points by farthest point sampling,
//! a scale here has one point for each cell of `stride³` cells, the one nearest to the mean of those
//! in it (a quarter too where Gaussians lie on surfaces; farthest point sampling takes time with the
//! square of their number, and a tile would have other points than its scene); positions are voxel
//! numbers instead of meters; a scene with fewer points than neighbors attends to those it has;
//! equally near neighbors count by their place; batch norm of a single row takes the remembered
//! statistics. The hidden layer of the original's classifier belongs to the backbone (`out`), so that
//! any head can stand behind it. The coarsest stage reads the mean of its scene, so tiles of a scene
//! differ a little from the whole.

use crate::layers::{BatchNorm, Encoding, Linear, LinearNormRelu, batch_norm};
use crate::neighborhood::{Neighborhood, Scale};
use crate::stages::{DEEPEST, LARGEST, check_fields, edge};
use crate::{Architecture, Backbone, BackboneCost, Compute, Forward, Mode, PointCloud, ops};
use candle_core::{Device, Result, Tensor, bail};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::{Groups, Reduce};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Shape of a Point Transformer. Defaults are the original's, with 50 layers.
///
/// Lists have one entry a stage, from fine to coarse; the first stage is the input's scale.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointTransformerV1Config {
    /// Width of the input features.
    pub in_channels: usize,
    /// Edge of a stage's cells, in cells of the stage before; 1 for the first.
    pub stride: Vec<usize>,
    /// Blocks of each encoder stage.
    pub enc_depths: Vec<usize>,
    /// Channels of each stage.
    pub channels: Vec<usize>,
    /// Neighbors of each stage, each row itself among them.
    pub neighbors: Vec<usize>,
    /// Blocks of each decoder stage.
    pub dec_depths: Vec<usize>,
    /// Channels that share an entry of a weight.
    pub share_channels: usize,
    /// Precision and joined layers: not part of the network, so not stored with it.
    #[serde(skip)]
    pub compute: Compute,
}

impl Default for PointTransformerV1Config {
    fn default() -> Self {
        Self {
            in_channels: 11,
            stride: vec![1, 2, 2, 2, 2],
            enc_depths: vec![1, 2, 3, 5, 2],
            channels: vec![32, 64, 128, 256, 512],
            neighbors: vec![8, 16, 16, 16, 16],
            dec_depths: vec![1; 5],
            share_channels: 8,
            compute: Compute::default(),
        }
    }
}

/// Neighbors that a decoder interpolates between.
const INTERPOLATED: usize = 3;

impl PointTransformerV1Config {
    fn position_width(&self, stage: usize) -> usize {
        if stage == 0 { 0 } else { 3 }
    }
}

impl Architecture for PointTransformerV1Config {
    fn check(&self) -> Result<()> {
        let stages = self.enc_depths.len();
        check_fields(
            stages,
            &[
                ("in_channels", &[self.in_channels], 1, 1..=LARGEST),
                ("stride", &self.stride, stages, 1..=LARGEST),
                ("channels", &self.channels, stages, 1..=LARGEST),
                ("neighbors", &self.neighbors, stages, 1..=LARGEST),
                ("share_channels", &[self.share_channels], 1, 1..=LARGEST),
                ("enc_depths", &self.enc_depths, stages, 0..=DEEPEST),
                ("dec_depths", &self.dec_depths, stages, 0..=DEEPEST),
            ],
        )?;
        if self.stride[0] != 1 {
            bail!(
                "stride[0]: {} given, but the first stage is the input's scale: 1",
                self.stride[0]
            );
        }
        if let Some(c) = self.channels.iter().find(|c| *c % self.share_channels != 0) {
            bail!("share_channels: {} do not divide {c} channels", self.share_channels);
        }
        Ok(())
    }
    fn build(&self, vb: VarBuilder<'_>) -> Result<Box<dyn Backbone>> {
        Ok(Box::new(PointTransformerV1::new(self, vb)?))
    }
    fn in_channels(&self) -> usize {
        self.in_channels
    }
    fn out_channels(&self) -> usize {
        self.channels.first().copied().unwrap_or(0)
    }
    fn num_values(&self) -> usize {
        let linear = |i: usize, o: usize| i * o + o;
        let norm = |c: usize| 4 * c + 1;
        let block = |c: usize| {
            let w = c / self.share_channels;
            let position = linear(3, 3) + norm(3) + linear(3, c);
            let weight = norm(c) + linear(c, w) + norm(w) + linear(w, w);
            3 * linear(c, c) + position + weight + 2 * c * c + 3 * norm(c)
        };
        let (mut sum, mut below) = (0, self.in_channels);
        for (stage, &c) in self.channels.iter().enumerate() {
            sum += (self.enc_depths[stage] + self.dec_depths[stage]) * block(c);
            sum += (below + self.position_width(stage)) * c + norm(c);
            sum += match self.channels.get(stage + 1) {
                Some(&coarse) => linear(c, c) + norm(c) + linear(coarse, c) + norm(c),
                None => linear(2 * c, c) + norm(c) + linear(c, c),
            };
            below = c;
        }
        sum + linear(self.out_channels(), self.out_channels()) + norm(self.out_channels())
    }
    fn cost(&self) -> BackboneCost {
        let (mut parts, mut up) = (Vec::new(), Vec::new());
        let (mut share, mut widest) = (1.0, 0f64);
        for (stage, &c) in self.channels.iter().enumerate() {
            // Cells of a surface: a quarter for twice the edge.
            share *= if stage == 0 { 1.0 } else { 1.05 * (self.stride[stage] as f64).powi(-2) };
            let (c, k) = (c as f64, self.neighbors[stage] as f64);
            // Query, key, value and both outer layers of a row; encodings of an edge.
            let w = c / self.share_channels as f64;
            let work = (5.0 * c * c + k * (3.0 * c + c * w + w * w + 3.0 * c)) * share;
            for block in 0..self.enc_depths[stage] {
                parts.push((format!("enc.enc{stage}.block{block}"), work));
            }
            for block in (0..self.dec_depths[stage]).rev() {
                up.push((format!("dec.dec{stage}.block{block}"), work));
            }
            // Rows of edges that stand beside each other: position, key or value, their sum, what a
            // norm makes of it.
            widest = widest.max((4.0 * k * c + 6.0 * c) * share);
        }
        parts.extend(up.into_iter().rev());
        let waiting = (self.in_channels + 2 * self.out_channels()) as f64;
        let tables = 24.0 * self.neighbors.first().copied().unwrap_or(0) as f64 + 200.0;
        let bytes_per_voxel = ((4.0 * (widest + waiting) + tables) * 1.1) as usize;
        BackboneCost { bytes_per_voxel, parts }
    }
    fn compute(&self) -> Compute {
        self.compute
    }
    fn set_compute(&mut self, compute: Compute) {
        self.compute = compute;
    }
}

/// Attention whose weights are vectors.
#[derive(Debug)]
struct VectorAttention {
    query: Linear,
    key: Linear,
    value: Linear,
    position: Encoding,
    weight_norm: BatchNorm,
    weight: Encoding,
    share: usize,
}

impl VectorAttention {
    fn new(compute: Compute, c: usize, share: usize, vb: VarBuilder<'_>) -> Result<Self> {
        let w = c / share;
        let linear = |i, o, name: &str| Linear::with(compute, i, o, true, vb.pp(name));
        let encoding = |widths, name: &str| Encoding::new(compute, widths, vb.pp(name));
        Ok(Self {
            query: linear(c, c, "query")?,
            key: linear(c, c, "key")?,
            value: linear(c, c, "value")?,
            position: encoding([3, 3, c], "position")?,
            weight_norm: batch_norm(c, vb.pp("weight.norm"))?,
            weight: encoding([c, w, w], "weight")?,
            share,
        })
    }

    /// `[N, C] → [N, C]`
    fn forward(&self, x: &Tensor, near: &Neighborhood, mode: Mode) -> Result<Tensor> {
        let position = self.position.forward(&near.relative.to_device(x.device())?, mode)?;
        let query = near.of_queries(&self.query.forward(x)?)?;
        let relation = ((near.of_sources(&self.key.forward(x)?)? - query)? + &position)?;
        let hidden = self.weight_norm.forward_relu(&relation, mode)?;
        let weight = near.softmax(&self.weight.forward(&hidden, mode)?)?;
        let value = (near.of_sources(&self.value.forward(x)?)? + position)?;
        let (edges, channels) = value.dims2()?;
        // Entry i of a weight is that of the channels i, i + C/share, …
        let grouped = value.reshape((edges, self.share, channels / self.share))?;
        let weighted = grouped.broadcast_mul(&weight.unsqueeze(1)?)?;
        near.reduce(&weighted.reshape((edges, channels))?, Reduce::Sum)
    }
}

/// Attention between two linear layers, with a residual.
#[derive(Debug)]
struct Block {
    first: LinearNormRelu,
    attention: VectorAttention,
    norm: BatchNorm,
    last: Linear,
    last_norm: BatchNorm,
}

impl Block {
    fn new(compute: Compute, c: usize, share: usize, vb: VarBuilder<'_>) -> Result<Self> {
        Ok(Self {
            first: LinearNormRelu::new(compute, c, c, false, vb.pp("first"))?,
            attention: VectorAttention::new(compute, c, share, vb.pp("attn"))?,
            norm: batch_norm(c, vb.pp("norm"))?,
            last: Linear::with(compute, c, c, false, vb.pp("last.linear"))?,
            last_norm: batch_norm(c, vb.pp("last.norm"))?,
        })
    }

    fn forward(&self, x: &Tensor, near: &Neighborhood, mode: Mode) -> Result<Tensor> {
        let y = self.attention.forward(&self.first.forward(x, mode)?, near, mode)?;
        let y = self.last.forward(&self.norm.forward_relu(&y, mode)?)?;
        (self.last_norm.forward(&y, mode)? + x)?.relu()
    }
}

/// To a scale's channels: of the rows themselves, or of the neighbors in the scale above.
#[derive(Debug)]
struct TransitionDown {
    joined: LinearNormRelu,
    stride: usize,
    neighbors: usize,
}

impl TransitionDown {
    fn forward(&self, x: &Tensor, scale: &Scale, mode: Mode) -> Result<(Tensor, Option<Scale>)> {
        if self.neighbors == 0 {
            return Ok((self.joined.forward(x, mode)?, None));
        }
        let (coarse, _) = scale.pool_to_voxels(self.stride);
        let near = Neighborhood::new(&coarse, scale, self.neighbors)?;
        let rows = Tensor::cat(&[&near.relative.to_device(x.device())?, &near.of_sources(x)?], 1)?;
        let rows = near.reduce(&self.joined.forward(&rows, mode)?, Reduce::Max)?;
        Ok((rows, Some(coarse)))
    }
}

/// From below: interpolated rows beside the scale's own; at the coarsest scale, the scene's mean.
#[derive(Debug)]
enum TransitionUp {
    Coarsest { mean: Linear, joined: LinearNormRelu },
    Finer { own: LinearNormRelu, below: LinearNormRelu },
}

#[derive(Debug)]
struct Stage {
    down: TransitionDown,
    encoder: Vec<Block>,
    up: TransitionUp,
    decoder: Vec<Block>,
    neighbors: usize,
}

/// The network; see the module's documentation.
#[derive(Debug)]
pub struct PointTransformerV1 {
    config: PointTransformerV1Config,
    /// Fine to coarse.
    stages: Vec<Stage>,
    out: LinearNormRelu,
    /// Where the parameters are; input is brought there.
    device: Device,
}

impl PointTransformerV1 {
    /// Builds the network.
    ///
    /// # Errors
    /// If the configuration does not fit together or parameters exist with another shape.
    pub fn new(config: &PointTransformerV1Config, vb: VarBuilder<'_>) -> Result<Self> {
        config.check()?;
        let (compute, share) = (config.compute, config.share_channels);
        let joined = |i, o, bias, vb| LinearNormRelu::new(compute, i, o, bias, vb);
        let mut stages = Vec::new();
        let mut below = config.in_channels;
        for (i, &c) in config.channels.iter().enumerate() {
            let (enc, dec) = (vb.pp(format!("enc.enc{i}")), vb.pp(format!("dec.dec{i}")));
            let neighbors = config.neighbors[i];
            let blocks = |depth: usize, vb: &VarBuilder<'_>| {
                let block = |j: usize| Block::new(compute, c, share, vb.pp(format!("block{j}")));
                (0..depth).map(block).collect::<Result<Vec<_>>>()
            };
            let down = TransitionDown {
                joined: joined(below + config.position_width(i), c, false, enc.pp("down"))?,
                stride: config.stride[i],
                neighbors: if i == 0 { 0 } else { neighbors },
            };
            let up = match config.channels.get(i + 1) {
                Some(&coarse) => TransitionUp::Finer {
                    own: joined(c, c, true, dec.pp("up.own"))?,
                    below: joined(coarse, c, true, dec.pp("up.below"))?,
                },
                None => TransitionUp::Coarsest {
                    mean: Linear::with(compute, c, c, true, dec.pp("up.mean"))?,
                    joined: joined(2 * c, c, true, dec.pp("up.joined"))?,
                },
            };
            let encoder = blocks(config.enc_depths[i], &enc)?;
            let decoder = blocks(config.dec_depths[i], &dec)?;
            stages.push(Stage { down, encoder, up, decoder, neighbors });
            below = c;
        }
        let width = Architecture::out_channels(config);
        let out = joined(width, width, true, vb.pp("out"))?;
        Ok(Self { config: config.clone(), stages, out, device: vb.device().clone() })
    }
}

fn run(
    blocks: &[Block],
    name: &str,
    mut x: Tensor,
    scale: &mut Scale,
    neighbors: usize,
    cx: &mut Forward<'_>,
) -> Result<Tensor> {
    if blocks.is_empty() {
        return Ok(x);
    }
    let near = scale.neighbors(neighbors)?;
    for (i, block) in blocks.iter().enumerate() {
        x = block.forward(&x, &near, cx.mode)?;
        cx.observe(&format!("{name}.block{i}"), &x)?;
    }
    Ok(x)
}

impl Backbone for PointTransformerV1 {
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        points.check_width(self.config.in_channels)?;
        if cx.recompute.is_some() {
            bail!("recompute: point_transformer_v1 keeps what it computes; switch it off");
        }
        let mode = cx.mode;
        let (finest, sorted) = Scale::new(points)?;
        let mut x = sorted.enter(&points.feat)?.to_device(&self.device)?;
        let mut scales = vec![finest];
        let mut skips = Vec::new();
        for (i, stage) in self.stages.iter().enumerate() {
            let Some(scale) = scales.last() else { bail!("no scale") };
            let (rows, coarse) = stage.down.forward(&x, scale, mode)?;
            scales.extend(coarse);
            let Some(scale) = scales.last_mut() else { bail!("no scale") };
            x = run(&stage.encoder, &format!("enc.enc{i}"), rows, scale, stage.neighbors, cx)?;
            skips.push(x.clone());
        }
        for (i, stage) in self.stages.iter().enumerate().rev() {
            let own = &skips[i];
            x = match &stage.up {
                TransitionUp::Coarsest { mean, joined } => {
                    let scenes = Arc::new(scenes(scales[i].offsets()));
                    let rows = ops::segment_reduce(own, scenes.clone(), Reduce::Mean)?;
                    let rows = ops::expand_groups(&mean.forward(&rows)?.relu()?, scenes)?;
                    joined.forward(&Tensor::cat(&[own, &rows], 1)?, mode)?
                }
                TransitionUp::Finer { own: layer, below } => {
                    let near = Neighborhood::new(&scales[i], &scales[i + 1], INTERPOLATED)?;
                    let rows = near.of_sources(&below.forward(&x, mode)?)?;
                    let rows = rows.broadcast_mul(&near.inverse_distances(rows.device())?)?;
                    (layer.forward(own, mode)? + near.reduce(&rows, Reduce::Sum)?)?
                }
            };
            let scale = &mut scales[i];
            x = run(&stage.decoder, &format!("dec.dec{i}"), x, scale, stage.neighbors, cx)?;
        }
        sorted.leave(&self.out.forward(&x, mode)?)
    }
    fn out_channels(&self) -> usize {
        Architecture::out_channels(&self.config)
    }
    fn alignment(&self) -> u32 {
        edge(&self.config.stride)
    }
    fn cost(&self) -> Option<BackboneCost> {
        Some(Architecture::cost(&self.config))
    }
    fn compute(&self) -> Compute {
        self.config.compute
    }
}

/// The rows of each scene; scenes without rows have no group.
fn scenes(offsets: &[usize]) -> Groups {
    let filled = offsets.windows(2).filter(|s| s[1] > s[0]).map(|s| s[1] as u32);
    let ends: Vec<u32> = std::iter::once(0).chain(filled).collect();
    let rows = (0..ends[ends.len() - 1]).collect();
    Groups::new(rows, ends).expect("scenes follow each other")
}
