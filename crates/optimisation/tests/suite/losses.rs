//! L1, SSIM with each border, depth.

use crate::support::{golden, number, picture};
use scenesplat_metrics::image::depth::{SamplePosition, sparse_disparity_l1};
use scenesplat_metrics::image::{ImageView, l1_with_gradient, ssim_with_gradient};
use scenesplat_optimisation::depth_loss::{DepthOutliers, DepthScratch, depth_loss};
use scenesplat_optimisation::{ImageComparison, ImageLoss, ImageWeights, SsimPadding};
use scenesplat_test_support::compare_relative as compare;

/// Of a loss, absolute.
const VALUE: f64 = 2e-6;
/// Of a gradient, relative to its largest value: sums of 121 products in f32, variances as differences.
const GRADIENT: f64 = 2e-5;

fn run(
    pred: &[f32],
    truth: &[f32],
    width: usize,
    ssim: f32,
    padding: SsimPadding,
) -> (ImageLoss, Vec<f32>) {
    let height = pred.len() / 3 / width;
    let weights = ImageWeights { ssim, padding };
    let mut comparison = ImageComparison::new(width, height, weights).unwrap();
    let mut gradient = vec![9.0; pred.len()];
    let loss = comparison.compare(pred, truth, None, &mut gradient).unwrap();
    (loss, gradient)
}

fn as_f64(values: &[f32]) -> Vec<f64> {
    values.iter().map(|v| f64::from(*v)).collect()
}

#[test]
fn image_goldens() {
    let Some(golden) = golden() else { return };
    let (pred, truth) = (picture(&golden, "img_pred"), picture(&golden, "img_gt"));
    let close = |name: &str, got: f64| {
        let want = number(&golden, &format!("/image/{name}"));
        assert!((got - want).abs() < VALUE, "{name}: {got}, not {want}");
    };
    for (padding, name) in [(SsimPadding::Zero, "zero"), (SsimPadding::Valid, "valid")] {
        let (loss, gradient) = run(&pred, &truth, 96, 0.2, padding);
        close("l1", loss.l1);
        close("mse", loss.mse);
        close(&format!("loss_{name}"), loss.loss);
        let want = as_f64(&picture(&golden, &format!("grad_loss_{name}")));
        compare(&format!("loss, {name}"), &gradient, &want, GRADIENT);
        // With λ = 1 the loss is 1 − SSIM; the fixture is the gradient of SSIM.
        let (loss, gradient) = run(&pred, &truth, 96, 1.0, padding);
        let key = if name == "zero" { "ssim_zero_pad" } else { "ssim_valid" };
        close(key, loss.ssim);
        let want: Vec<f64> =
            picture(&golden, &format!("grad_ssim_{name}")).iter().map(|v| -f64::from(*v)).collect();
        compare(&format!("ssim, {name}"), &gradient, &want, GRADIENT);
    }
    let (loss, _) = run(&pred, &truth, 96, 0.2, SsimPadding::Reflect);
    close("ssim_reflect_clamped_full", loss.ssim);
}

/// Pictures of odd sizes, with flat and bright parts.
fn pictures(width: usize, height: usize) -> [Vec<f32>; 2] {
    let value = |i: usize, seed: f64| {
        let (x, y, c) = (i / 3 % width, i / 3 / width, i % 3);
        let noise = ((i as f64 + seed) * 12.9898).sin() * 43_758.545;
        let flat = if x * 2 > width { 0.9 } else { 0.3 + 0.3 * (y as f64 / 4.0 + c as f64).sin() };
        (flat + 0.2 * (noise - noise.floor() - 0.5) * f64::from(u8::from(x * 3 < 2 * width))) as f32
    };
    [0.0, 0.37].map(|seed| (0..3 * width * height).map(|i| value(i, seed)).collect())
}

/// Against the f64 implementation of the metrics crate, for each border, at sizes around the window.
#[test]
fn every_border_against_f64() {
    for padding in SsimPadding::ALL {
        for [width, height] in [[11, 11], [12, 23], [21, 17], [37, 11], [64, 40]] {
            let [pred, truth] = pictures(width, height);
            let view = |v| ImageView::new(v, width, height, 3).unwrap();
            let (ssim, slope) = ssim_with_gradient(view(&pred), view(&truth), padding).unwrap();
            let (l1, l1_slope) = l1_with_gradient(view(&pred), view(&truth)).unwrap();
            let (loss, gradient) = run(&pred, &truth, width, 0.2, padding);
            assert!((loss.ssim - ssim).abs() < 2e-5, "{padding} {width}: {} {ssim}", loss.ssim);
            assert!((loss.l1 - l1).abs() < VALUE);
            assert!((loss.loss - (0.8 * l1 + 0.2 * (1.0 - ssim))).abs() < 1e-5);
            let want: Vec<f64> = slope
                .iter()
                .zip(&l1_slope)
                .map(|(s, l)| 0.8 * f64::from(*l) - 0.2 * f64::from(*s))
                .collect();
            compare(&format!("{padding} {width} × {height}"), &gradient, &want, 1e-3);
        }
    }
}

#[test]
fn small_pictures_are_refused_by_name() {
    let weights = ImageWeights { ssim: 0.2, padding: SsimPadding::Valid };
    let error = ImageComparison::new(10, 40, weights).unwrap_err().to_string();
    assert!(error.contains("10 × 40") && error.contains("11"), "{error}");
    let zero = ImageWeights { padding: SsimPadding::Zero, ..weights };
    assert!(ImageComparison::new(1, 1, zero).is_ok());
    assert!(ImageComparison::new(20, 20, ImageWeights { ssim: f32::NAN, ..weights }).is_err());
}

/// What a mask leaves out has no gradient, and does not count.
#[test]
fn masks() {
    let [pred, truth] = pictures(24, 20);
    let mask: Vec<u8> = (0..24 * 20).map(|i| u8::from(i % 24 > 5)).collect();
    let weights = ImageWeights { ssim: 0.2, padding: SsimPadding::Reflect };
    let mut comparison = ImageComparison::new(24, 20, weights).unwrap();
    let mut gradient = vec![0.0; pred.len()];
    let loss = comparison.compare(&pred, &truth, Some(&mask), &mut gradient).unwrap();
    let mut other = truth.clone();
    for (i, pixel) in other.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        if mask[i] == 0 {
            *pixel = [0.123; 3];
        }
    }
    let mut again = vec![0.0; pred.len()];
    assert_eq!(comparison.compare(&pred, &other, Some(&mask), &mut again).unwrap(), loss);
    assert_eq!(gradient, again);
    let (mut sum, mut count) = (0.0, 0);
    for (i, on) in mask.iter().enumerate() {
        let values = 3 * i..3 * i + 3;
        if *on == 0 {
            assert!(gradient[values].iter().all(|g| *g == 0.0));
        } else {
            sum += values.clone().map(|k| f64::from((pred[k] - truth[k]).abs())).sum::<f64>();
            count += 3;
        }
    }
    assert!((loss.l1 - sum / f64::from(count)).abs() < 1e-7);
    let nothing = vec![0; 24 * 20];
    let loss = comparison.compare(&pred, &truth, Some(&nothing), &mut gradient).unwrap();
    assert!(loss.l1 == 0.0 && gradient.iter().all(|g| *g == 0.0));
}

#[test]
fn threads_do_not_change_a_bit() {
    let [pred, truth] = pictures(50, 70);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&pred, &truth, 50, 0.2, SsimPadding::Valid))
    };
    assert_eq!(on(1), on(2));
    assert_eq!(on(1), on(5));
}

#[test]
fn depth_goldens() {
    let Some(golden) = golden() else { return };
    let (pred, truth) = (golden.f32s("depth_map"), golden.f32s("depth_dense_gt"));
    let mut gradient = vec![0.0; pred.len()];
    let scratch = &mut DepthScratch::default();
    let keep = DepthOutliers::Keep;
    let loss = depth_loss(&pred, &truth, None, keep, 1.0, scratch, &mut gradient).unwrap();
    assert!((loss.mean - number(&golden, "/depth/dense_metric_l1")).abs() < VALUE);
    assert_eq!(loss.count as f64, number(&golden, "/depth/dense_valid"));
    compare("dense depth", &gradient, &golden.f64s("grad_depth_dense"), 1e-6);
    // The rule of the authors, by hand.
    let rule = DepthOutliers::MedianRule;
    let loss = depth_loss(&pred, &truth, None, rule, 0.5, scratch, &mut gradient).unwrap();
    let errors: Vec<f64> = pred
        .iter()
        .zip(&truth)
        .filter(|(_, t)| **t > 0.01)
        .map(|(p, t)| f64::from(*t) - f64::from(*p))
        .collect();
    let mut sorted = errors.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[(sorted.len() - 1) / 2];
    assert!(median < 0.0, "this fixture is of the second kind");
    let kept: Vec<f64> = errors.into_iter().map(f64::abs).filter(|e| *e < 2.0).collect();
    assert_eq!(loss.count, kept.len());
    assert!((loss.mean - kept.iter().sum::<f64>() / kept.len() as f64).abs() < VALUE);
    let sum: f64 = gradient.iter().map(|g| f64::from(g.abs())).sum();
    assert!((sum - 0.5).abs() < 1e-4);
    let (points, depths) = (golden.rows::<2>("depth_pts"), golden.f32s("depth_pts_gt"));
    let scale = number(&golden, "/depth/scene_scale");
    let position = SamplePosition::Gsplat;
    let (loss, slope) = sparse_disparity_l1(&pred, 96, &points, &depths, scale, position).unwrap();
    assert!((loss - number(&golden, "/depth/sparse_disparity_l1")).abs() < VALUE);
    compare("sparse depth", &slope, &golden.f64s("grad_depth_sparse"), 1e-5);
}

/// With a mask both pictures are black where it is off; against the f64 implementation, in bands of several rows, with
/// memory that another comparison has left.
#[test]
fn masked_pictures_against_f64() {
    let (width, height) = (17, 150);
    let [pred, truth] = pictures(width, height);
    let mask: Vec<u8> = (0..width * height).map(|i| 2 * u8::from(i % 7 > 1)).collect();
    let black = |of: &[f32]| -> Vec<f32> {
        (0..of.len()).map(|k| if mask[k / 3] == 0 { 0.0 } else { of[k] }).collect()
    };
    for padding in SsimPadding::ALL {
        let weights = ImageWeights { ssim: 0.3, padding };
        let mut comparison = ImageComparison::new(width, height, weights).unwrap();
        assert_eq!(comparison.size(), [17, 150]);
        let mut gradient = vec![5.0; pred.len()];
        for masked in [false, true, false] {
            let (a, b) =
                if masked { (black(&pred), black(&truth)) } else { (pred.clone(), truth.clone()) };
            let view = |v| ImageView::new(v, width, height, 3).unwrap();
            let (ssim, slope) = ssim_with_gradient(view(&a), view(&b), padding).unwrap();
            let on = if masked { Some(&mask[..]) } else { None };
            let loss = comparison.compare(&pred, &truth, on, &mut gradient).unwrap();
            let counts = |k: usize| !masked || mask[k / 3] != 0;
            let errors: Vec<f64> = (0..pred.len())
                .filter(|k| counts(*k))
                .map(|k| f64::from(pred[k]) - f64::from(truth[k]))
                .collect();
            let n = errors.len() as f64;
            let l1 = errors.iter().map(|e| e.abs()).sum::<f64>() / n;
            let mse = errors.iter().map(|e| e * e).sum::<f64>() / n;
            assert!((loss.l1 - l1).abs() < 1e-6 && (loss.mse - mse).abs() < 1e-6, "{loss:?}");
            assert!((loss.ssim - ssim).abs() < 2e-5, "{padding} {masked}: {loss:?} {ssim}");
            assert!((loss.loss - (0.7 * l1 + 0.3 * (1.0 - ssim))).abs() < 1e-5);
            let want: Vec<f64> = (0..pred.len())
                .map(|k| {
                    let d = pred[k] - truth[k];
                    let sign = if d == 0.0 { 0.0 } else { f64::from(d.signum()) };
                    if counts(k) { 0.7 * sign / n - 0.3 * f64::from(slope[k]) } else { 0.0 }
                })
                .collect();
            compare(&format!("{padding}, masked {masked}"), &gradient, &want, 1e-3);
        }
    }
}

#[test]
fn arrays_of_another_length_and_weights_out_of_range_are_named() {
    let weights = ImageWeights { ssim: 1.0, padding: SsimPadding::Reflect };
    let mut comparison = ImageComparison::new(7, 6, weights).unwrap();
    let (mut whole, mut short) = (vec![0.0; 126], vec![0.0; 125]);
    let some = vec![0.5; 126];
    let mut failed = |pred: &[f32], truth: &[f32], mask: &[u8], slope: &mut [f32]| {
        comparison.compare(pred, truth, Some(mask), slope).unwrap_err().to_string()
    };
    assert_eq!(
        failed(&some[1..], &some, &[1; 42], &mut whole),
        "rendered picture: expected 126 values, got 125"
    );
    assert_eq!(
        failed(&some, &some[2..], &[1; 42], &mut whole),
        "picture of the frame: expected 126 values, got 124"
    );
    assert_eq!(
        failed(&some, &some, &[1; 42], &mut short),
        "gradient of the picture: expected 126 values, got 125"
    );
    assert_eq!(failed(&some, &some, &[1; 41], &mut whole), "mask: expected 42 values, got 41");
    let refused = |width, height, weights| {
        ImageComparison::new(width, height, weights).unwrap_err().to_string()
    };
    for ssim in [-0.1, 1.1] {
        let error = refused(7, 6, ImageWeights { ssim, ..weights });
        assert_eq!(
            error,
            format!("weight of SSIM is {}; it has to be from 0 to 1", f64::from(ssim))
        );
    }
    assert!(ImageComparison::new(6, 6, ImageWeights { ssim: 0.0, ..weights }).is_ok());
    let error = refused(9, 5, weights);
    assert!(
        error.contains("9 × 5 pixels is smaller than 6 on a side")
            && error.contains("border reflect"),
        "{error}"
    );
}
