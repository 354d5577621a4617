//! The heads of student and teacher for each term.

use super::config::{GaussianHeads, Prototypes, TermConfig};
use candle_core::{Result, Tensor, bail};
use scenesplat_datasets::{InputChannel, InputFeatures};
use scenesplat_models::self_supervised_heads::{
    AttributeHeads, AttributeRange, ProjectionHead, ProjectionShape, PrototypeHead,
    ReconstructionHead,
};
use scenesplat_models::{Compute, ModelConfig, ParamStore, PointTransformerV3Config};

/// Where the parameters of heads stand, before the name of their term.
pub(super) const HEADS: &str = "heads";

/// Widths of what heads read and give.
#[derive(Debug, Clone)]
pub(super) struct Widths {
    /// Rows of the finest scale.
    pub rows: usize,
    /// Channels of the encoder's scales, fine to coarse.
    pub encoder: Vec<usize>,
    /// Groups of input channels: what is reconstructed.
    pub input: Vec<InputChannel>,
}

impl Widths {
    pub fn new(
        model: &ModelConfig,
        backbone: &PointTransformerV3Config,
        input: &InputFeatures,
    ) -> Self {
        let encoder = backbone.enc_channels.clone();
        Self { rows: model.out_channels(), encoder, input: input.channels.clone() }
    }
}

/// A head; most have one, self-distillation has one for masked and one for local views.
#[derive(Debug, Clone)]
pub(super) enum Head {
    Attributes(ReconstructionHead),
    EachAttribute(AttributeHeads),
    Vectors(ProjectionHead),
    Logits(PrototypeHead),
    Pair(Box<Pair>),
}

/// The heads of self-distillation.
#[derive(Debug, Clone)]
pub(super) struct Pair {
    masked: Option<PrototypeHead>,
    local: Option<PrototypeHead>,
}

impl Head {
    /// The head of a term, with parameters `heads.<term>.*`.
    ///
    /// # Errors
    /// If parameters exist with another shape, or the network has too few scales.
    pub fn new(
        term: &TermConfig,
        widths: &Widths,
        compute: Compute,
        store: &ParamStore,
    ) -> Result<Self> {
        let vb = store.builder().pp(HEADS).pp(term.name());
        let coarsest = widths.encoder.last().copied().unwrap_or(0);
        let shape = |channels, hidden, out| ProjectionShape { channels, hidden, out };
        let logits = |channels, p: &Prototypes, vb| {
            PrototypeHead::new(shape(channels, p.hidden, p.out), p.count, compute, &vb)
        };
        // Channels of a scale with all coarser ones beside it.
        let up_cast = |scales: usize| -> Result<usize> {
            let level = level_of(term.name(), widths.encoder.len(), scales)?;
            Ok(widths.encoder[level..].iter().sum())
        };
        Ok(match term {
            TermConfig::MaskedGaussians(t) => match t.heads {
                GaussianHeads::Joint => {
                    let width = widths.input.iter().map(|channel| channel.width()).sum();
                    Self::Attributes(ReconstructionHead::new(widths.rows, width, compute, &vb)?)
                }
                GaussianHeads::PerAttribute => {
                    let each = widths.input.iter().map(|channel| {
                        let (name, range) = attribute(*channel);
                        (name, channel.width(), range)
                    });
                    Self::EachAttribute(AttributeHeads::new(widths.rows, each, compute, &vb)?)
                }
            },
            TermConfig::LanguageAlignment(t) => Self::Attributes(ReconstructionHead::with_hidden(
                widths.rows,
                t.hidden,
                t.out,
                compute,
                &vb,
            )?),
            TermConfig::SimDino(t) => {
                Self::Vectors(ProjectionHead::new(shape(coarsest, t.hidden, t.out), compute, &vb)?)
            }
            TermConfig::Ibot(t) => Self::Vectors(ProjectionHead::new(
                shape(widths.rows, t.hidden, t.out),
                compute,
                &vb,
            )?),
            TermConfig::Dino(t) => Self::Logits(logits(coarsest, &t.prototypes, vb)?),
            TermConfig::IbotCrossEntropy(t) => {
                Self::Logits(logits(widths.rows, &t.prototypes, vb)?)
            }
            TermConfig::SimDinoRows(t) => {
                let shape = shape(up_cast(t.up_cast)?, t.hidden, t.out);
                Self::Vectors(ProjectionHead::new(shape, compute, &vb)?)
            }
            TermConfig::SelfDistillation(t) => {
                let channels = up_cast(t.up_cast)?;
                let head = |on: bool, name| {
                    on.then(|| logits(channels, &t.prototypes, vb.pp(name))).transpose()
                };
                let [same, other, local] = t.shares;
                let masked = head(same > 0.0 || other > 0.0, "masked")?;
                Self::Pair(Box::new(Pair { masked, local: head(local > 0.0, "local")? }))
            }
        })
    }

    /// Attributes of rows. `[N, C] → [N, input]`
    pub fn attributes(&self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Attributes(head) => head.forward(x),
            Self::EachAttribute(heads) => heads.forward(x),
            _ => bail!("this head gives no attributes"),
        }
    }

    /// Vectors of unit length or logits. `[N, C] → [N, out]`
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Vectors(head) => head.forward(x),
            Self::Logits(head) => head.forward(x),
            Self::Attributes(head) => head.forward(x),
            Self::EachAttribute(heads) => heads.forward(x),
            Self::Pair(_) => bail!("this term has one head for each kind of view"),
        }
    }

    /// Logits of rows of a local or another view.
    pub fn of_view(&self, x: &Tensor, is_local: bool) -> Result<Tensor> {
        let Self::Pair(pair) = self else { return self.forward(x) };
        match if is_local { &pair.local } else { &pair.masked } {
            Some(head) => head.forward(x),
            None => bail!("there is no head for such views: their share is 0"),
        }
    }
}

/// Name and range of an attribute.
fn attribute(channel: InputChannel) -> (&'static str, AttributeRange) {
    match channel {
        InputChannel::Color => ("color", AttributeRange::Signed),
        InputChannel::UnitColor => ("unit_color", AttributeRange::Unit),
        InputChannel::Opacity => ("opacity", AttributeRange::Unit),
        InputChannel::Quat => ("quat", AttributeRange::Direction),
        InputChannel::Scale => ("scale", AttributeRange::Any),
        InputChannel::Normal => ("normal", AttributeRange::Signed),
        InputChannel::Height => ("height", AttributeRange::Any),
        InputChannel::Position => ("position", AttributeRange::Any),
    }
}

/// The scale `up_cast` above the coarsest of `scales`.
///
/// # Errors
/// If there is none.
pub(super) fn level_of(term: &str, scales: usize, up_cast: usize) -> Result<usize> {
    match scales.checked_sub(up_cast + 1) {
        Some(level) => Ok(level),
        None => bail!(
            "{term}.up_cast: {up_cast} scales above the coarsest of {scales}; at most {} are \
             there",
            scales.saturating_sub(1)
        ),
    }
}
