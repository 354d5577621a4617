//! Point Transformer V2: grouped vector attention over nearest neighbors, pooling by grid cells.
//!
//! Embedding and blocks at the finest scale, then stages of pooling and blocks, then a decoder that
//! gives each voxel what its cell has. A weight of the attention is a vector with one entry for each
//! group of channels, made of the difference of key and query and of where the neighbor lies.
//!
//! # Source
//! "Point Transformer V2" (Wu et al. 2022), mode 2 of Pointcept (`PT-v2m2`, its defaults). Differs:
//! positions are voxel numbers instead of meters (the batch norm behind the first layer of the
//! position encoding takes the unit out); cells are counted from the corner of the grid instead of
//! the scene's lowest point, so that tiles of a scene have its cells; a scene with fewer points than
//! neighbors attends to those it has; equally near neighbors count by their place; batch norm of a
//! single row takes the remembered statistics; attention has no dropout. The hidden layer of the
//! original's classifier belongs to the backbone (`out`), so that any head can stand behind it.

use crate::layers::{BatchNorm, DropPath, Encoding, Linear, LinearNormRelu, batch_norm};
use crate::neighborhood::{Neighborhood, Scale};
use crate::stages::{
    DEEPEST, LARGEST, channels_below, check_drop_path, check_fields, drop_rates, edge,
};
use crate::{Architecture, Backbone, BackboneCost, Compute, Forward, Mode, PointCloud, ops};
use candle_core::{Device, Result, Tensor, bail};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::{Groups, Reduce};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Shape of a Point Transformer V2. Defaults are the original's.
///
/// Lists have one entry a stage, from fine to coarse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointTransformerV2Config {
    /// Width of the input features.
    pub in_channels: usize,
    /// Blocks at the finest scale.
    pub patch_embed_depth: usize,
    /// Channels there.
    pub patch_embed_channels: usize,
    /// Attention groups there.
    pub patch_embed_groups: usize,
    /// Neighbors there, each row itself among them.
    pub patch_embed_neighbors: usize,
    /// Edge of a stage's cells, in cells of the stage before.
    pub stride: Vec<usize>,
    /// Blocks of each encoder stage.
    pub enc_depths: Vec<usize>,
    /// Channels of each encoder stage.
    pub enc_channels: Vec<usize>,
    /// Attention groups of each encoder stage.
    pub enc_groups: Vec<usize>,
    /// Neighbors in each encoder stage.
    pub enc_neighbors: Vec<usize>,
    /// Blocks of each decoder stage, which works at the scale above the encoder stage.
    pub dec_depths: Vec<usize>,
    /// Channels of each decoder stage.
    pub dec_channels: Vec<usize>,
    /// Attention groups of each decoder stage.
    pub dec_groups: Vec<usize>,
    /// Neighbors in each decoder stage.
    pub dec_neighbors: Vec<usize>,
    /// Whether the place of a neighbor also multiplies the difference of key and query.
    pub position_multiplier: bool,
    /// Largest probability that a row skips a block in training.
    pub drop_path: f64,
    /// Precision and joined layers: not part of the network, so not stored with it.
    #[serde(skip)]
    pub compute: Compute,
}

impl Default for PointTransformerV2Config {
    fn default() -> Self {
        Self {
            in_channels: 11,
            patch_embed_depth: 1,
            patch_embed_channels: 48,
            patch_embed_groups: 6,
            patch_embed_neighbors: 8,
            // 6, 12, 24 and 48 cm at voxels of 2 cm.
            stride: vec![3, 2, 2, 2],
            enc_depths: vec![2, 2, 6, 2],
            enc_channels: vec![96, 192, 384, 512],
            enc_groups: vec![12, 24, 48, 64],
            enc_neighbors: vec![16; 4],
            dec_depths: vec![1; 4],
            dec_channels: vec![48, 96, 192, 384],
            dec_groups: vec![6, 12, 24, 48],
            dec_neighbors: vec![16; 4],
            position_multiplier: false,
            drop_path: 0.3,
            compute: Compute::default(),
        }
    }
}

/// Where blocks stand: their name, shape and number.
struct Site {
    name: String,
    /// Poolings above this scale.
    level: usize,
    channels: usize,
    groups: usize,
    neighbors: usize,
    /// Drop rates of the blocks, as many as there are.
    rates: Vec<f64>,
}

impl PointTransformerV2Config {
    /// All sequences of blocks: the finest scale, the encoder's, the decoder's.
    fn sites(&self) -> Vec<Site> {
        let encoder = drop_rates(&self.enc_depths, self.drop_path);
        let decoder = drop_rates(&self.dec_depths, self.drop_path);
        let mut sites = vec![Site {
            name: "patch_embed".to_owned(),
            level: 0,
            channels: self.patch_embed_channels,
            groups: self.patch_embed_groups,
            neighbors: self.patch_embed_neighbors,
            rates: vec![0.0; self.patch_embed_depth],
        }];
        sites.extend(encoder.into_iter().enumerate().map(|(i, rates)| Site {
            name: format!("enc.enc{i}"),
            level: i + 1,
            channels: self.enc_channels[i],
            groups: self.enc_groups[i],
            neighbors: self.enc_neighbors[i],
            rates,
        }));
        sites.extend(decoder.into_iter().enumerate().map(|(i, rates)| Site {
            name: format!("dec.dec{i}"),
            level: i,
            channels: self.dec_channels[i],
            groups: self.dec_groups[i],
            neighbors: self.dec_neighbors[i],
            rates,
        }));
        sites
    }

    /// Channels of the skip rows of a decoder stage, and of the rows from below.
    fn decoder_inputs(&self, stage: usize) -> (usize, usize) {
        let skip = match stage {
            0 => self.patch_embed_channels,
            _ => self.enc_channels[stage - 1],
        };
        (skip, channels_below(&self.enc_channels, &self.dec_channels, stage))
    }

    fn encoder_input(&self, stage: usize) -> usize {
        self.decoder_inputs(stage).0
    }
}

impl Architecture for PointTransformerV2Config {
    fn check(&self) -> Result<()> {
        let stages = self.enc_depths.len();
        check_fields(
            stages,
            &[
                ("in_channels", &[self.in_channels], 1, 1..=LARGEST),
                ("patch_embed_channels", &[self.patch_embed_channels], 1, 1..=LARGEST),
                ("patch_embed_groups", &[self.patch_embed_groups], 1, 1..=LARGEST),
                ("patch_embed_neighbors", &[self.patch_embed_neighbors], 1, 1..=LARGEST),
                ("stride", &self.stride, stages, 1..=LARGEST),
                ("enc_channels", &self.enc_channels, stages, 1..=LARGEST),
                ("enc_groups", &self.enc_groups, stages, 1..=LARGEST),
                ("enc_neighbors", &self.enc_neighbors, stages, 1..=LARGEST),
                ("dec_channels", &self.dec_channels, stages, 1..=LARGEST),
                ("dec_groups", &self.dec_groups, stages, 1..=LARGEST),
                ("dec_neighbors", &self.dec_neighbors, stages, 1..=LARGEST),
                ("patch_embed_depth", &[self.patch_embed_depth], 1, 0..=DEEPEST),
                ("enc_depths", &self.enc_depths, stages, 0..=DEEPEST),
                ("dec_depths", &self.dec_depths, stages, 0..=DEEPEST),
            ],
        )?;
        for site in self.sites() {
            if site.channels % site.groups != 0 {
                bail!(
                    "{}: {} groups do not divide {} channels",
                    site.name,
                    site.groups,
                    site.channels
                );
            }
        }
        check_drop_path(self.drop_path)
    }
    fn build(&self, vb: VarBuilder<'_>) -> Result<Box<dyn Backbone>> {
        Ok(Box::new(PointTransformerV2::new(self, vb)?))
    }
    fn in_channels(&self) -> usize {
        self.in_channels
    }
    fn out_channels(&self) -> usize {
        self.dec_channels.first().copied().unwrap_or(0)
    }
    fn num_values(&self) -> usize {
        let linear = |i: usize, o: usize| i * o + o;
        let norm = |c: usize| 4 * c + 1;
        let joined = |i: usize, o: usize| linear(i, o) + norm(o);
        let block = |c: usize, g: usize| {
            let position = joined(3, c) + linear(c, c);
            let position = if self.position_multiplier { 2 * position } else { position };
            let attention =
                2 * joined(c, c) + linear(c, c) + position + joined(c, g) + linear(g, g);
            attention + 2 * c * c + 3 * norm(c)
        };
        let mut sum: usize =
            self.sites().iter().map(|s| s.rates.len() * block(s.channels, s.groups)).sum();
        sum += self.in_channels * self.patch_embed_channels + norm(self.patch_embed_channels);
        for stage in 0..self.enc_depths.len() {
            sum += self.encoder_input(stage) * self.enc_channels[stage]
                + norm(self.enc_channels[stage]);
            let (skip, below) = self.decoder_inputs(stage);
            sum += joined(below, self.dec_channels[stage]) + joined(skip, self.dec_channels[stage]);
        }
        sum + joined(self.out_channels(), self.out_channels())
    }
    fn cost(&self) -> BackboneCost {
        // Cells of a surface: a quarter for twice the edge.
        let share = |level: usize| -> f64 {
            self.stride[..level].iter().map(|s| 1.05 * (*s as f64).powi(-2)).product()
        };
        let mut parts = Vec::new();
        let mut widest = 0f64;
        for site in self.sites() {
            let (c, k) = (site.channels as f64, site.neighbors as f64);
            // Query, key, value and both outer layers of a row; the position encoding of an edge.
            let position = if self.position_multiplier { 2.0 * c * c } else { c * c };
            let work = 5.0 * c * c + k * (position + 3.0 * c + 2.0 * c * site.groups as f64);
            for block in 0..site.rates.len() {
                parts.push((format!("{}.block{block}", site.name), work * share(site.level)));
            }
            // Rows of edges that stand beside each other: position encoding, its hidden layer, key or
            // value, and their sum.
            widest = widest.max((4.0 * k * c + 6.0 * c) * share(site.level));
        }
        let waiting = (self.in_channels + self.patch_embed_channels + self.out_channels()) as f64;
        let tables = 24.0 * self.patch_embed_neighbors as f64 + 200.0;
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

/// Attention whose weights are vectors, one entry for each group of channels.
#[derive(Debug)]
struct GroupedVectorAttention {
    query: LinearNormRelu,
    key: LinearNormRelu,
    value: Linear,
    position: Encoding,
    multiplier: Option<Encoding>,
    weight: Encoding,
    groups: usize,
}

impl GroupedVectorAttention {
    fn new(
        compute: Compute,
        channels: usize,
        groups: usize,
        multiplier: bool,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (c, joined) = (channels, LinearNormRelu::new);
        let encoding = |widths, name: &str| Encoding::new(compute, widths, vb.pp(name));
        let multiplier = multiplier.then(|| encoding([3, c, c], "multiplier"));
        Ok(Self {
            query: joined(compute, c, c, true, vb.pp("query"))?,
            key: joined(compute, c, c, true, vb.pp("key"))?,
            value: Linear::with(compute, c, c, true, vb.pp("value"))?,
            position: encoding([3, c, c], "position")?,
            multiplier: multiplier.transpose()?,
            weight: encoding([c, groups, groups], "weight")?,
            groups,
        })
    }

    /// `[N, C] → [N, C]`
    fn forward(&self, x: &Tensor, near: &Neighborhood, mode: Mode) -> Result<Tensor> {
        let query = near.of_queries(&self.query.forward(x, mode)?)?;
        let mut relation = (near.of_sources(&self.key.forward(x, mode)?)? - query)?;
        let relative = near.relative.to_device(x.device())?;
        if let Some(multiplier) = &self.multiplier {
            relation = (relation * multiplier.forward(&relative, mode)?)?;
        }
        let position = self.position.forward(&relative, mode)?;
        let logits = self.weight.forward(&(relation + &position)?, mode)?;
        let weight = near.softmax(&logits)?;
        let value = (near.of_sources(&self.value.forward(x)?)? + position)?;
        let (edges, channels) = value.dims2()?;
        let grouped = value.reshape((edges, self.groups, channels / self.groups))?;
        let weighted = grouped.broadcast_mul(&weight.unsqueeze(2)?)?;
        near.reduce(&weighted.reshape((edges, channels))?, Reduce::Sum)
    }
}

/// Attention between two linear layers, with a residual.
#[derive(Debug)]
struct Block {
    first: Linear,
    norm1: BatchNorm,
    attention: GroupedVectorAttention,
    norm2: BatchNorm,
    last: Linear,
    norm3: BatchNorm,
    drop_path: DropPath,
}

impl Block {
    fn new(
        compute: Compute,
        site: &Site,
        rate: f64,
        multiplier: bool,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let c = site.channels;
        let attention = vb.pp("attn");
        Ok(Self {
            first: Linear::with(compute, c, c, false, vb.pp("fc1"))?,
            norm1: batch_norm(c, vb.pp("norm1"))?,
            attention: GroupedVectorAttention::new(compute, c, site.groups, multiplier, attention)?,
            norm2: batch_norm(c, vb.pp("norm2"))?,
            last: Linear::with(compute, c, c, false, vb.pp("fc3"))?,
            norm3: batch_norm(c, vb.pp("norm3"))?,
            drop_path: DropPath { rate },
        })
    }

    fn forward(&self, x: &Tensor, near: &Neighborhood, cx: &mut Forward<'_>) -> Result<Tensor> {
        let mode = cx.mode;
        let y = self.norm1.forward_relu(&self.first.forward(x)?, mode)?;
        let y = self.attention.forward(&y, near, mode)?;
        let y = self.last.forward(&self.norm2.forward_relu(&y, mode)?)?;
        let y = self.norm3.forward(&y, mode)?;
        self.drop_path.forward_residual(&y, x, mode, cx.rng)?.relu()
    }
}

/// Blocks over the same neighborhoods.
#[derive(Debug)]
struct BlockSequence {
    name: String,
    neighbors: usize,
    blocks: Vec<Block>,
}

impl BlockSequence {
    fn new(config: &PointTransformerV2Config, site: &Site, vb: &VarBuilder<'_>) -> Result<Self> {
        let vb = vb.pp(&site.name);
        let block = |(i, rate): (usize, &f64)| {
            let vb = vb.pp(format!("block{i}"));
            Block::new(config.compute, site, *rate, config.position_multiplier, vb)
        };
        let blocks = site.rates.iter().enumerate().map(block).collect::<Result<_>>()?;
        Ok(Self { name: site.name.clone(), neighbors: site.neighbors, blocks })
    }

    fn forward(&self, mut x: Tensor, scale: &mut Scale, cx: &mut Forward<'_>) -> Result<Tensor> {
        if self.blocks.is_empty() {
            return Ok(x);
        }
        let near = scale.neighbors(self.neighbors)?;
        for (i, block) in self.blocks.iter().enumerate() {
            x = block.forward(&x, &near, cx)?;
            cx.observe(&format!("{}.block{i}", self.name), &x)?;
        }
        Ok(x)
    }
}

#[derive(Debug)]
struct EncoderStage {
    down: LinearNormRelu,
    stride: usize,
    blocks: BlockSequence,
}

#[derive(Debug)]
struct DecoderStage {
    up: LinearNormRelu,
    skip: LinearNormRelu,
    blocks: BlockSequence,
}

/// The network; see the module's documentation.
#[derive(Debug)]
pub struct PointTransformerV2 {
    config: PointTransformerV2Config,
    embedding: LinearNormRelu,
    finest: BlockSequence,
    encoder: Vec<EncoderStage>,
    /// Fine to coarse; run in reverse.
    decoder: Vec<DecoderStage>,
    out: LinearNormRelu,
    /// Where the parameters are; input is brought there.
    device: Device,
}

impl PointTransformerV2 {
    /// Builds the network.
    ///
    /// # Errors
    /// If the configuration does not fit together or parameters exist with another shape.
    pub fn new(config: &PointTransformerV2Config, vb: VarBuilder<'_>) -> Result<Self> {
        config.check()?;
        let compute = config.compute;
        let joined = |i, o, bias, vb| LinearNormRelu::new(compute, i, o, bias, vb);
        let embedding = joined(
            config.in_channels,
            config.patch_embed_channels,
            false,
            vb.pp("patch_embed.proj"),
        )?;
        let mut sequences = config.sites().into_iter().map(|s| BlockSequence::new(config, &s, &vb));
        let mut next = || match sequences.next() {
            Some(sequence) => sequence,
            None => bail!("the network has fewer blocks than stages"),
        };
        let finest = next()?;
        let mut encoder = Vec::new();
        for (i, &stride) in config.stride.iter().enumerate() {
            let (from, to) = (config.encoder_input(i), config.enc_channels[i]);
            let down = joined(from, to, false, vb.pp(format!("enc.enc{i}.down")))?;
            encoder.push(EncoderStage { down, stride, blocks: next()? });
        }
        let mut decoder = Vec::new();
        for i in 0..encoder.len() {
            let (skip, below) = config.decoder_inputs(i);
            let (to, vb) = (config.dec_channels[i], vb.pp(format!("dec.dec{i}.up")));
            decoder.push(DecoderStage {
                up: joined(below, to, true, vb.pp("proj"))?,
                skip: joined(skip, to, true, vb.pp("proj_skip"))?,
                blocks: next()?,
            });
        }
        let width = Architecture::out_channels(config);
        let out = joined(width, width, true, vb.pp("out"))?;
        let (config, device) = (config.clone(), vb.device().clone());
        Ok(Self { config, embedding, finest, encoder, decoder, out, device })
    }
}

impl Backbone for PointTransformerV2 {
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        points.check_width(self.config.in_channels)?;
        if cx.recompute.is_some() {
            bail!("recompute: point_transformer_v2 keeps what it computes; switch it off");
        }
        let (mut scale, sorted) = Scale::new(points)?;
        let feat = sorted.enter(&points.feat)?.to_device(&self.device)?;
        let x = self.embedding.forward(&feat, cx.mode)?;
        let mut x = self.finest.forward(x, &mut scale, cx)?;
        let mut above: Vec<(Tensor, Scale, Arc<Groups>)> = Vec::new();
        for stage in &self.encoder {
            let (coarse, groups) = scale.pool(stage.stride);
            let rows = stage.down.forward(&x, cx.mode)?;
            let pooled = ops::segment_reduce(&rows, groups.clone(), Reduce::Max)?;
            above.push((x, std::mem::replace(&mut scale, coarse), groups));
            x = stage.blocks.forward(pooled, &mut scale, cx)?;
        }
        for stage in self.decoder.iter().rev() {
            let Some((skip, fine, groups)) = above.pop() else {
                bail!("a decoder stage has no encoder stage");
            };
            let up = ops::expand_groups(&stage.up.forward(&x, cx.mode)?, groups)?;
            scale = fine;
            x = (up + stage.skip.forward(&skip, cx.mode)?)?;
            x = stage.blocks.forward(x, &mut scale, cx)?;
        }
        sorted.leave(&self.out.forward(&x, cx.mode)?)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ParamStore;
    use crate::weights::{WeightSource, unit};
    use candle_core::Device;
    use std::collections::BTreeMap;

    /// Rows of f64, and the parameters by name.
    type Rows = Vec<Vec<f64>>;
    type Parameters = BTreeMap<String, Vec<f64>>;

    fn linear(p: &Parameters, name: &str, x: &Rows) -> Rows {
        let (weight, bias) = (&p[&format!("{name}.weight")], &p[&format!("{name}.bias")]);
        let row = |x: &Vec<f64>| {
            let out = weight.chunks_exact(x.len()).zip(bias);
            out.map(|(w, b)| b + w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>()).collect()
        };
        x.iter().map(row).collect()
    }

    fn norm_relu(p: &Parameters, name: &str, x: Rows) -> Rows {
        let of = |field: &str| &p[&format!("{name}.{field}")];
        let (weight, bias) = (of("weight"), of("bias"));
        let (mean, var) = (of("running_mean"), of("running_var"));
        let value = |(i, v): (usize, f64)| {
            ((v - mean[i]) / (var[i] + 1e-5).sqrt() * weight[i] + bias[i]).max(0.0)
        };
        x.into_iter().map(|row| row.into_iter().enumerate().map(value).collect()).collect()
    }

    fn joined(p: &Parameters, name: &str, x: &Rows) -> Rows {
        norm_relu(p, &format!("{name}.norm"), linear(p, &format!("{name}.linear"), x))
    }

    fn encoding(p: &Parameters, name: &str, x: &Rows) -> Rows {
        linear(p, &format!("{name}.last"), &joined(p, &format!("{name}.hidden"), x))
    }

    fn values(store: &ParamStore) -> Parameters {
        let all = store.parameters().into_iter().chain(store.buffers());
        all.filter(|(name, _)| !name.ends_with("tracked"))
            .map(|(name, v)| {
                let values = v.flatten_all().unwrap().to_vec1::<f32>().unwrap();
                (name, values.into_iter().map(f64::from).collect())
            })
            .collect()
    }

    #[test]
    fn attention_is_the_formula() {
        let cells: Vec<[i32; 3]> = (0..12).map(|i| [i % 4, i / 4, i % 3]).collect();
        let (n, c, groups, k) = (cells.len(), 6, 3, 4);
        let feat = unit("x", n * c, 2);
        let tensor = Tensor::from_vec(feat.clone(), (n, c), &Device::Cpu).unwrap();
        let (mut scale, sorted) =
            Scale::new(&PointCloud::single(cells.clone(), tensor).unwrap()).unwrap();
        let near = scale.neighbors(k).unwrap();
        let store = ParamStore::trainable_from(WeightSource::hashed(9, ""), 0);
        let layer =
            GroupedVectorAttention::new(Compute::default(), c, groups, true, store.builder())
                .unwrap();
        let tensor = Tensor::from_vec(feat.clone(), (n, c), &Device::Cpu).unwrap();
        let out = layer.forward(&sorted.enter(&tensor).unwrap(), &near, Mode::Eval).unwrap();
        let out = sorted.leave(&out).unwrap().to_vec2::<f32>().unwrap();

        let p = values(&store);
        let x: Rows = feat.chunks(c).map(|r| r.iter().map(|v| f64::from(*v)).collect()).collect();
        let query = joined(&p, "query", &x);
        let key = joined(&p, "key", &x);
        let value = linear(&p, "value", &x);
        for (i, here) in cells.iter().enumerate() {
            // Nearest first; equally near ones by place.
            let mut order: Vec<usize> = (0..n).collect();
            let apart =
                |j: usize| -> i32 { cells[j].iter().zip(here).map(|(a, b)| (a - b).pow(2)).sum() };
            order.sort_by_key(|&j| (apart(j), cells[j]));
            order.truncate(k);
            let place = |j: &usize| {
                cells[*j].iter().zip(here).map(|(a, b)| f64::from(a - b)).collect::<Vec<_>>()
            };
            let places: Rows = order.iter().map(place).collect();
            let (add, multiply) =
                (encoding(&p, "position", &places), encoding(&p, "multiplier", &places));
            let relation: Rows = (0..k)
                .map(|e| {
                    let j = order[e];
                    let one = |d| (key[j][d] - query[i][d]) * multiply[e][d] + add[e][d];
                    (0..c).map(one).collect()
                })
                .collect();
            let logits = encoding(&p, "weight", &relation);
            for channel in 0..c {
                let group = channel / (c / groups);
                let powers: Vec<f64> = logits.iter().map(|l| l[group].exp()).collect();
                let sum: f64 = powers.iter().sum();
                let expected: f64 = (0..k)
                    .map(|e| powers[e] / sum * (value[order[e]][channel] + add[e][channel]))
                    .sum();
                let got = f64::from(out[i][channel]);
                assert!((got - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{got} {expected}");
            }
        }
    }
}
