//! Errors of this crate.

use scenesplat_kernels::neighbors::NeighborError;
use scenesplat_metrics::image::ImageError;
use scenesplat_rasterizer::RasterError;
use scenesplat_rasterizer::backward::BackwardError;
use scenesplat_scene::{SceneError, WriteError};
use std::path::PathBuf;

/// What can go wrong. Every variant names the field and the value, and how to fix it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OptimiseError {
    /// An array of the wrong length.
    #[error("{field}: expected {expected} values, got {got}")]
    Length {
        /// Which array.
        field: &'static str,
        /// Values expected.
        expected: usize,
        /// Values found.
        got: usize,
    },
    /// A number outside its range.
    #[error("{field} is {value}; it has to be {range}")]
    Number {
        /// Which number.
        field: &'static str,
        /// What it is.
        value: f64,
        /// What it has to be.
        range: &'static str,
    },
    /// A picture that the window of SSIM does not fit into.
    #[error(
        "a picture of {width} × {height} pixels is smaller than {least} on a side, which SSIM with \
         border {border} needs; use larger pictures or border zero"
    )]
    Picture {
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Least side.
        least: usize,
        /// Which border.
        border: &'static str,
    },
    /// A frame that cannot be learned from.
    #[error("frame {frame:?}: {problem}; {help}")]
    Frame {
        /// Its name.
        frame: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        help: &'static str,
    },
    /// No frame to learn from.
    #[error("no frame to learn from is left: {problem}; {help}")]
    NoFrames {
        /// Why.
        problem: String,
        /// What to do.
        help: &'static str,
    },
    /// Nothing to begin with.
    #[error("no point to begin with: {problem}; {help}")]
    NoPoints {
        /// Why.
        problem: String,
        /// What to do.
        help: &'static str,
    },
    /// A loss that is not a number.
    #[error(
        "step {step}, frame {frame:?}: the loss is {value}; the checkpoint before it is whole; lower \
         the learning rates or check that frame"
    )]
    NotFinite {
        /// Which step.
        step: u64,
        /// Which frame.
        frame: String,
        /// The loss.
        value: f64,
    },
    /// A checkpoint that cannot be gone on from.
    #[error("{path}: {problem}; {help}")]
    Checkpoint {
        /// Which one.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do.
        help: &'static str,
    },
    /// A step at which the run was asked to stop.
    #[error("stopped")]
    Stopped,
    /// What the rasterizer refuses.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// What its backward pass refuses.
    #[error(transparent)]
    Backward(#[from] BackwardError),
    /// What a metric refuses.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// What a file is refused for.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// What was not written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Points that cannot be searched.
    #[error(transparent)]
    Neighbors(#[from] NeighborError),
}

/// That an array has as many values as it should.
pub(crate) fn expect(
    field: &'static str,
    expected: usize,
    got: usize,
) -> Result<(), OptimiseError> {
    if got == expected { Ok(()) } else { Err(OptimiseError::Length { field, expected, got }) }
}

/// That a number is in its range.
pub(crate) fn within(
    field: &'static str,
    value: f64,
    good: bool,
    range: &'static str,
) -> Result<(), OptimiseError> {
    if good { Ok(()) } else { Err(OptimiseError::Number { field, value, range }) }
}
