//! A backbone of one's own: anything that maps voxels to rows.

use candle_core::{Device, Result, Tensor};
use rand::SeedableRng;
use scenesplat::models::layers::Linear;
use scenesplat::models::{Forward, ParamStore, PointCloud, ops};
use scenesplat::prelude::*;

/// A linear layer on each voxel.
struct PerVoxel {
    linear: Linear,
}

impl Backbone for PerVoxel {
    fn forward(&self, points: &PointCloud, _: &mut Forward<'_>) -> Result<Tensor> {
        ops::l2_normalize(&self.linear.forward(&points.feat)?)
    }
    fn out_channels(&self) -> usize {
        8
    }
}

fn main() -> anyhow::Result<()> {
    let store = ParamStore::trainable(0);
    let backbone = PerVoxel { linear: Linear::new(11, 8, true, store.builder())? };
    let feat = Tensor::ones((3, 11), candle_core::DType::F32, &Device::Cpu)?;
    let points = PointCloud::single(vec![[0, 0, 0], [1, 0, 0], [5, 5, 5]], feat)?;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(0);
    let out = backbone.forward(&points, &mut Forward::train(&mut rng))?;
    let gradients = out.sum_all()?.backward()?;
    for (name, var) in store.parameters() {
        println!("{name}: gradient {:?}", gradients.get(&var).map(Tensor::shape));
    }
    Ok(())
}
