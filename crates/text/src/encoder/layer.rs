//! One layer of BERT: attention and two linear layers, each with a residual and a norm behind.

use super::attention::attend;
use super::config::Config;
use super::weights::WeightFile;
use crate::PhraseError;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm};
use scenesplat_kernels::layer_norm;

pub(super) struct Layer {
    heads: usize,
    eps: f32,
    /// Queries, keys and values side by side.
    qkv: (PackedMatrix, Vec<f32>),
    out: (PackedMatrix, Vec<f32>),
    norm_attention: (Vec<f32>, Vec<f32>),
    up: (PackedMatrix, Vec<f32>),
    down: (PackedMatrix, Vec<f32>),
    norm_output: (Vec<f32>, Vec<f32>),
}

impl Layer {
    pub fn take(file: &mut WeightFile, index: usize, config: &Config) -> Result<Self, PhraseError> {
        let name = |part: &str| format!("encoder.layer.{index}.{part}");
        let (width, inner) = (config.hidden_size, config.intermediate_size);
        let qkv = ["query", "key", "value"].map(|part| name(&format!("attention.self.{part}")));
        Ok(Self {
            heads: config.num_attention_heads,
            eps: config.layer_norm_eps,
            qkv: file.linear(&qkv, width, width)?,
            out: file.linear(&[name("attention.output.dense")], width, width)?,
            norm_attention: file.norm(&name("attention.output.LayerNorm"), width)?,
            up: file.linear(&[name("intermediate.dense")], width, inner)?,
            down: file.linear(&[name("output.dense")], inner, width)?,
            norm_output: file.norm(&name("output.LayerNorm"), width)?,
        })
    }

    /// `x`: rows of phrases behind each other, of these lengths. `[Σ lengths, width]`
    pub fn forward(&self, x: &mut [f32], lengths: &[usize]) {
        let rows: usize = lengths.iter().sum();
        let qkv = product(x, &self.qkv, rows, false, None);
        let attended = attend(&qkv, lengths, self.heads, qkv.len() / rows.max(1) / 3);
        let joined = product(&attended, &self.out, rows, false, Some(x));
        let mut normed = vec![0.0; joined.len()];
        let (weight, bias) = &self.norm_attention;
        layer_norm::forward(&joined, None, weight, bias, self.eps, &mut normed);
        let inner = product(&normed, &self.up, rows, true, None);
        let joined = product(&inner, &self.down, rows, false, Some(&normed));
        let (weight, bias) = &self.norm_output;
        layer_norm::forward(&joined, None, weight, bias, self.eps, x);
    }
}

fn product(
    x: &[f32],
    (weight, bias): &(PackedMatrix, Vec<f32>),
    rows: usize,
    gelu: bool,
    residual: Option<&[f32]>,
) -> Vec<f32> {
    let mut out = vec![0.0; rows * weight.n()];
    gemm(x, weight, Epilogue { bias: Some(bias), gelu, residual }, &mut out);
    out
}
