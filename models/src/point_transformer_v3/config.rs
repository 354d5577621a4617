//! Shape of a network.

use super::PointTransformerV3;
use super::attention::BatchRule;
use super::block::BlockShape;
use crate::architecture::NO_LAST_STAGE;
use crate::layers::NormKind;
use crate::params::check_values;
use crate::stages::{
    DEEPEST, LARGEST, MAX_MLP_RATIO, channels_below, check_fields, check_rates, curves, drop_rates,
    each_block, falling_drop_rates, stem_inputs,
};
use crate::weights::Shapes;
use crate::{Architecture, Backbone, BackboneCost, Compute, LastStage, MultiplyAdds, Shortcuts};
use candle_core::{Result, bail};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::Reduce;
use scenesplat_kernels::serialization::Curve;
use serde::{Deserialize, Serialize};

/// The widest input of a voxel.
const MAX_INPUTS: usize = 1 << 16;
/// The largest pooling factor: curves have 21 bits an axis.
const MAX_STRIDE: usize = 1 << 16;
/// The most points of an attention patch, 64 times the original's.
const MAX_PATCH_SIZE: usize = 1 << 16;

/// How features of pooled voxels are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoolingReduce {
    /// Mean: the language and segmentation networks.
    Mean,
    /// Maximum: the self-supervised networks.
    Max,
}

impl From<PoolingReduce> for Reduce {
    fn from(p: PoolingReduce) -> Self {
        match p {
            PoolingReduce::Mean => Self::Mean,
            PoolingReduce::Max => Self::Max,
        }
    }
}

/// Which of the two published forms of the network.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Version {
    /// `PT-v3m1`: a convolution over 5³ voxels in front, batch norms around the stages. In the decoder the first
    /// convolution of a stage reads the skip branch alone.
    #[default]
    M1,
    /// `PT-v3m2` (Sonata, Concerto, Chorus): a linear layer in front, layer norms everywhere. In the decoder the first
    /// convolution of a stage reads the sum of both branches.
    M2,
}

impl Version {
    /// The norm of stem, pooling and unpooling.
    pub(crate) fn norm(self) -> NormKind {
        match self {
            Self::M1 => NormKind::Batch,
            Self::M2 => NormKind::Layer,
        }
    }

    /// Where the token for masked rows is.
    pub(crate) fn mask_token(self) -> &'static str {
        match self {
            Self::M1 => "mask_token",
            Self::M2 => "embedding.mask_token",
        }
    }
}

/// Shape of a Point Transformer V3. Defaults are those of the language network.
///
/// Lists of the encoder have one entry a stage; lists of the decoder one entry a stage but the
/// last, from fine to coarse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointTransformerV3Config {
    /// Which form: stem, norms, and what the decoder's convolutions read.
    pub version: Version,
    /// Width of the input features.
    pub in_channels: usize,
    /// Curves in the order in which the blocks of a stage take turns.
    pub order: Vec<String>,
    /// Pooling factor between stages, powers of two.
    pub stride: Vec<usize>,
    /// Blocks of each encoder stage.
    pub enc_depths: Vec<usize>,
    /// Channels of each encoder stage.
    pub enc_channels: Vec<usize>,
    /// Attention heads of each encoder stage.
    pub enc_num_head: Vec<usize>,
    /// Points of an attention patch, each encoder stage.
    pub enc_patch_size: Vec<usize>,
    /// Blocks of each decoder stage; empty for an encoder alone, whose output are all of its scales,
    /// up-cast to the input rows.
    pub dec_depths: Vec<usize>,
    /// Channels of each decoder stage.
    pub dec_channels: Vec<usize>,
    /// Attention heads of each decoder stage.
    pub dec_num_head: Vec<usize>,
    /// Points of an attention patch, each decoder stage.
    pub dec_patch_size: Vec<usize>,
    /// Width of the hidden layer of a block, in channels.
    pub mlp_ratio: usize,
    /// Largest probability that a row skips a branch in training.
    pub drop_path: f64,
    /// How pooled features are joined.
    pub pooling: PoolingReduce,
    /// Whether there is a learned token for masked rows (self-supervised networks).
    pub mask_token: bool,
    /// Whether scenes of a batch are kept apart.
    pub batch_rule: BatchRule,
    /// Precision and joined layers: not part of the network, so not stored with it.
    #[serde(skip)]
    pub compute: Compute,
    /// What inference leaves out: not part of the network either.
    #[serde(skip)]
    pub shortcuts: Shortcuts,
}

impl Default for PointTransformerV3Config {
    fn default() -> Self {
        Self::language()
    }
}

impl PointTransformerV3Config {
    /// The language network: 11 inputs, 768 outputs, 91,712,800 parameters.
    pub fn language() -> Self {
        Self {
            version: Version::M1,
            in_channels: 11,
            order: Curve::ALL.map(|c| c.name().to_owned()).to_vec(),
            stride: vec![2; 3],
            enc_depths: vec![2, 2, 2, 6],
            enc_channels: vec![32, 64, 128, 256],
            enc_num_head: vec![2, 4, 8, 16],
            enc_patch_size: vec![1024; 4],
            dec_depths: vec![2; 3],
            dec_channels: vec![768, 512, 256],
            dec_num_head: vec![16; 3],
            dec_patch_size: vec![1024; 3],
            mlp_ratio: 4,
            drop_path: 0.3,
            pooling: PoolingReduce::Mean,
            mask_token: false,
            batch_rule: BatchRule::Isolated,
            compute: Compute::default(),
            shortcuts: Shortcuts::default(),
        }
    }

    /// The supervised segmentation network: 14 inputs (with normals), 64 outputs.
    pub fn semseg() -> Self {
        let encoder = [[2, 32, 2], [2, 64, 4], [2, 128, 8], [6, 256, 16], [2, 512, 32]];
        let decoder = [[2, 64, 4], [2, 64, 4], [2, 128, 8], [2, 256, 16]];
        Self { in_channels: 14, ..Self::language() }.with_stages(&encoder, &decoder, 1024)
    }

    /// The self-supervised network: as for segmentation, with maximum pooling and a mask token.
    pub fn ssl() -> Self {
        Self { in_channels: 11, pooling: PoolingReduce::Max, mask_token: true, ..Self::semseg() }
    }

    /// The encoder of Sonata, of Concerto's base size and of Chorus: 108.5 million parameters, `PT-v3m2` without decoder,
    /// whose output are its five scales side by side (1232 channels). Nine inputs are those of Sonata: position, color,
    /// normal.
    pub fn sonata() -> Self {
        let encoder = [[3, 48, 3], [3, 96, 6], [3, 192, 12], [12, 384, 24], [3, 512, 32]];
        let version = Version::M2;
        Self { version, in_channels: 9, pooling: PoolingReduce::Max, ..Self::language() }
            .with_stages(&encoder, &[], 1024)
    }

    /// [`sonata`](Self::sonata) with the decoder of its probes and fine-tuned networks, 64 outputs.
    pub fn sonata_with_decoder() -> Self {
        let sonata = Self::sonata();
        let heads = sonata.enc_num_head.clone();
        let encoder: Vec<[usize; 3]> =
            (0..5).map(|s| [sonata.enc_depths[s], sonata.enc_channels[s], heads[s]]).collect();
        let decoder = [[2, 64, 4], [2, 96, 6], [2, 192, 12], [2, 384, 24]];
        sonata.with_stages(&encoder, &decoder, 1024)
    }

    /// The encoder of Concerto's large size: [`sonata`](Self::sonata), 64 to 768 channels wide.
    pub fn concerto_large() -> Self {
        let encoder = [[3, 64, 4], [3, 128, 8], [3, 256, 16], [12, 512, 32], [3, 768, 48]];
        Self::sonata().with_stages(&encoder, &[], 1024)
    }

    /// A small language network (64 outputs) for trying things out.
    pub fn tiny() -> Self {
        let (encoder, decoder) = ([[1, 16, 1], [1, 32, 2], [2, 64, 4]], [[1, 64, 4], [1, 32, 2]]);
        Self { drop_path: 0.1, ..Self::language() }.with_stages(&encoder, &decoder, 256)
    }

    /// With other stages, each half as fine as the one before: their blocks, channels and attention heads, from
    /// fine to coarse, those of the decoder without the last; and so many points in an attention patch.
    #[must_use]
    pub fn with_stages(
        self,
        encoder: &[[usize; 3]],
        decoder: &[[usize; 3]],
        patch_size: usize,
    ) -> Self {
        let of = |stages: &[[usize; 3]], i: usize| stages.iter().map(|stage| stage[i]).collect();
        Self {
            stride: vec![2; encoder.len().saturating_sub(1)],
            enc_depths: of(encoder, 0),
            enc_channels: of(encoder, 1),
            enc_num_head: of(encoder, 2),
            enc_patch_size: vec![patch_size; encoder.len()],
            dec_depths: of(decoder, 0),
            dec_channels: of(decoder, 1),
            dec_num_head: of(decoder, 2),
            dec_patch_size: vec![patch_size; decoder.len()],
            ..self
        }
    }

    /// Width of the last decoder stage, if that has blocks.
    fn last_stage_width(&self) -> Option<usize> {
        let blocks = self.dec_depths.first().is_some_and(|depth| *depth > 0);
        self.dec_channels.first().copied().filter(|_| blocks)
    }

    /// Number of scales.
    pub fn num_stages(&self) -> usize {
        self.enc_depths.len()
    }

    /// Width of the output: of the decoder's last stage, or of all scales of an encoder alone.
    pub fn out_channels(&self) -> usize {
        if self.dec_depths.is_empty() {
            return self.enc_channels.iter().fold(0, |sum: usize, c| sum.saturating_add(*c));
        }
        self.dec_channels.first().copied().unwrap_or(0)
    }

    /// Values of all parameters and buffers, without building anything; at most `usize::MAX`.
    pub fn num_values(&self) -> usize {
        // Of a configuration that was not checked, sizes may be anything.
        let product = |sizes: &[usize]| sizes.iter().fold(1usize, |n, s| n.saturating_mul(*s));
        let sum = |counts: &[usize]| counts.iter().fold(0usize, |n, c| n.saturating_add(*c));
        let linear = |i: usize, o: usize| product(&[i, o]).saturating_add(o);
        let block = |c: usize| {
            let hidden = product(&[self.mlp_ratio, c]);
            let (conv, qkv) = (product(&[27, c, c]), linear(c, product(&[3, c])));
            let norms = product(&[7, c]);
            sum(&[
                conv,
                norms,
                linear(c, c),
                qkv,
                linear(c, c),
                linear(c, hidden),
                linear(hidden, c),
            ])
        };
        let norm = |c: usize| self.version.norm().num_values(c);
        let first = self.enc_channels.first().copied().unwrap_or(0);
        let stem = match self.version {
            Version::M1 => product(&[125, self.in_channels, first]),
            Version::M2 => linear(self.in_channels, first),
        };
        let mut all = stem.saturating_add(norm(first));
        all = all.saturating_add(if self.mask_token { first } else { 0 });
        let mut finer = None;
        for (&c, &depth) in self.enc_channels.iter().zip(&self.enc_depths) {
            let down = finer.map_or(0, |finer| sum(&[linear(finer, c), norm(c)]));
            all = sum(&[all, product(&[depth, block(c)]), down]);
            finer = Some(c);
        }
        for (stage, (&c, &depth)) in self.dec_channels.iter().zip(&self.dec_depths).enumerate() {
            let coarse = channels_below(&self.enc_channels, &self.dec_channels, stage);
            let skip = self.enc_channels.get(stage).copied().unwrap_or(0);
            let up = [linear(coarse, c), linear(skip, c), norm(c).saturating_mul(2)];
            all = sum(&[all, product(&[depth, block(c)]), sum(&up)]);
        }
        all
    }

    /// Checks that sizes are possible and the lists fit together, and gives the curves.
    ///
    /// A configuration may come from a file that somebody else wrote, so every size has an upper
    /// bound, far above any network that is known, and so has the number of values in all
    /// ([`MAX_VALUES`](crate::MAX_VALUES)): nothing is reserved for more.
    ///
    /// # Errors
    /// Names the first field that does not fit.
    pub fn check(&self) -> Result<Vec<Curve>> {
        let stages = self.num_stages();
        let above = stages.saturating_sub(1);
        let decoder = if self.dec_depths.is_empty() { 0 } else { above };
        check_fields(
            stages,
            &[
                ("in_channels", &[self.in_channels], 1, 1..=MAX_INPUTS),
                ("mlp_ratio", &[self.mlp_ratio], 1, 1..=MAX_MLP_RATIO),
                ("stride", &self.stride, above, 1..=MAX_STRIDE),
                ("enc_depths", &self.enc_depths, stages, 0..=DEEPEST),
                ("dec_depths", &self.dec_depths, decoder, 0..=DEEPEST),
                ("enc_channels", &self.enc_channels, stages, 1..=LARGEST),
                ("dec_channels", &self.dec_channels, decoder, 1..=LARGEST),
                ("enc_num_head", &self.enc_num_head, stages, 1..=LARGEST),
                ("dec_num_head", &self.dec_num_head, decoder, 1..=LARGEST),
                ("enc_patch_size", &self.enc_patch_size, stages, 1..=MAX_PATCH_SIZE),
                ("dec_patch_size", &self.dec_patch_size, decoder, 1..=MAX_PATCH_SIZE),
            ],
        )?;
        check_values(self.num_values())?;
        if self.shortcuts != Shortcuts::default() && self.last_stage_width().is_none() {
            bail!("shortcuts: {NO_LAST_STAGE}");
        }
        for (field, channels, heads) in [
            ("enc_num_head", &self.enc_channels, &self.enc_num_head),
            ("dec_num_head", &self.dec_channels, &self.dec_num_head),
        ] {
            if let Some(i) = channels.iter().zip(heads).position(|(c, h)| c % h != 0) {
                bail!("{field}[{i}]: {} heads do not divide {} channels", heads[i], channels[i]);
            }
        }
        check_rates(&self.stride, self.drop_path)?;
        curves(&self.order)
    }

    /// Shapes of the blocks of each encoder stage.
    pub(crate) fn encoder_blocks(&self) -> Vec<Vec<BlockShape>> {
        let rates = drop_rates(&self.enc_depths, self.drop_path);
        self.blocks(&rates, &self.enc_channels, &self.enc_num_head, &self.enc_patch_size)
    }

    /// Shapes of the blocks of each decoder stage, fine to coarse: the first block that runs, in the
    /// coarsest stage, has the highest drop rate.
    pub(crate) fn decoder_blocks(&self) -> Vec<Vec<BlockShape>> {
        let rates = falling_drop_rates(&self.dec_depths, self.drop_path);
        self.blocks(&rates, &self.dec_channels, &self.dec_num_head, &self.dec_patch_size)
    }

    fn blocks(
        &self,
        rates: &[Vec<f64>],
        channels: &[usize],
        heads: &[usize],
        patches: &[usize],
    ) -> Vec<Vec<BlockShape>> {
        let block = |stage: usize, i: usize, drop_path: f64| BlockShape {
            channels: channels[stage],
            num_heads: heads[stage],
            patch_size: patches[stage],
            mlp_ratio: self.mlp_ratio,
            drop_path,
            order: i % self.order.len(),
            batch_rule: self.batch_rule,
            compute: self.compute,
        };
        each_block(rates, block)
    }
}

impl Architecture for PointTransformerV3Config {
    fn check(&self) -> Result<()> {
        Self::check(self).map(|_| ())
    }
    fn build(&self, vb: VarBuilder<'_>) -> Result<Box<dyn Backbone>> {
        Ok(Box::new(PointTransformerV3::new(self, vb)?))
    }
    fn in_channels(&self) -> usize {
        self.in_channels
    }
    fn out_channels(&self) -> usize {
        Self::out_channels(self)
    }
    fn num_values(&self) -> usize {
        Self::num_values(self)
    }
    fn cost(&self) -> BackboneCost {
        BackboneCost {
            bytes_per_voxel: self.inference_bytes_per_voxel(),
            parts: self.block_costs(),
        }
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
        self.enc_patch_size.fill(points);
        self.dec_patch_size.fill(points);
        Ok(())
    }
    fn set_last_stage(&mut self, stage: LastStage) -> std::result::Result<(), String> {
        self.last_stage_width().ok_or(NO_LAST_STAGE)?;
        self.shortcuts.stage = stage;
        Ok(())
    }
    fn set_rank(&mut self, rank: usize) -> std::result::Result<(), String> {
        let width = self.last_stage_width().ok_or(NO_LAST_STAGE)?;
        if !(1..=width).contains(&rank) {
            return Err(format!(
                "convolutions of the last stage are {width} wide: 1 to {width} are possible"
            ));
        }
        self.shortcuts.rank = Some(rank);
        Ok(())
    }
    fn adapt_to(&mut self, shapes: &Shapes) {
        self.in_channels = stem_inputs(shapes).unwrap_or(self.in_channels);
        // Published with and without, after training with it.
        if self.version == Version::M2 && !shapes.is_empty() {
            self.mask_token = shapes.contains_key(self.version.mask_token());
        }
    }
    fn fits(&self, shapes: &Shapes) -> bool {
        self.has_shapes(shapes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drop_rates_of_the_language_network() {
        let config = PointTransformerV3Config::language();
        let close = |blocks: &[BlockShape], rates: &[f64]| {
            blocks.iter().zip(rates).all(|(b, rate)| (b.drop_path - rate).abs() < 5e-5)
        };
        let (enc, dec) = (config.encoder_blocks(), config.decoder_blocks());
        assert!(close(&enc[1], &[0.0545, 0.0818]));
        assert!(close(&enc[3], &[0.1636, 0.1909, 0.2182, 0.2455, 0.2727, 0.3]));
        for (stage, rates) in dec.iter().zip([[0.06, 0.0], [0.18, 0.12], [0.30, 0.24]]) {
            assert!(close(stage, &rates));
        }
    }

    #[test]
    fn checks_name_the_field() {
        let broken = |f: &dyn Fn(&mut PointTransformerV3Config)| {
            let mut c = PointTransformerV3Config::language();
            f(&mut c);
            c.check().unwrap_err().to_string()
        };
        assert!(broken(&|c| c.stride = vec![2]).contains("stride"));
        assert!(broken(&|c| c.stride[0] = 3).contains("stride[0]"));
        assert!(broken(&|c| c.enc_num_head[1] = 5).contains("enc_num_head[1]"));
        assert!(broken(&|c| c.enc_patch_size[2] = 0).contains("enc_patch_size[2]"));
        assert!(broken(&|c| c.order[0] = "peano".into()).contains("peano"));
        assert!(broken(&|c| c.enc_depths.clear()).contains("enc_depths"));
        assert!(broken(&|c| c.order = vec!["z".into(); 65]).contains("order: 65 entries"));
        assert!(broken(&|c| c.in_channels = 1 << 62).contains("in_channels: 4611686018427387904"));
        let large = broken(&|c| {
            c.dec_channels = vec![1 << 14; 3];
            c.mlp_ratio = 64;
        });
        assert!(large.contains("values, at most"), "{large}");
        for c in [
            PointTransformerV3Config::semseg(),
            PointTransformerV3Config::ssl(),
            PointTransformerV3Config::tiny(),
            PointTransformerV3Config::sonata(),
            PointTransformerV3Config::sonata_with_decoder(),
            PointTransformerV3Config::concerto_large(),
        ] {
            assert_eq!(c.check().unwrap().len(), 4);
        }
    }
}
