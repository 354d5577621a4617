//! Twelve Gaussians: the f64 reference against central differences, and the crate against it.

use crate::support::reference::{self, Params, Upstream};
use crate::support::{groups as groups_of, noise};
use scenesplat_rasterizer::backward::{
    self, FeatureGradient, GradMask, Gradients, TraceRequest, trace,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};
use scenesplat_test_support::compare_relative;

const COUNT: usize = 12;
const SIZE: [usize; 2] = [37, 29];
/// Step of the differences: its cube is nothing, and ten digits remain.
const STEP: f64 = 1e-5;
/// Largest error of a difference, relative to the largest gradient of its group.
const DIFFERENCE: f64 = 1e-6;
/// Largest error of f32, likewise.
const F32: f64 = 1e-4;

/// Rounded to f32, so that both versions have the same numbers.
fn rounded(v: f64) -> f64 {
    f64::from(v as f32)
}

fn view() -> View {
    // A turn about the y axis, and a small one about x.
    let ((s, c), (t, d)) = (0.3f64.sin_cos(), 0.1f64.sin_cos());
    let pose = [[c, 0.0, s, 0.2], [t * s, d, -t * c, -0.1], [-d * s, t, d * c, 4.0]];
    View {
        world_to_camera: pose.map(|row| row.map(|v| v as f32)),
        fx: 30.0,
        fy: 34.0,
        cx: 17.25,
        cy: 15.5,
        width: SIZE[0] as u32,
        height: SIZE[1] as u32,
    }
}

/// Some of everything: a needle, one that saturates, one beyond the tangent limits, one below a
/// pixel, a color that is clamped, two close behind each other.
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

fn cases() -> [(&'static str, RasterSettings); 4] {
    let settings = RasterSettings::gsplat_1_6();
    let background = Some([0.25, 0.5, 0.75]);
    [
        ("classic", settings),
        ("antialiased", RasterSettings { antialiased: true, ..settings }),
        ("background", RasterSettings { background, ..settings }),
        ("quaternions as they are", RasterSettings { normalize_quats: false, ..settings }),
    ]
}

/// The scene, fit for quaternions that are not normalized.
fn scene_for(settings: &RasterSettings, dim: usize) -> Params {
    let mut p = scene(dim);
    if !settings.normalize_quats {
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
    let (view, up) = (view(), upstream(5));
    for (name, settings) in cases() {
        let mut p = scene_for(&settings, 5);
        let picture = reference::forward(&p, &view, &settings, None);
        let decisions = picture.decisions();
        let mut want = reference::backward(&p, &view, &settings, &picture, &up, true);
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
                    let picture = reference::forward(&p, &view, &settings, Some(&decisions));
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

/// The crate's gradients, of the pictures that have an upstream one.
fn crate_gradients(
    p: &Params,
    settings: &RasterSettings,
    up: &Upstream,
    mask: GradMask,
) -> Gradients {
    let (gaussians, view) = (gaussians(p), view());
    let f32s = |v: &[f64]| -> Vec<f32> { v.iter().map(|v| *v as f32).collect() };
    let rgb = f32s(up.rgb.as_flattened());
    let (alpha, accumulated, expected) =
        (f32s(&up.alpha), f32s(&up.depth_accumulated), f32s(&up.depth_expected));
    let dim = p.features.first().map_or(0, Vec::len);
    let (features, gradient) = (f32s(&p.features.concat()), f32s(&up.features.concat()));
    fn given(values: &[f32]) -> Option<&[f32]> {
        (!values.is_empty()).then_some(values)
    }
    let upstream = backward::Upstream {
        rgb: given(&rgb),
        alpha: given(&alpha),
        depth_accumulated: given(&accumulated),
        depth_expected: given(&expected),
        features: given(&gradient).map(|gradient| FeatureGradient {
            features: &features,
            gradient,
            dim,
        }),
    };
    let traced = trace(&gaussians, &view, settings, TraceRequest::rgb_depth()).unwrap();
    backward::backward(&gaussians, &view, settings, &traced, &upstream, mask).unwrap()
}

fn compare(case: &str, got: &Gradients, want: &Params) {
    let want = groups(&mut want.clone()).map(|(_, values)| values.iter().map(|v| **v).collect());
    for ((group, got), want) in groups_of(got).into_iter().zip::<[Vec<f64>; 6]>(want) {
        // No gradient where none came from above.
        if !got.is_empty() && want.iter().any(|v| *v != 0.0) {
            compare_relative(&format!("{case}, {group}"), got, &want, F32);
        } else {
            assert!(got.iter().all(|v| *v == 0.0), "{case}, {group}");
        }
    }
}

/// All pictures at once, and each by itself.
#[test]
fn gradients_are_those_of_the_reference() {
    for (name, settings) in cases() {
        // More channels than one group of them.
        let (dim, p) = (41, scene_for(&settings, 41));
        let picture = reference::forward(&p, &view(), &settings, None);
        let all = upstream(dim);
        let none = Upstream::default();
        let cases = [
            ("all", all.clone()),
            ("rgb", Upstream { rgb: all.rgb.clone(), ..none.clone() }),
            ("alpha", Upstream { alpha: all.alpha.clone(), ..none.clone() }),
            (
                "accumulated",
                Upstream { depth_accumulated: all.depth_accumulated.clone(), ..none.clone() },
            ),
            ("expected", Upstream { depth_expected: all.depth_expected.clone(), ..none.clone() }),
            ("features", Upstream { features: all.features.clone(), ..none }),
        ];
        for (which, up) in cases {
            let want = reference::backward(&p, &view(), &settings, &picture, &up, true);
            let got = crate_gradients(&p, &settings, &up, GradMask::all());
            compare(&format!("{name}, {which}"), &got, &want);
        }
        let detached = GradMask { sh_direction: false, ..GradMask::all() };
        let want = reference::backward(&p, &view(), &settings, &picture, &all, false);
        let got = crate_gradients(&p, &settings, &all, detached);
        compare(&format!("{name}, detached"), &got, &want);
    }
}

/// A scene of equal scales, drawn without its quaternions: the shared scale has the sum.
#[test]
fn isotropic() {
    let mut p = scene(0);
    for s in &mut p.scales {
        *s = [s[0]; 3];
    }
    let up = Upstream { features: Vec::new(), ..upstream(0) };
    let classic = RasterSettings::gsplat_1_6();
    let picture = reference::forward(&p, &view(), &classic, None);
    let mut want = reference::backward(&p, &view(), &classic, &picture, &up, true);
    for row in &mut want.scales {
        *row = [row.iter().sum(), 0.0, 0.0];
    }
    want.quats = vec![[0.0; 4]; COUNT];
    let settings = RasterSettings { isotropic: true, ..classic };
    compare("isotropic", &crate_gradients(&p, &settings, &up, GradMask::all()), &want);
}
