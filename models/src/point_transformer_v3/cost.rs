//! What a pass of the network costs: memory, and multiply–adds on scenes as they are on average or on
//! given voxels.

use super::{PointTransformerV3Config, Version};
use crate::multiply_adds::{BlockSize, MultiplyAdds, count};
use crate::{LastStage, Shortcuts};
use candle_core::Result;

/// Pairs of a 3³ kernel map per voxel, on average over scenes.
const PAIRS_PER_VOXEL: f64 = 14.0;
/// Voxels of a scale per voxel of the finer one, on average over scenes.
const KEPT_BY_POOLING: f64 = 0.27;

impl PointTransformerV3Config {
    /// Bytes of memory that inference needs per input voxel, at the widest moment.
    ///
    /// That is the attention of a block: residual, query, key, value and result side by side, five
    /// rows; plus what waits at the finest scale (the skip rows and the pairs of a 3³ kernel map,
    /// 14 voxels on average), with a tenth for buffers.
    pub fn inference_bytes_per_voxel(&self) -> usize {
        let widest = |channels: &[usize]| channels.first().copied().unwrap_or(0);
        // Coarser scales have a quarter of the voxels at most twice the width.
        let finest = widest(&self.dec_channels).max(widest(&self.enc_channels));
        let deeper = self.dec_channels.get(1).copied().unwrap_or(0) / 2;
        let rows = 5 * finest.max(deeper) + widest(&self.enc_channels) + self.in_channels;
        let tables = PAIRS_PER_VOXEL as usize * 8 + 200;
        let mut values = rows as f64;
        let mut bytes = tables;
        if self.dec_depths.is_empty() {
            // All scales at every voxel, and the same in the caller's order.
            values = values.max((2 * self.out_channels() + widest(&self.enc_channels)) as f64);
        }
        if self.shortcuts.stage == LastStage::Coarse {
            // Blocks have so many rows less; their result and the skip branch have as many as the
            // input, and so have the tables of the way between.
            let last = widest(&self.dec_channels) as f64;
            let inside = 5.0 * last * KEPT_BY_POOLING + last;
            let after = 2.0 * last + 2.0 * last * KEPT_BY_POOLING;
            let before = 5.0 * widest(&self.enc_channels).max(deeper) as f64;
            let entry = (widest(&self.enc_channels) + self.in_channels) as f64;
            values = inside.max(after).max(before) + entry;
            bytes += 64 + 8 * 4;
        }
        if let Some(rank) = self.shortcuts.rank {
            // The narrow result beside the wide one; never the widest moment but for wide ranks.
            let fine = self.shortcuts.stage == LastStage::Fine;
            let here = 3 * widest(&self.dec_channels) + rank;
            values = values.max(if fine { here as f64 } else { 0.0 });
        }
        ((values * size_of::<f32>() as f64) as usize + bytes) * 11 / 10
    }

    /// Multiply–adds of each block per input voxel of a scene, on average over scenes, by its name.
    pub fn block_costs(&self) -> Vec<(String, f64)> {
        let cost = |c: usize, patch: usize, scale: usize, rank: Option<usize>| {
            let voxels = KEPT_BY_POOLING.powi(scale as i32);
            let (pairs, attended) = (PAIRS_PER_VOXEL * voxels, patch as f64 * voxels);
            self.block_work(c, false, &BlockSize { voxels, pairs, attended }, rank)
        };
        let mut out = Vec::new();
        for (stage, &depth) in self.enc_depths.iter().enumerate() {
            for j in 0..depth {
                let c = cost(self.enc_channels[stage], self.enc_patch_size[stage], stage, None);
                out.push((format!("enc.enc{stage}.block{j}"), c));
            }
        }
        for (stage, &depth) in self.dec_depths.iter().enumerate() {
            for j in 0..depth {
                let (scale, rank) = self.shortened(stage);
                let c = cost(self.dec_channels[stage], self.dec_patch_size[stage], scale, rank);
                out.push((format!("dec.dec{stage}.block{j}"), c));
            }
        }
        out
    }

    /// As [`Architecture::multiply_adds`](crate::Architecture::multiply_adds).
    pub(super) fn count_multiply_adds(
        &self,
        voxels: &[[i32; 3]],
        frozen: bool,
    ) -> Result<MultiplyAdds> {
        self.check()?;
        let folded = frozen && self.compute.fold;
        let (enc, dec) = (self.enc_channels.as_slice(), self.dec_channels.as_slice());
        let stem = match self.version {
            Version::M1 => 5,
            Version::M2 => 1,
        };
        count(voxels, (stem, self.in_channels), &self.stride, [enc, dec], |stage, cloud| {
            let block = |c: usize, patch_size: usize, rank: Option<usize>| -> Result<f64> {
                Ok(self.block_work(c, folded, &BlockSize::count(cloud, patch_size)?, rank))
            };
            let mut work = self.enc_depths[stage] as f64
                * block(enc[stage], self.enc_patch_size[stage], None)?;
            for (at, &depth) in self.dec_depths.iter().enumerate() {
                let (scale, rank) = self.shortened(at);
                if scale == stage {
                    work += depth as f64 * block(dec[at], self.dec_patch_size[at], rank)?;
                }
            }
            Ok(work)
        })
    }

    /// On which scale the blocks of a decoder stage run, and the rank of their convolutions.
    fn shortened(&self, stage: usize) -> (usize, Option<usize>) {
        match self.shortcuts {
            Shortcuts { stage: LastStage::Coarse, rank } if stage == 0 => (1, rank),
            Shortcuts { rank, .. } if stage == 0 => (0, rank),
            _ => (stage, None),
        }
    }

    fn block_work(&self, c: usize, folded: bool, size: &BlockSize, rank: Option<usize>) -> f64 {
        let convolution = match rank {
            None => size.convolution(c, folded),
            Some(rank) => size.convolution_of_rank(c, folded, rank),
        };
        convolution + size.attention(c, self.mlp_ratio)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> PointTransformerV3Config {
        PointTransformerV3Config { in_channels: 3, ..PointTransformerV3Config::tiny() }.with_stages(
            &[[1, 4, 1], [2, 8, 1]],
            &[[1, 6, 1]],
            16,
        )
    }

    #[test]
    fn one_voxel_by_hand() {
        let found = small().count_multiply_adds(&[[0, 0, 0]], false).unwrap();
        assert_eq!(found.stem, 3 * 4);
        let block = |c: u64| (1 + 5 + 8) * c * c + 2 * c;
        let scales = 4 * 8 + 8 * 6 + 4 * 6;
        assert_eq!(found.rest, block(4) + 2 * block(8) + block(6) + scales);
        let joined = small().count_multiply_adds(&[[0, 0, 0]], true).unwrap();
        assert_eq!(found.rest - joined.rest, 16 + 2 * 64 + 36);
        assert!(small().count_multiply_adds(&[[i32::MAX, 0, 0], [i32::MIN, 0, 0]], true).is_err());
    }

    #[test]
    fn the_average_scene_is_like_a_scene() {
        // Two walls and a floor of 48 × 48 voxels, as rooms have.
        let voxels: Vec<[i32; 3]> = (0..48 * 48)
            .map(|i| [i % 48, i / 48, 0])
            .chain((0..48 * 47).map(|i| [i % 48, 0, i / 48 + 1]))
            .chain((0..47 * 47).map(|i| [0, i % 47 + 1, i / 47 + 1]))
            .collect();
        let config = PointTransformerV3Config::language();
        let counted = config.count_multiply_adds(&voxels, false).unwrap().rest as f64;
        let expected: f64 = config.block_costs().iter().map(|(_, work)| work).sum();
        let ratio = counted / (expected * voxels.len() as f64);
        assert!((0.6..1.6).contains(&ratio), "{ratio}");
    }
}
