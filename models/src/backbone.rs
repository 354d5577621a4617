//! The interface of a network.

use crate::Compute;
use crate::point_cloud::PointCloud;
use crate::recompute::Recompute;
use crate::{LevelOptions, Levels};
use candle_core::{Result, Tensor, TensorId, Var, bail};
use rand_chacha::ChaCha8Rng;
use std::collections::HashSet;
use std::sync::Arc;

/// Whether drop path and batch statistics are on. An argument, never hidden state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Random layers on, statistics from the batch.
    Train,
    /// Deterministic.
    Eval,
}

/// Whether the curve orders are shuffled at the input and after each pooling.
///
/// The original shuffles always, in inference too; there it is off here unless asked for.
#[derive(Debug, Clone, Default)]
pub enum Orders {
    /// As listed in the configuration.
    #[default]
    Listed,
    /// A new random permutation at each scale, from the generator of [`Forward`].
    Shuffled,
    /// Given permutations, one a scale: the new order `i` is the old order `permutation[i]`.
    Given(Vec<Vec<usize>>),
}

/// Batch statistics that neither move nor come from the batch, though the rest of the network
/// trains: those of frozen layers.
#[derive(Debug, Clone, Default)]
pub struct FrozenStatistics(Arc<HashSet<TensorId>>);

impl FrozenStatistics {
    /// Of the given buffers, see [`ParamStore::buffers`](crate::ParamStore::buffers).
    pub fn new<'a>(buffers: impl IntoIterator<Item = &'a Var>) -> Self {
        Self(Arc::new(buffers.into_iter().map(|var| var.id()).collect()))
    }

    /// Whether a buffer is one of them.
    pub fn contains(&self, buffer: &Var) -> bool {
        self.0.contains(&buffer.id())
    }
}

/// Called with the name of a finished part and the features there: for progress, inspection and
/// tests. An error stops the pass.
pub type Observer<'a> = dyn FnMut(&str, &Tensor) -> Result<()> + 'a;

/// What a forward pass needs besides its input.
pub struct Forward<'a> {
    /// Train or eval.
    pub mode: Mode,
    /// Randomness of drop path and order shuffling (candle's CPU generator has no seed).
    pub rng: &'a mut ChaCha8Rng,
    /// Order shuffling.
    pub orders: Orders,
    /// Sees features on their way, with rows in the order of the network's inside.
    pub observer: Option<&'a mut Observer<'a>>,
    /// Keeps the inputs of blocks only and computes the rest again in the backward pass.
    pub recompute: Option<Recompute>,
    /// Batch norms that use their remembered statistics in training too.
    pub frozen: FrozenStatistics,
}

impl<'a> Forward<'a> {
    /// Deterministic, orders as listed.
    pub fn eval(rng: &'a mut ChaCha8Rng) -> Self {
        Self { mode: Mode::Eval, orders: Orders::Listed, ..Self::train(rng) }
    }

    /// Training, with shuffled orders.
    pub fn train(rng: &'a mut ChaCha8Rng) -> Self {
        Self {
            mode: Mode::Train,
            rng,
            orders: Orders::Shuffled,
            observer: None,
            recompute: None,
            frozen: FrozenStatistics::default(),
        }
    }

    pub(crate) fn observe(&mut self, name: &str, feat: &Tensor) -> Result<()> {
        match &mut self.observer {
            Some(observer) => observer(name, feat),
            None => Ok(()),
        }
    }
}

/// What inference with a backbone costs, by its shape alone.
#[derive(Debug, Clone, PartialEq)]
pub struct BackboneCost {
    /// Bytes of memory per input voxel, at the widest moment.
    pub bytes_per_voxel: usize,
    /// Multiply–adds per input voxel of each part, in the order in which they run, by the names that
    /// an [`Observer`] hears when they are done. They need not be all of the network.
    pub parts: Vec<(String, f64)>,
}

impl BackboneCost {
    /// Multiply–adds per input voxel of all parts.
    pub fn work_per_voxel(&self) -> f64 {
        self.parts.iter().map(|(_, work)| work).sum()
    }
}

/// A network after calibration on an example of its input.
pub struct Calibrated {
    /// The network, to run instead of the one that was asked.
    pub backbone: Box<dyn Backbone>,
    /// Calibrated layers, with the part of their variance on the example that they keep, 0..=1.
    pub kept: Vec<(String, f64)>,
}

impl std::fmt::Debug for Calibrated {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Calibrated").field("kept", &self.kept).finish_non_exhaustive()
    }
}

/// Maps a batch of voxels to features of the same voxels.
///
/// Training needs the first two methods alone. The others are for whole scenes: where tiles may begin,
/// how far the work has come, how much memory it takes. An implementation that wraps another network must
/// forward them all; `#[deny(clippy::missing_trait_methods)]` on it makes that an error of clippy.
pub trait Backbone: Send + Sync {
    /// Features of every input row. `[N, out_channels]`
    ///
    /// # Errors
    /// If the input does not fit the network.
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor>;
    /// Width of the output.
    fn out_channels(&self) -> usize;
    /// Rows of every scale, with rows hidden from the network: what self-supervised training and
    /// probes read.
    ///
    /// # Errors
    /// If the input does not fit the network, it has no mask token for a mask, or does not give its
    /// scales.
    fn forward_levels(
        &self,
        points: &PointCloud,
        options: LevelOptions<'_>,
        cx: &mut Forward<'_>,
    ) -> Result<Levels> {
        _ = (points, options, cx);
        bail!("this architecture does not give the rows of its scales; point_transformer_v3 does")
    }
    /// Edge of the coarsest cells in voxels: a tile that begins at a multiple of it falls into the
    /// same cells as the whole scene. 1 for a network with one scale.
    fn alignment(&self) -> u32 {
        1
    }
    /// What inference costs; `None` if the network does not know.
    fn cost(&self) -> Option<BackboneCost> {
        None
    }
    /// Most voxels of a forward pass, where something limits them: the arrays of a graphics processor. Larger scenes are
    /// computed in tiles.
    fn most_voxels(&self) -> Option<usize> {
        None
    }
    /// How it computes; a head behind it does the same.
    fn compute(&self) -> Compute {
        Compute::default()
    }
    /// Whether it cannot run before it is [`calibrated`](Self::calibrated).
    fn needs_example(&self) -> bool {
        false
    }
    /// The network with all that an example decides; `None` where there is nothing to decide. Equal
    /// examples give equal networks.
    ///
    /// # Errors
    /// If the example does not fit the network.
    fn calibrated(&self, example: &PointCloud) -> Result<Option<Calibrated>> {
        _ = example;
        Ok(None)
    }
}

#[deny(clippy::missing_trait_methods, reason = "a default would hide the boxed network's answer")]
impl<B: Backbone + ?Sized> Backbone for Box<B> {
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        (**self).forward(points, cx)
    }
    fn forward_levels(
        &self,
        points: &PointCloud,
        options: LevelOptions<'_>,
        cx: &mut Forward<'_>,
    ) -> Result<Levels> {
        (**self).forward_levels(points, options, cx)
    }
    fn out_channels(&self) -> usize {
        (**self).out_channels()
    }
    fn alignment(&self) -> u32 {
        (**self).alignment()
    }
    fn cost(&self) -> Option<BackboneCost> {
        (**self).cost()
    }
    fn most_voxels(&self) -> Option<usize> {
        (**self).most_voxels()
    }
    fn compute(&self) -> Compute {
        (**self).compute()
    }
    fn needs_example(&self) -> bool {
        (**self).needs_example()
    }
    fn calibrated(&self, example: &PointCloud) -> Result<Option<Calibrated>> {
        (**self).calibrated(example)
    }
}
