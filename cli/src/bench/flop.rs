//! Operations of a network on given voxels.

use anyhow::Result;
use scenesplat::models::{Head, ModelConfig};

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
    let found = model.backbone.get().multiply_adds(voxels, frozen)?;
    let width = match model.head {
        Head::Classes(width) | Head::Features { projection: Some(width) } => width,
        Head::Features { projection: None } => 0,
    };
    let head = (voxels.len() * model.backbone.get().out_channels() * width) as u64;
    Ok(Flop { stem: 2 * found.stem, rest: 2 * (found.rest + head) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat::models::litept::BlockKind;
    use scenesplat::models::{LitePtConfig, PointTransformerV3Config};

    #[test]
    fn one_voxel_by_hand() {
        let config =
            PointTransformerV3Config { in_channels: 3, ..PointTransformerV3Config::tiny() }
                .with_stages(&[[1, 4, 1], [2, 8, 1]], &[[1, 6, 1]], 16);
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
    fn litept_takes_a_hundredth_of_the_language_network() {
        let voxels = scenesplat::kernels::bench_room::voxels(100_000);
        let lite = ModelConfig::new(LitePtConfig::small()).with_projection(768);
        let gflop = |model: &ModelConfig, frozen: bool| {
            count(model, &voxels, frozen).unwrap().forward() as f64 / 1e9
        };
        let [lite, joined] = [false, true].map(|frozen| gflop(&lite, frozen));
        let language = gflop(&ModelConfig::language(), false);
        println!("LitePT-S {lite:.1}, joined {joined:.1}, language network {language:.0} GFLOP");
        assert!((50.0..75.0).contains(&lite) && joined < lite, "{lite} {joined}");
        assert!(language > 100.0 * lite, "{language}");
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
