//! Normalization over the channels of each row.

use super::{Rows, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands, Gpu};
use bytemuck::{Pod, Zeroable};

const TEXT: &str = include_str!("../../wgsl/layer_norm.wgsl");
/// Added to the variance, as PyTorch does.
pub const EPSILON: f32 = 1e-5;

/// Weight and bias of a layer norm on the device.
#[derive(Debug, Clone)]
pub struct LayerNorm {
    weight: Array<f32>,
    bias: Array<f32>,
}

impl LayerNorm {
    /// Parameters. `[C]` each
    ///
    /// # Errors
    /// If lengths differ, or the device has no room.
    pub fn upload(gpu: &Gpu, weight: &[f32], bias: &[f32]) -> Result<Self> {
        if weight.len() != bias.len() {
            return shape(format!("layer norm: {} weights, {} biases", weight.len(), bias.len()));
        }
        Ok(Self { weight: gpu.upload("weights", weight)?, bias: gpu.upload("bias", bias)? })
    }
}

/// What follows a norm.
#[derive(Debug, Clone, Copy, Default)]
pub enum Ending<'a> {
    /// Nothing.
    #[default]
    None,
    /// GELU.
    Gelu,
    /// The sum with other rows.
    Residual(&'a Rows),
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    channels: u32,
    epsilon: f32,
    pad: u32,
}

/// `ending(norm(x))`. `[N, C] → [N, C]`
///
/// # Errors
/// If sizes do not fit together, or the device has no room.
pub fn layer_norm(
    commands: &mut Commands,
    x: &Rows,
    norm: &LayerNorm,
    ending: Ending<'_>,
) -> Result<Rows> {
    let (rows, channels, stored) = (x.rows, x.channels, x.stored());
    if norm.weight.len() != channels {
        return shape(format!("layer norm of {}: rows of {channels}", norm.weight.len()));
    }
    let out = Rows::new(commands, "a norm", rows, channels, stored)?;
    let mut arrays: Vec<(u32, &dyn Bound)> =
        vec![(1, x), (2, &norm.weight), (3, &norm.bias), (4, &out)];
    let flag = match ending {
        Ending::None => None,
        Ending::Gelu => Some("GELU"),
        Ending::Residual(residual) => {
            if (residual.rows, residual.channels, residual.stored()) != (rows, channels, stored) {
                return shape("layer norm: the residual does not fit");
            }
            arrays.push((5, residual));
            Some("RESIDUAL")
        }
    };
    let lanes = if channels <= 64 { 16 } else { 64 };
    let kernel = commands.gpu().kernel("layer_norm", TEXT, &stored.with(flag), &[("LANES", lanes)]);
    let params =
        Params { rows: number(rows)?, channels: number(channels)?, epsilon: EPSILON, pad: 0 };
    commands.run(&kernel, &params, &arrays, (rows as u64).div_ceil(64 / u64::from(lanes)))?;
    Ok(out)
}
