//! Features classified by the texts of the classes, as zero-shot labelling does it.

use crate::contrastive::TextColumns;
use crate::cross_entropy::cross_entropy;
use crate::error::LossError;
use crate::loss::{Loss, LossInput};
use crate::lovasz::lovasz_softmax;
use candle_core::{DType, Result, Tensor};

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
        let Some(label) = input.label else {
            return Err(LossError::Missing { loss: NAME, field: "label" }.into());
        };
        let dtype = if input.pred.dtype() == DType::F64 { DType::F64 } else { DType::F32 };
        let (rows, width) = input.pred.dims2()?;
        if width != self.texts.width() {
            let expected = format!("[N, {}]", self.texts.width());
            let got = format!("[{rows}, {width}]");
            return Err(LossError::Shape { loss: NAME, field: "pred", expected, got }.into());
        }
        let texts = self.texts.columns().to_dtype(dtype)?.to_device(input.pred.device())?;
        let logits = (input.pred.to_dtype(dtype)?.matmul(&texts)? * (1.0 / self.temperature))?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    fn loss(lovasz: f64) -> TextClassification {
        let texts = TextColumns::new(&[1.0, 0.0, 0.0, 1.0, -1.0, 0.0], 2).unwrap();
        TextClassification { texts, temperature: 0.5, lovasz, label_smoothing: 0.0 }
    }

    fn value(loss: &TextClassification, pred: &Tensor, label: &[i32]) -> Option<Tensor> {
        let input = LossInput {
            pred,
            target: None,
            label: Some(label),
            valid: None,
            progress: 0.0,
            seed: 0,
        };
        loss.forward(&input).unwrap()
    }

    #[test]
    fn by_hand_and_against_central_differences() {
        let rows = [[0.6_f64, 0.8], [-1.0, 0.0], [0.0, 1.0]];
        let label = [0, 2, -1];
        let plain = |rows: &[[f64; 2]; 3]| -> f64 {
            let texts = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]];
            let row = |r: usize| {
                let logits = texts.map(|t| (t[0] * rows[r][0] + t[1] * rows[r][1]) / 0.5);
                let sum: f64 = logits.iter().map(|l| l.exp()).sum();
                sum.ln() - logits[label[r] as usize]
            };
            f64::midpoint(row(0), row(1))
        };
        let pred = Var::new(&rows, &Device::Cpu).unwrap();
        let found = value(&loss(0.0), &pred, &label).unwrap();
        assert!((found.to_scalar::<f64>().unwrap() - plain(&rows)).abs() < 1e-6);
        for weight in [0.0, 0.7] {
            let term = loss(weight);
            let grads = value(&term, &pred, &label).unwrap().backward().unwrap();
            let grads = grads.get(&pred).unwrap().to_vec2::<f64>().unwrap();
            for r in 0..3 {
                for c in 0..2 {
                    let at = |step: f64| {
                        let mut moved = rows;
                        moved[r][c] += step;
                        let moved = Tensor::new(&moved, &Device::Cpu).unwrap();
                        value(&term, &moved, &label).unwrap().to_scalar::<f64>().unwrap()
                    };
                    let expected = (at(1e-5) - at(-1e-5)) / 2e-5;
                    assert!((grads[r][c] - expected).abs() < 1e-6, "{r} {c}");
                }
            }
        }
    }

    #[test]
    fn no_label_is_off_and_a_wrong_width_is_an_error() {
        let pred = Tensor::new(&[[1.0_f32, 0.0]], &Device::Cpu).unwrap();
        assert!(value(&loss(1.0), &pred, &[-1]).is_none());
        let wide = Tensor::new(&[[1.0_f32, 0.0, 0.0]], &Device::Cpu).unwrap();
        let input = LossInput {
            pred: &wide,
            target: None,
            label: Some(&[0]),
            valid: None,
            progress: 0.0,
            seed: 0,
        };
        assert!(loss(1.0).forward(&input).is_err());
    }
}
