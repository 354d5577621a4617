//! Numbers of a reference in f64: dense compositing, weights by segment, both rules.

use super::support::{dense, golden_maps, lifter, picture, totals, weights};
use crate::support::Scene;
use scenesplat_rasterizer::lifting::{
    FinaliseSettings, FrameWeight, LiftRule, LiftSettings, Lifter, fuse_crops,
};
use scenesplat_rasterizer::{RasterSettings, project};
use scenesplat_test_support::Golden;
use std::slice::from_ref;

/// Weights of pixels at a threshold (α near 1/255, transmittance near its stop) may be in or out: the
/// tolerance of the reference for sums over pixels.
const BOUNDARY: f64 = 5e-3;
const WEIGHT_RELATIVE: f64 = 1e-4;

#[test]
fn weights_by_segment_are_those_of_the_reference() {
    let Some((scene, lift)) = Scene::synthetic().zip(Golden::raster("lift")) else { return };
    let maps = golden_maps(&scene);
    let Scene { gaussians, views, .. } = &scene;
    let mut expected = vec![0.0; gaussians.len() * 39];
    let (g, s, w) = (
        lift.ints::<i32>("coo_gaussian"),
        lift.ints::<i32>("coo_segment"),
        lift.f32s("coo_weight"),
    );
    for ((g, s), w) in g.iter().zip(&s).zip(&w) {
        expected[*g as usize * 39 + *s as usize] = f64::from(*w);
    }
    let mut got = vec![0.0; expected.len()];
    for (view, map) in views.iter().zip(&maps) {
        let weights = weights(gaussians, view, from_ref(map), LiftRule::AlphaWeighted);
        for (sum, w) in got.iter_mut().zip(dense(&weights, gaussians.len(), 39)) {
            *sum += f64::from(w);
        }
    }
    let mut loose = 0;
    for (i, (&got, &expected)) in got.iter().zip(&expected).enumerate() {
        let off = (got - expected).abs();
        let place = (i / 39, i % 39);
        assert!(off <= WEIGHT_RELATIVE * expected + BOUNDARY, "{place:?}: {got}, not {expected}");
        loose += usize::from(off > WEIGHT_RELATIVE * expected + 1e-6);
    }
    println!("{loose} of {} weights at a threshold", w.len());
    assert!(loose * 200 < w.len(), "{loose} of {} weights", w.len());
}

#[test]
fn features_of_all_pixels_are_those_of_the_reference() {
    let Some((scene, lift)) = Scene::synthetic().zip(Golden::raster("lift")) else { return };
    let maps = golden_maps(&scene);
    let Scene { gaussians, views, .. } = &scene;
    let table = scene.golden.f32s("seg_feat");
    let mut lifter = lifter(gaussians, 1, 8);
    for (view, map) in views.iter().zip(&maps) {
        lifter.add(&picture(view, from_ref(map), &table)).unwrap();
    }
    // The reference divides by the weights, not by the length.
    let plain = FinaliseSettings { normalise: false, ..FinaliseSettings::default() };
    let lifted = lifter.collect(0, &plain).unwrap();
    let (expected, den) = (lift.f32s("feat_alpha"), lift.f32s("den_alpha"));
    let valid = den.iter().filter(|&&d| d > 0.0).count();
    assert_eq!(valid, 1411, "as the manifest says");
    let mut at_threshold = 0;
    for (i, &den) in den.iter().enumerate() {
        let coverage = lifted.coverage[i];
        assert!((coverage - den).abs() <= 1e-4 * den + BOUNDARY as f32, "{i}: {coverage}, {den}");
        let (feature, expected) = (&lifted.features[i * 8..][..8], &expected[i * 8..][..8]);
        let off = feature.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        // What a pixel at a threshold can move, of this Gaussian's weight.
        let slack = if den > 0.0 { (2.0 * BOUNDARY as f32 / den).min(2.0) } else { 0.0 };
        assert!(off <= 1e-4 + slack, "{i}: off by {off}");
        at_threshold += usize::from(off > 1e-4);
        if den == 0.0 {
            assert!(coverage == 0.0 || !lifted.valid[i] || coverage < BOUNDARY as f32);
        }
    }
    println!("{at_threshold} features at a threshold");
    assert!(at_threshold <= 10, "{at_threshold} features");
}

#[test]
fn the_center_pixel_rule_is_that_of_the_reference() {
    let Some((scene, lift)) = Scene::synthetic().zip(Golden::raster("lift")) else { return };
    let maps = golden_maps(&scene);
    let Scene { gaussians, views, .. } = &scene;
    // The reference has this rule with the constants of gsplat 1.6.
    let settings = LiftSettings { rule: LiftRule::CentrePixel, ..LiftSettings::default() };
    let n = gaussians.len();
    let (activated, significance) =
        (lift.ints::<i32>("occ_activated"), lift.f32s("occ_significance"));
    let segment = lift.ints::<i32>("occ_segment");
    let mut lifter = Lifter::new(gaussians, 1, 8, settings.clone()).unwrap();
    let table = scene.golden.f32s("seg_feat");
    // Gaussians whose segment is another one than the reference's.
    let mut other = vec![false; n];
    for (v, (view, map)) in views.iter().zip(&maps).enumerate() {
        let weights = weights(gaussians, view, from_ref(map), settings.rule);
        let seen = totals(&weights, n);
        let mut ids = vec![-1; n];
        weights.levels[0].iter().for_each(|w| ids[w.gaussian as usize] = w.segment as i32);
        // Where f32 and f64 may find the center in different pixels.
        let mut between_pixels = vec![false; n];
        let projected = project(gaussians, view, &RasterSettings::default()).unwrap();
        for (&i, mean) in projected.index.iter().zip(&projected.mean2d) {
            let near = mean.iter().any(|m| (m - m.round()).abs() < 1e-5);
            between_pixels[i as usize] = near;
        }
        for i in 0..n {
            let (w, expected) = (seen[i], significance[v * n + i]);
            assert_eq!(w > 0.0, activated[v * n + i] == 1, "{v} {i}: {w}, {expected}");
            assert!((w - expected).abs() <= 1e-4 * expected + 1e-6, "{v} {i}: {w}, {expected}");
            if w > 0.0 && ids[i] != segment[v * n + i] {
                assert!(between_pixels[i], "view {v}, Gaussian {i}: {}", ids[i]);
                other[i] = true;
            }
        }
        lifter.add(&picture(view, from_ref(map), &table)).unwrap();
    }
    let plain = FinaliseSettings { normalise: false, ..FinaliseSettings::default() };
    let lifted = lifter.collect(0, &plain).unwrap();
    assert_eq!(
        lifted.valid,
        lift.ints("occ_valid").into_iter().map(|v: u8| v != 0).collect::<Vec<_>>()
    );
    assert_eq!(lifted.valid.iter().filter(|&&v| v).count(), 1296, "as the manifest says");
    for (i, (got, expected)) in lifted.features.iter().zip(lift.f32s("occ_feat")).enumerate() {
        let same = (got - expected).abs() <= 2e-5;
        assert!(same || other[i / 8], "value {i}: {got}, {expected}");
        assert!(lifted.valid[i / 8] || *got == 0.0, "row {} has no label", i / 8);
    }
    for (i, (got, expected)) in lifted.coverage.iter().zip(lift.f32s("occ_den")).enumerate() {
        let same = (got - expected).abs() <= 1e-4 * expected + 1e-6;
        assert!(same || other[i], "{i}: {got}, {expected}");
    }
    assert!(other.iter().filter(|&&b| b).count() <= 3);
}

#[test]
fn weights_of_segments_and_of_none_add_up_to_those_of_the_render() {
    let Some((scene, render)) = Scene::synthetic().zip(Golden::raster("render_classic_sh0")) else {
        return;
    };
    let maps = golden_maps(&scene);
    let Scene { gaussians, views, .. } = &scene;
    let expected = render.f32s("wsum");
    for (v, (view, map)) in views.iter().zip(&maps).enumerate() {
        let weights = weights(gaussians, view, from_ref(map), LiftRule::AlphaWeighted);
        let total = totals(&weights, gaussians.len());
        for (i, got) in total.iter().enumerate() {
            let expected = expected[v * gaussians.len() + i];
            assert!((got - expected).abs() <= 1e-5 * expected + 5e-3, "{v} {i}: {got}, {expected}");
        }
        let mut labelled = vec![0.0; gaussians.len()];
        weights.levels[0].iter().for_each(|w| labelled[w.gaussian as usize] += w.weight);
        let share = labelled.iter().sum::<f32>() / total.iter().sum::<f32>();
        assert!((0.8..1.0).contains(&share), "about a tenth of the pixels is in no segment");
        for (i, (labelled, total)) in labelled.iter().zip(&total).enumerate() {
            assert!(*labelled <= total * (1.0 + 1e-5), "{i}: {labelled} of {total}");
        }
    }
}

#[test]
fn fused_crops_are_those_of_the_reference() {
    let Some(golden) = Golden::raster("optimise") else { return };
    let [frame, crops, masked] = ["fuse_fg", "fuse_fl", "fuse_fm"].map(|name| golden.f32s(name));
    for (weight, name) in [(FrameWeight::Softmax, "softmax"), (FrameWeight::Logistic, "sigmoid")] {
        let fused = fuse_crops(&frame, &crops, &masked, weight).unwrap();
        let same = |name: &str, got: &[f32]| {
            let expected = golden.f32s(name);
            assert_eq!(got.len(), expected.len());
            for (i, (got, expected)) in got.iter().zip(expected).enumerate() {
                assert!((got - expected).abs() < 2e-6, "{name} {i}: {got}, {expected}");
            }
        };
        same("fuse_r", &fused.crop_agreement);
        same("fuse_phi", &fused.frame_similarity);
        same(&format!("fuse_w_{name}"), &fused.frame_weight);
        same(&format!("fuse_out_{name}"), &fused.features);
        assert!(!fused.single_segment);
    }
}
