//! Sharpness and the choice of frames.

use crate::support::{close, in_all_pools, rng};
use rand::Rng;
use scenesplat_metrics::image::frame_filter::{CapturedFrame, FrameFilter, FrameVerdict};
use scenesplat_metrics::image::sharpness::{GrayImage, shrink_to_width, variance_of_laplacian};
use scenesplat_test_support::Golden;

#[test]
fn sharpness_of_the_goldens() {
    let Some(golden) = Golden::raster("optimise") else { return };
    let frames = golden.ints::<u8>("blur_gray_u8");
    let expected = &golden.entry()["scalars"]["blur_variance_of_laplacian"];
    for (i, frame) in frames.chunks(72 * 108).enumerate() {
        let image = GrayImage::new(frame.to_vec(), 108).unwrap();
        let got = in_all_pools(|| variance_of_laplacian(&image).to_bits());
        let expected = expected[i].as_f64().unwrap();
        close(f64::from_bits(got), expected, 1e-9 * expected, "variance of the Laplacian");
    }
}

/// The Laplacian by its definition, with mirrored indices.
fn slow_variance(image: &GrayImage) -> f64 {
    let (w, h) = (image.width() as i64, image.height() as i64);
    let mirror = |i: i64, len: i64| match i {
        _ if len == 1 => 0,
        -1 => 1,
        i if i == len => len - 2,
        i => i,
    };
    let at = |x: i64, y: i64| f64::from(image.values()[(mirror(y, h) * w + mirror(x, w)) as usize]);
    let values: Vec<f64> = (0..h)
        .flat_map(|y| (0..w).map(move |x| (x, y)))
        .map(|(x, y)| at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1) - 4.0 * at(x, y))
        .collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64
}

#[test]
fn sharpness_of_small_and_odd_pictures() {
    let mut rng = rng(5);
    for (width, height) in [(1, 1), (1, 2), (2, 1), (1, 9), (9, 1), (2, 2), (3, 3), (17, 5)] {
        let values = (0..width * height).map(|_| rng.random()).collect();
        let image = GrayImage::new(values, width).unwrap();
        let expected = slow_variance(&image);
        close(variance_of_laplacian(&image), expected, 1e-9 * expected.max(1.0), "variance");
    }
    assert!(GrayImage::new(vec![], 4).is_err());
    assert!(GrayImage::new(vec![1; 4], 0).is_err());
    assert!(GrayImage::new(vec![1; 5], 2).is_err());
}

#[test]
fn grey_and_shrinking() {
    let rgb = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255; 3], [0; 3], [1, 1, 1]];
    assert_eq!(GrayImage::from_rgb(&rgb, 3).unwrap().values(), [76, 150, 29, 255, 0, 1]);
    // Two by two pixels become one; 5 columns become 2 of 2½.
    let image = GrayImage::new(vec![0, 4, 8, 12, 16, 20, 24, 28], 4).unwrap();
    assert_eq!(shrink_to_width(&image, 2).unwrap().values(), [10, 18]);
    let row = GrayImage::new(vec![10, 20, 30, 40, 50], 5).unwrap();
    assert_eq!(shrink_to_width(&row, 2).unwrap().values(), [18, 42]);
    assert_eq!(shrink_to_width(&row, 1).unwrap().values(), [30]);
    assert_eq!(shrink_to_width(&row, 5).unwrap(), row);
    assert_eq!(shrink_to_width(&row, 9).unwrap(), row);
    assert!(shrink_to_width(&row, 0).is_err());
    // What is flat stays flat to the last byte.
    let flat = GrayImage::new(vec![201; 97 * 41], 97).unwrap();
    for width in 1..97 {
        let small = shrink_to_width(&flat, width).unwrap();
        assert!(small.values().iter().all(|v| *v == 201), "{width}");
        assert_eq!(small.width(), width);
    }
}

fn pose(i: usize) -> Option<[[f64; 4]; 3]> {
    Some([[1.0, 0.0, 0.0, i as f64], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
}

fn frames(sharpness: &[f64]) -> Vec<CapturedFrame> {
    let frame =
        |(i, s): (usize, &f64)| CapturedFrame { sharpness: *s, pose: pose(i), image_hash: None };
    sharpness.iter().enumerate().map(frame).collect()
}

fn dropped(verdicts: &[FrameVerdict]) -> Vec<usize> {
    (0..verdicts.len()).filter(|&i| !verdicts[i].is_kept()).collect()
}

#[test]
fn blurred_frames_go_relative_to_their_surroundings() {
    // A textured half and a blank one: the same number is sharp in the second.
    let mut sharpness = vec![1000.0; 40];
    sharpness.extend([100.0; 40]);
    sharpness[10] = 400.0;
    sharpness[60] = 49.0;
    sharpness[70] = 50.0;
    let verdicts = FrameFilter::default().judge(&frames(&sharpness)).unwrap();
    assert_eq!(verdicts[10], FrameVerdict::Blurred { share: 0.4 });
    assert_eq!(verdicts[60], FrameVerdict::Blurred { share: 0.49 });
    assert_eq!(verdicts[70], FrameVerdict::Sharp, "exactly half stays");
    // Behind the step the median of ±15 frames is still the textured one's for 15 frames; the
    // limits of gap and share keep ten of them at most from being lost.
    let lost = dropped(&verdicts);
    assert!(lost.iter().all(|i| [10, 60].contains(i) || (40..55).contains(i)), "{lost:?}");
}

#[test]
fn limits_of_gaps_and_shares() {
    let filter = FrameFilter { half_window: 1000, ..FrameFilter::default() };
    // 12 blurred frames in a row of 100, the first the most.
    let mut sharpness = vec![10.0; 100];
    for (i, s) in sharpness[50..62].iter_mut().enumerate() {
        *s = 1.0 + i as f64 * 0.1;
    }
    let verdicts = filter.judge(&frames(&sharpness)).unwrap();
    // One stays to split the gap; the one behind it begins another.
    assert_eq!(dropped(&verdicts), (50..60).chain([61]).collect::<Vec<_>>());
    assert!(matches!(verdicts[60], FrameVerdict::KeptForCoverage { .. }));
    // Every third frame is blurred, and a tenth of all may go.
    let sharpness: Vec<f64> = (0..90).map(|i| if i % 3 == 0 { 1.0 } else { 10.0 }).collect();
    let tight = FrameFilter { max_dropped: 0.1, ..filter };
    assert_eq!(dropped(&tight.judge(&frames(&sharpness)).unwrap()).len(), 9);
    // A gap that missing poses begin counts.
    let mut half = frames(&[10.0; 40]);
    for f in &mut half[10..20] {
        f.pose = None;
    }
    half[20].sharpness = 1.0;
    half[30].sharpness = 1.0;
    let verdicts = filter.judge(&half).unwrap();
    assert!(matches!(verdicts[20], FrameVerdict::KeptForCoverage { .. }));
    assert!(matches!(verdicts[30], FrameVerdict::Blurred { .. }));
}

#[test]
fn random_captures_keep_the_limits() {
    let mut rng = rng(11);
    for _ in 0..200 {
        let count = rng.random_range(0..120);
        let sharpness: Vec<f64> =
            (0..count).map(|_| 10f64.powf(rng.random_range(-2.0..3.0))).collect();
        let filter = FrameFilter { half_window: rng.random_range(0..30), ..FrameFilter::default() };
        let verdicts = filter.judge(&frames(&sharpness)).unwrap();
        let lost = dropped(&verdicts);
        assert!(lost.len() as f64 <= 0.3 * count as f64);
        let longest = verdicts.chunk_by(|a, b| a.is_kept() == b.is_kept());
        let longest = longest.filter(|run| !run[0].is_kept()).map(<[_]>::len).max();
        assert!(longest.unwrap_or(0) <= 10, "{longest:?}");
    }
}

#[test]
fn poses_duplicates_and_hard_input() {
    let filter = FrameFilter::default();
    assert_eq!(filter.judge(&[]).unwrap(), []);
    assert_eq!(filter.judge(&frames(&[0.0])).unwrap(), [FrameVerdict::Sharp]);
    let mut list = frames(&[5.0; 6]);
    list[1].pose = None;
    list[2].pose = pose(2).map(|mut p| {
        p[1][1] = 0.0;
        p
    });
    list[3].pose = pose(3).map(|mut p| {
        p[2][3] = f64::NAN;
        p
    });
    (list[0].image_hash, list[4].image_hash, list[5].image_hash) = (Some(7), Some(7), Some(7));
    list[5].pose = list[0].pose;
    let verdicts = filter.judge(&list).unwrap();
    assert_eq!(
        verdicts,
        [
            FrameVerdict::Sharp,
            FrameVerdict::NoPose,
            FrameVerdict::BadPose,
            FrameVerdict::BadPose,
            FrameVerdict::Sharp,
            FrameVerdict::Duplicate { of: 0 },
        ]
    );
    assert_eq!(verdicts[5].to_string(), "same as frame 0");
    for bad in [f64::NAN, f64::INFINITY, -1.0] {
        let error = filter.judge(&frames(&[1.0, bad])).unwrap_err().to_string();
        assert!(error.contains("sharpness[1]"), "{error}");
    }
    let wrong = FrameFilter { max_dropped: 1.5, ..filter };
    assert!(wrong.judge(&[]).is_err());
}
