//! One step of training the segmentation network. Criterion's benchmark includes this file too.

use candle_core::{D, Device, Result, Tensor, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat_models::{
    Backbone, Forward, ParamStore, PointCloud, PointTransformerV3Config, SemanticSegmenter,
};
use scenesplat_trainers::{AdamW, AdamWConfig, Controls, Optimizer, group_by_keyword};

/// The network with its optimizer, voxels and labels.
pub struct TrainStep {
    network: SemanticSegmenter,
    optimizer: AdamW,
    points: PointCloud,
    labels: Tensor,
    rng: ChaCha8Rng,
    stem: Var,
    first_gradient: Vec<f32>,
}

impl TrainStep {
    /// Labels are bands of height, so that there is something to learn.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn new(config: &PointTransformerV3Config, points: PointCloud) -> Result<Self> {
        let store = ParamStore::trainable(0);
        let network = SemanticSegmenter::new(config, store.builder())?;
        let parameters = store.parameters();
        let Some(stem) = parameters.get("embedding.stem.conv.weight").cloned() else {
            candle_core::bail!("the network has no stem");
        };
        let groups = group_by_keyword(&parameters, 6e-4, 0.05, &[]);
        let optimizer =
            AdamW::new(groups, AdamWConfig::default()).map_err(candle_core::Error::wrap)?;
        let classes = network.out_channels() as u32;
        let top = points.grid_coord.iter().map(|c| c[2] as u32 + 1).max().unwrap_or(1);
        let labels: Vec<u32> =
            points.grid_coord.iter().map(|c| c[2] as u32 * classes / top).collect();
        let labels = Tensor::from_vec(labels, (points.grid_coord.len(), 1), &Device::Cpu)?;
        let (rng, first_gradient) = (ChaCha8Rng::seed_from_u64(0), Vec::new());
        Ok(Self { network, optimizer, points, labels, rng, stem, first_gradient })
    }

    /// The gradient of the first convolution in the first step, `[out, taps · in]`: it has come
    /// through the whole network. Empty before that step.
    pub fn first_gradient(&self) -> &[f32] {
        &self.first_gradient
    }

    /// Forward, cross entropy, backward, AdamW. Gives the loss.
    ///
    /// # Errors
    /// If a loss or gradient is not finite.
    pub fn run(&mut self) -> Result<f32> {
        let logits = self.network.forward(&self.points, &mut Forward::train(&mut self.rng))?;
        let top = logits.max_keepdim(D::Minus1)?.detach();
        let shifted = logits.broadcast_sub(&top)?;
        let total = shifted.exp()?.sum_keepdim(D::Minus1)?.log()?;
        let loss = (total - shifted.gather(&self.labels, D::Minus1)?)?.mean_all()?;
        let grads = loss.backward()?;
        if let (true, Some(found)) = (self.first_gradient.is_empty(), grads.get(&self.stem)) {
            self.first_gradient = found.flatten_all()?.to_vec1()?;
        }
        self.optimizer.step(&grads, &Controls::default()).map_err(candle_core::Error::wrap)?;
        loss.to_scalar::<f32>()
    }
}
