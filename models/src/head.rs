//! Makes features or classes of a backbone's output.

use crate::{
    Backbone, BackboneCost, Calibrated, Compute, Forward, LevelOptions, Levels, PointCloud,
    layers::Linear, ops,
};
use candle_core::{Result, Tensor, bail};
use candle_nn::VarBuilder;

/// The most classes, or features of a projection.
const MAX_WIDTH: usize = 1 << 16;

/// What stands behind a backbone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Head {
    /// Features at unit length, the language embedding; a zero row stays zero.
    Features {
        /// Width of a linear layer (`projection`), which gives a narrow network wide features; none in the
        /// original.
        projection: Option<usize>,
    },
    /// Logits of so many classes, from a linear layer (`seg_head`).
    Classes(usize),
}

impl Head {
    /// Name of its linear layer, as parameters and observers know it, and its width.
    pub(crate) fn linear(self) -> Option<(&'static str, usize)> {
        match self {
            Self::Features { projection } => projection.map(|n| ("projection", n)),
            Self::Classes(classes) => Some(("seg_head", classes)),
        }
    }

    /// Puts the head behind a backbone.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn build(
        self,
        backbone: impl Backbone + 'static,
        vb: VarBuilder<'_>,
    ) -> Result<Box<dyn Backbone>> {
        let (compute, width) = (backbone.compute(), backbone.out_channels());
        let linear = |(name, wide)| Linear::with(compute, width, wide, true, vb.pp(name));
        let linear = self.linear().map(linear).transpose()?;
        Ok(Box::new(WithHead { backbone: Box::new(backbone), head: self, linear }))
    }

    /// Width of the result, behind a backbone of this width.
    pub fn out_channels(self, backbone: usize) -> usize {
        self.linear().map_or(backbone, |(_, width)| width)
    }

    /// Values of its parameters, behind a backbone of this width.
    pub fn num_values(self, backbone: usize) -> usize {
        self.linear().map_or(0, |(_, n)| backbone.saturating_mul(n).saturating_add(n))
    }

    /// What a network costs with it, behind a backbone of this width and cost: the product of its
    /// linear layer, and its results beside what they are made from.
    pub fn cost(self, mut backbone: BackboneCost, width: usize) -> BackboneCost {
        let Some((name, wide)) = self.linear() else { return backbone };
        let bytes = (width + wide) * size_of::<f32>() * 11 / 10;
        backbone.bytes_per_voxel = backbone.bytes_per_voxel.max(bytes);
        backbone.parts.push((name.to_owned(), width as f64 * wide as f64));
        backbone
    }

    /// Checks its widths.
    ///
    /// # Errors
    /// Names the field that is 0 or too large.
    pub fn check(self) -> Result<()> {
        let (field, width) = match self {
            Self::Features { projection: None } => return Ok(()),
            Self::Features { projection: Some(n) } => ("projection", n),
            Self::Classes(n) => ("num_classes", n),
        };
        if !(1..=MAX_WIDTH).contains(&width) {
            bail!("{field}: {width} is not in 1 to {MAX_WIDTH}");
        }
        Ok(())
    }
}

/// A backbone with a head.
struct WithHead {
    backbone: Box<dyn Backbone>,
    head: Head,
    linear: Option<Linear>,
}

#[deny(clippy::missing_trait_methods, reason = "a default would hide the backbone's answer")]
impl Backbone for WithHead {
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        let feat = self.backbone.forward(points, cx)?;
        let (Some(linear), Some((name, _))) = (&self.linear, self.head.linear()) else {
            return ops::l2_normalize(&feat);
        };
        let out = match self.head {
            Head::Features { .. } => linear.forward_unit(&feat)?,
            Head::Classes(_) => linear.forward(&feat)?,
        };
        cx.observe(name, &out)?;
        Ok(out)
    }
    fn forward_levels(
        &self,
        points: &PointCloud,
        options: LevelOptions<'_>,
        cx: &mut Forward<'_>,
    ) -> Result<Levels> {
        self.backbone.forward_levels(points, options, cx)
    }
    fn out_channels(&self) -> usize {
        self.head.out_channels(self.backbone.out_channels())
    }
    fn alignment(&self) -> u32 {
        self.backbone.alignment()
    }
    fn cost(&self) -> Option<BackboneCost> {
        Some(self.head.cost(self.backbone.cost()?, self.backbone.out_channels()))
    }
    fn most_voxels(&self) -> Option<usize> {
        self.backbone.most_voxels()
    }
    fn compute(&self) -> Compute {
        self.backbone.compute()
    }
    fn needs_example(&self) -> bool {
        self.backbone.needs_example()
    }
    fn calibrated(&self, example: &PointCloud) -> Result<Option<Calibrated>> {
        let Some(Calibrated { backbone, kept }) = self.backbone.calibrated(example)? else {
            return Ok(None);
        };
        let (head, linear) = (self.head, self.linear.clone());
        Ok(Some(Calibrated { backbone: Box::new(Self { backbone, head, linear }), kept }))
    }
}
