//! Memory that is used again: nothing of an earlier picture is in a later one.

use scenesplat_rasterizer::backward::{
    BackwardError, FeatureGradient, GradMask, Gradients, Trace, TraceRequest, Upstream, Workspace,
    backward, trace,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};

/// A number in 0..1 that depends on its place alone.
fn noise(at: usize) -> f32 {
    let mut x = (at as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((x ^ x >> 27) >> 40) as f32 / (1u64 << 24) as f32
}

fn values(len: usize, seed: usize) -> Vec<f32> {
    (0..len).map(|i| noise(seed * 1_000_003 + i) - 0.5).collect()
}

/// A cloud in front of the camera, some of it beside the picture; every 50th colour is not finite.
fn cloud(n: usize, seed: usize) -> Gaussians {
    let at = |i: usize, k: usize| noise(seed * 100_003 + 16 * i + k);
    let mut sh = values(12 * n, seed);
    sh.iter_mut().step_by(50 * 12).skip(1).for_each(|v| *v = f32::NAN);
    Gaussians {
        means: (0..n)
            .map(|i| [4.0 * at(i, 0) - 2.0, 3.0 * at(i, 1) - 1.5, 3.0 * at(i, 2) + 0.5])
            .collect(),
        quats: (0..n).map(|i| [3, 4, 5, 6].map(|k| at(i, k) - 0.5)).collect(),
        scales: (0..n).map(|i| [7, 8, 9].map(|k| 0.01 + 0.1 * at(i, k))).collect(),
        opacities: (0..n).map(|i| at(i, 10)).collect(),
        sh,
        sh_degree: 1,
    }
}

fn view(width: u32, height: u32) -> View {
    View {
        world_to_camera: [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5]],
        fx: width as f32,
        fy: width as f32,
        cx: width as f32 / 2.0,
        cy: height as f32 / 2.0,
        width,
        height,
    }
}

/// Gaussians, size of the picture, colour, depth, channels of features, whether geometry is wanted.
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
