//! Operations of a network on given voxels, counted from its tables.

use anyhow::{Context, Result, bail};
use scenesplat::kernels::serialization::Curve;
use scenesplat::kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat::models::{
    BackboneConfig, Head, LitePtConfig, ModelConfig, PointTransformerV3Config,
};

/// Operations of a forward pass; a multiply–add counts as two. Only matrix products count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Flop {
    /// The first convolution: training needs no gradient of its input.
    pub stem: u64,
    /// All products but those of the stem.
    pub rest: u64,
}

impl Flop {
    /// Forward pass.
    pub fn forward(self) -> u64 {
        self.stem + self.rest
    }

    /// Forward and backward: each product has two in the backward pass, one for each factor. What an
    /// implementation computes a second time is not counted.
    pub fn train(self) -> u64 {
        2 * self.stem + 3 * self.rest
    }
}

/// Counts the operations on one scene, head included. Frozen layers may be joined, as the
/// configuration says: then the linear layer behind each convolution is a part of it.
///
/// # Errors
/// If the voxels are out of range, or the operations of the architecture are not counted.
pub(super) fn count(model: &ModelConfig, voxels: &[[i32; 3]], frozen: bool) -> Result<Flop> {
    let mut flop = match &model.backbone {
        BackboneConfig::PointTransformerV3(config) => {
            patches_at_every_scale(config, voxels, frozen)
        }
        BackboneConfig::LitePt(config) => convolutions_then_attention(config, voxels, frozen),
        other => bail!("operations of {} are not counted", other.name()),
    }?;
    let head = match model.head {
        Head::Classes(width) | Head::Features { projection: Some(width) } => width,
        Head::Features { projection: None } => 0,
    };
    flop.rest += (2 * voxels.len() * model.backbone.get().out_channels() * head) as u64;
    Ok(flop)
}

/// Occupied pairs, and products of queries and keys, of one scale.
struct Tables<'a>(&'a SerializedCloud);

impl Tables<'_> {
    fn convolution(&self, c: usize, linear: usize) -> Result<usize> {
        Ok(2 * (self.0.kernel_map(3)?.num_pairs() + linear * self.0.len()) * c * c)
    }

    /// Query, key, value and projection, both layers of the MLP; then queries with keys and weights
    /// with values.
    fn attention(&self, c: usize, patch_size: usize, mlp_ratio: usize) -> usize {
        let patches = self.0.patches(patch_size);
        let products: usize = patches.patches().iter().map(|p| p.own * p.len).sum();
        2 * (3 + 1 + 2 * mlp_ratio) * self.0.len() * c * c + 4 * products * c
    }
}

fn convolutions_then_attention(
    config: &LitePtConfig,
    voxels: &[[i32; 3]],
    frozen: bool,
) -> Result<Flop> {
    let after_convolution = usize::from(!(frozen && config.compute.fold));
    let mut cloud = finest(voxels)?;
    let (enc, dec) = (&config.enc_channels, &config.dec_channels);
    let stem = 2 * cloud.kernel_map(5)?.num_pairs() * config.in_channels * enc[0];
    let mut rest = 0;
    for stage in 0..config.num_stages() {
        if stage > 0 {
            let fine = cloud.len();
            cloud = cloud.pool(config.stride[stage - 1].trailing_zeros()).0;
            rest += between(enc, dec, stage, fine, cloud.len())?;
        }
        let decoder = dec.get(stage).map(|&c| {
            (config.dec_depths[stage], c, config.dec_blocks[stage], config.dec_patch_size[stage])
        });
        let encoder = (
            config.enc_depths[stage],
            enc[stage],
            config.enc_blocks[stage],
            config.enc_patch_size[stage],
        );
        for (depth, c, kind, patch_size) in std::iter::once(encoder).chain(decoder) {
            let tables = Tables(&cloud);
            if depth > 0 && kind.has_convolution() {
                rest += depth * tables.convolution(c, after_convolution)?;
            }
            if depth > 0 && kind.has_attention() {
                rest += depth * tables.attention(c, patch_size, config.mlp_ratio);
            }
        }
    }
    Ok(Flop { stem: stem as u64, rest: rest as u64 })
}

fn finest(voxels: &[[i32; 3]]) -> Result<SerializedCloud> {
    let offsets = vec![0, voxels.len()];
    Ok(SerializedCloud::new(voxels.to_vec(), offsets, &[Curve::Z], CurveDepth::PerScene)?)
}

/// Layers from a scale to `stage` and back: pooling, and both branches of the decoder.
fn between(
    enc: &[usize],
    dec: &[usize],
    stage: usize,
    fine: usize,
    coarse: usize,
) -> Result<usize> {
    let mut sum = 2 * fine * enc[stage - 1] * enc[stage];
    if let Some(&up) = dec.get(stage - 1) {
        let below = *dec.get(stage).or(enc.last()).context("no stage")?;
        sum += 2 * coarse * below * up + 2 * fine * enc[stage - 1] * up;
    }
    Ok(sum)
}

fn patches_at_every_scale(
    config: &PointTransformerV3Config,
    voxels: &[[i32; 3]],
    frozen: bool,
) -> Result<Flop> {
    let after_convolution = usize::from(!(frozen && config.compute.fold));
    let mut cloud = finest(voxels)?;
    let stem = 2 * cloud.kernel_map(5)?.num_pairs() * config.in_channels * config.enc_channels[0];
    let (enc, dec) = (&config.enc_channels, &config.dec_channels);
    let mut rest = 0;
    for stage in 0..config.num_stages() {
        if stage > 0 {
            let fine = cloud.len();
            cloud = cloud.pool(config.stride[stage - 1].trailing_zeros()).0;
            rest += between(enc, dec, stage, fine, cloud.len())?;
        }
        let block = |c: usize, patch_size: usize| -> Result<usize> {
            let tables = Tables(&cloud);
            let convolution = tables.convolution(c, after_convolution)?;
            Ok(convolution + tables.attention(c, patch_size, config.mlp_ratio))
        };
        rest += config.enc_depths[stage] * block(enc[stage], config.enc_patch_size[stage])?;
        if let Some(&depth) = config.dec_depths.get(stage) {
            rest += depth * block(dec[stage], config.dec_patch_size[stage])?;
        }
    }
    Ok(Flop { stem: stem as u64, rest: rest as u64 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat::models::litept::BlockKind;

    #[test]
    fn one_voxel_by_hand() {
        let config = PointTransformerV3Config {
            in_channels: 3,
            stride: vec![2],
            enc_depths: vec![1, 2],
            enc_channels: vec![4, 8],
            enc_num_head: vec![1, 1],
            enc_patch_size: vec![16, 16],
            dec_depths: vec![1],
            dec_channels: vec![6],
            dec_num_head: vec![1],
            dec_patch_size: vec![16],
            ..PointTransformerV3Config::tiny()
        };
        let model = ModelConfig::new(config).with_classes(5);
        let found = count(&model, &[[0, 0, 0]], false).unwrap();
        assert_eq!(found.stem, 2 * 3 * 4);
        let block = |c: u64| 2 * (1 + 5 + 8) * c * c + 4 * c;
        let scales = 2 * 4 * 8 + 2 * 8 * 6 + 2 * 4 * 6;
        assert_eq!(found.rest, block(4) + 2 * block(8) + block(6) + scales + 2 * 6 * 5);
        assert_eq!(found.train(), 2 * found.stem + 3 * found.rest);
        let joined = count(&model, &[[0, 0, 0]], true).unwrap();
        assert_eq!(found.rest - joined.rest, 2 * (16 + 2 * 64 + 36));
    }

    #[test]
    fn one_voxel_of_litept_by_hand() {
        let config = LitePtConfig {
            in_channels: 3,
            stride: vec![2],
            enc_depths: vec![1, 2],
            enc_channels: vec![4, 12],
            enc_blocks: vec![BlockKind::Convolution, BlockKind::Attention],
            enc_num_head: vec![1, 2],
            enc_patch_size: vec![16, 16],
            dec_depths: vec![0],
            dec_channels: vec![6],
            dec_blocks: vec![BlockKind::Both],
            dec_num_head: vec![1],
            dec_patch_size: vec![16],
            ..LitePtConfig::small()
        };
        let model = ModelConfig::new(config.clone()).with_projection(7);
        let found = count(&model, &[[0, 0, 0]], false).unwrap();
        assert_eq!(found.stem, 2 * 3 * 4);
        let attention = |c: u64| 2 * 12 * c * c + 4 * c;
        let scales = 2 * 4 * 12 + 2 * 12 * 6 + 2 * 4 * 6;
        assert_eq!(found.rest, 2 * 2 * 16 + 2 * attention(12) + scales + 2 * 6 * 7);
        let joined = count(&model, &[[0, 0, 0]], true).unwrap();
        assert_eq!(found.rest - joined.rest, 2 * 16);
        // A block of both kinds, in the decoder.
        let more = ModelConfig::new(LitePtConfig { dec_depths: vec![1], ..config });
        let more = count(&more.with_projection(7), &[[0, 0, 0]], true).unwrap();
        assert_eq!(more.rest - joined.rest, 2 * 36 + attention(6));
    }
}
