//! The layers that both towers are made of.

use super::config::Tower;
use crate::VisionError;
use crate::layers::{Linear, Norm, gelu_tanh};
use crate::weights::Weights;
use scenesplat_kernels::Precision;
use scenesplat_kernels::patch_attention::{Heads, forward_with};
use scenesplat_kernels::patches::cut;

/// The layers of a tower, on items (pictures or texts) of the same number of tokens.
pub(super) struct Layers {
    layers: Vec<Layer>,
    heads: Heads,
    precision: Precision,
}

struct Layer {
    norm_attention: Norm,
    qkv: Linear,
    out: Linear,
    norm_mlp: Norm,
    mlp: Mlp,
}

/// Two linear layers with the approximate GELU between.
pub(super) struct Mlp {
    first: Linear,
    second: Linear,
}

impl Mlp {
    pub fn take(weights: &mut Weights, prefix: &str, tower: &Tower) -> Result<Self, VisionError> {
        let (width, inner) = (tower.hidden_size, tower.intermediate_size);
        Ok(Self {
            first: weights.linear(&format!("{prefix}.fc1"), width, inner)?,
            second: weights.linear(&format!("{prefix}.fc2"), inner, width)?,
        })
    }

    /// `second(gelu(first(x))) + residual`
    pub fn plus(&self, x: &[f32], residual: &[f32]) -> Vec<f32> {
        let mut hidden = self.first.forward(x);
        gelu_tanh(&mut hidden);
        self.second.plus(&hidden, residual)
    }
}

impl Layers {
    pub fn take(
        weights: &mut Weights,
        prefix: &str,
        tower: &Tower,
        precision: Precision,
    ) -> Result<Self, VisionError> {
        let (width, eps) = (tower.hidden_size, tower.layer_norm_eps);
        let layer = |index: usize| {
            let name = |part: &str| format!("{prefix}.layers.{index}.{part}");
            let qkv = ["q_proj", "k_proj", "v_proj"].map(|p| name(&format!("self_attn.{p}")));
            Ok(Layer {
                norm_attention: weights.norm(&name("layer_norm1"), width, eps)?,
                qkv: weights.linears(&qkv, width, width)?,
                out: weights.linear(&name("self_attn.out_proj"), width, width)?,
                norm_mlp: weights.norm(&name("layer_norm2"), width, eps)?,
                mlp: Mlp::take(weights, &name("mlp"), tower)?,
            })
        };
        let layers = (0..tower.num_hidden_layers).map(layer).collect::<Result<_, VisionError>>()?;
        let count = tower.num_attention_heads;
        Ok(Self { layers, heads: Heads { count, dim: width / count }, precision })
    }

    /// `[items · tokens, width]`: each token sees all of its item.
    pub fn forward(&self, mut x: Vec<f32>, tokens: usize) -> Vec<f32> {
        let rows = x.len() / self.heads.channels();
        let offsets: Vec<usize> = (0..=rows).step_by(tokens).collect();
        let patches = cut(&offsets, tokens);
        let order: Vec<u32> = (0..rows as u32).collect();
        for layer in &self.layers {
            let qkv = layer.qkv.forward(&layer.norm_attention.forward(&x));
            let mut seen = vec![0.0; x.len()];
            forward_with(self.precision, &qkv, self.heads, &patches, &order, &mut seen);
            drop(qkv);
            x = layer.out.plus(&seen, &x);
            x = layer.mlp.plus(&layer.norm_mlp.forward(&x), &x);
        }
        x
    }
}
