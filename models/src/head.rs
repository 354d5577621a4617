//! What makes features or classes of a backbone's output.

use crate::{
    Backbone, BackboneCost, Calibrated, Compute, Forward, LevelOptions, Levels, PointCloud,
    layers::Linear, ops,
};
use candle_core::{Result, Tensor, bail};
use candle_nn::VarBuilder;

/// The most classes, or features of a projection.
const MAX_WIDTH: usize = 1 << 16;

/// Names of the linear layers, as parameters and observers know them.
const PROJECTION: &str = "projection";
const CLASSIFIER: &str = "seg_head";

/// What stands behind a backbone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Head {
    /// Features at unit length: a [`LanguageModel`].
    Features {
        /// Width that a linear layer brings them to, so that a narrow network can have wide
        /// features; none in the original.
        projection: Option<usize>,
    },
    /// Logits of so many classes: a [`SemanticSegmenter`].
    Classes(usize),
}

impl Head {
    /// Puts the head behind a backbone.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn build(
        self,
        backbone: impl Backbone + 'static,
        vb: VarBuilder<'_>,
    ) -> Result<Box<dyn Backbone>> {
        Ok(match self {
            Self::Features { projection } => {
                Box::new(LanguageModel::new(backbone, projection, vb)?)
            }
            Self::Classes(classes) => Box::new(SemanticSegmenter::new(backbone, classes, vb)?),
        })
    }

    /// Width of what comes out, behind a backbone of this width.
    pub fn out_channels(self, backbone: usize) -> usize {
        match self {
            Self::Features { projection } => projection.unwrap_or(backbone),
            Self::Classes(classes) => classes,
        }
    }

    /// Values of its parameters, behind a backbone of this width.
    pub fn num_values(self, backbone: usize) -> usize {
        match self {
            Self::Features { projection: None } => 0,
            Self::Features { projection: Some(n) } | Self::Classes(n) => {
                backbone.saturating_mul(n).saturating_add(n)
            }
        }
    }

    /// What a network costs with it, behind a backbone of this width and cost: the product of its
    /// linear layer, and its results beside what they are made from.
    pub fn cost(self, mut backbone: BackboneCost, width: usize) -> BackboneCost {
        let (name, wide) = match self {
            Self::Features { projection: None } => return backbone,
            Self::Features { projection: Some(n) } => (PROJECTION, n),
            Self::Classes(n) => (CLASSIFIER, n),
        };
        let bytes = (width + wide) * size_of::<f32>() * 11 / 10;
        backbone.bytes_per_voxel = backbone.bytes_per_voxel.max(bytes);
        backbone.parts.push((name.to_owned(), width as f64 * wide as f64));
        backbone
    }

    /// Checks its widths.
    ///
    /// # Errors
    /// Names the field that is 0 or beyond any use.
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

/// A backbone whose features, at unit length, are the language embedding.
pub struct LanguageModel {
    backbone: Box<dyn Backbone>,
    /// To the width of the texts, where the backbone is narrower.
    projection: Option<Linear>,
    width: usize,
}

impl LanguageModel {
    /// Puts the head behind a backbone, whatever it is; parameters of a projection are
    /// `projection.*`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        backbone: impl Backbone + 'static,
        projection: Option<usize>,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (narrow, vb) = (backbone.out_channels(), vb.pp(PROJECTION));
        let wide = |n| Linear::with(backbone.compute(), narrow, n, true, vb);
        let layer = projection.map(wide).transpose()?;
        let width = projection.unwrap_or(narrow);
        Ok(Self { width, backbone: Box::new(backbone), projection: layer })
    }
}

impl Backbone for LanguageModel {
    /// Unit rows, except that a zero row stays zero.
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        let feat = self.backbone.forward(points, cx)?;
        let Some(projection) = &self.projection else { return ops::l2_normalize(&feat) };
        let feat = projection.forward_unit(&feat)?;
        cx.observe(PROJECTION, &feat)?;
        Ok(feat)
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
        self.width
    }
    fn alignment(&self) -> u32 {
        self.backbone.alignment()
    }
    fn cost(&self) -> Option<BackboneCost> {
        let projection = self.projection.as_ref().map(|_| self.width);
        let head = Head::Features { projection };
        Some(head.cost(self.backbone.cost()?, self.backbone.out_channels()))
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
        let (projection, width) = (self.projection.clone(), self.width);
        Ok(Some(Calibrated { backbone: Box::new(Self { backbone, projection, width }), kept }))
    }
}

/// A backbone with a linear classifier.
pub struct SemanticSegmenter {
    backbone: Box<dyn Backbone>,
    head: Linear,
    num_classes: usize,
}

impl SemanticSegmenter {
    /// Puts the classifier behind a backbone, whatever it is; its parameters are `seg_head.*`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        backbone: impl Backbone + 'static,
        num_classes: usize,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let width = backbone.out_channels();
        let head = Linear::with(backbone.compute(), width, num_classes, true, vb.pp(CLASSIFIER))?;
        Ok(Self { backbone: Box::new(backbone), head, num_classes })
    }
}

impl Backbone for SemanticSegmenter {
    /// Class logits.
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        let logits = self.head.forward(&self.backbone.forward(points, cx)?)?;
        cx.observe(CLASSIFIER, &logits)?;
        Ok(logits)
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
        self.num_classes
    }
    fn alignment(&self) -> u32 {
        self.backbone.alignment()
    }
    fn cost(&self) -> Option<BackboneCost> {
        let head = Head::Classes(self.num_classes);
        Some(head.cost(self.backbone.cost()?, self.backbone.out_channels()))
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
        let (head, num_classes) = (self.head.clone(), self.num_classes);
        Ok(Some(Calibrated { backbone: Box::new(Self { backbone, head, num_classes }), kept }))
    }
}
