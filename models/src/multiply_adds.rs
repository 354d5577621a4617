//! Multiply–adds of a network: what its parts cost, on scenes as they are on average and on given voxels.

use candle_core::Result;
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};

/// Multiply–adds of one forward pass without a head. Only matrix products count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MultiplyAdds {
    /// The first convolution: training needs no gradient of its input.
    pub stem: u64,
    /// All products but those of the stem.
    pub rest: u64,
}

/// What a block works on: counted on a scene, or an average.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BlockSize {
    /// Voxels of the scale.
    pub(crate) voxels: f64,
    /// Pairs of its 3³ kernel map.
    pub(crate) pairs: f64,
    /// Pairs of voxels that attend to each other.
    pub(crate) attended: f64,
}

impl BlockSize {
    /// Counts those of a scale. These are whole numbers far below 2⁵³, so no digit is lost.
    pub(crate) fn count(cloud: &SerializedCloud, patch_size: usize) -> Result<Self> {
        let patches = cloud.patches(patch_size);
        let attended: usize = patches.patches().iter().map(|p| p.own * p.len).sum();
        let map = cloud.kernel_map(3).map_err(candle_core::Error::wrap)?;
        let (voxels, pairs) = (cloud.len() as f64, map.num_pairs() as f64);
        Ok(Self { voxels, pairs, attended: attended as f64 })
    }

    /// A 3³ convolution of `c` channels, and the linear layer behind it unless it is `folded` into it.
    pub(crate) fn convolution(&self, c: usize, folded: bool) -> f64 {
        let linear = if folded { 0.0 } else { self.voxels };
        (self.pairs + linear) * (c * c) as f64
    }

    /// As [`convolution`](Self::convolution), through so many channels.
    pub(crate) fn convolution_of_rank(&self, c: usize, folded: bool, rank: usize) -> f64 {
        let linear = if folded { 0.0 } else { self.voxels };
        (self.pairs + self.voxels) * (c * rank) as f64 + linear * (c * c) as f64
    }

    /// Query, key, value and projection, both layers of the MLP; then queries with keys and weights with
    /// values.
    pub(crate) fn attention(&self, c: usize, mlp_ratio: usize) -> f64 {
        let linear = (3 + 1 + 2 * mlp_ratio) as f64;
        linear * self.voxels * (c * c) as f64 + 2.0 * self.attended * c as f64
    }
}

/// Counts the multiply–adds of an encoder and decoder on the voxels of one scene. The first layer reads so many voxels
/// an axis, of so many channels. `blocks` gives those of a scale's blocks.
pub(crate) fn count(
    voxels: &[[i32; 3]],
    (stem_size, in_channels): (usize, usize),
    stride: &[usize],
    [enc, dec]: [&[usize]; 2],
    mut blocks: impl FnMut(usize, &SerializedCloud) -> Result<f64>,
) -> Result<MultiplyAdds> {
    let offsets = vec![0, voxels.len()];
    let finest = SerializedCloud::new(voxels.to_vec(), offsets, &[Curve::Z], CurveDepth::PerScene);
    let mut cloud = finest.map_err(candle_core::Error::wrap)?;
    let pairs = match stem_size {
        1 => cloud.len(),
        size => cloud.kernel_map(size).map_err(candle_core::Error::wrap)?.num_pairs(),
    };
    let stem = pairs * in_channels * enc[0];
    let (mut scales, mut work) = (0, blocks(0, &cloud)?);
    for (stage, stride) in (1..).zip(stride) {
        let fine = cloud.len();
        cloud = cloud.pool(stride.trailing_zeros()).0;
        // Pooling, and both branches of the decoder.
        scales += fine * enc[stage - 1] * enc[stage];
        if let Some(&up) = dec.get(stage - 1) {
            let below = dec.get(stage).or(enc.last()).copied().unwrap_or(0);
            scales += cloud.len() * below * up + fine * enc[stage - 1] * up;
        }
        work += blocks(stage, &cloud)?;
    }
    Ok(MultiplyAdds { stem: stem as u64, rest: scales as u64 + work as u64 })
}
