//! Shape of a network.

use super::LitePt;
use super::attention::AttentionShape;
use super::block::{BlockKind, BlockShape};
use crate::stages::{
    DEEPEST, LARGEST, MAX_MLP_RATIO, channels_below, check_fields, check_length, check_rates,
    curves, drop_rates, each_block, falling_drop_rates, stem_inputs,
};
use crate::weights::Shapes;
use crate::{Architecture, Backbone, BackboneCost, Compute, MultiplyAdds};
use candle_core::{Result, bail};
use candle_nn::VarBuilder;
use scenesplat_kernels::serialization::Curve;
use serde::{Deserialize, Serialize};

/// The published sizes of LitePT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LitePtSize {
    /// S: 12.7 million parameters.
    Small,
    /// S*, with blocks in the decoder: 16 million.
    SmallWithDecoder,
    /// B: 45 million.
    Base,
    /// L: 86 million.
    Large,
}

impl LitePtSize {
    /// All of them, small ones first.
    pub const ALL: [Self; 4] = [Self::Small, Self::SmallWithDecoder, Self::Base, Self::Large];

    /// The configuration, for 11 inputs.
    pub fn config(self) -> LitePtConfig {
        match self {
            Self::Small => LitePtConfig::small(),
            Self::SmallWithDecoder => LitePtConfig::small_with_decoder(),
            Self::Base => LitePtConfig::base(),
            Self::Large => LitePtConfig::large(),
        }
    }
}

/// Shape of a LitePT. Defaults are those of LitePT-S.
///
/// Lists of the encoder have one entry a stage; lists of the decoder one entry a stage but the
/// last, from fine to coarse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LitePtConfig {
    /// Width of the input features.
    pub in_channels: usize,
    /// Curves in the order in which the attention blocks of a stage take turns.
    pub order: Vec<String>,
    /// Pooling factor between stages, powers of two.
    pub stride: Vec<usize>,
    /// Blocks of each encoder stage.
    pub enc_depths: Vec<usize>,
    /// Channels of each encoder stage.
    pub enc_channels: Vec<usize>,
    /// What the blocks of each encoder stage are made of.
    pub enc_blocks: Vec<BlockKind>,
    /// Attention heads of each encoder stage; where there is attention, six times as many divide
    /// the channels.
    pub enc_num_head: Vec<usize>,
    /// Points of an attention patch, each encoder stage.
    pub enc_patch_size: Vec<usize>,
    /// Blocks of each decoder stage; none in LitePT-S, B and L.
    pub dec_depths: Vec<usize>,
    /// Channels of each decoder stage.
    pub dec_channels: Vec<usize>,
    /// What the blocks of each decoder stage are made of.
    pub dec_blocks: Vec<BlockKind>,
    /// Attention heads of each decoder stage.
    pub dec_num_head: Vec<usize>,
    /// Points of an attention patch, each decoder stage.
    pub dec_patch_size: Vec<usize>,
    /// Width of the hidden layer of an attention block, in channels.
    pub mlp_ratio: usize,
    /// Base of the angles by which queries and keys turn: a voxel further, the first channels turn by
    /// a radian, the last by little more than its inverse.
    pub rope_base: f64,
    /// Largest probability that a row skips a branch of an attention block in training.
    pub drop_path: f64,
    /// Precision and joined layers: not part of the network, so not stored with it.
    #[serde(skip)]
    pub compute: Compute,
}

impl Default for LitePtConfig {
    fn default() -> Self {
        Self::small()
    }
}

/// Convolution where there are many voxels, attention where there are few.
const STAGES: [BlockKind; 5] = [
    BlockKind::Convolution,
    BlockKind::Convolution,
    BlockKind::Convolution,
    BlockKind::Attention,
    BlockKind::Attention,
];

impl LitePtConfig {
    /// LitePT-S: 11 inputs, 72 outputs, 12,735,432 parameters.
    pub fn small() -> Self {
        Self {
            in_channels: 11,
            order: Curve::ALL.map(|c| c.name().to_owned()).to_vec(),
            stride: vec![2; 4],
            enc_depths: vec![2, 2, 2, 6, 2],
            enc_channels: vec![36, 72, 144, 252, 504],
            enc_blocks: STAGES.to_vec(),
            enc_num_head: vec![2, 4, 8, 14, 28],
            enc_patch_size: vec![1024; 5],
            dec_depths: vec![0; 4],
            dec_channels: vec![72, 72, 144, 252],
            dec_blocks: STAGES[..4].to_vec(),
            dec_num_head: vec![4, 4, 8, 14],
            dec_patch_size: vec![1024; 4],
            mlp_ratio: 4,
            rope_base: 100.0,
            drop_path: 0.3,
            compute: Compute::default(),
        }
    }

    /// LitePT-S*: S with two blocks in each decoder stage, 16,011,216 parameters; for instances.
    pub fn small_with_decoder() -> Self {
        Self { dec_depths: vec![2; 4], ..Self::small() }
    }

    /// LitePT-B: 72 outputs, 45,146,538 parameters.
    pub fn base() -> Self {
        Self {
            enc_depths: vec![3, 3, 3, 12, 3],
            enc_channels: vec![54, 108, 216, 432, 576],
            enc_num_head: vec![3, 6, 12, 24, 32],
            dec_channels: vec![72, 108, 216, 432],
            dec_num_head: vec![4, 6, 12, 24],
            ..Self::small()
        }
    }

    /// LitePT-L: 72 outputs, 85,925,448 parameters.
    pub fn large() -> Self {
        Self {
            enc_depths: vec![3, 3, 3, 12, 3],
            enc_channels: vec![72, 144, 288, 576, 864],
            enc_num_head: vec![4, 8, 16, 32, 48],
            dec_channels: vec![72, 144, 288, 576],
            dec_num_head: vec![4, 8, 16, 32],
            ..Self::small()
        }
    }

    /// Number of scales.
    pub fn num_stages(&self) -> usize {
        self.enc_depths.len()
    }

    /// Width of the output.
    pub fn out_channels(&self) -> usize {
        self.dec_channels.first().or(self.enc_channels.first()).copied().unwrap_or(0)
    }

    /// Channels of the rows that come up to a decoder stage.
    pub(crate) fn channels_below(&self, stage: usize) -> usize {
        channels_below(&self.enc_channels, &self.dec_channels, stage)
    }

    /// Whether any block at this scale attends.
    pub(crate) fn attends(&self, scale: usize) -> bool {
        let any = |depths: &[usize], kinds: &[BlockKind]| {
            depths.get(scale).is_some_and(|&d| d > 0)
                && kinds.get(scale).is_some_and(|k| k.has_attention())
        };
        any(&self.enc_depths, &self.enc_blocks) || any(&self.dec_depths, &self.dec_blocks)
    }

    /// Shapes of the blocks of each encoder stage.
    pub(crate) fn encoder_blocks(&self) -> Vec<Vec<BlockShape>> {
        // Counted over convolution blocks too, which do not use them.
        let rates = drop_rates(&self.enc_depths, self.drop_path);
        let (channels, heads) = (&self.enc_channels, &self.enc_num_head);
        self.blocks(&rates, &self.enc_blocks, channels, heads, &self.enc_patch_size)
    }

    /// Shapes of the blocks of each decoder stage: the first that runs, in the coarsest stage, has
    /// the highest drop rate.
    pub(crate) fn decoder_blocks(&self) -> Vec<Vec<BlockShape>> {
        let rates = falling_drop_rates(&self.dec_depths, self.drop_path);
        let (channels, heads) = (&self.dec_channels, &self.dec_num_head);
        self.blocks(&rates, &self.dec_blocks, channels, heads, &self.dec_patch_size)
    }

    fn blocks(
        &self,
        rates: &[Vec<f64>],
        kinds: &[BlockKind],
        channels: &[usize],
        heads: &[usize],
        patches: &[usize],
    ) -> Vec<Vec<BlockShape>> {
        each_block(rates, |stage, i, drop_path| BlockShape {
            kind: kinds[stage],
            attention: AttentionShape {
                channels: channels[stage],
                num_heads: heads[stage],
                patch_size: patches[stage],
                order: i % self.order.len().max(1),
                rope_base: self.rope_base,
            },
            mlp_ratio: self.mlp_ratio,
            drop_path,
            compute: self.compute,
        })
    }

    /// Checks the width of heads where there is attention.
    fn check_heads(&self) -> Result<()> {
        let c = self;
        for (field, depths, kinds, channels, heads) in [
            ("enc_num_head", &c.enc_depths, &c.enc_blocks, &c.enc_channels, &c.enc_num_head),
            ("dec_num_head", &c.dec_depths, &c.dec_blocks, &c.dec_channels, &c.dec_num_head),
        ] {
            for (i, (&c, &h)) in channels.iter().zip(heads).enumerate() {
                if depths[i] > 0 && kinds[i].has_attention() && c % (6 * h) != 0 {
                    bail!(
                        "{field}[{i}]: {h} heads of {c} channels: each head must have a multiple of \
                         6 channels, a pair of numbers for each of three axes"
                    );
                }
            }
        }
        Ok(())
    }
}

impl Architecture for LitePtConfig {
    fn check(&self) -> Result<()> {
        let stages = self.num_stages();
        let above = stages.saturating_sub(1);
        check_fields(
            stages,
            &[
                ("in_channels", &[self.in_channels], 1, 1..=LARGEST),
                ("mlp_ratio", &[self.mlp_ratio], 1, 1..=MAX_MLP_RATIO),
                ("stride", &self.stride, above, 1..=LARGEST),
                ("enc_channels", &self.enc_channels, stages, 1..=LARGEST),
                ("enc_num_head", &self.enc_num_head, stages, 1..=LARGEST),
                ("enc_patch_size", &self.enc_patch_size, stages, 1..=LARGEST),
                ("dec_channels", &self.dec_channels, above, 1..=LARGEST),
                ("dec_num_head", &self.dec_num_head, above, 1..=LARGEST),
                ("dec_patch_size", &self.dec_patch_size, above, 1..=LARGEST),
                ("enc_depths", &self.enc_depths, stages, 0..=DEEPEST),
                ("dec_depths", &self.dec_depths, above, 0..=DEEPEST),
            ],
        )?;
        check_length("enc_blocks", self.enc_blocks.len(), stages, stages)?;
        check_length("dec_blocks", self.dec_blocks.len(), above, stages)?;
        check_rates(&self.stride, self.drop_path)?;
        self.check_heads()?;
        if !(self.rope_base.is_finite() && self.rope_base >= 1.0) {
            bail!("rope_base: {} is not a number of at least 1", self.rope_base);
        }
        curves(&self.order).map(|_| ())
    }
    fn build(&self, vb: VarBuilder<'_>) -> Result<Box<dyn Backbone>> {
        Ok(Box::new(LitePt::new(self, vb)?))
    }
    fn in_channels(&self) -> usize {
        self.in_channels
    }
    fn out_channels(&self) -> usize {
        Self::out_channels(self)
    }
    fn num_values(&self) -> usize {
        self.count_values()
    }
    fn cost(&self) -> BackboneCost {
        self.inference_cost()
    }
    fn multiply_adds(&self, voxels: &[[i32; 3]], frozen: bool) -> Result<MultiplyAdds> {
        self.count_multiply_adds(voxels, frozen)
    }
    fn compute(&self) -> Compute {
        self.compute
    }
    fn set_compute(&mut self, compute: Compute) {
        self.compute = compute;
    }
    fn set_patch_size(&mut self, points: usize) -> std::result::Result<(), String> {
        if !(0..self.num_stages()).any(|scale| self.attends(scale)) {
            return Err("no block of this network attends".to_owned());
        }
        if points > LARGEST {
            return Err(format!("patches of this architecture have 1 to {LARGEST} points"));
        }
        self.enc_patch_size.fill(points);
        self.dec_patch_size.fill(points);
        Ok(())
    }
    fn adapt_to(&mut self, shapes: &Shapes) {
        self.in_channels = stem_inputs(shapes).unwrap_or(self.in_channels);
    }
    fn fits(&self, shapes: &Shapes) -> bool {
        self.has_shapes(shapes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drop_rates_count_convolution_blocks_too() {
        let config = LitePtConfig::small_with_decoder();
        let rates = |blocks: &[BlockShape]| blocks.iter().map(|b| b.drop_path).collect::<Vec<_>>();
        let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        let enc = config.encoder_blocks();
        assert!(close(&rates(&enc[3]), &[6., 7., 8., 9., 10., 11.].map(|k| k * 0.3 / 13.0)));
        assert!(close(&rates(&enc[4]), &[12.0 * 0.3 / 13.0, 0.3]));
        let dec = config.decoder_blocks();
        assert!(close(&rates(&dec[3]), &[0.3, 6.0 * 0.3 / 7.0]));
        assert!(close(&rates(&dec[0]), &[0.3 / 7.0, 0.0]));
        assert_eq!(
            enc[3].iter().map(|b| b.attention.order).collect::<Vec<_>>(),
            [0, 1, 2, 3, 0, 1]
        );
    }

    #[test]
    fn checks_name_the_field() {
        let broken = |f: &dyn Fn(&mut LitePtConfig)| {
            let mut c = LitePtConfig::small();
            f(&mut c);
            c.check().unwrap_err().to_string()
        };
        assert!(broken(&|c| c.stride = vec![2]).contains("stride"));
        assert!(broken(&|c| c.stride[0] = 3).contains("stride[0]"));
        assert!(broken(&|c| c.dec_depths = vec![]).contains("dec_depths"));
        assert!(broken(&|c| c.enc_blocks.truncate(1)).contains("enc_blocks"));
        assert!(broken(&|c| c.enc_num_head[3] = 9).contains("enc_num_head[3]"));
        assert!(broken(&|c| c.enc_num_head[3] = 0).contains("enc_num_head[3]"));
        assert!(broken(&|c| c.rope_base = 0.5).contains("rope_base"));
        assert!(broken(&|c| c.rope_base = f64::NAN).contains("rope_base"));
        assert!(broken(&|c| c.mlp_ratio = 65).contains("mlp_ratio"));
        assert!(broken(&|c| c.drop_path = 1.0).contains("drop_path"));
        assert!(broken(&|c| c.order[1] = "peano".into()).contains("peano"));
        assert!(broken(&|c| c.order.clear()).contains("order"));
        assert!(broken(&|c| c.enc_depths.clear()).contains("enc_depths"));
        assert!(broken(&|c| c.in_channels = 1 << 62).contains("in_channels"));
        // Heads of stages that do not attend turn nothing.
        let mut free = LitePtConfig::small();
        free.enc_num_head[0] = 5;
        free.dec_num_head[3] = 5;
        free.check().unwrap();
        free.dec_depths[3] = 1;
        assert!(free.check().unwrap_err().to_string().contains("dec_num_head[3]"));
    }
}
