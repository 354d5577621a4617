//! Scores by hand.

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
    assert!(flat.iter().zip([0.2f32, 0.4, 0.6, 0.2, 0.4, 0.6]).all(|(a, b)| (a - b).abs() < 1e-6));
}

#[test]
fn what_is_fitted_stays_a_picture() {
    // One gain from the first two pixels; the third, which is masked, would be 1.5 and the fourth -0.5.
    let pred: Vec<f32> = [0.25, 0.75, 1.0, 0.0].iter().flat_map(|v| [*v; 3]).collect();
    let truth: Vec<f32> = [0.0, 1.0, 0.0, 0.0].iter().flat_map(|v| [*v; 3]).collect();
    let fitted = exposed(&pred, &truth, Some(&[1, 1, 0, 0]));
    let want: Vec<f32> = [0.0, 1.0, 1.0, 0.0].iter().flat_map(|v| [*v; 3]).collect();
    assert!(fitted.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-6), "{fitted:?}");
}

#[test]
fn accumulated_and_expected_depth_are_scored_by_themselves() {
    let settings = OptimiseSettings::scenesplat();
    // Half opaque, 2 away, before a measurement of 2 in the middle of the picture.
    let stored = crate::Stored {
        mean: [0.0; 3],
        log_scale: [0.0; 3],
        quat: [1.0, 0.0, 0.0, 0.0],
        logit: 0.0,
    };
    let harmonics = 3 * (usize::from(settings.initial.sh_degree) + 1).pow(2);
    let model =
        Model::from_arrays(&[stored], vec![0.0; harmonics], settings.initial.sh_degree).unwrap();
    let mut frame = crate::frame::tests::frame(crate::frame::tests::view(16, 12), Some(2.0));
    let mut mask = vec![0; 16 * 12];
    mask[6 * 16 + 8] = 1;
    frame.mask = Some(mask);
    let (score, _) = score_frame(&model, &frame, &settings, 0).unwrap();
    let (accumulated, expected) = (score.depth_l1.unwrap(), score.depth_l1_expected.unwrap());
    assert!((accumulated - 1.0).abs() < 0.05 && expected < 1e-3, "{accumulated} {expected}");
}

/// A picture of flat color before a camera, and what is measured of it.
#[test]
fn every_score_by_hand() {
    use crate::Colors;
    let mut frame = crate::frame::tests::frame(crate::frame::tests::view(12, 8), Some(2.0));
    let pixels = 12 * 8;
    frame.rgb = Colors::Floats((0..3 * pixels).map(|k| 0.1 + 0.25 * (k % 3) as f32).collect());
    frame.alpha = Some((0..pixels).map(|i| if i % 12 < 3 { 127 } else { 128 }).collect());
    frame.mask = Some((0..pixels).map(|i| u8::from(i / 12 < 2)).collect());
    frame.depth = Some((0..pixels).map(|i| [0.01, 1.5, f32::NAN, 3.0][i % 4]).collect());
    // Nothing is drawn: all that is seen is the background.
    let row = crate::Stored {
        mean: [0.0, 0.0, -9.0],
        log_scale: [0.0; 3],
        quat: [1.0, 0.0, 0.0, 0.0],
        logit: 0.0,
    };
    let model = Model::from_arrays(&[row], vec![0.0; 3], 0).unwrap();
    let background = crate::Background::Fixed([0.5, 0.25, 0.75]);
    let settings = OptimiseSettings {
        background,
        ssim_border: SsimPadding::Zero,
        exposure: true,
        ..OptimiseSettings::scenesplat()
    };
    let (score, picture) = score_frame(&model, &frame, &settings, 0).unwrap();
    assert_eq!(picture.rgb.as_deref().unwrap()[..3], [0.5, 0.25, 0.75]);
    let mut truth = Vec::new();
    frame.put_over([0.5, 0.25, 0.75], &mut truth);
    let squares = |of: std::ops::Range<usize>| {
        let n = of.len() as f64;
        of.map(|k| (f64::from(truth[k]) - [0.5, 0.25, 0.75][k % 3]).powi(2)).sum::<f64>() / n
    };
    let close = |got: Option<f64>, want: f64| {
        assert!((got.unwrap() - want).abs() < 1e-4, "{got:?} {want}");
    };
    close(score.psnr, -10.0 * squares(0..3 * pixels).log10());
    // The first two rows are on.
    close(score.psnr_masked, -10.0 * squares(0..3 * 24).log10());
    assert_ne!(score.psnr, score.psnr_masked);
    // Flat colors get the mean of what the mask leaves; a quarter of each row is a little less opaque.
    assert!(score.psnr_corrected.unwrap() > score.psnr.unwrap() + 10.0, "{score:?}");
    let pred: Vec<f32> = (0..3 * pixels).map(|k| [0.5, 0.25, 0.75][k % 3]).collect();
    let view = |v| ImageView::new(v, 12, 8, 3).unwrap();
    close(score.ssim, ssim(view(&pred), view(&truth), SsimPadding::Zero).unwrap());
    let mixed = [&pred[..3 * 24], &truth[3 * 24..]].concat();
    close(score.ssim_masked, ssim(view(&mixed), view(&truth), SsimPadding::Zero).unwrap());
    // Half of the measured depths that count are 1.5 and half 3; drawn is 0.
    assert_eq!((score.depth_l1, score.depth_l1_expected), (Some(2.25), Some(2.25)));
    // All that is opaque is a hole.
    assert_eq!(score.holes, 1.0);
    let plain = OptimiseSettings { exposure: false, ssim_border: SsimPadding::Valid, ..settings };
    frame.mask = None;
    let (score, _) = score_frame(&model, &frame, &plain, 0).unwrap();
    let none = [score.psnr_masked, score.psnr_corrected, score.ssim, score.ssim_masked];
    assert_eq!((none, score.depth_l1), ([None; 4], Some(2.25)));
    frame.depth = None;
    assert_eq!(score_frame(&model, &frame, &plain, 0).unwrap().0.depth_l1, None);
    assert_eq!(decibels(&[0.5; 3], &[0.5; 3], [1, 1]).unwrap(), None);
    assert_eq!(decibels_of(&[0.5; 3], &[0.1; 3], &[0]).unwrap(), None);
}

#[test]
fn holes_are_where_something_opaque_is_shown_with_less_than_nine_tenths() {
    let mut frame = crate::frame::tests::frame(crate::frame::tests::view(4, 1), None);
    let light = [0.2, 0.11, 0.09, 0.9];
    assert_eq!(holes(&frame, &light), 0.75);
    frame.alpha = Some(vec![127, 128, 255, 0]);
    assert_eq!(holes(&frame, &light), 0.5);
    frame.alpha = Some(vec![0; 4]);
    assert_eq!(holes(&frame, &light), 0.0);
}

#[test]
fn drawn_pictures_are_cut_to_what_can_be_shown_and_use_the_bands_they_are_told() {
    let row = crate::Stored {
        mean: [0.0; 3],
        log_scale: [1.0; 3],
        quat: [1.0, 0.0, 0.0, 0.0],
        logit: 9.0,
    };
    // Red far above 1, green below 0; blue of the second band alone.
    let mut sh = vec![0.0; 12];
    (sh[0], sh[1], sh[2]) = (9.0, -9.0, 0.0);
    (sh[5], sh[8], sh[11]) = (0.4, 0.4, 0.4);
    let model = Model::from_arrays(&[row], sh, 1).unwrap();
    let frame = crate::frame::tests::frame(crate::frame::tests::view(16, 12), None);
    let raster = OptimiseSettings::scenesplat().raster();
    let at = |degree| drawn(&model, &frame, &raster, degree).unwrap().rgb.unwrap();
    let middle = 3 * (6 * 16 + 8);
    let (plain, bands) = (at(0), at(1));
    assert!(plain.iter().chain(&bands).all(|v| (0.0..=1.0).contains(v)));
    assert!(
        plain[middle] > 0.9 && plain[middle + 1] == 0.0 && (plain[middle + 2] - 0.5).abs() < 0.02
    );
    assert!((bands[middle + 2] - plain[middle + 2]).abs() > 0.05, "{}", bands[middle + 2]);
    let both = drawn(&model, &frame, &raster, 0).unwrap();
    assert!(both.depth_accumulated.is_some() && both.depth_expected.is_some());
}

#[test]
fn a_mean_is_over_the_frames_that_have_a_score() {
    let score = |k: f64| FrameScore {
        name: String::new(),
        psnr: Some(k),
        psnr_masked: Some(10.0 * k),
        psnr_corrected: None,
        ssim: Some(100.0 * k),
        ssim_masked: Some(1000.0 * k),
        depth_l1: Some(-k),
        depth_l1_expected: Some(-10.0 * k),
        holes: 0.1 * k,
    };
    let one = FrameScore { psnr: None, psnr_corrected: Some(7.0), ..score(2.0) };
    let want = MeanScore {
        frames: 2,
        psnr: Some(4.0),
        psnr_masked: Some(30.0),
        psnr_corrected: Some(7.0),
        ssim: Some(300.0),
        ssim_masked: Some(3000.0),
        depth_l1: Some(-3.0),
        depth_l1_expected: Some(-30.0),
        holes: 0.3,
    };
    let found = MeanScore::of(&[one, score(4.0)]);
    assert!((found.holes - 0.3).abs() < 1e-12);
    assert_eq!(MeanScore { holes: 0.3, ..found }, want);
    assert_eq!(MeanScore::of(&[]), MeanScore::default());
}
