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
        ssim,
        depth_l1: depth(&picture.depth_accumulated),
        depth_l1_expected: depth(&picture.depth_expected),
        holes: holes as f64 / picture.transmittance.len().max(1) as f64,
    };
    Ok((score, picture))
}
