//! What a pass of the network costs: memory, and multiply–adds on scenes as they are on average or on
//! given voxels.

use super::block::BlockShape;
use super::config::LitePtConfig;
use crate::BackboneCost;
use crate::multiply_adds::{BlockSize, MultiplyAdds, count};
use candle_core::Result;

/// Occupied voxels among the 5³ around one, on average.
const TAPS_5: f64 = 43.0;
/// Occupied voxels among the 3³ around one, on average over the scales.
const TAPS_3: f64 = 15.0;

impl LitePtConfig {
    /// Values of all parameters and buffers.
    pub(super) fn count_values(&self) -> usize {
        let linear = |i: usize, o: usize| i * o + o;
        let batch_norm = |c: usize| 4 * c + 1;
        let block = |shape: &BlockShape| {
            let c = shape.attention.channels;
            let hidden = shape.mlp_ratio * c;
            let entry = if shape.kind.has_convolution() { 28 * c * c + 4 * c } else { 2 * c };
            let attention = 4 * c + linear(c, 3 * c) + linear(c, c);
            let mlp = linear(c, hidden) + linear(hidden, c);
            entry + if shape.kind.has_attention() { attention + mlp } else { 0 }
        };
        let blocks = self.encoder_blocks().into_iter().chain(self.decoder_blocks());
        let mut sum: usize = blocks.flatten().map(|shape| block(&shape)).sum();
        let channels = &self.enc_channels;
        sum += 125 * self.in_channels * channels[0] + batch_norm(channels[0]);
        for (stage, &c) in channels.iter().enumerate().skip(1) {
            sum += linear(channels[stage - 1], c) + batch_norm(c);
        }
        for (stage, &c) in self.dec_channels.iter().enumerate() {
            sum += linear(self.channels_below(stage), c) + linear(channels[stage], c);
            sum += 2 * batch_norm(c);
        }
        sum
    }

    /// Voxels of a scale, in those of the input: on noisy surfaces at voxels of 2 cm the four scales
    /// below have 0.285, 0.055, 0.012 and 0.003.
    fn share(&self, scale: usize) -> f64 {
        self.stride[..scale].iter().map(|s| (*s as f64).powf(-2.1)).product()
    }

    /// Multiply–adds of each part and memory at the widest moment, per input voxel.
    pub(super) fn inference_cost(&self) -> BackboneCost {
        let block = |shape: &BlockShape| {
            let attended = shape.attention.patch_size as f64;
            let size = BlockSize { voxels: 1.0, pairs: TAPS_3, attended };
            block_work(shape, self.compute.fold, &size)
        };
        let product = |i: usize, o: usize| i as f64 * o as f64;
        let channels = &self.enc_channels;
        let stem = TAPS_5 * product(self.in_channels, channels[0]);
        let mut parts = vec![("embedding".to_owned(), stem)];
        for (stage, blocks) in self.encoder_blocks().iter().enumerate() {
            if stage > 0 {
                let work = product(channels[stage - 1], channels[stage]) * self.share(stage - 1);
                parts.push((format!("enc.enc{stage}.down"), work));
            }
            let works = blocks.iter().map(|shape| block(shape) * self.share(stage));
            parts.extend(works.enumerate().map(|(i, w)| (format!("enc.enc{stage}.block{i}"), w)));
        }
        for (stage, blocks) in self.decoder_blocks().iter().enumerate().rev() {
            let c = self.dec_channels[stage];
            let work = product(channels[stage], c) * self.share(stage)
                + product(self.channels_below(stage), c) * self.share(stage + 1);
            parts.push((format!("dec.dec{stage}.up"), work));
            let works = blocks.iter().map(|shape| block(shape) * self.share(stage));
            parts.extend(works.enumerate().map(|(i, w)| (format!("dec.dec{stage}.block{i}"), w)));
        }
        BackboneCost { bytes_per_voxel: self.bytes_per_voxel(), parts }
    }

    /// As [`Architecture::multiply_adds`](crate::Architecture::multiply_adds).
    pub(super) fn count_multiply_adds(
        &self,
        voxels: &[[i32; 3]],
        frozen: bool,
    ) -> Result<MultiplyAdds> {
        crate::Architecture::check(self)?;
        let folded = frozen && self.compute.fold;
        let (encoder, decoder) = (self.encoder_blocks(), self.decoder_blocks());
        let channels = [self.enc_channels.as_slice(), &self.dec_channels];
        count(voxels, (5, self.in_channels), &self.stride, channels, |stage, cloud| {
            let mut work = 0.0;
            for shape in encoder[stage].iter().chain(decoder.get(stage).into_iter().flatten()) {
                let size = BlockSize::count(cloud, shape.attention.patch_size)?;
                work += block_work(shape, folded, &size);
            }
            Ok(work)
        })
    }

    /// At the finest scale stand side by side: in the stem its input, its result and the pairs of a
    /// 5³ kernel map; later the skip rows, what each of the two branches of the decoder gives, their
    /// sum, and the pairs of a 3³ map. Blocks of the decoder keep as much as those branches.
    fn bytes_per_voxel(&self) -> usize {
        let wide = self.out_channels() as f64;
        let first = self.enc_channels[0] as f64;
        let pairs = |taps: f64| 8.0 * taps;
        let stem = 4.0 * (self.in_channels as f64 + 2.0 * first) + pairs(TAPS_5);
        let encoder = 4.0 * 4.0 * first + pairs(TAPS_3);
        let attending = if self.attends(0) { 4.0 * 6.0 * first.max(wide) } else { 0.0 };
        let decoder = 4.0 * (first + 3.0 * wide + self.share(1.min(self.stride.len())) * wide)
            + pairs(TAPS_3);
        let widest = stem.max(encoder).max(decoder).max(attending);
        ((widest + 200.0) * 1.1) as usize
    }
}

/// Multiply–adds of a block.
fn block_work(shape: &BlockShape, folded: bool, size: &BlockSize) -> f64 {
    let c = shape.attention.channels;
    let convolution = if shape.kind.has_convolution() { size.convolution(c, folded) } else { 0.0 };
    let attends = shape.kind.has_attention();
    convolution + if attends { size.attention(c, shape.mlp_ratio) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Architecture;

    #[test]
    fn small_networks_cost_an_eighth_of_a_megaflop_a_voxel() {
        let work = |config: LitePtConfig| config.cost().work_per_voxel();
        // Counted from the tables of a room of 100,000 voxels: 55 GFLOP, two for a multiply–add,
        // without folding.
        for (config, gflop) in [
            (LitePtConfig::small(), 55.0),
            (LitePtConfig::small_with_decoder(), 111.0),
            (LitePtConfig::base(), 198.0),
            (LitePtConfig::large(), 340.0),
        ] {
            let compute = crate::Compute::EXACT;
            let found = 2.0 * work(LitePtConfig { compute, ..config }) * 1e5 / 1e9;
            assert!((found / gflop - 1.0).abs() < 0.1, "{found} of {gflop} GFLOP");
        }
    }
}
