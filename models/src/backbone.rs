//! What a network is to its users, and the networks with their heads.

use crate::point_cloud::PointCloud;
use crate::point_transformer_v3::{PointTransformerV3, PointTransformerV3Config};
use crate::recompute::Recompute;
use crate::{layers::Linear, ops};
use candle_core::{Result, Tensor, TensorId, Var, bail};
use candle_nn::VarBuilder;
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

/// Maps a batch of voxels to features of the same voxels.
pub trait Backbone: Send + Sync {
    /// Features of every input row. `[N, out_channels]`
    ///
    /// # Errors
    /// If the input does not fit the network.
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor>;
    /// Width of the output.
    fn out_channels(&self) -> usize;
}

/// A backbone whose last features, at unit length, are the language embedding.
pub struct LanguageModel {
    backbone: PointTransformerV3,
    /// To the width of the texts, where the backbone is narrower.
    projection: Option<Linear>,
    width: usize,
}

impl LanguageModel {
    /// Builds the network; parameters have the backbone's names, those of a projection are
    /// `projection.*`.
    ///
    /// # Errors
    /// If the configuration has a segmentation head, or parameters exist with another shape.
    pub fn new(config: &PointTransformerV3Config, vb: VarBuilder<'_>) -> Result<Self> {
        if config.num_classes.is_some() {
            bail!("num_classes: a language network has no classifier; build a SemanticSegmenter");
        }
        let backbone = PointTransformerV3::new(config, vb.clone())?;
        let (narrow, vb) = (backbone.out_channels(), vb.pp("projection"));
        let wide = |n| Linear::with(config.compute, narrow, n, true, vb);
        let projection = config.projection.map(wide).transpose()?;
        Ok(Self { width: config.projection.unwrap_or(narrow), backbone, projection })
    }
}

impl Backbone for LanguageModel {
    /// Unit rows, except that a zero row stays zero.
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        let mut feat = self.backbone.forward(points, cx)?;
        if let Some(projection) = &self.projection {
            feat = projection.forward(&feat)?;
        }
        ops::l2_normalize(&feat)
    }
    fn out_channels(&self) -> usize {
        self.width
    }
}

/// A backbone with a linear classifier.
pub struct SemanticSegmenter {
    backbone: PointTransformerV3,
    head: Linear,
    num_classes: usize,
}

impl SemanticSegmenter {
    /// Builds the network; the classifier's parameters are `seg_head.*`.
    ///
    /// # Errors
    /// If the configuration names no number of classes, or parameters exist with another shape.
    pub fn new(config: &PointTransformerV3Config, vb: VarBuilder<'_>) -> Result<Self> {
        let Some(num_classes) = config.num_classes else {
            bail!("segmentation needs num_classes in the configuration");
        };
        let backbone = PointTransformerV3::new(config, vb.clone())?;
        let head = Linear::with(
            config.compute,
            backbone.out_channels(),
            num_classes,
            true,
            vb.pp("seg_head"),
        )?;
        Ok(Self { backbone, head, num_classes })
    }
}

impl Backbone for SemanticSegmenter {
    /// Class logits.
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        self.head.forward(&self.backbone.forward(points, cx)?)
    }
    fn out_channels(&self) -> usize {
        self.num_classes
    }
}
