//! Nothing, one, hostile values and bad input.

use crate::support::pinhole;
use scenesplat_rasterizer::backward::{
    BackwardError, FeatureGradient, GradMask, Gradients, TraceRequest, Upstream, backward, trace,
};
use scenesplat_rasterizer::{Gaussians, RasterError, RasterSettings, View};

fn view() -> View {
    pinhole([19, 17], 20.0, 3.0)
}

/// `n` Gaussians in a row, the first at the center of the picture.
fn row(n: usize) -> Gaussians {
    Gaussians {
        means: (0..n).map(|i| [0.1 * i as f32, 0.0, 0.2 * i as f32]).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
        scales: vec![[0.2, 0.1, 0.3]; n],
        opacities: vec![0.5; n],
        sh: vec![0.25; 3 * n],
        sh_degree: 0,
    }
}

fn run(g: &Gaussians, settings: &RasterSettings, rgb: &[f32]) -> Result<Gradients, BackwardError> {
    let traced = trace(g, &view(), settings, TraceRequest::rgb())?;
    let up = Upstream { rgb: Some(rgb), ..Upstream::default() };
    backward(g, &view(), settings, &traced, &up, GradMask::all())
}

#[test]
fn no_gaussian_no_gradient() {
    let none = row(0);
    let got = run(&none, &RasterSettings::default(), &vec![1.0; 3 * 19 * 17]).unwrap();
    assert_eq!(got, Gradients::default());
}

#[test]
fn one_gaussian() {
    let g = row(1);
    let rgb = vec![1.0; 3 * 19 * 17];
    let got = run(&g, &RasterSettings::default(), &rgb).unwrap();
    // A uniform gradient sees Σα alone. It grows with opacity and size, but not by a shift.
    assert!(got.opacities[0] > 0.0);
    assert!(got.scales[0][0] > 0.0 && got.scales[0][1] > 0.0);
    assert!(got.means[0][0].abs() < 1e-2 * got.scales[0][0], "{got:?}");
    assert_eq!(got.quats[0][0], 0.0, "along the quaternion nothing changes");
    // Each channel's DC gets Σw · B₀, which is Σα · B₀ for a single Gaussian.
    let traced = trace(&g, &view(), &RasterSettings::default(), TraceRequest::rgb()).unwrap();
    let total: f32 = traced.picture.alpha().iter().sum();
    for v in got.sh {
        assert!((v / (total * 0.282_094_8) - 1.0).abs() < 1e-4, "{v} {total}");
    }
}

#[test]
fn nothing_visible() {
    let mut g = row(2);
    for mean in &mut g.means {
        mean[2] = -50.0;
    }
    let got = run(&g, &RasterSettings::default(), &vec![1.0; 3 * 19 * 17]).unwrap();
    assert_eq!(got, Gradients::zeros(&g, 0));
}

#[test]
fn no_upstream_no_gradient() {
    let (g, settings) = (row(2), RasterSettings::default());
    let traced = trace(&g, &view(), &settings, TraceRequest::rgb_depth()).unwrap();
    let up = Upstream::default();
    let got = backward(&g, &view(), &settings, &traced, &up, GradMask::all()).unwrap();
    assert_eq!(got, Gradients::zeros(&g, 0));
}

/// Opacity beyond 1 is drawn as 1, a constant.
#[test]
fn opacity_beyond_one() {
    let mut g = row(2);
    g.opacities = vec![1.5, 0.5];
    let got = run(&g, &RasterSettings::default(), &vec![1.0; 3 * 19 * 17]).unwrap();
    assert_eq!(got.opacities[0], 0.0);
    assert!(got.opacities[1] != 0.0);
}

#[test]
fn upstream_that_is_not_finite_is_named() {
    let (g, settings) = (row(2), RasterSettings::default());
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut rgb = vec![1.0; 3 * 19 * 17];
        rgb[3 * (5 * 19 + 7) + 2] = bad;
        let error = run(&g, &settings, &rgb).unwrap_err();
        let BackwardError::NotFinite { picture: "rgb", x: 7, y: 5, channel: 2, .. } = error else {
            panic!("{error}")
        };
        let text = error.to_string();
        assert!(text.contains("rgb") && text.contains("(7, 5)"), "{text}");
    }
}

#[test]
fn bad_input_is_named() {
    let (g, settings, mask) = (row(2), RasterSettings::default(), GradMask::all());
    let traced = trace(&g, &view(), &settings, TraceRequest::default()).unwrap();
    let plane = vec![1.0; 19 * 17];
    let refused = |up: Upstream<'_>, g: &Gaussians, view: &View| {
        backward(g, view, &settings, &traced, &up, mask).unwrap_err()
    };
    let color = vec![1.0; 3 * 19 * 17];
    let rgb = Upstream { rgb: Some(&color), ..Upstream::default() };
    assert!(matches!(refused(rgb, &g, &view()), BackwardError::NotTraced { picture: "rgb" }));
    let expected = Upstream { depth_expected: Some(&plane), ..Upstream::default() };
    let error = refused(expected, &g, &view());
    assert!(matches!(error, BackwardError::NotTraced { picture: "depth_expected" }));
    let short = Upstream { alpha: Some(&plane[1..]), ..Upstream::default() };
    let error = refused(short, &g, &view());
    let BackwardError::Raster(RasterError::Length { field: "alpha", expected, got }) = error else {
        panic!("{error}")
    };
    assert_eq!((expected, got), (323, 322));
    let good = Upstream { alpha: Some(&plane), ..Upstream::default() };
    let error = refused(good, &row(3), &view());
    assert!(error.to_string().contains("Gaussians of the trace"), "{error}");
    let error = refused(good, &g, &View { width: 17, height: 19, ..view() });
    assert!(error.to_string().contains("width of the trace"), "{error}");
    let features = [1.0; 2 * 3];
    let gradient = vec![1.0; 19 * 17 * 3];
    let of = |features, gradient, dim| Upstream {
        features: Some(FeatureGradient { features, gradient, dim }),
        ..Upstream::default()
    };
    let error = refused(of(&features[1..], &gradient, 3), &g, &view());
    assert!(error.to_string().contains("features: expected 6"), "{error}");
    let error = refused(of(&[], &[], 0), &g, &view());
    assert!(error.to_string().contains("feature dim"), "{error}");
    let error =
        trace(&g, &view(), &settings, TraceRequest { sh_degree: Some(4), ..TraceRequest::rgb() });
    assert!(matches!(error, Err(RasterError::Degree { degree: 4 })));
}

/// Many Gaussians behind each other: pixels that stop, on the border of the picture and inside.
#[test]
fn deep_stack_keeps_its_sums() {
    let mut g = row(200);
    for (i, mean) in g.means.iter_mut().enumerate() {
        *mean = [0.3 * (i as f32 * 0.7).sin(), 0.3 * (i as f32 * 1.3).cos(), 0.01 * i as f32];
    }
    g.opacities = (0..200).map(|i| if i % 7 == 0 { 1.0 } else { 0.3 }).collect();
    let settings = RasterSettings::default();
    let traced = trace(&g, &view(), &settings, TraceRequest::rgb()).unwrap();
    assert!(traced.picture.transmittance.iter().any(|t| *t < 2e-4), "some pixels stop");
    // The loss Σ rgb: each channel's DC gradient, summed over the Gaussians, is B₀ · Σ alpha.
    let got = run(&g, &settings, &vec![1.0; 3 * 19 * 17]).unwrap();
    let sum: f64 = got.sh.iter().step_by(3).map(|v| f64::from(*v)).sum();
    let alpha: f64 = traced.picture.alpha().iter().map(|v| f64::from(*v)).sum();
    assert!((sum / (alpha * 0.282_094_791_773_878_1) - 1.0).abs() < 1e-5, "{sum} {alpha}");
}
