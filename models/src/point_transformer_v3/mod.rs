//! Point Transformer V3 as SceneSplat uses it.
//!
//! Encoder and decoder over a pyramid of voxel scales. Attention runs inside patches of
//! space-filling-curve orders, positions enter through a sparse convolution in each block.
//!
//! # Source
//! `PT-v3m1` and `PT-v3m1-simdino` of SceneSplat be9d5e1. Differs: patches and curve depth belong to
//! each scene ([`BatchRule::Isolated`]), orders are shuffled only when asked for, attention is f32,
//! and codes reach 21 bits an axis. Kept because weights were trained with it: the first convolution
//! of each decoder stage reads the skip branch alone, pooling is a mean, there is no final norm.
//! [`Version::M2`] is `PT-v3m2` of Pointcept d74c646 (Sonata, Concerto, Chorus) with its defaults: no layer scale, no
//! relative positions, norms in front of attention and MLP. Differs in the same, and in the first values of a network
//! that is trained from nothing, which are those of `PT-v3m1`.

mod attention;
mod block;
mod coarse;
mod config;
mod cost;
mod embedding;
mod pooling;
mod recognize;
mod unpooling;

pub use attention::{BatchRule, SerializedAttention};
pub use block::{Block, BlockShape};
pub use config::{PointTransformerV3Config, PoolingReduce, Version};
pub use embedding::Embedding;
pub use pooling::SerializedPooling;
pub use unpooling::{SerializedUnpooling, Unpooled};

use crate::row_order::{OrderShuffle, SortedRows, enter, leave, morton_rows};
use crate::stages::channels_below;
use crate::{
    Architecture, Backbone, BackboneCost, Calibrated, Compute, Forward, LastStage, Level,
    LevelOptions, Levels, Mode, PointCloud, Shortcuts, ops,
};
use candle_core::{Device, Result, Tensor, bail};
use candle_nn::{Init, VarBuilder};
use coarse::Between;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat_kernels::segment::{Groups, Reduce};
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::SerializedCloud;
use std::sync::Arc;

/// The network; see the module's documentation.
#[derive(Debug)]
pub struct PointTransformerV3 {
    config: PointTransformerV3Config,
    curves: Vec<Curve>,
    embedding: Arc<Embedding>,
    mask_token: Option<Tensor>,
    encoder: Arc<Vec<EncoderStage>>,
    /// Fine to coarse; run in reverse.
    decoder: Vec<DecoderStage>,
    /// Whether the last stage waits for an example of its input.
    waits: bool,
    /// Where the parameters are; input is brought there.
    device: Device,
}

/// Called before each block of the last stage with its name, the block, what its convolution reads,
/// and the scale; gives the block to run.
type BeforeBlock<'a> =
    dyn FnMut(&str, &Arc<Block>, &Tensor, &SerializedCloud) -> Result<Arc<Block>> + 'a;

#[derive(Debug)]
struct EncoderStage {
    down: Option<SerializedPooling>,
    blocks: Vec<Arc<Block>>,
}

#[derive(Debug, Clone)]
struct DecoderStage {
    up: Arc<SerializedUnpooling>,
    blocks: Vec<Arc<Block>>,
}

/// Both ends of the network.
#[derive(Debug)]
pub struct EncoderDecoderOutput {
    /// Features of the coarsest scale. `[M, enc_channels.last()]`
    pub encoder: Tensor,
    /// Voxels of the coarsest scale: rows of scene `i` are `offsets[i]..offsets[i + 1]`.
    pub encoder_offsets: Vec<usize>,
    /// Features of the input rows; `None` without decoder. `[N, dec_channels[0]]`
    pub decoder: Option<Tensor>,
}

/// Result of a pass.
struct Pass {
    encoder: Tensor,
    encoder_offsets: Vec<usize>,
    /// Fine to coarse; empty unless they were to be kept.
    levels: Vec<Level>,
    decoder: Option<Tensor>,
    sorted: Option<SortedRows>,
}

/// Rows of a scale that the decoder comes back to, and the groups that were pooled.
struct Skip {
    feat: Tensor,
    cloud: Arc<SerializedCloud>,
    groups: Arc<Groups>,
}

/// Blocks under `block0`, `block1` …
fn blocks(
    shapes: &[BlockShape],
    rank: Option<usize>,
    vb: &VarBuilder<'_>,
) -> Result<Vec<Arc<Block>>> {
    let build = |(i, shape): (usize, &BlockShape)| {
        Block::with_rank(*shape, rank, vb.pp(format!("block{i}"))).map(Arc::new)
    };
    shapes.iter().enumerate().map(build).collect()
}

impl PointTransformerV3 {
    /// Builds the network; parameters have the original's names.
    ///
    /// # Errors
    /// If the configuration does not fit together or parameters exist with another shape.
    pub fn new(config: &PointTransformerV3Config, vb: VarBuilder<'_>) -> Result<Self> {
        let curves = config.check()?;
        config.compute.refuse_f16()?;
        let (channels, compute) = (&config.enc_channels, config.compute);
        let (version, norm) = (config.version, config.version.norm());
        let first = match version {
            Version::M1 => Embedding::convolution,
            Version::M2 => Embedding::linear,
        };
        let embedding = first(config.in_channels, channels[0], compute, vb.pp("embedding"))?;
        let token = || {
            let init = match version {
                Version::M1 => Init::Randn { mean: 0.0, stdev: 0.02 },
                Version::M2 => Init::Const(0.0),
            };
            vb.get_with_hints((1, channels[0]), version.mask_token(), init)
        };
        let mask_token = config.mask_token.then(token).transpose()?;
        let mut encoder = Vec::new();
        for (stage, shapes) in config.encoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("enc.enc{stage}"));
            let down = || {
                let (fine, coarse) = (channels[stage - 1], channels[stage]);
                let (stride, how) = (config.stride[stage - 1], config.pooling.into());
                SerializedPooling::new(fine, coarse, stride, how, norm, compute, vb.pp("down"))
            };
            let down = (stage > 0).then(down).transpose()?;
            encoder.push(EncoderStage { down, blocks: blocks(shapes, None, &vb)? });
        }
        let mut decoder = Vec::new();
        for (stage, shapes) in config.decoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("dec.dec{stage}"));
            let up = SerializedUnpooling::new(
                channels_below(channels, &config.dec_channels, stage),
                channels[stage],
                config.dec_channels[stage],
                norm,
                compute,
                vb.pp("up"),
            )?;
            let rank = config.shortcuts.rank.filter(|_| stage == 0);
            decoder.push(DecoderStage { up: Arc::new(up), blocks: blocks(shapes, rank, &vb)? });
        }
        Ok(Self {
            config: config.clone(),
            curves,
            embedding: Arc::new(embedding),
            mask_token,
            encoder: Arc::new(encoder),
            decoder,
            waits: config.shortcuts.rank.is_some(),
            device: vb.device().clone(),
        })
    }

    /// The configuration it was built from.
    pub fn config(&self) -> &PointTransformerV3Config {
        &self.config
    }

    /// Runs encoder and decoder.
    ///
    /// Rows of the stem where `mask` is true are replaced by the mask token before the encoder.
    ///
    /// # Errors
    /// If the input does not fit, or a mask is given to a network without mask token.
    pub fn forward_both(
        &self,
        points: &PointCloud,
        mask: Option<&[bool]>,
        cx: &mut Forward<'_>,
    ) -> Result<EncoderDecoderOutput> {
        let Pass { encoder, encoder_offsets, decoder, .. } =
            self.run(points, LevelOptions { mask, decoder: true }, cx, false, None)?;
        Ok(EncoderDecoderOutput { encoder, encoder_offsets, decoder })
    }

    /// `keep`: rows of all scales are kept for the caller.
    fn run(
        &self,
        points: &PointCloud,
        options: LevelOptions<'_>,
        cx: &mut Forward<'_>,
        keep: bool,
        mut before_block: Option<&mut BeforeBlock<'_>>,
    ) -> Result<Pass> {
        if cx.mode == Mode::Train && self.config.shortcuts != Shortcuts::default() {
            bail!("a network with shortcuts in its last stage cannot be trained");
        }
        if self.waits && before_block.is_none() {
            bail!("rank: the network needs an example of its input first (Backbone::calibrated)");
        }
        let mut shuffle = OrderShuffle::new(&cx.orders);
        let (mut x, mut cloud, sorted) = self.stem(points, options.mask, &mut shuffle, cx)?;
        let (mut skips, mut levels) = (Vec::new(), Vec::new());
        for (i, stage) in self.encoder.iter().enumerate() {
            if let Some(down) = &stage.down {
                let (pooled, mut coarse, groups) = down.forward(&x, &cloud, cx)?;
                shuffle.apply(&mut coarse, cx)?;
                if keep {
                    let offsets = cloud.offsets().to_vec();
                    let parents = Some(Arc::clone(&groups));
                    levels.push(Level { feat: x.clone(), offsets, parents });
                }
                let fine = std::mem::replace(&mut cloud, Arc::new(coarse));
                skips.push(Skip { feat: x, cloud: fine, groups });
                x = pooled;
                cx.observe(&format!("enc.enc{i}.down"), &x)?;
            }
            for (j, block) in stage.blocks.iter().enumerate() {
                x = block.forward_shared(x, None, &cloud, cx)?;
                cx.observe(&format!("enc.enc{i}.block{j}"), &x)?;
            }
            cx.observe(&format!("enc.enc{i}"), &x)?;
        }
        let (encoder, encoder_offsets) = (x.clone(), cloud.offsets().to_vec());
        if keep {
            let (feat, offsets) = (x.clone(), encoder_offsets.clone());
            levels.push(Level { feat, offsets, parents: None });
        }
        if self.decoder.is_empty() || !options.decoder {
            return Ok(Pass { encoder, encoder_offsets, levels, decoder: None, sorted });
        }
        for i in (0..self.decoder.len()).rev() {
            let Some(skip) = skips.pop() else { bail!("decoder stage {i} has no encoder stage") };
            let before = before_block.as_deref_mut().filter(|_| i == 0);
            (x, cloud) = self.decode(i, x, cloud, skip, before, cx)?;
        }
        x = leave(sorted.as_ref(), x)?;
        Ok(Pass { encoder, encoder_offsets, levels, decoder: Some(x), sorted })
    }

    /// Rows of the stem and their scale.
    fn stem(
        &self,
        points: &PointCloud,
        mask: Option<&[bool]>,
        shuffle: &mut OrderShuffle,
        cx: &mut Forward<'_>,
    ) -> Result<(Tensor, Arc<SerializedCloud>, Option<SortedRows>)> {
        points.check_width(self.config.in_channels)?;
        let (cells, sorted) = morton_rows(points)?;
        let depth = self.config.batch_rule.curve_depth();
        let mut cloud = SerializedCloud::new(cells, points.offsets.to_vec(), &self.curves, depth)
            .map_err(candle_core::Error::wrap)?;
        shuffle.apply(&mut cloud, cx)?;
        let feat = enter(sorted.as_ref(), &points.feat)?.to_device(&self.device)?;
        let mut x = self.embedding.forward(&feat, &cloud, cx)?;
        cx.observe("embedding", &x)?;
        if let Some(mask) = mask {
            x = self.replace_masked(&x, mask, sorted.as_ref().map(|sorted| sorted.order()))?;
        }
        Ok((x, Arc::new(cloud), sorted))
    }

    /// A decoder stage, from rows of the coarse scale to those of the skipped one.
    fn decode(
        &self,
        i: usize,
        coarse: Tensor,
        coarse_cloud: Arc<SerializedCloud>,
        skip: Skip,
        mut before_block: Option<&mut BeforeBlock<'_>>,
        cx: &mut Forward<'_>,
    ) -> Result<(Tensor, Arc<SerializedCloud>)> {
        let stage = &self.decoder[i];
        let Skip { feat: fine, cloud: fine_cloud, groups } = skip;
        // Of a last stage on the coarse scale: how its rows come back to the fine one.
        let mut return_to_fine = None;
        let mut cloud = Arc::clone(&fine_cloud);
        let Unpooled { sum, skip } = if i == 0 && self.config.shortcuts.stage == LastStage::Coarse {
            cloud = coarse_cloud;
            let [up, skip] = stage.up.branches(&coarse, &fine, cx)?;
            let pooled = ops::segment_reduce(&skip, Arc::clone(&groups), Reduce::Mean)?;
            let between = Between::new(&fine_cloud, &cloud, &groups)?;
            return_to_fine = Some((between, skip, pooled.clone()));
            Unpooled { sum: (up + &pooled)?, skip: pooled }
        } else {
            drop(coarse_cloud);
            stage.up.forward(&coarse, &fine, groups, cx)?
        };
        cx.observe(&format!("dec.dec{i}.up"), &sum)?;
        cx.observe(&format!("dec.dec{i}.up.skip"), &skip)?;
        drop((coarse, fine));
        let skip_alone = self.config.version == Version::M1;
        let (mut x, mut conv_input) = (sum, skip_alone.then_some(skip));
        for (j, block) in stage.blocks.iter().enumerate() {
            let name = format!("dec.dec{i}.block{j}");
            let mut block = Arc::clone(block);
            if let Some(before) = before_block.as_deref_mut() {
                block = before(&name, &block, conv_input.as_ref().unwrap_or(&x), &cloud)?;
            }
            x = block.forward_shared(x, conv_input.take(), &cloud, cx)?;
            cx.observe(&name, &x)?;
        }
        if let Some((between, skip, pooled)) = return_to_fine {
            // What the voxels of a cell have in common comes from the cell and its neighbors,
            // what tells them apart from their own skip branch.
            x = between.add_to(&(x - pooled)?, &skip)?;
        }
        cx.observe(&format!("dec.dec{i}"), &x)?;
        Ok((x, fine_cloud))
    }

    fn replace_masked(&self, x: &Tensor, mask: &[bool], order: Option<&[u32]>) -> Result<Tensor> {
        let Some(token) = &self.mask_token else {
            bail!("mask: this network has no mask token");
        };
        let n = x.dim(0)?;
        if mask.len() != n {
            bail!("mask: expected {n} rows, got {}", mask.len());
        }
        let at = |i: usize| mask[order.map_or(i, |o| o[i] as usize)];
        let masked: Vec<f32> = (0..n).map(|i| if at(i) { 1.0 } else { 0.0 }).collect();
        let masked = Tensor::from_vec(masked, (n, 1), x.device())?;
        let kept = masked.affine(-1.0, 1.0)?;
        x.broadcast_mul(&kept)? + masked.broadcast_mul(token)?
    }
}

impl Backbone for PointTransformerV3 {
    /// Decoder features of the input rows; of a network without decoder all scales of its encoder,
    /// up-cast to the input rows ([`Levels::up_cast`]).
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        if self.decoder.is_empty() {
            let options = LevelOptions { mask: None, decoder: false };
            return self.forward_levels(points, options, cx)?.up_cast(0);
        }
        match self.forward_both(points, None, cx)?.decoder {
            Some(x) => Ok(x),
            None => bail!("the decoder gave no rows"),
        }
    }
    fn forward_levels(
        &self,
        points: &PointCloud,
        options: LevelOptions<'_>,
        cx: &mut Forward<'_>,
    ) -> Result<Levels> {
        let Pass { levels, decoder, sorted, .. } = self.run(points, options, cx, true, None)?;
        Ok(Levels { encoder: levels, decoder, sorted })
    }
    fn out_channels(&self) -> usize {
        self.config.out_channels()
    }
    fn alignment(&self) -> u32 {
        crate::stages::edge(&self.config.stride)
    }
    fn cost(&self) -> Option<BackboneCost> {
        Some(Architecture::cost(&self.config))
    }
    fn compute(&self) -> Compute {
        self.config.compute
    }
    fn needs_example(&self) -> bool {
        self.waits
    }
    fn calibrated(&self, example: &PointCloud) -> Result<Option<Calibrated>> {
        if !self.waits {
            return Ok(None);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let (mut blocks, mut kept) = (Vec::new(), Vec::new());
        // Each block sees what the calibrated ones before it make.
        let mut before = |name: &str, block: &Arc<Block>, x: &Tensor, cloud: &SerializedCloud| {
            let (block, part) = block.calibrated(x, cloud)?;
            kept.push((name.to_owned(), part));
            let block = Arc::new(block);
            blocks.push(Arc::clone(&block));
            Ok(block)
        };
        let options = LevelOptions { mask: None, decoder: true };
        self.run(example, options, &mut Forward::eval(&mut rng), false, Some(&mut before))?;
        let mut decoder = self.decoder.clone();
        if let Some(last) = decoder.first_mut() {
            last.blocks = blocks;
        }
        let network = Self {
            config: self.config.clone(),
            curves: self.curves.clone(),
            embedding: Arc::clone(&self.embedding),
            mask_token: self.mask_token.clone(),
            encoder: Arc::clone(&self.encoder),
            decoder,
            waits: false,
            device: self.device.clone(),
        };
        Ok(Some(Calibrated { backbone: Box::new(network), kept }))
    }
}
