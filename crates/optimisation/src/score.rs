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
    /// dB, of the whole render cut to 0..=1, on the [background](crate::Background::shown) of the settings, as the
    /// picture is where it is transparent; `None` if it is infinite.
    pub psnr: Option<f64>,
    /// The same of the pixels that the mask leaves; `None` without a mask.
    pub psnr_masked: Option<f64>,
    /// The same after the gain and offset of each channel that fit best, of scenes whose exposure was learned: the
    /// camera's exposure of this picture is not the scene's. `None` otherwise.
    pub psnr_corrected: Option<f64>,
    /// Of the whole render, with the border of the settings.
    pub ssim: Option<f64>,
    /// The same where all that does not count is as it should be; `None` without a mask.
    pub ssim_masked: Option<f64>,
    /// Mean `|Σ w z − measured|`, units of the scene, over all measured pixels.
    pub depth_l1: Option<f64>,
    /// The same of the expected depth, `Σ w z / Σ w`.
    pub depth_l1_expected: Option<f64>,
    /// Part of the pixels that show something with less than 0.9 of the light taken, 0 to 1.
    pub holes: f64,
}

/// Means over frames.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct MeanScore {
    /// Frames.
    pub frames: usize,
    /// dB.
    pub psnr: Option<f64>,
    /// dB, of what masks leave.
    pub psnr_masked: Option<f64>,
    /// dB.
    pub psnr_corrected: Option<f64>,
    /// −1 to 1.
    pub ssim: Option<f64>,
    /// −1 to 1, of what masks leave.
    pub ssim_masked: Option<f64>,
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
            psnr_masked: mean(|s| s.psnr_masked),
            psnr_corrected: mean(|s| s.psnr_corrected),
            ssim: mean(|s| s.ssim),
            ssim_masked: mean(|s| s.ssim_masked),
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
    let size = [frame.view.width as usize, frame.view.height as usize];
    let mut truth = Vec::new();
    frame.put_over(settings.background.shown(), &mut truth);
    let pred = picture.rgb.as_deref().unwrap_or_default();
    let mask = frame.mask.as_deref();
    let corrected = settings.exposure.then(|| exposed(pred, &truth, mask));
    let score = FrameScore {
        name: frame.name.clone(),
        psnr: decibels(pred, &truth, size)?,
        psnr_masked: match mask {
            Some(mask) => decibels_of(pred, &truth, mask)?,
            None => None,
        },
        psnr_corrected: match corrected {
            Some(fitted) => decibels(&fitted, &truth, size)?,
            None => None,
        },
        ssim: similarity(pred, &truth, size, settings.ssim_border)?,
        ssim_masked: match mask {
            Some(mask) => {
                similarity(&with_masked(pred, &truth, mask), &truth, size, settings.ssim_border)?
            }
            None => None,
        },
        depth_l1: depth_error(frame, picture.depth_accumulated.as_deref()),
        depth_l1_expected: depth_error(frame, picture.depth_expected.as_deref()),
        holes: holes(frame, &picture.transmittance),
    };
    Ok((score, picture))
}

/// PSNR, `None` if it is infinite.
fn decibels(pred: &[f32], truth: &[f32], size: [usize; 2]) -> Result<Option<f64>, OptimiseError> {
    let view = |values| ImageView::new(values, size[0], size[1], 3);
    let db = psnr(view(pred)?, view(truth)?)?;
    Ok(db.is_finite().then_some(db))
}

/// PSNR of the pixels that count, `None` if there is none.
fn decibels_of(pred: &[f32], truth: &[f32], mask: &[u8]) -> Result<Option<f64>, OptimiseError> {
    let counted = |values: &[f32]| -> Vec<f32> {
        let pixels = values.as_chunks::<3>().0.iter().zip(mask);
        pixels.filter(|(_, on)| **on != 0).flat_map(|(pixel, _)| *pixel).collect()
    };
    let (pred, truth) = (counted(pred), counted(truth));
    if pred.is_empty() { Ok(None) } else { decibels(&pred, &truth, [pred.len() / 3, 1]) }
}

/// SSIM, `None` if the picture is too small for it.
fn similarity(
    pred: &[f32],
    truth: &[f32],
    size: [usize; 2],
    padding: SsimPadding,
) -> Result<Option<f64>, OptimiseError> {
    let view = |values| ImageView::new(values, size[0], size[1], 3);
    let fits = size[0].min(size[1]) >= padding.least_side();
    Ok(if fits { Some(ssim(view(pred)?, view(truth)?, padding)?) } else { None })
}

/// A render in which what does not count is as it should be.
fn with_masked(pred: &[f32], truth: &[f32], mask: &[u8]) -> Vec<f32> {
    let pixels = pred.as_chunks::<3>().0.iter().zip(truth.as_chunks::<3>().0).zip(mask);
    pixels.flat_map(|((pred, truth), on)| if *on == 0 { *truth } else { *pred }).collect()
}

/// Mean error of depth over the measured pixels that count, `None` if there is none.
fn depth_error(frame: &TrainingFrame, drawn: Option<&[f32]>) -> Option<f64> {
    let (truth, drawn) = (frame.depth.as_ref()?, drawn?);
    let counts = |i: usize| {
        let on = frame.mask.as_ref().is_none_or(|m| m[i] != 0);
        on && truth[i] > NOTHING && truth[i].is_finite()
    };
    let errors: Vec<f64> = (0..truth.len())
        .filter(|&i| counts(i))
        .map(|i| (f64::from(drawn[i]) - f64::from(truth[i])).abs())
        .collect();
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
}

/// Part of the pixels that show something in the picture and little in the render.
fn holes(frame: &TrainingFrame, transmittance: &[f32]) -> f64 {
    let opaque = |i: &usize| frame.alpha.as_ref().is_none_or(|alpha| alpha[*i] >= 128);
    let shown = (0..transmittance.len()).filter(opaque);
    let holes = shown.clone().filter(|&i| transmittance[i] > 1.0 - HOLE).count();
    holes as f64 / shown.count().max(1) as f64
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
mod tests;
