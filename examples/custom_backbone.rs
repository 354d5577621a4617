//! A backbone of one's own: anything that maps voxels to rows. It trains like ours, and runs over
//! whole scenes.

use candle_core::{Result, Tensor};
use scenesplat::datasets::{InputFeatures, sample_rng};
use scenesplat::models::layers::Linear;
use scenesplat::models::{Forward, Head, ParamStore, PointCloud};
use scenesplat::prelude::*;
use scenesplat::rooms::{SyntheticRoomSettings, generate};

/// A linear layer on each voxel.
struct PerVoxel {
    linear: Linear,
}

impl Backbone for PerVoxel {
    fn forward(&self, points: &PointCloud, _: &mut Forward<'_>) -> Result<Tensor> {
        self.linear.forward(&points.feat)
    }
    fn out_channels(&self) -> usize {
        8
    }
}

fn main() -> anyhow::Result<()> {
    let input = InputFeatures::default();
    let store = ParamStore::trainable(0);
    let linear = Linear::new(input.width(), 8, true, store.builder())?;
    // Any head of ours stands behind it: here features of 16 numbers at unit length.
    let head = Head::Features { projection: Some(16) };
    let model = head.build(PerVoxel { linear }, store.builder())?;

    // One gradient, as training takes it.
    let feat = Tensor::ones((3, 11), candle_core::DType::F32, &candle_core::Device::Cpu)?;
    let points = PointCloud::single(vec![[0, 0, 0], [1, 0, 0], [5, 5, 5]], feat)?;
    let out = model.forward(&points, &mut Forward::train(&mut sample_rng(0, 0, 0)))?;
    let gradients = out.sum_all()?.backward()?;
    for (name, var) in store.parameters() {
        println!("{name}: gradient {:?}", gradients.get(&var).map(Tensor::shape));
    }

    // A whole scene, at voxels of 5 cm.
    let room = generate(&SyntheticRoomSettings::with_count(2000, 1))?;
    let network = Network::from_backbone(model, input, 0.05, NetworkOutput::Features)?;
    let features = SceneEncoder::new(&network).encode(&room.scene, &mut |_| Ok(()))?;
    println!("{} Gaussians, {} numbers each", features.len(), features.width());
    Ok(())
}
