//! One step of training the segmentation network. Criterion's benchmark includes this file too.

use candle_core::{Result, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat_losses::{CrossEntropy, LossInput, LovaszSoftmax, Objective};
use scenesplat_models::{Backbone, Forward, ModelConfig, ParamStore, PointCloud, Recompute};
use scenesplat_trainers::{AdamW, AdamWConfig, Optimizer, StepHyperparameters, group_by_keyword};

/// The network with its optimizer, voxels and labels.
pub struct TrainStep {
    network: Box<dyn Backbone>,
    optimizer: AdamW,
    objective: Objective,
    points: PointCloud,
    labels: Vec<i32>,
    recompute: Option<Recompute>,
    rng: ChaCha8Rng,
    stem: Var,
    first_gradient: Vec<f32>,
}

impl TrainStep {
    /// Labels are bands of height, so that there is something to learn. With `recompute`, blocks keep
    /// their input only.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn new(config: &ModelConfig, points: PointCloud, recompute: bool) -> Result<Self> {
        let store = ParamStore::trainable(0);
        let network = config.build(store.builder())?;
        let parameters = store.parameters();
        let Some(stem) = parameters.get("embedding.stem.conv.weight").cloned() else {
            candle_core::bail!("the network has no stem");
        };
        let groups = group_by_keyword(&parameters, 6e-4, 0.05, &[]);
        let optimizer =
            AdamW::new(groups, AdamWConfig::default()).map_err(candle_core::Error::wrap)?;
        let classes = network.out_channels() as i32;
        let top = points.grid_coord.iter().map(|c| c[2] + 1).max().unwrap_or(1);
        let labels = points.grid_coord.iter().map(|c| c[2] * classes / top).collect();
        let objective =
            Objective::new().with(1.0, CrossEntropy::default()).with(1.0, LovaszSoftmax);
        let recompute = recompute.then(|| Recompute::new(parameters));
        let (rng, first_gradient) = (ChaCha8Rng::seed_from_u64(0), Vec::new());
        Ok(Self {
            network,
            optimizer,
            objective,
            points,
            labels,
            recompute,
            rng,
            stem,
            first_gradient,
        })
    }

    /// The gradient of the first convolution in the first step, `[out, taps · in]`: it has come
    /// through the whole network. Empty before that step.
    pub fn first_gradient(&self) -> &[f32] {
        &self.first_gradient
    }

    /// Forward, cross entropy and Lovász softmax, backward, AdamW. Gives the loss.
    ///
    /// # Errors
    /// If a loss or gradient is not finite.
    pub fn run(&mut self) -> Result<f32> {
        let mut cx = Forward::train(&mut self.rng);
        cx.recompute.clone_from(&self.recompute);
        let logits = self.network.forward(&self.points, &mut cx)?;
        let input = LossInput {
            pred: &logits,
            target: None,
            label: Some(&self.labels),
            valid: None,
            progress: 0.0,
            seed: 0,
        };
        let loss = self.objective.forward(&input)?.total;
        drop(logits);
        let mut grads = loss.backward()?;
        if let Some(recompute) = &self.recompute {
            recompute.drain_into(&mut grads)?;
        }
        if let (true, Some(found)) = (self.first_gradient.is_empty(), grads.get(&self.stem)) {
            self.first_gradient = found.flatten_all()?.to_vec1()?;
        }
        self.optimizer
            .step(&grads, &StepHyperparameters::default())
            .map_err(candle_core::Error::wrap)?;
        loss.to_scalar::<f32>()
    }
}
