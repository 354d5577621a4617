//! Operations of a network on given voxels.

use anyhow::Result;
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
/// for none. `frozen`: as inference joins layers.
///
/// # Errors
/// If the voxels are out of range.
pub(super) fn count(
    config: &PointTransformerV3Config,
    head: usize,
    voxels: &[[i32; 3]],
    frozen: bool,
) -> Result<Flop> {
    let found = config.multiply_adds(voxels, frozen)?;
    let head = (voxels.len() * config.out_channels() * head) as u64;
    Ok(Flop { stem: 2 * found.stem, rest: 2 * (found.rest + head) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_multiply_add_is_two_and_training_three_times_that() {
        let config = PointTransformerV3Config::tiny();
        let voxels = [[0, 0, 0], [0, 0, 1]];
        let found = config.multiply_adds(&voxels, false).unwrap();
        let with_head = count(&config, 5, &voxels, false).unwrap();
        assert_eq!(with_head.rest, 2 * (found.rest + 2 * config.out_channels() as u64 * 5));
        assert_eq!(with_head.forward(), 2 * found.stem + with_head.rest);
        assert_eq!(with_head.train(), 2 * (2 * found.stem) + 3 * with_head.rest);
    }
}
