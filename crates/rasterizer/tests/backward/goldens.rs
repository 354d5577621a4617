//! Gradients of the golden scenes, summed over their cameras.

use crate::support::Golden;
use scenesplat_kernels::simd::Isa;
use scenesplat_rasterizer::backward::{
    BackwardError, GradMask, Gradients, Trace, TraceRequest, Upstream, Workspace, backward, trace,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};

/// Largest error of a gradient, relative to the largest value of its tensor.
const GRADIENT: f64 = 1e-4;
/// The same for scales with antialiasing, whose factor is a quotient of determinants.
const ANTIALIASED_SCALES: f64 = 1e-3;

/// One golden file and how it is rendered.
struct Case {
    file: &'static str,
    degree: u8,
    settings: RasterSettings,
    /// Which pictures have an upstream gradient beside colour.
    alpha: bool,
    depth: bool,
    background: bool,
}

fn cases() -> Vec<Case> {
    let plain = |file, degree, all| Case {
        file,
        degree,
        settings: RasterSettings::gsplat_1_6(),
        alpha: all,
        depth: all,
        background: false,
    };
    let sh3 = |file| plain(file, 3, true);
    let legacy = RasterSettings { alpha_max: 0.999, ..RasterSettings::gsplat_1_6() };
    let antialiased = RasterSettings { antialiased: true, ..RasterSettings::gsplat_1_6() };
    vec![
        plain("render_classic_sh0", 0, false),
        plain("render_classic_sh1", 1, false),
        plain("render_classic_sh2", 2, false),
        sh3("render_classic_sh3"),
        Case { depth: false, background: true, ..sh3("render_background_sh3") },
        Case { settings: antialiased, ..sh3("render_antialiased_sh3") },
        Case { settings: legacy, ..sh3("render_legacy_alpha0999_sh3") },
    ]
}

/// Gradients of `Σ v · picture` over the cameras, upstream gradients from `from`.
fn gradients(
    case: &Case,
    gaussians: &Gaussians,
    views: &[View],
    from: &Golden,
    backgrounds: Option<&Golden>,
    mask: GradMask,
) -> Result<(Gradients, Vec<Trace>), BackwardError> {
    let mut out = Gradients::zeros(gaussians, 0);
    let mut traces = Vec::new();
    for (i, view) in views.iter().enumerate() {
        let part = |name: &str| from.part(name, i).iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let (rgb, alpha, depth) = (part("v_rgb"), part("v_alpha"), part("v_depth"));
        let background = backgrounds.map(|b| {
            let c = b.part("backgrounds", i);
            [c[0] as f32, c[1] as f32, c[2] as f32]
        });
        let settings = RasterSettings { background, ..case.settings };
        let request = TraceRequest { rgb: true, depth: case.depth, sh_degree: Some(case.degree) };
        let upstream = Upstream {
            rgb: Some(&rgb),
            alpha: case.alpha.then_some(&alpha),
            depth_accumulated: case.depth.then_some(&depth),
            ..Upstream::default()
        };
        let traced = trace(gaussians, view, &settings, request)?;
        Workspace::new()
            .backward(gaussians, view, &settings, &traced, &upstream, mask, &mut out)?;
        traces.push(traced);
    }
    Ok((out, traces))
}

/// Largest error relative to the largest value.
fn error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let most = want.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let worst = got.iter().zip(want).map(|(g, w)| (f64::from(*g) - w).abs());
    worst.fold(0.0, |m: f64, e| if e.is_nan() { e } else { m.max(e) }) / most
}

fn compare(name: &str, got: &[f32], want: &[f64], limit: f64) {
    let error = error(got, want);
    println!("{name}: {error:.2e}");
    assert!(error <= limit, "{name}: {error:e} of the largest value, more than {limit:e}");
}

/// The first `bands` bands of harmonics that have 16.
fn bands(sh: &[f32], bands: usize) -> Vec<f32> {
    sh.chunks_exact(48).flat_map(|row| row[..3 * bands].to_vec()).collect()
}

fn compare_all(name: &str, got: &Gradients, want: &Golden, prefix: &str, degree: u8, scales: f64) {
    let side = usize::from(degree) + 1;
    let arrays: [(&str, Vec<f32>, f64); 5] = [
        ("means", got.means.as_flattened().to_vec(), GRADIENT),
        ("quats", got.quats.as_flattened().to_vec(), GRADIENT),
        ("scales", got.scales.as_flattened().to_vec(), scales),
        ("opacities", got.opacities.clone(), GRADIENT),
        ("sh", bands(&got.sh, side * side), GRADIENT),
    ];
    for (tensor, values, limit) in arrays {
        compare(
            &format!("{name} {tensor}"),
            &values,
            want.array(&format!("{prefix}{tensor}")),
            limit,
        );
    }
    for row in got.sh.chunks_exact(48) {
        assert!(row[3 * side * side..].iter().all(|v| *v == 0.0), "bands that were not drawn");
    }
}

#[test]
fn synthetic_scene() {
    let Some(scene) = Golden::open("scene") else { return };
    let (gaussians, views) = (scene.gaussians(), scene.views([64, 96]));
    for case in cases() {
        let Some(want) = Golden::open(case.file) else { return };
        let backgrounds = case.background.then_some(&want);
        let all = GradMask::all();
        let (got, _) = gradients(&case, &gaussians, &views, &scene, backgrounds, all).unwrap();
        let scales = if case.settings.antialiased { ANTIALIASED_SCALES } else { GRADIENT };
        compare_all(case.file, &got, &want, "v_", case.degree, scales);
        if want.has("v_means_shpath") {
            let detached = GradMask { sh_direction: false, ..all };
            let (got, _) =
                gradients(&case, &gaussians, &views, &scene, backgrounds, detached).unwrap();
            let path = want.array("v_means").iter().zip(want.array("v_means_shpath"));
            let rest: Vec<f64> = path.map(|(all, path)| all - path).collect();
            compare("means, direction detached", got.means.as_flattened(), &rest, GRADIENT);
        }
    }
}

#[test]
fn every_instruction_set() {
    let Some(scene) = Golden::open("scene") else { return };
    let (gaussians, views) = (scene.gaussians(), scene.views([64, 96]));
    let Some(want) = Golden::open("render_classic_sh3") else { return };
    for isa in [Isa::Portable, Isa::Avx2, Isa::Avx512] {
        let settings = RasterSettings { isa, ..RasterSettings::gsplat_1_6() };
        let case = Case { settings, ..cases().swap_remove(3) };
        let (got, _) = gradients(&case, &gaussians, &views, &scene, None, GradMask::all()).unwrap();
        compare_all(isa.name(), &got, &want, "v_", 3, GRADIENT);
    }
}

#[test]
fn garden() {
    let Some(garden) = Golden::open("garden") else { return };
    let case = Case { file: "garden", ..cases().swap_remove(3) };
    let (gaussians, views) = (garden.gaussians(), garden.views([70, 108]));
    let (got, _) = gradients(&case, &gaussians, &views, &garden, None, GradMask::all()).unwrap();
    compare_all("garden", &got, &garden, "g_", 3, GRADIENT);
}

/// Hostile Gaussians have no gradient, and nobody else's changes.
#[test]
fn hazards() {
    let (Some(scene), Some(hazards)) = (Golden::open("scene"), Golden::open("hazards")) else {
        return;
    };
    let (clean, hostile) = (scene.gaussians(), hazards.gaussians());
    let (n, views) = (clean.len(), scene.views([64, 96]));
    for antialiased in [false, true] {
        let settings = RasterSettings { antialiased, ..RasterSettings::gsplat_1_6() };
        let case = Case { settings, ..cases().swap_remove(3) };
        let run =
            |g: &Gaussians| gradients(&case, g, &views, &scene, None, GradMask::all()).unwrap().0;
        let (want, got) = (run(&clean), run(&hostile));
        assert_eq!(got.means[..n], want.means);
        assert_eq!(got.quats[..n], want.quats);
        assert_eq!(got.scales[..n], want.scales);
        assert_eq!(got.opacities[..n], want.opacities);
        assert_eq!(got.sh[..48 * n], want.sh);
        assert!(got.means[n..].as_flattened().iter().all(|v| *v == 0.0));
        assert!(got.quats[n..].as_flattened().iter().all(|v| *v == 0.0));
        assert!(got.scales[n..].as_flattened().iter().all(|v| *v == 0.0));
        assert!(got.opacities[n..].iter().all(|v| *v == 0.0));
        assert!(got.sh[48 * n..].iter().all(|v| *v == 0.0));
    }
}

/// A frozen group has gradient 0, and what is not frozen is what it was.
#[test]
fn masks() {
    let Some(scene) = Golden::open("scene") else { return };
    let (gaussians, views) = (scene.gaussians(), scene.views([64, 96]));
    let case = cases().swap_remove(3);
    let run = |mask| gradients(&case, &gaussians, &views, &scene, None, mask).unwrap().0;
    let zero = Gradients::zeros(&gaussians, 0);
    let all = run(GradMask::all());
    let none = GradMask::none();
    assert_eq!(run(none), zero);
    assert_eq!(run(GradMask::sh_only()), Gradients { sh: all.sh.clone(), ..zero.clone() });
    let means = GradMask { means: true, sh_direction: true, ..none };
    assert_eq!(run(means), Gradients { means: all.means.clone(), ..zero.clone() });
    let quats = run(GradMask { quats: true, ..none });
    assert_eq!(quats, Gradients { quats: all.quats.clone(), ..zero.clone() });
    let scales = run(GradMask { scales: true, ..none });
    assert_eq!(scales, Gradients { scales: all.scales.clone(), ..zero.clone() });
    let opacities = run(GradMask { opacities: true, ..none });
    assert_eq!(opacities, Gradients { opacities: all.opacities, ..zero });
}

#[test]
fn thread_counts_are_bit_equal() {
    let Some(scene) = Golden::open("scene") else { return };
    let (gaussians, views) = (scene.gaussians(), scene.views([64, 96]));
    let case = cases().swap_remove(3);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            gradients(&case, &gaussians, &views, &scene, None, GradMask::all()).unwrap().0
        })
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

/// A gradient of the picture that `trace` drew alone: what `backward` gives equals `Workspace::backward`
/// on zeros, and a second call adds.
#[test]
fn into_adds() {
    let Some(scene) = Golden::open("scene") else { return };
    let (gaussians, view) = (scene.gaussians(), scene.views([64, 96])[0]);
    let settings = RasterSettings::default();
    let traced = trace(&gaussians, &view, &settings, TraceRequest::rgb()).unwrap();
    let rgb: Vec<f32> = scene.part("v_rgb", 0).iter().map(|v| *v as f32).collect();
    let up = Upstream { rgb: Some(&rgb), ..Upstream::default() };
    let mask = GradMask::all();
    let once = backward(&gaussians, &view, &settings, &traced, &up, mask).unwrap();
    let mut twice = once.clone();
    Workspace::new()
        .backward(&gaussians, &view, &settings, &traced, &up, mask, &mut twice)
        .unwrap();
    for (a, b) in once.means.iter().zip(&twice.means) {
        assert_eq!(a.map(|v| v + v), *b);
    }
    for (a, b) in once.sh.iter().zip(&twice.sh) {
        assert_eq!(a + a, *b);
    }
}

/// Gradients of centres on the picture, camera by camera; without room for them nothing else changes.
#[test]
fn centres_on_the_picture() {
    let Some(scene) = Golden::open("scene") else { return };
    let Some(want) = Golden::open("render_classic_sh3") else { return };
    let (gaussians, views) = (scene.gaussians(), scene.views([64, 96]));
    let settings = RasterSettings::gsplat_1_6();
    for (i, view) in views.iter().enumerate() {
        let part = |name: &str| scene.part(name, i).iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let (rgb, alpha, depth) = (part("v_rgb"), part("v_alpha"), part("v_depth"));
        let upstream = Upstream {
            rgb: Some(&rgb),
            alpha: Some(&alpha),
            depth_accumulated: Some(&depth),
            ..Upstream::default()
        };
        let traced = trace(&gaussians, view, &settings, TraceRequest::rgb_depth()).unwrap();
        let run = |room: usize| {
            let zeros = Gradients::zeros(&gaussians, 0);
            let mut out = Gradients { screen: vec![[0.0; 2]; room], ..zeros };
            let all = GradMask::all();
            Workspace::new()
                .backward(&gaussians, view, &settings, &traced, &upstream, all, &mut out)
                .map(|()| out)
        };
        let with = run(gaussians.len()).unwrap();
        let name = format!("camera {i}");
        compare(&name, with.screen.as_flattened(), want.part("v_means2d", i), GRADIENT);
        assert_eq!(Gradients { screen: Vec::new(), ..with }, run(0).unwrap());
        assert!(run(3).is_err(), "room for three of them");
    }
}
