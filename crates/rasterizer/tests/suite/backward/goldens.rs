//! Gradients of the golden scenes, summed over their cameras.

use crate::support::{Scene, groups, on_threads};
use scenesplat_kernels::simd::Isa;
use scenesplat_rasterizer::backward::{
    BackwardError, GradMask, Gradients, TraceRequest, Upstream, Workspace, backward, trace,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings};
use scenesplat_test_support::{Golden, compare_relative};

/// Largest error of a gradient, relative to the largest value of its tensor.
const GRADIENT: f64 = 1e-4;
/// The same for scales with antialiasing, whose factor is a quotient of determinants.
const ANTIALIASED_SCALES: f64 = 1e-3;

/// One golden file and how it is rendered.
struct Case {
    file: &'static str,
    degree: u8,
    settings: RasterSettings,
    /// Which pictures have an upstream gradient beside color.
    alpha: bool,
    depth: bool,
    background: bool,
}

fn plain(file: &'static str, degree: u8, all: bool) -> Case {
    let settings = RasterSettings::gsplat_1_6();
    Case { file, degree, settings, alpha: all, depth: all, background: false }
}

fn sh3(file: &'static str) -> Case {
    plain(file, 3, true)
}

fn classic(settings: RasterSettings) -> Case {
    Case { settings, ..sh3("render_classic_sh3") }
}

fn cases() -> [Case; 7] {
    let settings = RasterSettings::gsplat_1_6();
    let legacy = RasterSettings { alpha_max: 0.999, ..settings };
    let antialiased = RasterSettings { antialiased: true, ..settings };
    [
        plain("render_classic_sh0", 0, false),
        plain("render_classic_sh1", 1, false),
        plain("render_classic_sh2", 2, false),
        classic(settings),
        Case { depth: false, background: true, ..sh3("render_background_sh3") },
        Case { settings: antialiased, ..sh3("render_antialiased_sh3") },
        Case { settings: legacy, ..sh3("render_legacy_alpha0999_sh3") },
    ]
}

/// Gradients of `Σ v · picture` over the cameras of a scene, whose file has the upstream gradients.
fn gradients(
    case: &Case,
    gaussians: &Gaussians,
    scene: &Scene,
    backgrounds: Option<&Golden>,
    mask: GradMask,
) -> Result<Gradients, BackwardError> {
    let mut out = Gradients::zeros(gaussians, 0);
    for (i, view) in scene.views.iter().enumerate() {
        let [rgb, alpha, depth] = upstream(scene, i);
        let background = backgrounds.map(|b| b.part_f32("backgrounds", i).try_into().unwrap());
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
    }
    Ok(out)
}

/// Of color, alpha and accumulated depth.
fn upstream(scene: &Scene, view: usize) -> [Vec<f32>; 3] {
    ["v_rgb", "v_alpha", "v_depth"].map(|name| scene.golden.part_f32(name, view))
}

/// Gradients of a scene's own Gaussians.
fn run(case: &Case, scene: &Scene, mask: GradMask) -> Gradients {
    gradients(case, &scene.gaussians, scene, None, mask).unwrap()
}

fn compare_all(name: &str, got: &Gradients, want: &Golden, prefix: &str, degree: u8, scales: f64) {
    let coefficients = 3 * usize::from(degree + 1).pow(2);
    let (drawn, rest): (Vec<_>, Vec<_>) =
        got.sh.chunks_exact(48).map(|row| row.split_at(coefficients)).unzip();
    assert!(rest.concat().iter().all(|v| *v == 0.0), "bands that were not drawn");
    let got = Gradients { sh: drawn.concat(), ..got.clone() };
    for (tensor, values) in groups(&got).into_iter().filter(|(tensor, _)| *tensor != "features") {
        let limit = if tensor == "scales" { scales } else { GRADIENT };
        let want = want.f64s(&format!("{prefix}{tensor}"));
        compare_relative(&format!("{name} {tensor}"), values, &want, limit);
    }
}

#[test]
fn synthetic_scene() {
    let Some(scene) = Scene::synthetic() else { return };
    for case in cases() {
        let Some(want) = Golden::raster(case.file) else { return };
        let backgrounds = case.background.then_some(&want);
        let run = |mask| gradients(&case, &scene.gaussians, &scene, backgrounds, mask).unwrap();
        let scales = if case.settings.antialiased { ANTIALIASED_SCALES } else { GRADIENT };
        compare_all(case.file, &run(GradMask::all()), &want, "v_", case.degree, scales);
        if want.has("v_means_shpath") {
            let got = run(GradMask { sh_direction: false, ..GradMask::all() });
            let (all, path) = (want.f64s("v_means"), want.f64s("v_means_shpath"));
            let rest: Vec<f64> = all.iter().zip(path).map(|(all, path)| all - path).collect();
            let means = got.means.as_flattened();
            compare_relative("means, direction detached", means, &rest, GRADIENT);
        }
    }
}

#[test]
fn every_instruction_set() {
    let Some(scene) = Scene::synthetic() else { return };
    let Some(want) = Golden::raster("render_classic_sh3") else { return };
    for isa in [Isa::Portable, Isa::Avx2, Isa::Avx512] {
        let case = classic(RasterSettings { isa, ..RasterSettings::gsplat_1_6() });
        let got = run(&case, &scene, GradMask::all());
        compare_all(isa.name(), &got, &want, "v_", 3, GRADIENT);
    }
}

#[test]
fn garden() {
    let Some(garden) = Scene::garden() else { return };
    let got = run(&sh3("garden"), &garden, GradMask::all());
    compare_all("garden", &got, &garden.golden, "g_", 3, GRADIENT);
}

/// Hostile Gaussians have no gradient, and nobody else's changes.
#[test]
fn hazards() {
    let Some((scene, hazards)) = Scene::synthetic().zip(Scene::hazards()) else { return };
    for antialiased in [false, true] {
        let case = classic(RasterSettings { antialiased, ..RasterSettings::gsplat_1_6() });
        let want = run(&case, &scene, GradMask::all());
        let got = run(&case, &hazards, GradMask::all());
        for ((name, got), (_, want)) in groups(&got).into_iter().zip(groups(&want)) {
            let (own, hostile) = got.split_at(want.len());
            assert!(own == want, "{name}");
            assert!(hostile.iter().all(|v| *v == 0.0), "{name}");
        }
    }
}

/// A frozen group has gradient 0, and the others' gradients are the same.
#[test]
fn masks() {
    let Some(scene) = Scene::synthetic() else { return };
    let case = classic(RasterSettings::gsplat_1_6());
    let run = |mask| run(&case, &scene, mask);
    let zero = Gradients::zeros(&scene.gaussians, 0);
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
    let Some(scene) = Scene::synthetic() else { return };
    let case = classic(RasterSettings::gsplat_1_6());
    let [one, two, five] =
        [1, 2, 5].map(|threads| on_threads(threads, || run(&case, &scene, GradMask::all())));
    assert!(one == two && one == five);
}

/// What `backward` gives equals `Workspace::backward` on zeros, and a second call adds.
#[test]
fn into_adds() {
    let Some(scene) = Scene::synthetic() else { return };
    let (gaussians, view) = (&scene.gaussians, &scene.views[0]);
    let settings = RasterSettings::default();
    let traced = trace(gaussians, view, &settings, TraceRequest::rgb()).unwrap();
    let [rgb, ..] = upstream(&scene, 0);
    let up = Upstream { rgb: Some(&rgb), ..Upstream::default() };
    let mask = GradMask::all();
    let once = backward(gaussians, view, &settings, &traced, &up, mask).unwrap();
    let mut twice = once.clone();
    Workspace::new().backward(gaussians, view, &settings, &traced, &up, mask, &mut twice).unwrap();
    for ((name, once), (_, twice)) in groups(&once).into_iter().zip(groups(&twice)) {
        assert!(once.iter().zip(twice).all(|(a, b)| a + a == *b), "{name}");
    }
}

/// Gradients of centers on the picture, camera by camera; without room for them nothing else changes.
#[test]
fn centers_on_the_picture() {
    let Some(scene) = Scene::synthetic() else { return };
    let Some(want) = Golden::raster("render_classic_sh3") else { return };
    let gaussians = &scene.gaussians;
    let settings = RasterSettings::gsplat_1_6();
    for (i, view) in scene.views.iter().enumerate() {
        let [rgb, alpha, depth] = upstream(&scene, i);
        let upstream = Upstream {
            rgb: Some(&rgb),
            alpha: Some(&alpha),
            depth_accumulated: Some(&depth),
            ..Upstream::default()
        };
        let traced = trace(gaussians, view, &settings, TraceRequest::rgb_depth()).unwrap();
        let run = |room: usize| {
            let zeros = Gradients::zeros(gaussians, 0);
            let mut out = Gradients { screen: vec![[0.0; 2]; room], ..zeros };
            let all = GradMask::all();
            Workspace::new()
                .backward(gaussians, view, &settings, &traced, &upstream, all, &mut out)
                .map(|()| out)
        };
        let with = run(gaussians.len()).unwrap();
        let name = format!("camera {i}");
        let centers = with.screen.as_flattened();
        compare_relative(&name, centers, &want.part("v_means2d", i), GRADIENT);
        assert_eq!(Gradients { screen: Vec::new(), ..with }, run(0).unwrap());
        assert!(run(3).is_err(), "room for three of them");
    }
}
