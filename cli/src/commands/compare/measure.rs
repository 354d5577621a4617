//! The numbers of one pair, and their means.

use super::pictures::{Pair, Picture, read};
use super::{Args, MetricArg};
use anyhow::{Context, Result, bail};
use scenesplat::metrics::image::depth::{DepthRange, depth_l1};
use scenesplat::metrics::image::{ImageView, SsimPadding, psnr, ssim};
use scenesplat::models::Lpips;
use serde::Serialize;

/// Numbers of a pair; `None` where they do not apply or were not asked for.
#[derive(Debug, Default, Serialize)]
pub(super) struct Measured {
    pub(super) name: String,
    pub(super) width: usize,
    pub(super) height: usize,
    /// dB; none if the pictures are identical, which has no finite one.
    pub(super) psnr: Option<f64>,
    /// Whether the PSNR is infinite.
    pub(super) identical: bool,
    pub(super) ssim_valid: Option<f64>,
    pub(super) ssim_reflect: Option<f64>,
    pub(super) ssim_zero: Option<f64>,
    pub(super) lpips: Option<f64>,
    /// Units of the scene, over the pixels where both have a depth.
    pub(super) depth_l1: Option<f64>,
    /// Pixels that the depth error is over.
    pub(super) depth_pixels: Option<usize>,
}

/// Means over the pictures that have the number.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    pub(super) images: usize,
    /// Pictures that are identical to their partner; not in the mean of the PSNRs.
    pub(super) identical: usize,
    pub(super) psnr: Option<f64>,
    pub(super) ssim_valid: Option<f64>,
    pub(super) ssim_reflect: Option<f64>,
    pub(super) ssim_zero: Option<f64>,
    pub(super) lpips: Option<f64>,
    pub(super) depth_l1: Option<f64>,
}

impl Summary {
    pub(super) fn of(measured: &[Measured]) -> Self {
        let mean = |value: fn(&Measured) -> Option<f64>| {
            let values: Vec<f64> = measured.iter().filter_map(value).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        Self {
            images: measured.len(),
            identical: measured.iter().filter(|m| m.identical).count(),
            psnr: mean(|m| m.psnr),
            ssim_valid: mean(|m| m.ssim_valid),
            ssim_reflect: mean(|m| m.ssim_reflect),
            ssim_zero: mean(|m| m.ssim_zero),
            lpips: mean(|m| m.lpips),
            depth_l1: mean(|m| m.depth_l1),
        }
    }
}

/// Reads and compares a pair.
pub(super) fn measure(args: &Args, pair: &Pair, lpips: Option<&Lpips>) -> Result<Measured> {
    let (a, b) = (read(&pair.a, args.depth_scale)?, read(&pair.b, args.depth_scale)?);
    let (size_a, size_b) = match (&a, &b) {
        (Picture::Color { size: a, .. }, Picture::Color { size: b, .. })
        | (Picture::Depth { size: a, .. }, Picture::Depth { size: b, .. }) => (*a, *b),
        _ => bail!("{}: one is a 16-bit picture of depth, the other colour", pair.name),
    };
    if size_a != size_b {
        let [[w, h], [v, g]] = [size_a, size_b];
        bail!("{}: sizes differ, {w} × {h} against {v} × {g}; render at the same size", pair.name);
    }
    let [width, height] = size_a;
    let mut out = Measured { name: pair.name.clone(), width, height, ..Measured::default() };
    match (a, b) {
        (Picture::Color { values: a, .. }, Picture::Color { values: b, .. }) => {
            colors(args, &mut out, [&a, &b], lpips).with_context(|| pair.name.clone())?;
        }
        (Picture::Depth { values: a, .. }, Picture::Depth { values: b, .. }) => {
            depths(args, &mut out, [&a, &b]).with_context(|| pair.name.clone())?;
        }
        _ => {}
    }
    Ok(out)
}

fn depths(args: &Args, out: &mut Measured, [a, b]: [&[f32]; 2]) -> Result<()> {
    if !args.wants(MetricArg::Depth) {
        return Ok(());
    }
    // No depth is 0 in both.
    let mask: Vec<bool> = a.iter().map(|d| *d > 0.0).collect();
    let range = DepthRange { min: 0.0, max: f32::INFINITY };
    let error = depth_l1(a, b, Some(&mask), range)?;
    out.depth_l1 = error.map(|e| e.mean);
    out.depth_pixels = Some(error.map_or(0, |e| e.count));
    Ok(())
}

fn colors(
    args: &Args,
    out: &mut Measured,
    [a, b]: [&[f32]; 2],
    lpips: Option<&Lpips>,
) -> Result<()> {
    let (width, height) = (out.width, out.height);
    let views = [a, b].map(|v| ImageView::new(v, width, height, 3));
    let [pred, truth] = views;
    let (pred, truth) = (pred?, truth?);
    if args.wants(MetricArg::Psnr) {
        let value = psnr(pred, truth)?;
        out.identical = value.is_infinite();
        out.psnr = value.is_finite().then_some(value);
    }
    if args.wants(MetricArg::Ssim) {
        let value = |padding: SsimPadding| -> Result<Option<f64>> {
            // A picture smaller than the window has no such number.
            let fits = width.min(height) >= padding.least_side();
            Ok(if fits { Some(ssim(pred, truth, padding)?) } else { None })
        };
        out.ssim_valid = value(SsimPadding::Valid)?;
        out.ssim_reflect = value(SsimPadding::Reflect)?;
        out.ssim_zero = value(SsimPadding::Zero)?;
    }
    if let Some(lpips) = lpips {
        out.lpips = Some(lpips.distance(a, b, width, height)?);
    }
    Ok(())
}
