//! Memory that is used again: nothing of an earlier picture is in a later one.

use crate::support::{noise, pinhole, random};
use scenesplat_rasterizer::backward::{
    BackwardError, FeatureGradient, GradMask, Gradients, Trace, TraceRequest, Upstream, Workspace,
    backward, trace,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};

fn values(len: usize, seed: usize) -> Vec<f32> {
    (0..len).map(|i| noise(seed * 1_000_003 + i) as f32 / 2.0).collect()
}

/// Some of it beside the picture; every 50th color is not finite.
fn cloud(n: usize, seed: usize) -> Gaussians {
    let mut cloud = random(n, seed as u64);
    cloud.sh.iter_mut().step_by(50 * 27).skip(1).for_each(|v| *v = f32::NAN);
    cloud
}

fn view(width: u32, height: u32) -> View {
    pinhole([width, height], width as f32, 0.5)
}

/// Gaussians, size of the picture, color, depth, channels of features, whether geometry has gradients.
type Job = (usize, [u32; 2], bool, bool, usize, bool);

/// From many to few and back, every instantiation of the walk, and nothing at all.
const JOBS: [Job; 11] = [
    (6000, [160, 90], true, true, 0, true),
    // Two large ones in turn: lists are long, and what is behind the last Gaussian of a tile is, too.
    (7000, [150, 100], true, true, 0, true),
    (40, [19, 17], true, true, 0, true),
    (0, [33, 5], true, true, 0, true),
    (9000, [70, 45], true, false, 3, true),
    (500, [200, 120], false, true, 0, true),
    (3000, [64, 64], false, false, 0, true),
    (3000, [64, 64], true, false, 0, false),
    (800, [1, 1], true, true, 2, true),
    (6000, [160, 90], true, true, 0, true),
    (1, [90, 160], true, false, 0, true),
];

#[test]
fn nothing_is_left_of_an_earlier_picture() {
    let (mut workspace, mut again) = (Workspace::new(), Trace::default());
    let settings = RasterSettings { antialiased: true, ..RasterSettings::default() };
    for (i, (n, [width, height], rgb, depth, dim, geometry)) in JOBS.into_iter().enumerate() {
        let (g, view) = (cloud(n, i), view(width, height));
        let request = TraceRequest { rgb, depth, sh_degree: None };
        let fresh = trace(&g, &view, &settings, request).unwrap();
        workspace.trace(&g, &view, &settings, request, &mut again).unwrap();
        assert_eq!(again.picture, fresh.picture, "job {i}");
        assert_eq!((&again.lists, &again.colors), (&fresh.lists, &fresh.colors), "job {i}");
        assert_eq!(again.projected, fresh.projected, "job {i}");
        let pixels = view.pixels();
        let (of_rgb, of_depth, of_alpha) =
            (values(3 * pixels, 70), values(pixels, 71), values(pixels, 72));
        let (features, gradient) = (values(n * dim, 73), values(pixels * dim, 74));
        let of_features = FeatureGradient { features: &features, gradient: &gradient, dim };
        let up = Upstream {
            rgb: rgb.then_some(&of_rgb),
            alpha: geometry.then_some(&of_alpha),
            depth_accumulated: depth.then_some(&of_depth),
            depth_expected: None,
            features: (dim > 0).then_some(of_features),
        };
        let mask = if geometry { GradMask::all() } else { GradMask::sh_only() };
        let want = backward(&g, &view, &settings, &fresh, &up, mask).unwrap();
        let mut got = Gradients::zeros(&g, dim);
        workspace.backward(&g, &view, &settings, &again, &up, mask, &mut got).unwrap();
        assert_eq!(got, want, "job {i}");
        assert!(n < 100 || geometry == want.means.iter().flatten().any(|v| *v != 0.0), "job {i}");
    }
}

/// A trace that could not be made is of nothing: not of the picture before, whose sizes it may have.
#[test]
fn a_trace_that_failed_is_refused() {
    let (g, good) = (cloud(50, 1), view(20, 20));
    let (mut workspace, mut out) = (Workspace::new(), Trace::default());
    let (settings, request) = (RasterSettings::default(), TraceRequest::rgb());
    workspace.trace(&g, &good, &settings, request, &mut out).unwrap();
    let bad = View { fx: f32::NAN, ..good };
    assert!(workspace.trace(&g, &bad, &settings, request, &mut out).is_err());
    let rgb = vec![1.0; 1200];
    let up = Upstream { rgb: Some(&rgb), ..Upstream::default() };
    let mut gradients = Gradients::zeros(&g, 0);
    let all = GradMask::all();
    let error = workspace.backward(&g, &good, &settings, &out, &up, all, &mut gradients);
    assert!(matches!(error, Err(BackwardError::Raster(_))), "{error:?}");
    assert_eq!(gradients, Gradients::zeros(&g, 0));
}
