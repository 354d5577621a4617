//! Twelve Gaussians: the f64 reference against central differences, and the crate against it.

use crate::reference::{self, Camera, Params, Picture, Rules, Upstream};
use scenesplat_rasterizer::backward::{
    self, FeatureGradient, GradMask, Gradients, TraceRequest, trace,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};

const COUNT: usize = 12;
const SIZE: [usize; 2] = [37, 29];
/// Step of the differences: the cube of it is nothing, and ten digits are left.
const STEP: f64 = 1e-5;
/// Largest error of a difference, relative to the largest gradient of its group.
const DIFFERENCE: f64 = 1e-6;
/// Largest error of f32, likewise.
const F32: f64 = 1e-4;

/// A number in −1..1 that depends on the name alone.
fn noise(name: usize) -> f64 {
    let mut x = (name as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ x >> 31) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Rounded to f32, so that both versions have the same numbers.
fn rounded(v: f64) -> f64 {
    f64::from(v as f32)
}

fn camera() -> Camera {
    // A turn about the y axis, and a small one about x.
    let ((s, c), (t, d)) = (0.3f64.sin_cos(), 0.1f64.sin_cos());
    let rotation = [[c, 0.0, s], [t * s, d, -t * c], [-d * s, t, d * c]];
    Camera {
        rotation: rotation.map(|r| r.map(rounded)),
        translation: [0.2, -0.1, 4.0].map(rounded),
        focal: [30.0, 34.0],
        centre: [17.25, 15.5],
        size: SIZE,
    }
}

/// Some of everything: a needle, one that saturates, one beyond the tangent limits, one below a
/// pixel, a colour that is clamped, two close behind each other.
fn scene(dim: usize) -> Params {
    let mut p = Params::default();
    for i in 0..COUNT {
        let n = |k: usize| noise(100 * i + k);
        p.means.push([1.5 * n(0), 1.2 * n(1), 1.5 * n(2)].map(rounded));
        p.quats.push([n(3), n(4), n(5), n(6)].map(rounded));
        p.scales.push([7, 8, 9].map(|k| rounded(0.25 + 0.2 * n(k))));
        p.opacities.push(rounded(0.5 + 0.4 * n(10)));
        p.sh.push((0..48).map(|k| rounded(0.3 * n(11 + k))).collect());
        p.features.push((0..dim).map(|k| rounded(noise(9000 + 50 * i + k))).collect());
    }
    p.scales[1] = [0.9, 0.01, 0.01].map(rounded);
    p.opacities[2] = rounded(0.9999);
    p.scales[2] = [0.5, 0.4, 0.6].map(rounded);
    p.means[3] = [6.0, 0.3, 1.0];
    p.scales[3] = [2.0, 1.5, 1.0];
    p.scales[4] = [0.004, 0.003, 0.005].map(rounded);
    p.opacities[4] = rounded(0.95);
    p.sh[5][0] = -4.0;
    p.means[6] = p.means[7].map(|v| rounded(v + 0.01));
    p.quats[8] = p.quats[8].map(|q| rounded(30.0 * q));
    p
}

fn upstream(dim: usize) -> Upstream {
    let pixels = SIZE[0] * SIZE[1];
    let each = |name: usize, scale: f64| -> Vec<f64> {
        (0..pixels).map(|i| rounded(scale * noise(name + i))).collect()
    };
    Upstream {
        rgb: (0..pixels).map(|i| [0, 1, 2].map(|c| rounded(noise(20_000 + 3 * i + c)))).collect(),
        alpha: each(40_000, 1.0),
        depth_accumulated: each(50_000, 0.3),
        depth_expected: each(60_000, 0.2),
        features: (0..pixels)
            .map(|i| (0..dim).map(|c| rounded(0.5 * noise(80_000 + dim * i + c))).collect())
            .collect(),
    }
}

fn cases() -> Vec<(&'static str, Rules, RasterSettings)> {
    let (rules, settings) = (Rules::classic(), RasterSettings::gsplat_1_6());
    let background = [0.25, 0.5, 0.75];
    vec![
        ("classic", rules.clone(), settings),
        (
            "antialiased",
            Rules { floor: Some(f64::from(0.005f32)), ..rules.clone() },
            RasterSettings { antialiased: true, ..settings },
        ),
        (
            "background",
            Rules { background, ..rules.clone() },
            RasterSettings { background: Some(background.map(|v| v as f32)), ..settings },
        ),
        (
            "quaternions as they are",
            Rules { normalize: false, ..rules },
            RasterSettings { normalize_quats: false, ..settings },
        ),
    ]
}

/// The scene, fit for quaternions that are not normalised.
fn scene_for(rules: &Rules, dim: usize) -> Params {
    let mut p = scene(dim);
    if !rules.normalize {
        for q in &mut p.quats {
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            *q = q.map(|v| rounded(1.1 * v / norm));
        }
    }
    p
}

/// Every number of the parameters, by group.
fn groups(p: &mut Params) -> [(&'static str, Vec<&mut f64>); 6] {
    fn flat<const N: usize>(rows: &mut [[f64; N]]) -> Vec<&mut f64> {
        rows.iter_mut().flatten().collect()
    }
    [
        ("means", flat(&mut p.means)),
        ("quats", flat(&mut p.quats)),
        ("scales", flat(&mut p.scales)),
        ("opacities", p.opacities.iter_mut().collect()),
        ("sh", p.sh.iter_mut().flatten().collect()),
        ("features", p.features.iter_mut().flatten().collect()),
    ]
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |m, v| if v.is_nan() { v } else { m.max(v.abs()) })
}

#[test]
fn reference_is_the_difference_quotient() {
    let (cam, up) = (camera(), upstream(5));
    for (name, rules, _) in cases() {
        let mut p = scene_for(&rules, 5);
        let picture = reference::forward(&p, &cam, &rules, None);
        let decisions = picture.decisions();
        let mut want = reference::backward(&p, &cam, &rules, &picture, &up, true);
        let mut worst = Vec::new();
        for (group, values) in groups(&mut want) {
            let values: Vec<f64> = values.into_iter().map(|v| *v).collect();
            let scale = largest(values.iter().copied());
            assert!(scale > 0.0, "{name}: {group} has no gradient");
            for (i, value) in values.iter().enumerate() {
                let mut at = |step: f64| {
                    let of = |p: &mut Params| -> f64 {
                        let mut groups = groups(p);
                        let numbers = groups.iter_mut().find(|g| g.0 == group).unwrap();
                        *numbers.1[i] += step;
                        *numbers.1[i]
                    };
                    let before = of(&mut p) - step;
                    let picture = reference::forward(&p, &cam, &rules, Some(&decisions));
                    let loss = reference::loss(&picture, &up);
                    let mut all = groups(&mut p);
                    *all.iter_mut().find(|g| g.0 == group).unwrap().1[i] = before;
                    loss
                };
                let difference = (at(STEP) - at(-STEP)) / (2.0 * STEP);
                let error = (difference - value).abs() / scale;
                worst.push(error);
                assert!(error < DIFFERENCE, "{name}, {group}[{i}]: {value} is {difference}");
            }
        }
        println!("{name}: {} numbers, worst {:.1e}", worst.len(), largest(worst.into_iter()));
    }
}

fn gaussians(p: &Params) -> Gaussians {
    Gaussians {
        means: p.means.iter().map(|r| r.map(|v| v as f32)).collect(),
        quats: p.quats.iter().map(|r| r.map(|v| v as f32)).collect(),
        scales: p.scales.iter().map(|r| r.map(|v| v as f32)).collect(),
        opacities: p.opacities.iter().map(|v| *v as f32).collect(),
        sh: p.sh.iter().flatten().map(|v| *v as f32).collect(),
        sh_degree: 3,
    }
}

fn view(cam: &Camera) -> View {
    let row = |i: usize| {
        let [a, b, c] = cam.rotation[i];
        [a as f32, b as f32, c as f32, cam.translation[i] as f32]
    };
    View {
        world_to_camera: [row(0), row(1), row(2)],
        fx: cam.focal[0] as f32,
        fy: cam.focal[1] as f32,
        cx: cam.centre[0] as f32,
        cy: cam.centre[1] as f32,
        width: SIZE[0] as u32,
        height: SIZE[1] as u32,
    }
}

/// The crate's gradients, of the pictures that `which` names.
fn crate_gradients(
    p: &Params,
    settings: &RasterSettings,
    up: &Upstream,
    mask: GradMask,
) -> Gradients {
    let (gaussians, view) = (gaussians(p), view(&camera()));
    let f32s = |v: &[f64]| -> Vec<f32> { v.iter().map(|v| *v as f32).collect() };
    let rgb = f32s(up.rgb.as_flattened());
    let (alpha, acc, exp) =
        (f32s(&up.alpha), f32s(&up.depth_accumulated), f32s(&up.depth_expected));
    let dim = p.features.first().map_or(0, Vec::len);
    let features = f32s(&p.features.concat());
    let feature_gradient = f32s(&up.features.concat());
    let given = |v: &'static str, values: &[f32]| (!values.is_empty()).then_some(v);
    let upstream = backward::Upstream {
        rgb: given("rgb", &rgb).map(|_| &rgb[..]),
        alpha: given("alpha", &alpha).map(|_| &alpha[..]),
        depth_accumulated: given("acc", &acc).map(|_| &acc[..]),
        depth_expected: given("exp", &exp).map(|_| &exp[..]),
        features: given("features", &feature_gradient).map(|_| FeatureGradient {
            features: &features,
            gradient: &feature_gradient,
            dim,
        }),
    };
    let traced = trace(&gaussians, &view, settings, TraceRequest::rgb_depth()).unwrap();
    backward::backward(&gaussians, &view, settings, &traced, &upstream, mask).unwrap()
}

fn compare(case: &str, got: &Gradients, want: &Params) {
    let check = |group: &str, got: &[f32], want: Vec<f64>| {
        if got.is_empty() {
            return;
        }
        assert_eq!(got.len(), want.len(), "{case}, {group}");
        let scale = largest(want.iter().copied());
        let error = largest(got.iter().zip(&want).map(|(g, w)| f64::from(*g) - w));
        println!("{case}, {group}: {:.1e}", error / scale);
        assert!(error <= F32 * scale, "{case}, {group}: {error:e} where the largest is {scale:e}");
    };
    check("means", got.means.as_flattened(), want.means.concat());
    check("quats", got.quats.as_flattened(), want.quats.concat());
    check("scales", got.scales.as_flattened(), want.scales.concat());
    check("opacities", &got.opacities, want.opacities.clone());
    check("sh", &got.sh, want.sh.concat());
    check("features", &got.features, want.features.concat());
}

fn reference_picture(rules: &Rules, p: &Params) -> Picture {
    reference::forward(p, &camera(), rules, None)
}

/// All pictures at once, and each by itself.
#[test]
fn gradients_are_those_of_the_reference() {
    for (name, rules, settings) in cases() {
        // More channels than one group of them.
        let (dim, p) = (41, scene_for(&rules, 41));
        let picture = reference_picture(&rules, &p);
        let all = upstream(dim);
        let only = |name: &str| match name {
            "rgb" => Upstream { rgb: all.rgb.clone(), ..Upstream::default() },
            "alpha" => Upstream { alpha: all.alpha.clone(), ..Upstream::default() },
            "accumulated" => {
                Upstream { depth_accumulated: all.depth_accumulated.clone(), ..Upstream::default() }
            }
            "expected" => {
                Upstream { depth_expected: all.depth_expected.clone(), ..Upstream::default() }
            }
            "features" => Upstream { features: all.features.clone(), ..Upstream::default() },
            _ => all.clone(),
        };
        for which in ["all", "rgb", "alpha", "accumulated", "expected", "features"] {
            let up = only(which);
            let want = reference::backward(&p, &camera(), &rules, &picture, &up, true);
            let got = crate_gradients(&p, &settings, &up, GradMask::all());
            compare(&format!("{name}, {which}"), &got, &want);
        }
        let detached = GradMask { sh_direction: false, ..GradMask::all() };
        let want = reference::backward(&p, &camera(), &rules, &picture, &all, false);
        compare(
            &format!("{name}, detached"),
            &crate_gradients(&p, &settings, &all, detached),
            &want,
        );
    }
}

/// A scene of equal scales, drawn without its quaternions: the shared scale has the sum.
#[test]
fn isotropic() {
    let rules = Rules::classic();
    let mut p = scene(0);
    for s in &mut p.scales {
        *s = [s[0]; 3];
    }
    let up = Upstream { features: Vec::new(), ..upstream(0) };
    let picture = reference_picture(&rules, &p);
    let mut want = reference::backward(&p, &camera(), &rules, &picture, &up, true);
    for row in &mut want.scales {
        *row = [row.iter().sum(), 0.0, 0.0];
    }
    want.quats = vec![[0.0; 4]; COUNT];
    let settings = RasterSettings { isotropic: true, ..RasterSettings::gsplat_1_6() };
    let got = crate_gradients(&p, &settings, &up, GradMask::all());
    assert!(got.quats.as_flattened().iter().all(|v| *v == 0.0));
    let quiet = Gradients { quats: Vec::new(), ..got };
    compare("isotropic", &quiet, &want);
}
