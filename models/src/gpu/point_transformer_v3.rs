//! Point Transformer V3 on a graphics processor.

use super::head::Head;
use super::layers::{
    AttentionMlp, AttentionShape, CellPooling, Place, ResidualConv, Stem, Unpooling, most_voxels,
};
use super::scale::{Scale, host_groups};
use super::wrap;
use crate::point_transformer_v3::{BlockShape, PointTransformerV3Config, Version};
use crate::row_order::{OrderShuffle, SortedRows, enter, morton_rows};
use crate::stages::{channels_below, curves};
use crate::{
    Architecture, Backbone, BackboneCost, Compute, Forward, Level, LevelOptions, Levels, Mode,
    PointCloud, Shortcuts,
};
use candle_core::{Device, Result, Tensor, bail};
use candle_nn::VarBuilder;
use scenesplat_gpu::Commands;
use scenesplat_gpu::ops::Rows;
use scenesplat_gpu::ops::cloud::DeviceCloud;
use scenesplat_gpu::ops::pool::DeviceGroups;
use scenesplat_gpu::ops::rows::gather;
use scenesplat_kernels::segment::Groups;
use scenesplat_kernels::serialization::Curve;
use std::sync::Arc;

/// The network with its head.
#[derive(Debug)]
pub(super) struct Network {
    config: PointTransformerV3Config,
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
    conv: ResidualConv,
    rest: AttentionMlp,
}

/// Rows of a scale that the decoder comes back to.
struct Skip {
    feat: Rows,
    scale: Scale,
    groups: DeviceGroups,
}

/// Result of a pass: what the decoder gives, or the scales of an encoder alone.
enum Pass {
    Decoder(Rows),
    Encoder(Vec<EncoderScale>),
}

/// A scale of the encoder: its rows, its scenes, and which of its rows make one of the next coarser scale.
type EncoderScale = (Rows, Vec<usize>, Option<Arc<Groups>>);

fn blocks(place: &Place, shapes: &[BlockShape], vb: &VarBuilder<'_>) -> Result<Vec<Block>> {
    let build = |(i, shape): (usize, &BlockShape)| {
        let vb = vb.pp(format!("block{i}"));
        let attention = AttentionShape {
            channels: shape.channels,
            heads: shape.num_heads,
            patch_size: shape.patch_size,
            order: shape.order,
            mlp_ratio: shape.mlp_ratio,
            rope_base: None,
        };
        let conv = ResidualConv::new(place, shape.channels, &vb.pp("cpe"))?;
        Ok(Block { conv, rest: AttentionMlp::new(place, attention, &vb)? })
    };
    shapes.iter().enumerate().map(build).collect()
}

impl Network {
    pub fn new(
        config: &PointTransformerV3Config,
        place: Place,
        head: Head,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        if config.shortcuts != Shortcuts::default() {
            bail!("stage, rank: a last stage is shortened on the CPU only; leave them out");
        }
        let (channels, norm) = (&config.enc_channels, config.version.norm());
        let widths = [config.in_channels, channels[0]];
        let stem = match config.version {
            Version::M1 => Stem::convolution(&place, widths, &vb.pp("embedding"))?,
            Version::M2 => Stem::linear(&place, widths, &vb.pp("embedding"))?,
        };
        if config.mask_token {
            // Part of the weights, without a use in inference.
            vb.get((1, channels[0]), config.version.mask_token())?;
        }
        let mut encoder = Vec::new();
        for (stage, shapes) in config.encoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("enc.enc{stage}"));
            let down = || -> Result<(CellPooling, u32)> {
                let widths = [channels[stage - 1], channels[stage]];
                let reduce = config.pooling.into();
                let pooling = CellPooling::new(&place, widths, reduce, norm, &vb.pp("down"))?;
                Ok((pooling, config.stride[stage - 1].trailing_zeros()))
            };
            let down = (stage > 0).then(down).transpose()?;
            encoder.push(EncoderStage { down, blocks: blocks(&place, shapes, &vb)? });
        }
        let mut decoder = Vec::new();
        for (stage, shapes) in config.decoder_blocks().iter().enumerate() {
            let vb = vb.pp(format!("dec.dec{stage}"));
            let below = channels_below(channels, &config.dec_channels, stage);
            let widths = [below, channels[stage], config.dec_channels[stage]];
            let up = Unpooling::new(&place, norm, widths, &vb.pp("up"))?;
            decoder.push(DecoderStage { up, blocks: blocks(&place, shapes, &vb)? });
        }
        let curves = curves(&config.order)?;
        Ok(Self { config: config.clone(), place, curves, stem, encoder, decoder, head })
    }

    fn block(
        &self,
        block: &Block,
        commands: &mut Commands,
        x: &Rows,
        conv_input: Option<Rows>,
        scale: &mut Scale,
    ) -> Result<Rows> {
        let patch_size =
            self.config.batch_rule.patch_size(block.rest.patch_size(), scale.cloud.offsets());
        let x = block.conv.forward(commands, x, conv_input, scale)?;
        block.rest.forward(commands, &x, scale, patch_size)
    }

    fn run(
        &self,
        points: &PointCloud,
        commands: &mut Commands,
        cx: &mut Forward<'_>,
    ) -> Result<(Pass, Option<SortedRows>)> {
        if cx.mode == Mode::Train {
            bail!("a network on a graphics processor cannot be trained");
        }
        points.check_width(self.config.in_channels)?;
        let gpu = &self.place.gpu;
        let (cells, sorted) = morton_rows(points)?;
        let mut shuffle = OrderShuffle::new(&cx.orders);
        let depth = self.config.batch_rule.curve_depth();
        let offsets = points.offsets.to_vec();
        let cloud = DeviceCloud::upload(commands, &cells, offsets, &self.curves, depth);
        let mut cloud = cloud.map_err(wrap)?;
        shuffle_on_device(&mut shuffle, &mut cloud, cx)?;
        let feat = enter(sorted.as_ref(), &points.feat)?.flatten_all()?.to_vec1::<f32>()?;
        let feat = Rows::upload(gpu, &feat, self.config.in_channels, self.place.stored);
        let mut scale = Scale::new(cloud);
        let mut x = self.stem.forward(commands, &feat.map_err(wrap)?, &scale)?;
        let (mut skips, mut scales) = (Vec::new(), Vec::new());
        for stage in &self.encoder {
            if let Some((down, shift)) = &stage.down {
                let (mut coarse, groups) = scale.cloud.pool(commands, *shift).map_err(wrap)?;
                shuffle_on_device(&mut shuffle, &mut coarse, cx)?;
                let pooled = down.forward(commands, &x, &groups)?;
                let fine = std::mem::replace(&mut scale, Scale::new(coarse));
                if self.decoder.is_empty() {
                    let groups = host_groups(commands, &groups)?;
                    scales.push((x, fine.cloud.offsets().to_vec(), Some(Arc::new(groups))));
                } else {
                    skips.push(Skip { feat: x, scale: fine, groups });
                }
                x = pooled;
            }
            for block in &stage.blocks {
                x = self.block(block, commands, &x, None, &mut scale)?;
            }
        }
        if self.decoder.is_empty() {
            scales.push((x, scale.cloud.offsets().to_vec(), None));
            return Ok((Pass::Encoder(scales), sorted));
        }
        for (i, stage) in self.decoder.iter().enumerate().rev() {
            let Some(skip) = skips.pop() else { bail!("decoder stage {i} has no encoder stage") };
            let mut conv_input = None;
            (x, conv_input) = match self.config.version {
                Version::M1 => {
                    let both = stage.up.forward_both(commands, &x, &skip.feat, &skip.groups)?;
                    (both.0, Some(both.1))
                }
                Version::M2 => {
                    let sum = stage.up.forward_sum(commands, &x, &skip.feat, &skip.groups)?;
                    (sum, conv_input)
                }
            };
            scale = skip.scale;
            drop(skip.feat);
            for block in &stage.blocks {
                x = self.block(block, commands, &x, conv_input.take(), &mut scale)?;
            }
        }
        Ok((Pass::Decoder(x), sorted))
    }

    /// Rows of an encoder's scales on the CPU.
    fn levels(
        &self,
        scales: Vec<EncoderScale>,
        sorted: Option<SortedRows>,
        commands: &mut Commands,
    ) -> Result<Levels> {
        let level = |(rows, offsets, parents): EncoderScale| {
            Ok(Level { feat: tensor(commands, &rows)?, offsets, parents })
        };
        let encoder = scales.into_iter().map(level).collect::<Result<_>>()?;
        Ok(Levels { encoder, decoder: None, sorted })
    }
}

/// Permutes the orders of the next scale as the context says.
pub(super) fn shuffle_on_device(
    shuffle: &mut OrderShuffle,
    cloud: &mut DeviceCloud,
    cx: &mut Forward<'_>,
) -> Result<()> {
    match shuffle.next(cloud.num_orders(), cx)? {
        Some(permutation) => cloud.permute_orders(&permutation).map_err(wrap),
        None => Ok(()),
    }
}

/// Values of rows on the CPU.
pub(super) fn tensor(commands: &mut Commands, rows: &Rows) -> Result<Tensor> {
    let values = rows.read(commands).map_err(wrap)?;
    Tensor::from_vec(values, (rows.rows(), rows.channels()), &Device::Cpu)
}

/// The rows behind a head in the caller's order, on the CPU.
pub(super) fn finish(
    place: &Place,
    head: &Head,
    commands: &mut Commands,
    mut x: Rows,
    sorted: Option<&SortedRows>,
) -> Result<Tensor> {
    if let Some(sorted) = sorted {
        let list = place.gpu.upload("an order", sorted.inverse()).map_err(wrap)?;
        x = gather(commands, &x, &list).map_err(wrap)?;
    }
    let x = head.forward(commands, x)?;
    tensor(commands, &x)
}

impl Backbone for Network {
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        let mut commands = self.place.gpu.commands();
        match self.run(points, &mut commands, cx)? {
            (Pass::Decoder(x), sorted) => {
                finish(&self.place, &self.head, &mut commands, x, sorted.as_ref())
            }
            (Pass::Encoder(scales), sorted) => {
                let x = self.levels(scales, sorted, &mut commands)?.up_cast(0)?;
                let (_, width) = x.dims2()?;
                let x = x.flatten_all()?.to_vec1::<f32>()?;
                let x = Rows::upload(&self.place.gpu, &x, width, self.place.stored);
                finish(&self.place, &self.head, &mut commands, x.map_err(wrap)?, None)
            }
        }
    }
    fn forward_levels(
        &self,
        points: &PointCloud,
        options: LevelOptions<'_>,
        cx: &mut Forward<'_>,
    ) -> Result<Levels> {
        if options.mask.is_some() || options.decoder || !self.decoder.is_empty() {
            bail!("levels: on a graphics processor an encoder alone gives its scales; use the cpu");
        }
        let mut commands = self.place.gpu.commands();
        match self.run(points, &mut commands, cx)? {
            (Pass::Encoder(scales), sorted) => self.levels(scales, sorted, &mut commands),
            (Pass::Decoder(_), _) => bail!("levels: the network has a decoder"),
        }
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
