//! Image metrics against the goldens, against slow versions, and on hard input.

use crate::reference;
use crate::support::{all_close, close, in_all_pools, rng};
use rand::Rng;
use scenesplat_metrics::image::depth::{
    DepthRange, SamplePosition, depth_l1, depth_l1_with_gradient, sparse_disparity_l1,
};
use scenesplat_metrics::image::{
    ImageError, ImageView, SsimPadding, l1, l1_with_gradient, mean_squared_error, psnr, ssim,
    ssim_map, ssim_with_gradient,
};
use scenesplat_test_support::Golden;

/// The goldens' values are f64; their images f32.
const VALUE_ATOL: f64 = 2e-8;
/// Gradients are stored as f32; theirs were computed in f32 by autograd.
const GRADIENT_RTOL: f64 = 2e-5;

/// `[3, H, W]` to `[H, W, 3]`.
fn interleave(planes: &[f32]) -> Vec<f32> {
    let pixels = planes.len() / 3;
    (0..planes.len()).map(|i| planes[(i % 3) * pixels + i / 3]).collect()
}

fn same_gradient(got: &[f32], expected: &[f32], what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    let largest = expected.iter().fold(0.0f64, |m, v| m.max(f64::from(*v).abs()));
    for (i, (&g, &e)) in got.iter().zip(expected).enumerate() {
        close(g.into(), e.into(), GRADIENT_RTOL * largest, &format!("{what}[{i}]"));
    }
}

#[test]
fn the_goldens_images() {
    let Some(golden) = Golden::raster("optimise") else { return };
    let scalar = |name: &str| golden.entry()["scalars"]["image"][name].as_f64().unwrap();
    let [pred, truth] = ["img_pred", "img_gt"].map(|n| interleave(&golden.f32s(n)));
    let [pred, truth] = [&pred, &truth].map(|v| ImageView::new(v, 96, 64, 3).unwrap());
    close(mean_squared_error(pred, truth).unwrap(), scalar("mse"), VALUE_ATOL, "mse");
    close(psnr(pred, truth).unwrap(), scalar("psnr"), 1e-6, "psnr");
    close(l1(pred, truth).unwrap(), scalar("l1"), VALUE_ATOL, "l1");
    for (padding, name) in [
        (SsimPadding::Valid, "ssim_valid"),
        (SsimPadding::Zero, "ssim_zero_pad"),
        (SsimPadding::Reflect, "ssim_reflect_clamped_full"),
    ] {
        close(ssim(pred, truth, padding).unwrap(), scalar(name), VALUE_ATOL, name);
    }
    let map = ssim_map(pred, truth, SsimPadding::Zero).unwrap();
    all_close(&map, &interleave(&golden.f32s("ssim_map_zero")), 2e-6, "ssim map");

    let (l1_value, l1_slope) = l1_with_gradient(pred, truth).unwrap();
    for (padding, name) in [(SsimPadding::Valid, "valid"), (SsimPadding::Zero, "zero")] {
        let (value, slope) = ssim_with_gradient(pred, truth, padding).unwrap();
        let expected = interleave(&golden.f32s(&format!("grad_ssim_{name}")));
        same_gradient(&slope, &expected, &format!("gradient of ssim, {name}"));
        // The training loss: 0.8 L1 + 0.2 (1 − SSIM).
        let loss = 0.8 * l1_value + 0.2 * (1.0 - value);
        close(loss, scalar(&format!("loss_{name}")), VALUE_ATOL, "loss");
        let slope: Vec<f32> = l1_slope.iter().zip(&slope).map(|(l, s)| 0.8 * l - 0.2 * s).collect();
        let expected = interleave(&golden.f32s(&format!("grad_loss_{name}")));
        same_gradient(&slope, &expected, &format!("gradient of the loss, {name}"));
    }
}

#[test]
fn the_goldens_depths() {
    let Some(golden) = Golden::raster("optimise") else { return };
    let scalars = &golden.entry()["scalars"]["depth"];
    let (pred, truth) = (golden.f32s("depth_map"), golden.f32s("depth_dense_gt"));
    let (error, slope) =
        depth_l1_with_gradient(&pred, &truth, None, DepthRange::default()).unwrap().unwrap();
    assert_eq!(scalars["dense_valid"], error.count);
    close(error.mean, scalars["dense_metric_l1"].as_f64().unwrap(), 1e-7, "dense");
    same_gradient(&slope, &golden.f32s("grad_depth_dense"), "dense gradient");

    let (points, z) = (golden.f32s("depth_pts"), golden.f32s("depth_pts_gt"));
    let points = points.as_chunks::<2>().0;
    let scale = scalars["scene_scale"].as_f64().unwrap();
    let as_gsplat =
        sparse_disparity_l1(&pred, 96, points, &z, scale, SamplePosition::Gsplat).unwrap();
    let expected = scalars["sparse_disparity_l1"].as_f64().unwrap();
    close(as_gsplat.0, expected, 1e-7, "sparse");
    same_gradient(&as_gsplat.1, &golden.f32s("grad_depth_sparse"), "sparse gradient");
    // The same points half a pixel on, read at pixel centers.
    let shifted: Vec<[f32; 2]> = points.iter().map(|p| p.map(|v| v + 0.5)).collect();
    let exact =
        sparse_disparity_l1(&pred, 96, &shifted, &z, scale, SamplePosition::PixelCentres).unwrap();
    close(exact.0, as_gsplat.0, 1e-6, "shifted");
}

fn noise(seed: u64, len: usize) -> Vec<f32> {
    let mut rng = rng(seed);
    (0..len).map(|_| rng.random_range(-0.2..1.2)).collect()
}

/// Sizes at which a window, a band of rows or a run of registers ends in the middle, at the end or
/// one behind it.
const SIZES: [[usize; 3]; 8] = [
    [11, 11, 1],
    [12, 16, 3],
    [16, 12, 4],
    [37, 29, 2],
    [64, 63, 1],
    [40, 64, 3],
    [33, 65, 3],
    [23, 130, 1],
];

#[test]
fn the_separable_window_equals_the_square_one() {
    for (seed, [width, height, channels]) in (0..).zip(SIZES) {
        let len = width * height * channels;
        let (a, b) = (noise(seed, len), noise(seed + 100, len));
        let view = |v| ImageView::new(v, width, height, channels).unwrap();
        for padding in SsimPadding::ALL {
            let got = ssim(view(&a), view(&b), padding).unwrap();
            let expected = reference::ssim(view(&a), view(&b), padding);
            close(got, expected, 1e-12, &format!("{width} × {height} × {channels}, {padding}"));
            let map = ssim_map(view(&a), view(&b), padding).unwrap();
            let mean = map.iter().map(|v| f64::from(*v)).sum::<f64>() / map.len() as f64;
            close(mean, expected, 1e-7, "mean of the map");
        }
    }
}

#[test]
fn gradients_equal_differences() {
    const STEP: f64 = 1.0 / 1024.0;
    for [width, height, channels] in [[11, 12, 2], [13, 70, 1], [24, 17, 3]] {
        let len = width * height * channels;
        let (a, b) = (noise(3, len), noise(4, len));
        let view = |v| ImageView::new(v, width, height, channels).unwrap();
        for padding in SsimPadding::ALL {
            let (value, slope) = ssim_with_gradient(view(&a), view(&b), padding).unwrap();
            assert_eq!(value, ssim(view(&a), view(&b), padding).unwrap());
            let largest = slope.iter().fold(0.0f64, |m, v| m.max(f64::from(*v).abs()));
            // Corners, borders and inside.
            for at in (0..len).step_by(len / 60).chain([len - 1]) {
                let moved = |by: f64| {
                    let mut a = a.clone();
                    a[at] = (f64::from(a[at]) + by) as f32;
                    let moved = ImageView::new(&a, width, height, channels).unwrap();
                    (f64::from(a[at]), ssim(moved, view(&b), padding).unwrap())
                };
                let ((low, below), (high, above)) = (moved(-STEP), moved(STEP));
                let expected = (above - below) / (high - low);
                close(slope[at].into(), expected, 2e-3 * largest, &format!("{padding} at {at}"));
            }
        }
    }
}

#[test]
fn identical_flat_and_opposite_images() {
    for [width, height, channels] in SIZES {
        let len = width * height * channels;
        let a = noise(9, len);
        let clamped: Vec<f32> = a.iter().map(|v| v.clamp(0.0, 1.0)).collect();
        let (zero, one, huge) = (vec![0.0; len], vec![1.0; len], vec![f32::MAX; len]);
        let view = |v| ImageView::new(v, width, height, channels).unwrap();
        assert_eq!(psnr(view(&clamped), view(&clamped)).unwrap(), f64::INFINITY);
        assert_eq!(psnr(view(&a), view(&clamped)).unwrap(), f64::INFINITY, "renders are clamped");
        assert!(psnr(view(&clamped), view(&a)).unwrap().is_finite(), "truths are not");
        assert_eq!(l1(view(&a), view(&a)).unwrap(), 0.0);
        assert!(l1_with_gradient(view(&a), view(&a)).unwrap().1.iter().all(|v| *v == 0.0));
        assert_eq!(psnr(view(&zero), view(&one)).unwrap().to_bits(), 0.0f64.to_bits());
        for padding in SsimPadding::ALL {
            close(ssim(view(&a), view(&a), padding).unwrap(), 1.0, 1e-12, "identical");
            // Means 0 and 1, no variance: c₁ / (1 + c₁) where the window is inside.
            let flat = ssim(view(&zero), view(&one), padding).unwrap();
            if padding != SsimPadding::Zero {
                close(flat, 1e-4 / 1.0001, 1e-12, "flat");
            }
            assert!(ssim(view(&huge), view(&zero), padding).unwrap().is_finite());
            assert!(ssim(view(&huge), view(&huge), padding).unwrap().is_finite());
        }
    }
}

#[test]
fn wrong_input_is_refused_by_name() {
    assert!(matches!(ImageView::new(&[], 0, 4, 3), Err(ImageError::Empty { .. })));
    assert!(matches!(ImageView::new(&[0.0; 5], 2, 2, 1), Err(ImageError::Shape { len: 5, .. })));
    let error = ImageView::new(&[0.0; 4], usize::MAX, usize::MAX, 2).unwrap_err();
    assert!(error.to_string().contains("4 values"), "{error}");

    let values = vec![0.5; 12 * 12 * 3];
    let view = ImageView::new(&values, 12, 12, 3).unwrap();
    let other = ImageView::new(&values, 6, 24, 3).unwrap();
    assert!(matches!(psnr(view, other), Err(ImageError::SizesDiffer { .. })));
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut broken = values.clone();
        broken[(7 * 12 + 5) * 3 + 1] = value;
        let broken = ImageView::new(&broken, 12, 12, 3).unwrap();
        let errors = [
            psnr(broken, view).unwrap_err(),
            l1(view, broken).unwrap_err(),
            ssim(broken, view, SsimPadding::Zero).unwrap_err(),
            ssim_with_gradient(view, broken, SsimPadding::Valid).unwrap_err(),
        ];
        for error in errors {
            assert!(error.to_string().contains("pixel (5, 7) channel 1"), "{error}");
        }
    }
    for padding in SsimPadding::ALL {
        for (width, height) in [(1, 1), (1, 40), (5, 5), (6, 6), (10, 11), (11, 10), (11, 11)] {
            let values = vec![0.25; width * height];
            let view = ImageView::new(&values, width, height, 1).unwrap();
            let fits = width.min(height) >= padding.least_side();
            match ssim_with_gradient(view, view, padding) {
                Ok((value, _)) => {
                    assert!(fits, "{padding} {width} × {height}");
                    close(value, 1.0, 1e-12, "identical");
                    close(reference::ssim(view, view, padding), 1.0, 1e-12, "identical");
                }
                Err(error) => {
                    assert!(!fits, "{error}");
                    assert!(error.to_string().contains(padding.name()), "{error}");
                }
            }
        }
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    let (width, height, channels) = (97, 203, 3);
    let len = width * height * channels;
    let (a, b) = (noise(1, len), noise(2, len));
    let view = |v| ImageView::new(v, width, height, channels).unwrap();
    in_all_pools(|| {
        let slopes = SsimPadding::ALL.map(|p| ssim_with_gradient(view(&a), view(&b), p).unwrap());
        (psnr(view(&a), view(&b)).unwrap().to_bits(), slopes)
    });
}

#[test]
fn depths_that_do_not_count() {
    let truth = [2.0, 0.0, f32::NAN, f32::INFINITY, 0.1, 10.0, 10.5, 3.0];
    let pred = [2.5, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 0.0];
    let range = DepthRange::default();
    let (error, slope) = depth_l1_with_gradient(&pred, &truth, None, range).unwrap().unwrap();
    assert_eq!((error.count, error.mean), (3, (0.5 + 1.0 + 3.0) / 3.0));
    let step = (1.0f64 / 3.0) as f32;
    assert_eq!(slope, [step, 0.0, 0.0, 0.0, 0.0, -step, 0.0, -step]);
    let mask = [true, true, true, true, true, false, true, false];
    assert_eq!(depth_l1(&pred, &truth, Some(&mask), range).unwrap().unwrap().mean, 0.5);
    assert_eq!(depth_l1(&pred, &truth, Some(&[false; 8]), range).unwrap(), None);
    assert_eq!(depth_l1(&[], &[], None, range).unwrap(), None);
    // A broken prediction matters only where there is a truth.
    let mut broken = pred;
    broken[1] = f32::NAN;
    assert!(depth_l1(&broken, &truth, None, range).is_ok());
    broken[7] = f32::NAN;
    let error = depth_l1(&broken, &truth, None, range).unwrap_err().to_string();
    assert!(error.contains("rendered depth[7]"), "{error}");
    assert!(depth_l1(&pred[1..], &truth, None, range).is_err());
    assert!(depth_l1(&pred, &truth, Some(&mask[1..]), range).is_err());
}

#[test]
fn sparse_depths_at_the_border_and_without_points() {
    let depth = [1.0, 2.0, 4.0, 0.0];
    let loss = |points: &[[f32; 2]], z: &[f32]| {
        sparse_disparity_l1(&depth, 2, points, z, 1.0, SamplePosition::PixelCentres)
    };
    assert_eq!(loss(&[], &[]).unwrap(), (0.0, vec![0.0; 4]));
    // A pixel center reads that pixel alone.
    assert_eq!(loss(&[[1.5, 0.5]], &[4.0]).unwrap(), (0.25, vec![0.0, -0.25, 0.0, 0.0]));
    // Nothing hit, nothing known, far outside: no disparity, no gradient.
    for point in [[1.5, 1.5], [-100.0, 0.5], [1e30, -1e30]] {
        assert_eq!(loss(&[point], &[0.0]).unwrap(), (0.0, vec![0.0; 4]), "{point:?}");
        assert_eq!(loss(&[point], &[2.0]).unwrap(), (0.5, vec![0.0; 4]), "{point:?}");
    }
    assert!(loss(&[[f32::NAN, 0.0]], &[1.0]).is_err());
    assert!(loss(&[[0.0, 0.0]], &[-1.0]).is_err());
    assert!(loss(&[[0.0, 0.0]], &[]).is_err());
    let odd = sparse_disparity_l1(&depth, 3, &[], &[], 1.0, SamplePosition::Gsplat);
    assert!(odd.is_err());
}
