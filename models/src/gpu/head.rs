//! What stands behind a network on a graphics processor.

use super::layers::Place;
use super::wrap;
use crate::head::Head as HeadConfig;
use candle_core::Result;
use candle_nn::VarBuilder;
use scenesplat_gpu::Commands;
use scenesplat_gpu::ops::Rows;
use scenesplat_gpu::ops::product::{Product, Weights, product};
use scenesplat_gpu::ops::unit_rows::unit_rows;

/// A head with its weights.
#[derive(Debug)]
pub(super) struct Head {
    linear: Option<Weights>,
    /// Whether rows get unit length.
    unit: bool,
    width: usize,
}

impl Head {
    pub fn new(
        place: &Place,
        config: HeadConfig,
        inputs: usize,
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let linear = |(name, width)| place.linear(inputs, width, &vb.pp(name));
        Ok(Self {
            linear: config.linear().map(linear).transpose()?,
            unit: matches!(config, HeadConfig::Features { .. }),
            width: config.out_channels(inputs),
        })
    }

    /// Nothing behind rows of this width.
    pub fn none(width: usize) -> Self {
        Self { linear: None, unit: false, width }
    }

    /// Width of the result.
    pub fn width(&self) -> usize {
        self.width
    }

    /// `[N, inputs] → [N, width]`
    pub fn forward(&self, commands: &mut Commands, x: Rows) -> Result<Rows> {
        let mut y = x;
        if let Some(linear) = &self.linear {
            y = product(commands, &y, linear, &Product::default()).map_err(wrap)?;
        }
        if self.unit {
            y = unit_rows(commands, &y).map_err(wrap)?;
        }
        Ok(y)
    }
}
