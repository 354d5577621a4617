//! Features classified by the texts of the classes, as zero-shot labeling does it.

use crate::contrastive::TextColumns;
use crate::cross_entropy::cross_entropy;
use crate::loss::{Loss, LossInput};
use crate::lovasz::lovasz_softmax;
use candle_core::{Result, Tensor};

const NAME: &str = "text_classification";

/// Cross entropy (and Lovász softmax) of labels under the logits `cos(pred, textᵢ) / τ`.
///
/// The cosine loss is a mean over rows, so walls and floors decide it; this one asks every row to
/// be nearer to its own text than to the others, and with the Lovász term every class counts alike.
/// It uses labels: what it trains is not label-free. Not part of the original.
///
/// # Shapes
/// `pred`: `[N, D]`, rows of unit length · `label`: `[N]`, -1 or 0..C · texts: C rows of width D
#[derive(Debug, Clone)]
pub struct TextClassification {
    /// Texts of the classes.
    pub texts: TextColumns,
    /// τ, above 0; the smaller, the more the nearest texts decide.
    pub temperature: f64,
    /// Weight of the Lovász term beside the cross entropy, at least 0.
    pub lovasz: f64,
    /// As in [`cross_entropy`].
    pub label_smoothing: f64,
}

impl TextClassification {
    /// With temperature 0.1 and the Lovász term at 1.
    pub fn new(texts: TextColumns) -> Self {
        Self { texts, temperature: 0.1, lovasz: 1.0, label_smoothing: 0.0 }
    }
}

impl Loss for TextClassification {
    fn name(&self) -> &str {
        NAME
    }

    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        let label = input.needs_label(NAME)?;
        let logits = self.texts.logits(NAME, "pred", input.pred, self.temperature)?;
        let Some(entropy) = cross_entropy(&logits, label, self.label_smoothing, None)? else {
            return Ok(None);
        };
        if self.lovasz <= 0.0 {
            return Ok(Some(entropy));
        }
        match lovasz_softmax(&logits, label)? {
            Some(lovasz) => (entropy + (lovasz * self.lovasz)?).map(Some),
            None => Ok(Some(entropy)),
        }
    }

    fn off_reason(&self, _: &LossInput<'_>) -> String {
        "no row has a label".to_owned()
    }

    fn settings(&self) -> String {
        format!(
            "temperature {}, Lovász {}, label smoothing {}, {} texts",
            self.temperature,
            self.lovasz,
            self.label_smoothing,
            self.texts.len()
        )
    }
}
