//! How a network computes, as opposed to what.

use candle_core::{Result, bail};
use scenesplat_kernels::Precision;

/// Choices that change speed and rounding, but not the function that a network stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Compute {
    /// Form of the operands of products, in inference and training alike, but for
    /// [`Precision::Int8`], in which nothing is trained. Parameters, sums, norms and gradients that are
    /// stored stay f32.
    pub precision: Precision,
    /// Joins frozen layers that follow each other without anything between: the linear layer of a
    /// positional convolution goes into its taps, batch norms into the linear layer before them.
    /// That rounds differently and saves about 5 % of the time of the language network.
    pub fold: bool,
}

impl Default for Compute {
    fn default() -> Self {
        Self { precision: Precision::F32, fold: true }
    }
}

impl Compute {
    /// f32, layer by layer as the parameters are stored.
    pub const EXACT: Self = Self { precision: Precision::F32, fold: false };

    /// That tensors are not computed in [`Precision::F16`].
    ///
    /// # Errors
    /// If they were to be.
    pub(crate) fn refuse_f16(self) -> Result<()> {
        if self.precision == Precision::F16 {
            bail!("precision f16: only graphics processors compute in it");
        }
        Ok(())
    }
}
