//! Frames of a capture: poses, duplicates, blur.

use crate::OptimiseError;
use crate::frame::{Colors, TrainingFrame};
use rayon::prelude::*;
use scenesplat_metrics::image::frame_filter::{CapturedFrame, FrameFilter, FrameVerdict};
use scenesplat_metrics::image::sharpness::{GrayImage, shrink_to_width, variance_of_laplacian};
use serde::Serialize;

/// Width at which sharpness is compared, pixels.
const WIDTH: usize = 640;

/// A frame with its verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JudgedFrame {
    /// Of the frame.
    pub name: String,
    /// Variance of the Laplacian at up to 640 pixels of width.
    pub sharpness: f64,
    /// Whether it is used.
    pub kept: bool,
    /// Why, or why not.
    pub verdict: String,
}

/// All frames of a capture.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FrameReport {
    /// In their order.
    pub frames: Vec<JudgedFrame>,
    /// Frames that are used.
    pub kept: usize,
    /// Dropped as blurred.
    pub blurred: usize,
    /// Kept although blurred: too many in a row would be missing.
    pub kept_for_coverage: usize,
    /// Dropped for their pose.
    pub bad_poses: usize,
    /// Dropped as another's copy.
    pub duplicates: usize,
    /// Frames without a pixel above black.
    pub black: usize,
    /// Mean over frames of their brightness over that of all, standard deviation: automatic exposure.
    pub exposure_spread: f64,
    /// Part of the pixels with a channel of 250 and more, 0 to 1.
    pub saturated: f64,
}

/// Judges frames by the relative rule of [`FrameFilter`].
///
/// # Errors
/// If a setting of the filter is out of range.
pub fn judge_frames(
    frames: &[TrainingFrame],
    filter: &FrameFilter,
) -> Result<FrameReport, OptimiseError> {
    let looks: Result<Vec<Look>, OptimiseError> = frames.par_iter().map(Look::at).collect();
    let looks = looks?;
    let captured: Vec<CapturedFrame> = frames
        .iter()
        .zip(&looks)
        .map(|(frame, look)| CapturedFrame {
            sharpness: look.sharpness,
            pose: Some(frame.view.world_to_camera.map(|row| row.map(f64::from))),
            image_hash: Some(look.hash),
        })
        .collect();
    let verdicts = filter.judge(&captured)?;
    let count = |of: fn(&FrameVerdict) -> bool| verdicts.iter().filter(|v| of(v)).count();
    let seen: Vec<f64> = looks.iter().map(|l| l.mean).filter(|m| *m > 0.0).collect();
    let n = seen.len().max(1) as f64;
    let mean = seen.iter().sum::<f64>() / n;
    let spread = (seen.iter().map(|m| (m / mean - 1.0).powi(2)).sum::<f64>() / n).sqrt();
    Ok(FrameReport {
        kept: count(|v| v.is_kept()),
        blurred: count(|v| matches!(v, FrameVerdict::Blurred { .. })),
        kept_for_coverage: count(|v| matches!(v, FrameVerdict::KeptForCoverage { .. })),
        bad_poses: count(|v| matches!(v, FrameVerdict::NoPose | FrameVerdict::BadPose)),
        duplicates: count(|v| matches!(v, FrameVerdict::Duplicate { .. })),
        black: looks.iter().filter(|l| l.mean == 0.0).count(),
        exposure_spread: if seen.is_empty() { 0.0 } else { spread },
        saturated: looks.iter().map(|l| l.saturated).sum::<f64>() / looks.len().max(1) as f64,
        frames: frames
            .iter()
            .zip(&looks)
            .zip(&verdicts)
            .map(|((frame, look), verdict)| JudgedFrame {
                name: frame.name.clone(),
                sharpness: look.sharpness,
                kept: verdict.is_kept(),
                verdict: verdict.to_string(),
            })
            .collect(),
    })
}

/// What a picture says by itself.
struct Look {
    sharpness: f64,
    hash: u64,
    mean: f64,
    saturated: f64,
}

impl Look {
    fn at(frame: &TrainingFrame) -> Result<Self, OptimiseError> {
        let bytes: Vec<u8> = match &frame.rgb {
            Colors::Bytes(values) => values.clone(),
            Colors::Floats(v) => {
                v.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect()
            }
        };
        let pixels = bytes.as_chunks::<3>().0;
        let gray = GrayImage::from_rgb(pixels, frame.view.width as usize)?;
        let small = shrink_to_width(&gray, WIDTH)?;
        let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h: u64, b| {
            (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3)
        });
        let n = pixels.len().max(1) as f64;
        Ok(Self {
            sharpness: variance_of_laplacian(&small),
            hash,
            mean: bytes.iter().map(|b| f64::from(*b)).sum::<f64>() / (3.0 * n),
            saturated: pixels.iter().filter(|p| p.iter().any(|v| *v >= 250)).count() as f64 / n,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Colors;
    use crate::frame::tests::{frame, view};

    #[test]
    fn exposure_spread_is_the_deviation_of_mean_brightness() {
        let gray = |value: u8| {
            let mut frame = frame(view(16, 12), None);
            frame.rgb = Colors::Bytes(vec![value; 3 * 16 * 12]);
            frame
        };
        // A half, one and one and a half times the mean; a black frame has no exposure.
        let frames = [gray(50), gray(100), gray(150), gray(0)];
        let report = judge_frames(&frames, &FrameFilter::default()).unwrap();
        let want = (0.5f64 / 3.0).sqrt();
        assert!((report.exposure_spread - want).abs() < 1e-3, "{} {want}", report.exposure_spread);
        assert_eq!(report.black, 1);
    }

    #[test]
    fn one_channel_at_its_end_is_enough_to_be_saturated() {
        let mut frame = frame(view(16, 12), None);
        // A quarter of the pixels is red, another white, the others just below.
        let pixel = |i: usize| [[255, 0, 0], [255; 3], [249; 3], [0, 249, 0]][i % 4];
        frame.rgb = Colors::Bytes((0..16 * 12).flat_map(pixel).collect());
        let report = judge_frames(&[frame], &FrameFilter::default()).unwrap();
        assert!((report.saturated - 0.5).abs() < 1e-9, "{}", report.saturated);
    }
}
