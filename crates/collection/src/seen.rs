//! What a camera shows of a scene, from a small render.

use crate::CollectError;
use scenesplat_rasterizer::{DepthRequest, Gaussians, RasterSettings, RenderRequest, View, render};

/// Longer side of the small picture.
const SIDE: u32 = 96;
/// Gaussians of the sample, about.
const SAMPLE: usize = 40_000;
/// Weight, in pixels of the small picture, from which on a Gaussian is seen.
const LEAST_WEIGHT: f32 = 0.02;

/// What a camera shows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seen {
    /// Numbers of the Gaussians it shows, in a sample of every so-many-th of the scene.
    pub rows: Vec<u32>,
    /// Gaussians of the sample.
    pub sampled: usize,
    /// Part of the light that passes everything, 0 to 1.
    pub open: f32,
    /// Part of the pixels with something nearer than `clearance`, 0 to 1.
    pub near: f32,
}

/// Looks through a camera at a scene, in a picture of at most 96 pixels a side.
///
/// # Errors
/// What the renderer refuses.
pub fn seen_in(gaussians: &Gaussians, view: &View, clearance: f32) -> Result<Seen, CollectError> {
    let small = shrunk(view);
    let request = RenderRequest {
        contributions: true,
        depth: DepthRequest { median: true, ..DepthRequest::default() },
        ..RenderRequest::default()
    };
    let rendered = render(gaussians, &small, &RasterSettings::default(), &request)?;
    let step = gaussians.len().div_ceil(SAMPLE).max(1);
    let weights = rendered.contributions.map(|c| c.sum).unwrap_or_default();
    let sampled: Vec<f32> = weights.into_iter().step_by(step).collect();
    let rows = (0..).zip(&sampled).filter(|(_, w)| **w >= LEAST_WEIGHT).map(|(i, _)| i).collect();
    let pixels = rendered.transmittance.len().max(1) as f32;
    let depth = rendered.depth_median.unwrap_or_default();
    let near = depth.iter().filter(|d| **d > 0.0 && **d < clearance).count() as f32 / pixels;
    let open = rendered.transmittance.iter().sum::<f32>() / pixels;
    Ok(Seen { rows, sampled: sampled.len(), open, near })
}

fn shrunk(view: &View) -> View {
    let longer = view.width.max(view.height);
    if longer <= SIDE {
        return *view;
    }
    let size = |side: u32| ((u64::from(side) * u64::from(SIDE) / u64::from(longer)) as u32).max(1);
    let (width, height) = (size(view.width), size(view.height));
    let (x, y) = (width as f32 / view.width as f32, height as f32 / view.height as f32);
    View {
        fx: view.fx * x,
        fy: view.fy * y,
        cx: view.cx * x,
        cy: view.cy * y,
        width,
        height,
        ..*view
    }
}
