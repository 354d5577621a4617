//! Relocation, noise, first Gaussians, blur.

use crate::support::{golden, number};
use scenesplat_metrics::image::sharpness::{GrayImage, variance_of_laplacian};
use scenesplat_optimisation::initial::neighbour_log_scales;
use scenesplat_optimisation::noise::displacement;
use scenesplat_optimisation::relocation::{Relocation, relocated};
use scenesplat_test_support::compare_relative as compare;

#[test]
fn relocation_in_both_versions() {
    let Some(golden) = golden() else { return };
    let (opacities, scales) = (golden.f32s("rel_opacity"), golden.rows::<3>("rel_scale"));
    let copies: Vec<u32> = golden.f64s("rel_ratio").iter().map(|v| *v as u32).collect();
    assert_eq!(opacities.len(), 300);
    let versions = [(Relocation::Gsplat15, "v15"), (Relocation::Gsplat16, "v16")];
    for (version, name) in versions {
        let found: Vec<(f32, [f32; 3])> =
            (0..300).map(|i| relocated(opacities[i], scales[i], copies[i], version)).collect();
        let got: Vec<f32> = found.iter().map(|(o, _)| *o).collect();
        // The older version clamps last, after the fixture was taken.
        let key =
            if name == "v15" { "rel_new_opacity_v15_unclamped" } else { "rel_new_opacity_v16" };
        let want: Vec<f64> = golden.f64s(key).iter().map(|o| o.max(0.005)).collect();
        compare(&format!("opacity {name}"), &got, &want, 2e-6);
        let want = &golden.f64s(&format!("rel_new_scale_{name}"));
        let got: Vec<f32> = found.iter().flat_map(|(_, s)| *s).collect();
        let worst = got.iter().zip(want).map(|(g, w)| (f64::from(*g) / w - 1.0).abs());
        let worst = worst.fold(0.0, f64::max);
        println!("scales {name}: {worst:.2e} relative");
        assert!(worst < 2e-4, "{name}: {worst:e}");
    }
}

#[test]
fn noise() {
    let Some(golden) = golden() else { return };
    let (quats, logits) = (golden.rows::<4>("noise_quats"), golden.f32s("noise_logit"));
    let (log_scales, xi) = (golden.rows::<3>("noise_logscale"), golden.rows::<3>("noise_z"));
    let means = golden.rows::<3>("noise_means");
    let strength = number(&golden, "/noise/noise_scale") as f32;
    let mut got = Vec::new();
    for i in 0..means.len() {
        let opacity = 1.0 / (1.0 + (-logits[i]).exp());
        let by = displacement(quats[i], log_scales[i].map(f32::exp), opacity, xi[i], strength);
        got.extend((0..3).map(|k| means[i][k] + by[k]));
    }
    compare("noise", &got, &golden.f64s("noise_out"), 1e-5);
}

#[test]
fn scales_from_neighbours() {
    let Some(golden) = golden() else { return };
    let points = golden.rows::<3>("init_points");
    for (scale, name) in [(1.0, "default"), (0.1, "mcmc")] {
        let got = neighbour_log_scales(&points, scale).unwrap();
        compare(name, &got, &golden.f64s(&format!("init_logscale_{name}")), 1e-6);
    }
}

#[test]
fn blur() {
    let Some(golden) = golden() else { return };
    let values = &golden.f64s("blur_gray_u8");
    let [count, height, width] = golden.shape("blur_gray_u8")[..] else { return };
    for i in 0..count {
        let part = &values[i * height * width..(i + 1) * height * width];
        let gray = GrayImage::new(part.iter().map(|v| *v as u8).collect(), width).unwrap();
        let want = number(&golden, &format!("/blur_variance_of_laplacian/{i}"));
        let got = variance_of_laplacian(&gray);
        assert!((got - want).abs() < 1e-9 * want, "{i}: {got} {want}");
    }
}
