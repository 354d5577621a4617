//! Passes of operations as launches on a device, whatever runs them: CUDA, or the emulated grid of the tests.
//!
//! Index tables are on the host and go to the device with each pass.

#![cfg_attr(
    not(any(feature = "cuda", feature = "emulation")),
    allow(dead_code, reason = "nothing launches them")
)]

use candle_core::Shape;
use scenesplat_device::{Launcher, TooManyItems, ops};
use scenesplat_kernels::fallbacks::Pass;

/// An array of f32 without gaps, with its dimensions.
pub(crate) type Input<'a, L> = (&'a <L as Launcher>::Buffer, &'a [usize]);
/// Arrays of f32 with their shapes; `None` where there is no kernel for them.
pub(crate) type Launched<L> = Uploaded<L, Option<Vec<(<L as Launcher>::Buffer, Shape)>>>;
/// What asking a device for `T` comes to.
pub(crate) type Uploaded<L, T> = Result<T, <L as Launcher>::Error>;

/// A pass of an operation. Shapes were checked before.
pub(crate) trait Launches {
    /// Operation and pass, for counts.
    #[cfg_attr(not(feature = "emulation"), allow(dead_code, reason = "only the emulator counts"))]
    fn name(&self) -> (&'static str, Pass);

    /// Starts the kernels.
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L>;
}

/// A number of rows or channels as kernels take it.
pub(crate) fn narrow<L: Launcher>(n: usize) -> Result<u32, L::Error> {
    let too_many = || TooManyItems { kernel: "rows", items: n as u64, blocks: n as u64 };
    u32::try_from(n).map_err(|_| too_many().into())
}

/// Rows and channels.
pub(crate) fn matrix<L: Launcher>(dims: &[usize]) -> Result<(u32, u32), L::Error> {
    let [n, c] = *dims else { return Ok((0, 0)) };
    Ok((narrow::<L>(n)?, narrow::<L>(c)?))
}

/// Room for an array of f32.
pub(crate) fn room<L: Launcher>(l: &L, dims: &[usize]) -> Result<L::Buffer, L::Error> {
    l.alloc_values::<f32>(dims.iter().product())
}

/// Mean and biased variance of each channel of `x`, for the host. `[C]` each
pub(crate) fn batch_statistics<L: Launcher>(
    l: &L,
    (x, dims): Input<'_, L>,
) -> Result<(Vec<f64>, Vec<f64>), L::Error> {
    let (n, c) = matrix::<L>(dims)?;
    let statistics = ops::batch_norm::statistics(l, x, n, c)?;
    let mut mean = l.download_values::<f64>(&statistics, 2 * c as usize)?;
    let var = mean.split_off(c as usize);
    Ok((mean, var))
}
