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

#[cfg(test)]
mod tests {
    use super::super::config::{
        DinoTerm, IbotCrossEntropyTerm, IbotTerm, LanguageAlignmentTerm, MaskedGaussiansTerm,
        SelfDistillationTerm, SimDinoTerm,
    };
    use super::*;
    use candle_core::{DType, Device};

    #[test]
    fn attributes_have_the_ranges_of_their_values_and_scales_are_counted_from_the_coarsest() {
        use AttributeRange::{Any, Direction, Signed, Unit};
        for (channel, name, range) in [
            (InputChannel::Color, "color", Signed),
            (InputChannel::UnitColor, "unit_color", Unit),
            (InputChannel::Opacity, "opacity", Unit),
            (InputChannel::Quat, "quat", Direction),
            (InputChannel::Scale, "scale", Any),
            (InputChannel::Normal, "normal", Signed),
            (InputChannel::Height, "height", Any),
            (InputChannel::Position, "position", Any),
        ] {
            let found = attribute(channel);
            assert_eq!((found.0, format!("{:?}", found.1)), (name, format!("{range:?}")));
        }
        let level = |up_cast| level_of("t", 5, up_cast).ok();
        assert_eq!([0, 2, 4, 5].map(level), [Some(4), Some(2), Some(0), None]);
        let error = level_of("t", 5, 5).unwrap_err().to_string();
        assert!(
            error.contains("t.up_cast: 5 scales above the coarsest of 5; at most 4"),
            "{error}"
        );
    }

    #[test]
    fn each_head_reads_its_own_rows_and_gives_its_own_width() {
        let input = vec![InputChannel::Position, InputChannel::Quat, InputChannel::Opacity];
        let widths = Widths { rows: 7, encoder: vec![3, 5, 9], input };
        let store = ParamStore::trainable(1);
        let make =
            |term: &TermConfig| Head::new(term, &widths, Compute::default(), &store).unwrap();
        let small = || Prototypes { count: 4, hidden: 6, out: 2, ..Prototypes::default() };
        let (hidden, out) = (6, 2);
        let each = MaskedGaussiansTerm { heads: GaussianHeads::PerAttribute, ..<_>::default() };
        let joint = MaskedGaussiansTerm::default();
        let x = |width| Tensor::ones((2, width), DType::F32, &Device::Cpu).unwrap();
        for (term, reads, gives, attributes) in [
            (TermConfig::MaskedGaussians(joint), 7, 8, true),
            (
                TermConfig::LanguageAlignment(LanguageAlignmentTerm {
                    hidden,
                    out,
                    ..<_>::default()
                }),
                7,
                2,
                true,
            ),
            (TermConfig::SimDino(SimDinoTerm { hidden, out, ..<_>::default() }), 9, 2, false),
            (TermConfig::Ibot(IbotTerm { hidden, out, weight: 1.0 }), 7, 2, false),
            (TermConfig::Dino(DinoTerm { prototypes: small(), weight: 1.0 }), 9, 4, false),
            (
                TermConfig::IbotCrossEntropy(IbotCrossEntropyTerm {
                    prototypes: small(),
                    weight: 1.0,
                }),
                7,
                4,
                false,
            ),
        ] {
            let head = make(&term);
            assert_eq!(head.forward(&x(reads)).unwrap().dims(), [2, gives], "{}", term.name());
            assert!(head.forward(&x(reads + 1)).is_err(), "{}", term.name());
            assert_eq!(head.attributes(&x(reads)).is_ok(), attributes, "{}", term.name());
            let same = head.of_view(&x(reads), true).unwrap().to_vec2::<f32>().unwrap();
            assert_eq!(same, head.forward(&x(reads)).unwrap().to_vec2::<f32>().unwrap());
        }
        let store = ParamStore::trainable(2);
        let head =
            Head::new(&TermConfig::MaskedGaussians(each), &widths, Compute::default(), &store)
                .unwrap();
        let rows = head.attributes(&x(7)).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(
            (rows[0].len(), rows == head.forward(&x(7)).unwrap().to_vec2::<f32>().unwrap()),
            (8, true)
        );
        let length: f32 = rows[0][3..7].iter().map(|v| v * v).sum();
        assert!((length - 1.0).abs() < 1e-5 && (0.0..1.0).contains(&rows[0][7]), "{rows:?}");
        // Self-distillation has a head for each kind of view that has a share; scales 1 and 2 are 5 + 9 wide.
        for (shares, masked, local) in [
            ([0.5, 0.0, 0.5], true, true),
            ([0.0, 1.0, 0.0], true, false),
            ([1.0, 0.0, 0.0], true, false),
            ([0.0, 0.0, 1.0], false, true),
        ] {
            let term =
                SelfDistillationTerm { prototypes: small(), up_cast: 1, shares, ..<_>::default() };
            let store = ParamStore::trainable(3);
            let head =
                Head::new(&TermConfig::SelfDistillation(term), &widths, Compute::default(), &store)
                    .unwrap();
            let of = |is_local| {
                head.of_view(&x(14), is_local).map(|rows| rows.to_vec2::<f32>().unwrap()).ok()
            };
            assert_eq!([of(false).is_some(), of(true).is_some()], [masked, local], "{shares:?}");
            assert!(!(masked && local) || of(false) != of(true), "two heads");
            assert!(head.forward(&x(14)).is_err() && head.attributes(&x(14)).is_err());
        }
    }
}
