//! What a scene is worth, at frames that it was or was not learned from.

use crate::frame::TrainingFrame;
use crate::settings::OptimiseSettings;
use crate::{Model, OptimiseError};
use scenesplat_metrics::image::{ImageView, SsimPadding, psnr, ssim};
use scenesplat_rasterizer::{DepthRequest, RasterSettings, RenderRequest, Rendered, render};
use serde::Serialize;

/// Least measured depth that counts, units of the scene: as in training.
const NOTHING: f32 = 0.01;
/// Alpha below which a pixel shows a hole.
const HOLE: f32 = 0.9;

/// Scores of one frame. `None` where there is nothing to compare with.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameScore {
    /// Of the frame.
    pub name: String,
    /// dB, of the render cut to 0..=1; `None` if it is infinite.
    pub psnr: Option<f64>,
    /// The same after the gain and offset of each channel that fit best, of scenes whose exposure was learned: the
    /// camera's exposure of this picture is not the scene's. `None` otherwise.
    pub psnr_corrected: Option<f64>,
    /// With the border of the settings.
    pub ssim: Option<f64>,
    /// Mean `|Σ w z − measured|`, units of the scene, over all measured pixels.
    pub depth_l1: Option<f64>,
    /// The same of the expected depth, `Σ w z / Σ w`.
    pub depth_l1_expected: Option<f64>,
    /// Part of the pixels with less than 0.9 of the light taken, 0 to 1.
    pub holes: f64,
}

/// Means over frames.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct MeanScore {
    /// Frames.
    pub frames: usize,
    /// dB.
    pub psnr: Option<f64>,
    /// dB.
    pub psnr_corrected: Option<f64>,
    /// −1 to 1.
    pub ssim: Option<f64>,
    /// Units of the scene.
    pub depth_l1: Option<f64>,
    /// Units of the scene.
    pub depth_l1_expected: Option<f64>,
    /// 0 to 1.
    pub holes: f64,
}

impl MeanScore {
    /// The mean of each score over the frames that have it.
    pub fn of(scores: &[FrameScore]) -> Self {
        let mean = |of: fn(&FrameScore) -> Option<f64>| {
            let values: Vec<f64> = scores.iter().filter_map(of).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        Self {
            frames: scores.len(),
            psnr: mean(|s| s.psnr),
            psnr_corrected: mean(|s| s.psnr_corrected),
            ssim: mean(|s| s.ssim),
            depth_l1: mean(|s| s.depth_l1),
            depth_l1_expected: mean(|s| s.depth_l1_expected),
            holes: mean(|s| Some(s.holes)).unwrap_or(0.0),
        }
    }
}

/// A frame as the scene shows it, with depths.
///
/// # Errors
/// What the rasterizer refuses.
pub fn drawn(
    model: &Model,
    frame: &TrainingFrame,
    raster: &RasterSettings,
    sh_degree: u8,
) -> Result<Rendered, OptimiseError> {
    let depth = DepthRequest { accumulated: true, expected: true, median: false };
    let request = RenderRequest { depth, sh_degree: Some(sh_degree), ..RenderRequest::rgb() };
    let mut picture = render(model.gaussians(), &frame.view, raster, &request)?;
    for v in picture.rgb.iter_mut().flatten() {
        *v = v.clamp(0.0, 1.0);
    }
    Ok(picture)
}

/// Draws a frame and compares.
///
/// # Errors
/// What the rasterizer and the metrics refuse.
pub fn score_frame(
    model: &Model,
    frame: &TrainingFrame,
    settings: &OptimiseSettings,
    sh_degree: u8,
) -> Result<(FrameScore, Rendered), OptimiseError> {
    let picture = drawn(model, frame, &settings.raster(), sh_degree)?;
    let (width, height) = (frame.view.width as usize, frame.view.height as usize);
    let mut truth = Vec::new();
    frame.rgb.put(&mut truth);
    let mut pred = picture.rgb.clone().unwrap_or_default();
    if let Some(mask) = &frame.mask {
        // What does not count is as it should be.
        for (i, _) in mask.iter().enumerate().filter(|(_, on)| **on == 0) {
            pred[3 * i..3 * i + 3].copy_from_slice(&truth[3 * i..3 * i + 3]);
        }
    }
    let views =
        (ImageView::new(&pred, width, height, 3)?, ImageView::new(&truth, width, height, 3)?);
    let db = psnr(views.0, views.1)?;
    let corrected = if settings.exposure {
        let fitted = exposed(&pred, &truth, frame.mask.as_deref());
        Some(psnr(ImageView::new(&fitted, width, height, 3)?, views.1)?)
    } else {
        None
    };
    let padding: SsimPadding = settings.ssim_border;
    let fits = width.min(height) >= padding.least_side();
    let ssim = if fits { Some(ssim(views.0, views.1, padding)?) } else { None };
    let depth = |drawn: &Option<Vec<f32>>| {
        let (truth, drawn) = (frame.depth.as_ref()?, drawn.as_ref()?);
        let counts = |i: usize| {
            let on = frame.mask.as_ref().is_none_or(|m| m[i] != 0);
            on && truth[i] > NOTHING && truth[i].is_finite()
        };
        let errors: Vec<f64> = (0..truth.len())
            .filter(|&i| counts(i))
            .map(|i| (f64::from(drawn[i]) - f64::from(truth[i])).abs())
            .collect();
        (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
    };
    let holes = picture.transmittance.iter().filter(|t| **t > 1.0 - HOLE).count();
    let score = FrameScore {
        name: frame.name.clone(),
        psnr: db.is_finite().then_some(db),
        psnr_corrected: corrected.filter(|db| db.is_finite()),
        ssim,
        depth_l1: depth(&picture.depth_accumulated),
        depth_l1_expected: depth(&picture.depth_expected),
        holes: holes as f64 / picture.transmittance.len().max(1) as f64,
    };
    Ok((score, picture))
}

/// `gain · pred + offset`, cut to 0..=1, with the gain and offset of each channel that come nearest to the truth
/// where the mask is on. A channel without contrast gets an offset alone.
fn exposed(pred: &[f32], truth: &[f32], mask: Option<&[u8]>) -> Vec<f32> {
    let mut out = pred.to_vec();
    for c in 0..3 {
        let counted = || {
            let on = |i: &usize| mask.is_none_or(|mask| mask[*i] != 0);
            let at = |i: usize| (f64::from(pred[3 * i + c]), f64::from(truth[3 * i + c]));
            (0..pred.len() / 3).filter(on).map(at)
        };
        let n = counted().count().max(1) as f64;
        let (x, y) = counted().fold((0.0, 0.0), |(x, y), (p, t)| (x + p / n, y + t / n));
        let (var, cov) = counted().fold((0.0, 0.0), |(var, cov), (p, t)| {
            (var + (p - x).powi(2) / n, cov + (p - x) * (t - y) / n)
        });
        let gain = if var > 1e-12 { cov / var } else { 1.0 };
        for value in out.iter_mut().skip(c).step_by(3) {
            *value = (gain * (f64::from(*value) - x) + y).clamp(0.0, 1.0) as f32;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_and_offset_are_fitted_per_channel() {
        let pred: Vec<f32> = (0..30).map(|i| 0.02 * i as f32).collect();
        let (gain, offset) = ([0.5, 1.2, 1.0], [0.1, 0.0, 0.0]);
        let seen = |i: usize| gain[i % 3] * pred[i] + offset[i % 3];
        let mut truth: Vec<f32> = (0..30).map(seen).collect();
        // What is masked has no say.
        truth[3..6].fill(1.0);
        let mut mask = [1u8; 10];
        mask[1] = 0;
        let fitted = exposed(&pred, &truth, Some(&mask));
        for i in (0..30).filter(|i| !(3..6).contains(i)) {
            assert!((fitted[i] - truth[i]).abs() < 1e-5, "{i}: {} {}", fitted[i], truth[i]);
        }
        // No contrast: the mean moves, nothing divides by zero.
        let flat = exposed(&[0.5; 6], &[0.2, 0.4, 0.6, 0.2, 0.4, 0.6], None);
        assert!(
            flat.iter().zip([0.2f32, 0.4, 0.6, 0.2, 0.4, 0.6]).all(|(a, b)| (a - b).abs() < 1e-6)
        );
    }
}
