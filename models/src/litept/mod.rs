//! LitePT: convolutions where there are many voxels, attention where there are few.
//!
//! Encoder and decoder over a pyramid of voxel scales. The fine scales have convolution blocks
//! without attention, the coarse ones attention blocks without convolution, whose queries and keys
//! turn with the number of their voxel ([`PointROPE`](scenesplat_kernels::point_rope)). The decoder
//! of S, B and L has no blocks. So a scene costs a hundredth of what it costs with the wide blocks
//! at full resolution of the language network of Point Transformer V3.
//!
//! # Source
//! "LitePT: Lighter Yet Stronger Point Transformer" (arXiv:2512.13689), prs-eth/LitePT (MIT), whose
//! names of parameters these are. Differs: patches and curve depth belong to each scene; orders are
//! shuffled only when asked for; rotation and attention are f32 (there f16, in inference too), or
//! bf16 operands where asked for; codes reach 21 bits. Kept: an attention block normalizes the rows
//! that its residual path carries; drop rates are counted over convolution blocks too; there is no
//! final norm.

mod attention;
mod block;
mod config;
mod cost;
mod recognize;
mod scale;

pub use attention::{AttentionShape, PointRopeAttention};
pub use block::{Block, BlockKind, BlockShape};
pub use config::{LitePtConfig, LitePtSize};
pub use scale::Scale;

use crate::layers::{CellPooling, NormKind};
use crate::point_transformer_v3::{Embedding, SerializedUnpooling};
use crate::row_order::{OrderShuffle, enter, leave, morton_rows};
use crate::stages::curves;
use crate::{Architecture, Backbone, BackboneCost, Compute, Forward, PointCloud};
use candle_core::{Device, Result, Tensor, bail};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::{Groups, Reduce};
use scenesplat_kernels::serialization::Curve;
use std::sync::Arc;

/// The network; see the module's documentation.
#[derive(Debug)]
pub struct LitePt {
    config: LitePtConfig,
    curves: Vec<Curve>,
    embedding: Embedding,
    encoder: Vec<EncoderStage>,
    /// Fine to coarse; run in reverse.
    decoder: Vec<DecoderStage>,
    /// Where the parameters are; input is brought there.
    device: Device,
}

#[derive(Debug)]
struct EncoderStage {
    /// With the bits that it cuts off; none at the finest scale.
    down: Option<(CellPooling, u32)>,
    blocks: Vec<Arc<Block>>,
}

#[derive(Debug)]
struct DecoderStage {
    up: SerializedUnpooling,
    blocks: Vec<Arc<Block>>,
}

fn blocks(shapes: &[BlockShape], vb: &VarBuilder<'_>) -> Result<Vec<Arc<Block>>> {
    let build = |(i, shape): (usize, &BlockShape)| {
        Block::new(*shape, vb.pp(format!("block{i}"))).map(Arc::new)
    };
    shapes.iter().enumerate().map(build).collect()
}

impl LitePt {
    /// Builds the network; parameters have the names of the published weights.
    ///
    /// # Errors
    /// If the configuration does not fit together or parameters exist with another shape.
    pub fn new(config: &LitePtConfig, vb: VarBuilder<'_>) -> Result<Self> {
        config.check()?;
        config.compute.refuse_f16()?;
        let (channels, compute) = (&config.enc_channels, config.compute);
        let embedding =
            Embedding::convolution(config.in_channels, channels[0], compute, vb.pp("embedding"))?;
        let mut encoder = Vec::new();
        for (stage, shapes) in config.encoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("enc.enc{stage}"));
            let down = || -> Result<(CellPooling, u32)> {
                let (fine, coarse) = (channels[stage - 1], channels[stage]);
                let (reduce, norm) = (Reduce::Max, NormKind::Batch);
                let pooling = CellPooling::new(fine, coarse, reduce, norm, compute, vb.pp("down"))?;
                Ok((pooling, config.stride[stage - 1].trailing_zeros()))
            };
            let down = (stage > 0).then(down).transpose()?;
            encoder.push(EncoderStage { down, blocks: blocks(shapes, &vb)? });
        }
        let mut decoder = Vec::new();
        for (stage, shapes) in config.decoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("dec.dec{stage}"));
            let up = SerializedUnpooling::new(
                config.channels_below(stage),
                channels[stage],
                config.dec_channels[stage],
                NormKind::Batch,
                compute,
                vb.pp("up"),
            )?;
            decoder.push(DecoderStage { up, blocks: blocks(shapes, &vb)? });
        }
        let (config, curves, device) =
            (config.clone(), curves(&config.order)?, vb.device().clone());
        Ok(Self { config, curves, embedding, encoder, decoder, device })
    }

    /// The configuration it was built from.
    pub fn config(&self) -> &LitePtConfig {
        &self.config
    }

    /// A scale with the curves that its blocks need, permuted as the context says.
    fn scale(
        &self,
        stage: usize,
        (grid_coord, offsets): (Vec<[i32; 3]>, Vec<usize>),
        shuffle: &mut OrderShuffle,
        cx: &mut Forward<'_>,
    ) -> Result<Arc<Scale>> {
        let attends = self.config.attends(stage);
        let curves = if attends { self.curves.as_slice() } else { &[] };
        let mut scale =
            Scale::new(grid_coord, offsets, curves).map_err(candle_core::Error::wrap)?;
        if attends {
            shuffle.apply(scale.cloud_mut(), cx)?;
        }
        Ok(Arc::new(scale))
    }
}

impl Backbone for LitePt {
    /// Permutations of the orders ([`Orders`](crate::Orders)) are those of the scales with
    /// attention, from fine to coarse.
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        points.check_width(self.config.in_channels)?;
        let (cells, sorted) = morton_rows(points)?;
        let mut shuffle = OrderShuffle::new(&cx.orders);
        let mut scale = self.scale(0, (cells, points.offsets.to_vec()), &mut shuffle, cx)?;
        let feat = enter(sorted.as_ref(), &points.feat)?.to_device(&self.device)?;
        let mut x = self.embedding.forward(&feat, scale.cloud(), cx)?;
        drop(feat);
        cx.observe("embedding", &x)?;

        let mut skips: Vec<(Tensor, Arc<Scale>, Arc<Groups>)> = Vec::new();
        for (i, stage) in self.encoder.iter().enumerate() {
            if let Some((down, shift)) = &stage.down {
                let coarser = scale.coarser(*shift).map_err(candle_core::Error::wrap)?;
                let pooled = down.forward(&x, coarser.groups.clone(), cx)?;
                let coarse = (coarser.grid_coord, coarser.offsets);
                let coarse = self.scale(i, coarse, &mut shuffle, cx)?;
                skips.push((x, std::mem::replace(&mut scale, coarse), coarser.groups));
                x = pooled;
                cx.observe(&format!("enc.enc{i}.down"), &x)?;
            }
            for (j, block) in stage.blocks.iter().enumerate() {
                x = block.forward_shared(x, &scale, cx)?;
                cx.observe(&format!("enc.enc{i}.block{j}"), &x)?;
            }
        }
        for (i, stage) in self.decoder.iter().enumerate().rev() {
            let Some((fine, fine_scale, groups)) = skips.pop() else {
                bail!("decoder stage {i} has no encoder stage");
            };
            x = stage.up.forward_sum(&x, &fine, groups, cx)?;
            drop(fine);
            scale = fine_scale;
            cx.observe(&format!("dec.dec{i}.up"), &x)?;
            for (j, block) in stage.blocks.iter().enumerate() {
                x = block.forward_shared(x, &scale, cx)?;
                cx.observe(&format!("dec.dec{i}.block{j}"), &x)?;
            }
        }
        leave(sorted.as_ref(), x)
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
}
