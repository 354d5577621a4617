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

    #[test]
    fn every_verdict_is_counted_and_written() {
        let (width, height) = (16usize, 12usize);
        // Stripes of that contrast: the wider they are apart in value, the sharper.
        let striped = |i: usize, contrast: u8| {
            let mut frame = frame(view(16, 12), None);
            frame.name = format!("f{i}");
            frame.view.world_to_camera[0][3] = i as f32;
            let value = |p: usize| [100 + contrast, 100 - contrast][p % width % 2];
            frame.rgb = Colors::Bytes((0..width * height).flat_map(|p| [value(p); 3]).collect());
            frame
        };
        let mut frames: Vec<_> = (0..12).map(|i| striped(i, 40)).collect();
        // The weakest goes; a second is kept, for 1 of 9 usable frames may go.
        (frames[3], frames[7]) = (striped(3, 10), striped(7, 20));
        (frames[5], frames[9].view.world_to_camera[0][0]) = (frames[4].clone(), f32::NAN);
        frames[5].name = "f5".to_owned();
        let filter = FrameFilter { max_dropped: 0.15, ..FrameFilter::default() };
        let report = judge_frames(&frames, &filter).unwrap();
        let counts = [
            report.kept,
            report.blurred,
            report.kept_for_coverage,
            report.bad_poses,
            report.duplicates,
        ];
        assert_eq!((counts, report.black), ([9, 1, 1, 1, 1], 0));
        let verdicts: Vec<(&str, bool, &str)> =
            report.frames.iter().map(|f| (f.name.as_str(), f.kept, f.verdict.as_str())).collect();
        assert_eq!(verdicts[0], ("f0", true, "kept"));
        // Laplacians are ± 4 · contrast.. squares of 10 and 20 over 40.
        assert_eq!(verdicts[3], ("f3", false, "blurred (6 % of the sharpness around it)"));
        assert_eq!(verdicts[5], ("f5", false, "same as frame 4"));
        assert_eq!(
            verdicts[7],
            ("f7", true, "kept for coverage (25 % of the sharpness around it)")
        );
        assert_eq!(verdicts[9], ("f9", false, "bad pose"));
        // Between pixels of +40 and −40: ± 160, half of each; in the mirrored picture too.
        assert_eq!((report.frames[0].sharpness, report.frames[3].sharpness), (25_600.0, 1600.0));
        // Means are 100, whatever the contrast.
        assert!(report.exposure_spread.abs() < 1e-12 && report.saturated == 0.0);
    }

    #[test]
    fn a_look_is_at_bytes_of_at_most_640_columns() {
        let mut wide = frame(view(1280, 2), None);
        // Pairs of equal columns: at 640 columns every other one is bright.
        let value = |p: usize| [200u8, 100][p % 1280 / 2 % 2];
        wide.rgb = Colors::Bytes((0..2560).flat_map(|p| [value(p); 3]).collect());
        let look = Look::at(&wide).unwrap();
        assert_eq!((look.sharpness, look.mean), (40_000.0, 150.0));
        // Floats are rounded to bytes, cut to 0 to 1: the same picture has the same hash.
        let (mut bytes, mut floats) = (frame(view(2, 1), None), frame(view(2, 1), None));
        bytes.rgb = Colors::Bytes(vec![0, 255, 128, 1, 2, 250]);
        floats.rgb = Colors::Floats(vec![-1.0, 2.0, 0.5, 0.0041, 0.0078, 0.98]);
        let (a, b) = (Look::at(&bytes).unwrap(), Look::at(&floats).unwrap());
        assert_eq!((a.hash, a.mean, a.saturated), (b.hash, b.mean, 1.0));
        // FNV-1a of a byte: (basis ^ b) · prime.
        bytes.rgb = Colors::Bytes(vec![0, 0, 0, 0, 0, 1]);
        let want = [0u64, 0, 0, 0, 0, 1]
            .iter()
            .fold(14_695_981_039_346_656_037u64, |h, b| (h ^ b).wrapping_mul(1_099_511_628_211));
        let look = Look::at(&bytes).unwrap();
        assert_eq!((look.hash, look.mean, look.saturated), (want, 1.0 / 6.0, 0.0));
        assert_eq!(judge_frames(&[], &FrameFilter::default()).unwrap(), FrameReport::default());
    }
}
