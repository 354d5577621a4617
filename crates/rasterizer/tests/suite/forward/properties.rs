//! What holds for any scene.

use super::reference::compare;
use crate::support::{everything, join, on_threads, one, permute, random, view};
use scenesplat_kernels::simd::Isa;
use scenesplat_rasterizer::*;

#[test]
fn threads_change_no_bit() {
    let scene = random(30_000, 11);
    let (view, settings) = (view(200, 130), RasterSettings::default());
    let run =
        |threads| on_threads(threads, || render(&scene, &view, &settings, &everything()).unwrap());
    let one = run(1);
    assert!(one.work.pairs > 30_000, "{:?}", one.work);
    for threads in [2, 3] {
        assert!(one == run(threads), "{threads} threads");
    }
}

#[test]
fn every_instruction_set() {
    let scene = random(300, 12);
    let view = view(67, 45);
    for isa in [Isa::Portable, Isa::Avx2, Isa::Avx512] {
        let settings = RasterSettings { isa, ..RasterSettings::default() };
        compare(&scene, &view, &settings);
    }
}

/// Whole rows and groups of eight have to take the same pixels, with every rule.
#[test]
fn instruction_sets_agree_with_every_preset() {
    let scene = random(300, 12);
    let view = view(67, 45);
    let low = RasterSettings { alpha_cut: 0.001, ..RasterSettings::default() };
    for settings in [low, RasterSettings::gsplat_1_4(), RasterSettings::inria()] {
        let [portable, avx2, avx512] = [Isa::Portable, Isa::Avx2, Isa::Avx512].map(|isa| {
            let settings = RasterSettings { isa, ..settings };
            render(&scene, &view, &settings, &everything()).unwrap()
        });
        let counts = &portable.contributions.as_ref().unwrap().count;
        assert!(counts.iter().sum::<u32>() > 10_000);
        for other in [avx2, avx512] {
            let off = |a: &[f32], b: &[f32]| {
                a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 2e-5).count()
            };
            // A pixel on the cut may decide differently.
            let rgb = off(portable.rgb.as_ref().unwrap(), other.rgb.as_ref().unwrap());
            assert!(rgb <= 9, "{rgb} values differ: {settings:?}");
            let pixels = counts.iter().zip(&other.contributions.as_ref().unwrap().count);
            let pixels: u32 = pixels.map(|(a, b)| a.abs_diff(*b)).sum();
            assert!(pixels <= 3, "{pixels} pixels were taken or left: {settings:?}");
        }
    }
}

/// A Gaussian of 3.95 pixels reaches 3.33 of them, 13.1 pixels; its square of 3σ 12. Tiles that the
/// square meets are drawn to their end, others not at all.
#[test]
fn a_square_of_three_sigma_picks_whole_tiles() {
    let camera = View { fx: 100.0, fy: 100.0, cx: 0.0, cy: 0.0, ..view(32, 32) };
    // What the pixel of row y above column 3 has lost, of a Gaussian with its center in row v.
    let lost = |settings: RasterSettings, v: f32, y: usize| {
        let scene = one([0.32, 0.1 * v, 10.0], 0.3912, 1.0);
        let out = render(&scene, &camera, &settings, &RenderRequest::default()).unwrap();
        let found = 1.0 - out.transmittance[32 * y + 3];
        let d2 = (3.5 - 3.2f32).powi(2) + (y as f32 + 0.5 - v).powi(2);
        (found, (-0.5 * d2 / 15.6).exp())
    };
    for settings in [RasterSettings::gsplat_1_4(), RasterSettings::inria()] {
        let (found, full) = lost(settings, 3.2, 15);
        assert!(full > 0.007 && (found - full).abs() < 1e-4, "in the tile: {found}, {full}");
        let (found, full) = lost(settings, 3.9, 16);
        assert!(full > 0.006 && found == 0.0, "in the next tile: {found}");
    }
    let (found, full) = lost(RasterSettings::default(), 3.9, 16);
    assert!((found - full).abs() < 1e-4, "the ellipse ends at the cut: {found}, {full}");
}

#[test]
fn order_of_the_rows_matters_only_among_equal_depths() {
    let mut scene = random(200, 13);
    for (i, mean) in scene.means.iter_mut().enumerate() {
        mean[2] = 1.0 + 0.01 * i as f32;
    }
    // 77 and 200 have no common divisor.
    let order: Vec<usize> = (0..200).map(|i| i * 77 % 200).collect();
    let (view, settings) = (view(60, 50), RasterSettings::default());
    let a = render(&scene, &view, &settings, &everything()).unwrap();
    let b = render(&permute(&scene, &order), &view, &settings, &everything()).unwrap();
    assert!(a.rgb == b.rgb && a.transmittance == b.transmittance, "pictures differ");
    assert!(a.depth_median == b.depth_median && a.last == b.last, "depths differ");
    let (a, b) = (a.contributions.unwrap(), b.contributions.unwrap());
    for (to, &from) in order.iter().enumerate() {
        assert_eq!((a.sum[from], a.count[from]), (b.sum[to], b.count[to]));
    }
}

/// A larger picture with the same camera has the smaller one in its corner, wherever tiles end.
#[test]
fn more_picture_around_changes_nothing_inside() {
    let mut scene = random(200, 14);
    let settings = RasterSettings::default();
    let mut small = view(21, 19);
    // Limits of the tangents depend on the size: keep all centers inside them.
    for mean in &mut scene.means {
        mean[2] = mean[2].max(1.5);
    }
    small.fx = 5.0;
    small.fy = 5.0;
    let large = View { width: 70, height: 61, ..small };
    let a = render(&scene, &small, &settings, &everything()).unwrap();
    let b = render(&scene, &large, &settings, &everything()).unwrap();
    let (rgb_a, rgb_b) = (a.rgb.unwrap(), b.rgb.unwrap());
    for y in 0..19 {
        for x in 0..21 {
            let (i, j) = (y * 21 + x, y * 70 + x);
            assert_eq!(a.transmittance[i], b.transmittance[j], "pixel {x}, {y}");
            assert_eq!(rgb_a[3 * i..3 * i + 3], rgb_b[3 * j..3 * j + 3], "pixel {x}, {y}");
        }
    }
}

#[test]
fn a_gaussian_by_hand() {
    // At 2 m: 60 · 0.1 / 2 = 3 px wide, and 0.3 px² more.
    let scene = one([0.0, 0.0, 2.0], 0.1, 0.8);
    let mut view = view(33, 33);
    (view.cx, view.cy) = (16.5, 16.5);
    let out = render(&scene, &view, &RasterSettings::default(), &everything()).unwrap();
    let color = 0.5 + 0.282_094_79;
    let expected = |dx: f32, dy: f32| 0.8 * (-0.5 * (dx * dx / 9.3 + dy * dy / 6.55)).exp();
    let rgb = out.rgb.as_ref().unwrap();
    let mut sum = 0.0;
    for y in 0..33 {
        for x in 0..33 {
            let alpha = expected(x as f32 - 16.0, y as f32 - 16.0);
            let alpha = if alpha < 1.0 / 255.0 { 0.0 } else { alpha };
            sum += alpha;
            let i = y * 33 + x;
            assert!((rgb[3 * i] - alpha * color).abs() < 2e-6, "pixel {x}, {y}");
            assert!((out.alpha()[i] - alpha).abs() < 2e-6);
            let depth = if alpha > 0.0 { 2.0 } else { 0.0 };
            assert_eq!(out.depth_median.as_ref().unwrap()[i], depth);
            assert!((out.depth_expected.as_ref().unwrap()[i] - depth).abs() < 2e-4);
        }
    }
    let did = out.contributions.unwrap();
    assert!((did.sum[0] - sum).abs() < 1e-4 * sum && (did.max[0] - 0.8).abs() < 1e-6);
    assert_eq!(out.work.sh_bands, [1, 0, 0, 0]);
}

#[test]
fn features_blend_as_colors_do() {
    let scene = random(100, 15);
    let (view, settings) = (view(40, 30), RasterSettings::default());
    let projected = project(&scene, &view, &settings).unwrap();
    let colors = colors(&scene, &view, &projected, 2);
    let mut features = vec![f32::NAN; 5 * scene.len()];
    for (&i, color) in projected.index.iter().zip(&colors) {
        features[5 * i as usize..][..5].copy_from_slice(&[1.0, color[0], color[1], color[2], 0.0]);
    }
    let blended = render_features(&scene, &view, &settings, &features, 5).unwrap();
    let out = render(&scene, &view, &settings, &RenderRequest::rgb()).unwrap();
    let (rgb, alpha) = (out.rgb.as_ref().unwrap(), out.alpha());
    for (i, pixel) in blended.chunks_exact(5).enumerate() {
        assert!((pixel[0] - alpha[i]).abs() < 1e-5, "weights do not sum to alpha");
        assert_eq!(pixel[1..4], rgb[3 * i..3 * i + 3]);
        assert_eq!(pixel[4], 0.0);
    }
    let error = render_features(&scene, &view, &settings, &features, 4).unwrap_err();
    assert_eq!(error.to_string(), "features: expected 400 values, got 500");
    assert!(render_features(&scene, &view, &settings, &[], 0).is_err());
    assert!(render_features(&scene, &view, &settings, &[], usize::MAX).is_err());
}

/// Two Gaussians at one place and depth: the one with the lower row is in front.
#[test]
fn equal_depths_in_order_of_the_rows() {
    let mut scene = one([0.0, 0.0, 2.0], 0.2, 0.9);
    scene = join(scene.clone(), &scene);
    scene.sh = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let out = render(&scene, &view(20, 20), &RasterSettings::default(), &everything()).unwrap();
    let did = out.contributions.unwrap();
    assert!(did.sum[0] > 1.5 * did.sum[1], "{did:?}");
}

#[test]
fn presets_differ_where_they_say() {
    let opaque = one([0.0, 0.0, 2.0], 0.5, 1.0);
    let near = one([0.0, 0.0, 0.15], 0.01, 0.5);
    let view = view(32, 32);
    let alpha = |scene: &Gaussians, settings: RasterSettings| {
        let out = render(scene, &view, &settings, &RenderRequest::default()).unwrap();
        out.alpha().iter().fold(0.0f32, |m, &a| m.max(a))
    };
    assert!((alpha(&opaque, RasterSettings::gsplat_1_6()) - 0.99).abs() < 1e-6);
    assert!(alpha(&opaque, RasterSettings::gsplat_1_5()) > 0.99);
    assert!(alpha(&near, RasterSettings::gsplat_1_6()) > 0.4);
    assert_eq!(alpha(&near, RasterSettings::inria()), 0.0);
    // Without normalization this quaternion stretches two axes by 1 − 2 · 2² = −7.
    let mut long = one([0.0, 0.0, 2.0], 0.05, 0.5);
    long.quats[0] = [0.0, 2.0, 0.0, 0.0];
    let sum = |settings| {
        let out = render(&long, &view, &settings, &everything()).unwrap();
        out.contributions.unwrap().sum[0]
    };
    assert!(sum(RasterSettings::inria()) > 3.0 * sum(RasterSettings::gsplat_1_6()));
}
