//! Language features in few numbers.
//!
//! # Source
//! SceneSplat's paper compresses 768 features to 16 or 64 by layers of 384, 192, 96 and 48; its code is not
//! released. Batch norms and ReLUs stand where LangSplat's autoencoder has them: in the encoder before every
//! layer but the first, in the decoder ReLUs alone. Codes and features have unit length.

use crate::layers::{BatchNorm, Linear};
use crate::{Compute, Mode, ops};
use candle_core::{Result, Tensor, bail};
use candle_nn::VarBuilder;

/// Features to codes and back.
#[derive(Debug, Clone)]
pub struct Autoencoder {
    encoder: Vec<(Option<BatchNorm>, Linear)>,
    decoder: Vec<Linear>,
    widths: Vec<usize>,
}

impl Autoencoder {
    /// `widths`: of the features, of the layers between, and of the codes. Parameters `encoder.N.*`,
    /// `norm.N.*`, `decoder.N.*`.
    ///
    /// # Errors
    /// If there are fewer than two widths, one is 0, or parameters exist with another shape.
    pub fn new(widths: &[usize], compute: Compute, vb: &VarBuilder<'_>) -> Result<Self> {
        if widths.len() < 2 || widths.iter().any(|w| !(1..=1 << 16).contains(w)) {
            bail!("widths: {widths:?}, expected two or more, each in 1..=65536");
        }
        let (mut encoder, mut decoder) = (Vec::new(), Vec::new());
        for (i, pair) in widths.windows(2).enumerate() {
            let norm =
                (i > 0).then(|| BatchNorm::new(pair[0], vb.pp(format!("norm.{i}")))).transpose()?;
            let vb = vb.pp(format!("encoder.{i}"));
            encoder.push((norm, Linear::with(compute, pair[0], pair[1], true, vb)?));
        }
        let turned: Vec<usize> = widths.iter().rev().copied().collect();
        for (i, pair) in turned.windows(2).enumerate() {
            let vb = vb.pp(format!("decoder.{i}"));
            decoder.push(Linear::with(compute, pair[0], pair[1], true, vb)?);
        }
        Ok(Self { encoder, decoder, widths: widths.to_vec() })
    }

    /// Widths of features, layers and codes.
    pub fn widths(&self) -> &[usize] {
        &self.widths
    }

    /// Codes of unit length. `[N, D] → [N, K]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn encode(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        let mut x = x.clone();
        for (norm, layer) in &self.encoder {
            if let Some(norm) = norm {
                x = norm.forward_relu(&x, mode)?;
            }
            x = layer.forward(&x)?;
        }
        ops::l2_normalize(&x)
    }

    /// Features of unit length. `[N, K] → [N, D]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn decode(&self, codes: &Tensor) -> Result<Tensor> {
        let mut x = codes.clone();
        for (i, layer) in self.decoder.iter().enumerate() {
            if i > 0 {
                x = x.relu()?;
            }
            x = layer.forward(&x)?;
        }
        ops::l2_normalize(&x)
    }
}
