//! LitePT on a graphics processor.

use super::head::Head;
use super::layers::{
    AttentionMlp, AttentionShape, CellPooling, Place, ResidualConv, Stem, Unpooling, most_voxels,
};
use super::point_transformer_v3::{finish, shuffle_on_device};
use super::scale::Scale;
use super::wrap;
use crate::layers::NormKind;
use crate::litept::{BlockShape, LitePtConfig};
use crate::row_order::{OrderShuffle, enter, morton_rows};
use crate::stages::curves;
use crate::{Architecture, Backbone, BackboneCost, Compute, Forward, Mode, PointCloud};
use candle_core::{Result, Tensor, bail};
use candle_nn::VarBuilder;
use scenesplat_gpu::Commands;
use scenesplat_gpu::ops::Rows;
use scenesplat_gpu::ops::cloud::DeviceCloud;
use scenesplat_gpu::ops::layer_norm::{Ending, LayerNorm, layer_norm};
use scenesplat_kernels::segment::Reduce;
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::CurveDepth;

/// The network with its head.
#[derive(Debug)]
pub(super) struct Network {
    config: LitePtConfig,
    place: Place,
    curves: Vec<Curve>,
    stem: Stem,
    encoder: Vec<EncoderStage>,
    /// Fine to coarse; run in reverse.
    decoder: Vec<DecoderStage>,
    head: Head,
}

#[derive(Debug)]
struct EncoderStage {
    /// With the bits that it cuts off; none at the finest scale.
    down: Option<(CellPooling, u32)>,
    blocks: Vec<Block>,
}

#[derive(Debug)]
struct DecoderStage {
    up: Unpooling,
    blocks: Vec<Block>,
}

#[derive(Debug)]
struct Block {
    entry: Entry,
    attention: Option<AttentionMlp>,
}

#[derive(Debug)]
enum Entry {
    Convolution(Box<ResidualConv>),
    Norm(LayerNorm),
}

impl Block {
    fn new(place: &Place, shape: &BlockShape, vb: &VarBuilder<'_>) -> Result<Self> {
        let own = shape.attention;
        let entry = if shape.kind.has_convolution() {
            let conv = ResidualConv::new(place, own.channels, &vb.pp("conv"))?;
            Entry::Convolution(Box::new(conv))
        } else {
            Entry::Norm(place.layer_norm(own.channels, &vb.pp("norm0.0"))?)
        };
        let attention = || {
            let attention = AttentionShape {
                channels: own.channels,
                heads: own.num_heads,
                patch_size: own.patch_size,
                order: own.order,
                mlp_ratio: shape.mlp_ratio,
                rope_base: Some(own.rope_base),
            };
            AttentionMlp::new(place, attention, vb)
        };
        let attention = shape.kind.has_attention().then(attention).transpose()?;
        Ok(Self { entry, attention })
    }

    fn forward(&self, commands: &mut Commands, x: &Rows, scale: &mut Scale) -> Result<Rows> {
        let x = match &self.entry {
            Entry::Convolution(conv) => conv.forward(commands, x, None, scale)?,
            Entry::Norm(norm) => layer_norm(commands, x, norm, Ending::None).map_err(wrap)?,
        };
        match &self.attention {
            Some(part) => part.forward(commands, &x, scale, part.patch_size()),
            None => Ok(x),
        }
    }
}

fn blocks(place: &Place, shapes: &[BlockShape], vb: &VarBuilder<'_>) -> Result<Vec<Block>> {
    let build =
        |(i, shape): (usize, &BlockShape)| Block::new(place, shape, &vb.pp(format!("block{i}")));
    shapes.iter().enumerate().map(build).collect()
}

impl Network {
    pub fn new(
        config: &LitePtConfig,
        place: Place,
        head: Head,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let channels = &config.enc_channels;
        let widths = [config.in_channels, channels[0]];
        let stem = Stem::convolution(&place, widths, &vb.pp("embedding"))?;
        let mut encoder = Vec::new();
        for (stage, shapes) in config.encoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("enc.enc{stage}"));
            let down = || -> Result<(CellPooling, u32)> {
                let widths = [channels[stage - 1], channels[stage]];
                let (reduce, norm) = (Reduce::Max, NormKind::Batch);
                let pooling = CellPooling::new(&place, widths, reduce, norm, &vb.pp("down"))?;
                Ok((pooling, config.stride[stage - 1].trailing_zeros()))
            };
            let down = (stage > 0).then(down).transpose()?;
            encoder.push(EncoderStage { down, blocks: blocks(&place, shapes, &vb)? });
        }
        let mut decoder = Vec::new();
        for (stage, shapes) in config.decoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("dec.dec{stage}"));
            let widths =
                [config.channels_below(stage), channels[stage], config.dec_channels[stage]];
            let up = Unpooling::new(&place, NormKind::Batch, widths, &vb.pp("up"))?;
            decoder.push(DecoderStage { up, blocks: blocks(&place, shapes, &vb)? });
        }
        let curves = curves(&config.order)?;
        Ok(Self { config: config.clone(), place, curves, stem, encoder, decoder, head })
    }

    /// The curves that the blocks of a scale need.
    fn curves_at(&self, stage: usize) -> &[Curve] {
        if self.config.attends(stage) { &self.curves } else { &[] }
    }

    /// A scale with its orders permuted as the context says.
    fn scale(
        &self,
        stage: usize,
        mut cloud: DeviceCloud,
        shuffle: &mut OrderShuffle,
        cx: &mut Forward<'_>,
    ) -> Result<Scale> {
        if self.config.attends(stage) {
            shuffle_on_device(shuffle, &mut cloud, cx)?;
        }
        Ok(Scale::new(cloud))
    }
}

impl Backbone for Network {
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        if cx.mode == Mode::Train {
            bail!("a network on a graphics processor cannot be trained");
        }
        points.check_width(self.config.in_channels)?;
        let gpu = &self.place.gpu;
        let mut commands = gpu.commands();
        let (cells, sorted) = morton_rows(points)?;
        let mut shuffle = OrderShuffle::new(&cx.orders);
        let (offsets, curves) = (points.offsets.to_vec(), self.curves_at(0));
        let depth = CurveDepth::PerSceneExtent;
        let cloud = DeviceCloud::upload(&mut commands, &cells, offsets, curves, depth);
        let mut scale = self.scale(0, cloud.map_err(wrap)?, &mut shuffle, cx)?;
        let feat = enter(sorted.as_ref(), &points.feat)?.flatten_all()?.to_vec1::<f32>()?;
        let feat = Rows::upload(gpu, &feat, self.config.in_channels, self.place.stored);
        let mut x = self.stem.forward(&mut commands, &feat.map_err(wrap)?, &scale)?;
        let mut skips = Vec::new();
        for (i, stage) in self.encoder.iter().enumerate() {
            if let Some((down, shift)) = &stage.down {
                let curves = self.curves_at(i);
                let coarser = scale.cloud.coarser(&mut commands, *shift, curves);
                let (coarse, groups) = coarser.map_err(wrap)?;
                let pooled = down.forward(&mut commands, &x, &groups)?;
                let coarse = self.scale(i, coarse, &mut shuffle, cx)?;
                let fine = std::mem::replace(&mut scale, coarse);
                skips.push((std::mem::replace(&mut x, pooled), fine, groups));
            }
            for block in &stage.blocks {
                x = block.forward(&mut commands, &x, &mut scale)?;
            }
        }
        for (i, stage) in self.decoder.iter().enumerate().rev() {
            let Some((fine, fine_scale, groups)) = skips.pop() else {
                bail!("decoder stage {i} has no encoder stage");
            };
            x = stage.up.forward_sum(&mut commands, &x, &fine, &groups)?;
            drop(fine);
            scale = fine_scale;
            for block in &stage.blocks {
                x = block.forward(&mut commands, &x, &mut scale)?;
            }
        }
        finish(&self.place, &self.head, &mut commands, x, sorted.as_ref())
    }
    fn out_channels(&self) -> usize {
        self.head.width()
    }
    fn alignment(&self) -> u32 {
        crate::stages::edge(&self.config.stride)
    }
    fn cost(&self) -> Option<BackboneCost> {
        Some(Architecture::cost(&self.config))
    }
    fn most_voxels(&self) -> Option<usize> {
        let (encoder, decoder) = (&self.config.enc_channels, &self.config.dec_channels);
        let result = self.head.width().max(self.config.out_channels());
        Some(most_voxels(&self.place, result, encoder, decoder))
    }
    fn compute(&self) -> Compute {
        self.config.compute
    }
}
