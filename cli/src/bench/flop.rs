//! Operations of a network on given voxels, counted from its tables.

use anyhow::{Context, Result};
use scenesplat::kernels::serialization::Curve;
use scenesplat::kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat::models::PointTransformerV3Config;

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

/// Counts the operations on one scene; `head` is the width of a linear layer behind the network, 0
/// for none. Frozen layers may be joined, as the configuration says: then
/// the linear layer behind each convolution is a part of it.
///
/// # Errors
/// If the voxels are out of range.
pub(super) fn count(
    config: &PointTransformerV3Config,
    head: usize,
    voxels: &[[i32; 3]],
    frozen: bool,
) -> Result<Flop> {
    let n = voxels.len();
    let after_convolution = usize::from(!(frozen && config.compute.fold));
    let mut cloud =
        SerializedCloud::new(voxels.to_vec(), vec![0, n], &[Curve::Z], CurveDepth::PerScene)?;
    let stem = 2 * cloud.kernel_map(5)?.num_pairs() * config.in_channels * config.enc_channels[0];
    let (enc, dec) = (&config.enc_channels, &config.dec_channels);
    let mut rest = 0;
    for stage in 0..config.num_stages() {
        let c = enc[stage];
        if stage > 0 {
            let fine = cloud.len();
            let shift = config.stride[stage - 1].trailing_zeros();
            cloud = cloud.pool(shift).0;
            rest += 2 * fine * enc[stage - 1] * c;
            if let Some(&up) = dec.get(stage - 1) {
                let coarse = *dec.get(stage).or(enc.last()).context("no stage")?;
                rest += 2 * cloud.len() * coarse * up + 2 * fine * enc[stage - 1] * up;
            }
        }
        let block = |c: usize, patch_size: usize| -> Result<usize> {
            let n = cloud.len();
            let patches = cloud.patches(patch_size);
            let products: usize = patches.patches().iter().map(|p| p.own * p.len).sum();
            // Convolution, its linear layer, query, key, value and projection, both layers of the
            // MLP; then queries with keys and weights with values.
            let linear = after_convolution + 3 + 1 + 2 * config.mlp_ratio;
            let pairs = cloud.kernel_map(3)?.num_pairs();
            Ok(2 * (pairs + linear * n) * c * c + 4 * products * c)
        };
        rest += config.enc_depths[stage] * block(c, config.enc_patch_size[stage])?;
        if let Some(&depth) = config.dec_depths.get(stage) {
            rest += depth * block(dec[stage], config.dec_patch_size[stage])?;
        }
    }
    let head = 2 * n * config.out_channels() * head;
    Ok(Flop { stem: stem as u64, rest: (rest + head) as u64 })
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let found = count(&config, 5, &[[0, 0, 0]], false).unwrap();
        assert_eq!(found.stem, 2 * 3 * 4);
        let block = |c: u64| 2 * (1 + 5 + 8) * c * c + 4 * c;
        let scales = 2 * 4 * 8 + 2 * 8 * 6 + 2 * 4 * 6;
        assert_eq!(found.rest, block(4) + 2 * block(8) + block(6) + scales + 2 * 6 * 5);
        assert_eq!(found.train(), 2 * found.stem + 3 * found.rest);
        let joined = count(&config, 5, &[[0, 0, 0]], true).unwrap();
        assert_eq!(found.rest - joined.rest, 2 * (16 + 2 * 64 + 36));
    }
}
