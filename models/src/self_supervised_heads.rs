//! What stands behind a backbone while it learns from scenes without labels.
//!
//! # Source
//! `DINOHead` and the `mae_head` of SceneSplat be9d5e1, whose names of parameters these are. There no
//! optimizer sees them: the heads keep their first values. Here they are parameters like all others.

use crate::layers::{LayerNorm, Linear};
use crate::{Compute, ops};
use candle_core::{Result, Tensor};
use candle_nn::{Init, VarBuilder};

/// Norms below this count as this, as in the original.
const EPS: f64 = 1e-4;
/// Width inside of a [`ReconstructionHead`].
const HIDDEN: usize = 32;

/// Widths of a [`ProjectionHead`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProjectionShape {
    /// Of the rows that come in.
    pub channels: usize,
    /// Of both layers between.
    pub hidden: usize,
    /// Of the rows of unit length that come out.
    pub out: usize,
}

/// Three linear layers with exact GELUs between; rows of unit length.
///
/// The original has 512 → 2048 → 2048 → 256 for a vector of a scene, and 64 → 256 → 256 → 32 for masked
/// Gaussians.
#[derive(Debug, Clone)]
pub struct ProjectionHead {
    layers: [Linear; 3],
}

impl ProjectionHead {
    /// Parameters `mlp.0`, `mlp.2`, `mlp.4`: weights normal with σ = 0.02, biases 0.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(shape: ProjectionShape, compute: Compute, vb: &VarBuilder<'_>) -> Result<Self> {
        let init = Init::Randn { mean: 0.0, stdev: 0.02 };
        let layer = |name: &str, cin: usize, cout: usize| -> Result<Linear> {
            let vb = vb.pp(name);
            let weight = vb.get_with_hints((cout, cin), "weight", init)?;
            let bias = vb.get_with_hints(cout, "bias", Init::Const(0.0))?;
            Linear::of(compute, weight, Some(bias))
        };
        let ProjectionShape { channels, hidden, out } = shape;
        Ok(Self {
            layers: [
                layer("mlp.0", channels, hidden)?,
                layer("mlp.2", hidden, hidden)?,
                layer("mlp.4", hidden, out)?,
            ],
        })
    }

    /// `x / max(‖x‖, 1e-4)` of what the layers make of rows. `[N, C] → [N, out]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let [first, second, last] = &self.layers;
        let x = second.forward_gelu(&first.forward_gelu(x, None)?, None)?;
        ops::l2_normalize_above(&last.forward(&x)?, EPS)
    }
}

/// Similarities with prototypes: a [`ProjectionHead`], and rows of unit length that its rows are
/// compared with.
#[derive(Debug, Clone)]
pub struct PrototypeHead {
    projection: ProjectionHead,
    /// Brought to unit length at each pass: only their direction is learned. `[K, out]`
    prototypes: Tensor,
}

impl PrototypeHead {
    /// Parameters of the projection, and `prototypes.weight`: normal with σ = 0.02.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    ///
    /// # Source
    /// The heads of Sonata (Pointcept d74c646), whose prototypes are weight-normalized with a fixed
    /// length. Differs: three linear layers, where Sonata has two.
    pub fn new(
        shape: ProjectionShape,
        prototypes: usize,
        compute: Compute,
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let init = Init::Randn { mean: 0.0, stdev: 0.02 };
        let weight = vb.pp("prototypes").get_with_hints((prototypes, shape.out), "weight", init)?;
        Ok(Self { projection: ProjectionHead::new(shape, compute, vb)?, prototypes: weight })
    }

    /// Cosines with each prototype, not yet divided by a temperature. `[N, C] → [N, K]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let rows = self.projection.forward(x)?;
        let prototypes = ops::l2_normalize_above(&self.prototypes, EPS)?;
        ops::linear(&rows, &prototypes, None)
    }
}

/// Attributes of a masked Gaussian from its row: linear to 32, layer norm, ReLU, linear.
#[derive(Debug, Clone)]
pub struct ReconstructionHead {
    first: Linear,
    norm: LayerNorm,
    last: Linear,
}

impl ReconstructionHead {
    /// Parameters `0`, `1`, `3`: weights normal with σ² = 2 ÷ rows of the weight, biases uniform in
    /// ±1/√(columns).
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(channels: usize, out: usize, compute: Compute, vb: &VarBuilder<'_>) -> Result<Self> {
        Self::with_hidden(channels, HIDDEN, out, compute, vb)
    }

    /// As [`new`](Self::new), with another width inside.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn with_hidden(
        channels: usize,
        hidden: usize,
        out: usize,
        compute: Compute,
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let layer = |name: &str, cin: usize, cout: usize| -> Result<Linear> {
            let (vb, bound) = (vb.pp(name), 1.0 / (cin as f64).sqrt());
            let normal = Init::Randn { mean: 0.0, stdev: (2.0 / cout as f64).sqrt() };
            let weight = vb.get_with_hints((cout, cin), "weight", normal)?;
            let uniform = Init::Uniform { lo: -bound, up: bound };
            let bias = vb.get_with_hints(cout, "bias", uniform)?;
            Linear::of(compute, weight, Some(bias))
        };
        Ok(Self {
            first: layer("0", channels, hidden)?,
            norm: LayerNorm::new(hidden, vb.pp("1"))?,
            last: layer("3", hidden, out)?,
        })
    }

    /// `[N, C] → [N, out]`, in the scale of the network's inputs.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.last.forward(&self.norm.forward(&self.first.forward(x)?)?.relu()?)
    }
}

/// What an attribute's last layer goes through, so that the result is in the attribute's range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttributeRange {
    /// Any number.
    Any,
    /// −1 to 1: hyperbolic tangent.
    Signed,
    /// 0 to 1: logistic function.
    Unit,
    /// Rows of unit length; a zero row stays zero.
    Direction,
}

/// Attributes of a masked Gaussian, each from three linear layers of its own with exact GELUs between, and an activation
/// that brings it into its range.
///
/// # Source
/// What the paper of SceneSplat says of its masked Gaussian modeling; its code has a [`ReconstructionHead`]. Width inside
/// is that head's.
#[derive(Debug, Clone)]
pub struct AttributeHeads(Vec<AttributeHead>);

#[derive(Debug, Clone)]
struct AttributeHead {
    layers: [Linear; 3],
    range: AttributeRange,
}

impl AttributeHeads {
    /// For each attribute its name, width and range, in the order of the columns. Parameters `NAME.0`, `NAME.2`, `NAME.4`,
    /// with PyTorch's first values.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new<'a>(
        channels: usize,
        attributes: impl IntoIterator<Item = (&'a str, usize, AttributeRange)>,
        compute: Compute,
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let head = |(name, out, range): (&str, usize, AttributeRange)| -> Result<AttributeHead> {
            let vb = vb.pp(name);
            let layer = |at: &str, cin, cout| Linear::with(compute, cin, cout, true, vb.pp(at));
            let layers = [
                layer("0", channels, HIDDEN)?,
                layer("2", HIDDEN, HIDDEN)?,
                layer("4", HIDDEN, out)?,
            ];
            Ok(AttributeHead { layers, range })
        };
        attributes.into_iter().map(head).collect::<Result<_>>().map(Self)
    }

    /// `[N, C] → [N, out]`, the attributes side by side.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let each = |head: &AttributeHead| {
            let [first, second, last] = &head.layers;
            let x = second.forward_gelu(&first.forward_gelu(x, None)?, None)?;
            let x = last.forward(&x)?;
            match head.range {
                AttributeRange::Any => Ok(x),
                AttributeRange::Signed => x.tanh(),
                AttributeRange::Unit => candle_nn::ops::sigmoid(&x),
                AttributeRange::Direction => ops::l2_normalize_above(&x, EPS),
            }
        };
        let all: Vec<Tensor> = self.0.iter().map(each).collect::<Result<_>>()?;
        Tensor::cat(&all, 1)
    }
}
