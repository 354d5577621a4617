//! What goes in: the gradient of a loss with respect to the picture.

use super::Trace;
use crate::gaussians::expect;
use crate::{Gaussians, RasterError};
use rayon::prelude::*;

/// Values that one task checks.
const CHUNK: usize = 1 << 16;

/// What a backward pass refuses.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BackwardError {
    /// What a forward pass refuses too.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A gradient that would reach every Gaussian of its pixel.
    #[error(
        "upstream gradient of {picture} at pixel ({x}, {y}), channel {channel}: {value} is not \
         finite; check the loss of that pixel, or mask it"
    )]
    NotFinite {
        /// Which picture.
        picture: &'static str,
        /// Column of the first such pixel.
        x: usize,
        /// Row of it.
        y: usize,
        /// Channel of it.
        channel: usize,
        /// What was found.
        value: f32,
    },
    /// A gradient of a picture that does not exist.
    #[error(
        "upstream gradient of {picture}: the picture was not traced; ask for it in the TraceRequest"
    )]
    NotTraced {
        /// Which picture.
        picture: &'static str,
    },
}

/// Features and the gradient of their picture.
#[derive(Debug, Clone, Copy)]
pub struct FeatureGradient<'a> {
    /// What [`render_features`](crate::render_features) was given, finite. `[N, dim]`
    pub features: &'a [f32],
    /// Gradient of its picture. `[H, W, dim]`
    pub gradient: &'a [f32],
    /// Channels, at least 1.
    pub dim: usize,
}

/// Gradient of a loss with respect to each picture; what is `None` is 0.
#[derive(Debug, Clone, Copy, Default)]
pub struct Upstream<'a> {
    /// Of the color. `[H, W, 3]`
    pub rgb: Option<&'a [f32]>,
    /// Of `1 − transmittance`. `[H, W]`
    pub alpha: Option<&'a [f32]>,
    /// Of `Σ w z`. `[H, W]`
    pub depth_accumulated: Option<&'a [f32]>,
    /// Of `Σ w z / max(alpha, 1e-10)`. `[H, W]`
    pub depth_expected: Option<&'a [f32]>,
    /// Of any features, blended without background.
    pub features: Option<FeatureGradient<'a>>,
}

impl Upstream<'_> {
    /// Channels of the features, 0 without.
    pub fn feature_dim(&self) -> usize {
        self.features.map_or(0, |f| f.dim)
    }

    /// Whether a depth picture has a gradient.
    pub(crate) fn depth(&self) -> bool {
        self.depth_accumulated.is_some() || self.depth_expected.is_some()
    }

    pub(crate) fn check(&self, trace: &Trace, gaussians: &Gaussians) -> Result<(), BackwardError> {
        let (width, pixels) = (trace.picture.width as usize, trace.picture.transmittance.len());
        if self.rgb.is_some() && trace.picture.rgb.is_none() {
            return Err(BackwardError::NotTraced { picture: "rgb" });
        }
        if self.depth_expected.is_some() && trace.picture.depth_expected.is_none() {
            return Err(BackwardError::NotTraced { picture: "depth_expected" });
        }
        let planes = [
            ("rgb", self.rgb, 3),
            ("alpha", self.alpha, 1),
            ("depth_accumulated", self.depth_accumulated, 1),
            ("depth_expected", self.depth_expected, 1),
            ("features", self.features.map(|f| f.gradient), self.feature_dim()),
        ];
        for (picture, values, channels) in planes {
            let Some(values) = values else { continue };
            expect(picture, pixels.saturating_mul(channels), values.len())?;
            if let Some(at) = first_bad(values) {
                let (pixel, channel) = (at / channels, at % channels);
                let (x, y, value) = (pixel % width, pixel / width, values[at]);
                return Err(BackwardError::NotFinite { picture, x, y, channel, value });
            }
        }
        if let Some(f) = self.features {
            let (value, range) = (f.dim as f64, "at least 1");
            if f.dim == 0 {
                return Err(RasterError::Number { field: "feature dim", value, range }.into());
            }
            expect("features", gaussians.len().saturating_mul(f.dim), f.features.len())?;
        }
        Ok(())
    }
}

/// Where the first value is that is not finite.
fn first_bad(values: &[f32]) -> Option<usize> {
    let bad = |chunk: &[f32]| {
        let any = chunk.iter().fold(false, |any, v| any | !v.is_finite());
        if any { chunk.iter().position(|v| !v.is_finite()) } else { None }
    };
    values
        .par_chunks(CHUNK)
        .enumerate()
        .filter_map(|(i, chunk)| bad(chunk).map(|at| i * CHUNK + at))
        .min()
}
