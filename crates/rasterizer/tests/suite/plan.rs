//! Plans: what is left out changes no more than it says, and costs nothing.

use crate::support::{Scene, on_threads};
use scenesplat_rasterizer::{
    Bound, DepthRequest, Gaussians, NeededGradients, PlanError, PlanRequest, RasterSettings,
    RenderPlan, RenderRequest, Rendered, SceneProfile, View, WorkCounters,
};

/// Another order of the same f32 sums, as the goldens allow between implementations.
const ROUNDING: f32 = 2e-5;
/// A pixel where an alpha is on the cut may take a Gaussian or not: its whole weight, 1/255.
const FLIPPED: f32 = 5e-3;

fn plans(gaussians: &Gaussians, settings: RasterSettings, request: PlanRequest) -> [RenderPlan; 2] {
    let profile = SceneProfile::scan(gaussians).unwrap();
    let auto = RenderPlan::auto(&profile, settings, request).unwrap();
    [auto, RenderPlan::full(&profile, settings, request).unwrap()]
}

fn pictures(plan: &RenderPlan, gaussians: &Gaussians, views: &[View]) -> Vec<Rendered> {
    let prepared = plan.prepare(gaussians.clone()).unwrap();
    let request = plan.request.render;
    views.iter().map(|v| prepared.render(v, &request).unwrap()).collect()
}

/// Renders with both plans; the pictures differ by no more than the plan says. Returns the plan
/// and the work that it did in all views.
fn same_within_the_bound(
    gaussians: &Gaussians,
    views: &[View],
    settings: RasterSettings,
    request: PlanRequest,
) -> (RenderPlan, Vec<WorkCounters>) {
    let [auto, full] = plans(gaussians, settings, request);
    let rounds = auto.decisions.iter().any(|d| d.bound != Bound::Exact);
    let rotates = auto.decisions.iter().any(|d| d.effect == "rotations" && d.verdict == "off");
    let mut work = Vec::new();
    let rendered =
        pictures(&auto, gaussians, views).into_iter().zip(pictures(&full, gaussians, views));
    for (a, f) in rendered {
        work.push(a.work);
        if !rounds {
            assert_eq!(a.rgb, f.rgb, "{auto}");
            assert_eq!(a.transmittance, f.transmittance);
        }
        let bound = auto.bound() + ROUNDING;
        let (mut flipped, mut values) = (0, 0);
        for (a, f) in a.rgb.iter().flatten().zip(f.rgb.iter().flatten()) {
            values += 1;
            let error = (a - f).abs() / (1.0 + f.abs());
            if error > bound {
                assert!(rotates && error <= bound + FLIPPED, "{error} {bound}\n{auto}");
                flipped += 1;
            }
        }
        assert!(flipped * 200 <= values, "{flipped} of {values}");
        // Depths do not depend on colors: exact unless rotations are left out.
        for (a, f) in [
            (&a.depth_accumulated, &f.depth_accumulated),
            (&a.depth_expected, &f.depth_expected),
            (&a.depth_median, &f.depth_median),
        ] {
            if a.is_some() && !rotates {
                assert_eq!(a, f);
            }
        }
    }
    (auto, work)
}

fn all_depths() -> RenderRequest {
    let depth = DepthRequest { accumulated: true, expected: true, median: true };
    RenderRequest { depth, ..RenderRequest::rgb() }
}

#[test]
fn auto_is_full_on_every_golden() {
    let Some(Scene { gaussians: scene, views, .. }) = Scene::synthetic() else { return };
    let (hazards, garden) = (Scene::hazards().unwrap().gaussians, Scene::garden().unwrap());
    let default = RasterSettings::default();
    let settings = [
        default,
        RasterSettings { antialiased: true, ..default },
        RasterSettings { background: Some([0.2, 0.5, 0.9]), ..default },
        RasterSettings { background: Some([0.0; 3]), ..default },
        RasterSettings::gsplat_1_5(),
        RasterSettings::inria(),
    ];
    for settings in settings {
        for sh_degree in [None, Some(1)] {
            let request = PlanRequest::new(RenderRequest { sh_degree, ..all_depths() });
            same_within_the_bound(&scene, &views, settings, request);
            same_within_the_bound(&hazards, &views, settings, request);
            same_within_the_bound(&garden.gaussians, &garden.views, settings, request);
        }
    }
    let only_depth = PlanRequest::new(RenderRequest { rgb: false, ..all_depths() });
    let (_, work) = same_within_the_bound(&scene, &views, default, only_depth);
    assert!(work.iter().all(|w| w.sh_bands == [0; 4]));
}

/// Scales the coefficients of the bands above `degree`.
fn damp(gaussians: &mut Gaussians, degree: usize, factor: f32) {
    let (len, kept) = (gaussians.sh_len(), (degree + 1) * (degree + 1));
    for row in gaussians.sh.chunks_mut(3 * len) {
        row[3 * kept..].iter_mut().for_each(|v| *v *= factor);
    }
}

fn spheres(gaussians: &mut Gaussians) {
    gaussians.scales.iter_mut().for_each(|s| *s = [s[0]; 3]);
}

#[test]
fn bands_that_are_absent_or_too_weak_are_left_out() {
    let Some(Scene { gaussians: scene, views, .. }) = Scene::synthetic() else { return };
    let settings = RasterSettings::default();
    for degree in 0..3 {
        let mut absent = scene.clone();
        damp(&mut absent, degree, 0.0);
        let request = PlanRequest::new(RenderRequest::rgb());
        let (plan, work) = same_within_the_bound(&absent, &views, settings, request);
        assert_eq!((usize::from(plan.sh_degree), plan.bound()), (degree, 0.0));
        assert!(work.iter().all(|w| w.sh_bands[degree + 1..].iter().all(|n| *n == 0)));
        assert!(work.iter().all(|w| w.sh_bands[degree] == w.visible));
        // Bands that are 0 still have gradients.
        let gradients = NeededGradients { sh: true, ..NeededGradients::default() };
        let [plan, _] = plans(&absent, settings, PlanRequest { gradients, ..request });
        assert_eq!(plan.sh_degree, 3);

        let mut weak = scene.clone();
        damp(&mut weak, degree, 1e-4);
        let (plan, _) = same_within_the_bound(&weak, &views, settings, request);
        assert!(usize::from(plan.sh_degree) >= degree);
        assert!(plan.bound() < 1.0 / 512.0);
        if degree == 0 {
            assert!(plan.sh_degree == 0 && plan.bound() > 0.0, "{plan}");
        }
    }
    // One Gaussian that needs the last band is enough, wherever it is; a broken one too.
    for value in [0.1, f32::NAN, f32::INFINITY] {
        let mut almost = scene.clone();
        damp(&mut almost, 0, 0.0);
        let row = 1234;
        almost.opacities[row] = 0.5;
        almost.sh[row * 48 + 45] = value;
        let profile = SceneProfile::scan(&almost).unwrap();
        assert_eq!(profile.harmonics.witness, Some(row as u32));
        let request = PlanRequest::new(RenderRequest::rgb());
        let (plan, _) = same_within_the_bound(&almost, &views, settings, request);
        assert_eq!(plan.sh_degree, 3, "{plan}");
        almost.opacities[row] = 0.001;
        let (plan, _) = same_within_the_bound(&almost, &views, settings, request);
        assert_eq!(plan.sh_degree, 0, "who is not drawn does not count: {plan}");
    }
}

#[test]
fn a_scene_of_plain_spheres_costs_no_more_than_that() {
    let Some(Scene { gaussians: mut scene, views, .. }) = Scene::synthetic() else { return };
    spheres(&mut scene);
    damp(&mut scene, 0, 0.0);
    let request = PlanRequest::new(RenderRequest::rgb());
    let black = RasterSettings { background: Some([0.0; 3]), ..RasterSettings::default() };
    let (plan, work) = same_within_the_bound(&scene, &views, black, request);
    assert!(plan.settings.isotropic);
    for w in work {
        assert!(w.visible > 100);
        let nothing = WorkCounters {
            gaussians: w.gaussians,
            visible: w.visible,
            pairs: w.pairs,
            sh_bands: [w.visible, 0, 0, 0],
            ..WorkCounters::default()
        };
        assert_eq!(w, nothing);
    }
    // The full plan does it all.
    let [_, full] = plans(&scene, black, request);
    for w in pictures(&full, &scene, &views).iter().map(|p| p.work) {
        assert_eq!((w.rotated, w.sh_bands), (w.visible, [w.visible; 4]));
        assert!(w.depth_pixels > 0 && w.background_pixels > 0);
    }
    // What makes rotations matter brings them back.
    let needs = |gradients| {
        let [plan, _] = plans(&scene, black, PlanRequest { gradients, ..request });
        !plan.settings.isotropic
    };
    assert!(needs(NeededGradients { scales: true, ..NeededGradients::default() }));
    assert!(needs(NeededGradients { quats: true, ..NeededGradients::default() }));
    assert!(!needs(NeededGradients { means: true, opacities: true, ..NeededGradients::default() }));
    let mut headless = scene.clone();
    headless.quats[700] = [0.0; 4];
    headless.opacities[700] = 0.9;
    let (plan, _) = same_within_the_bound(&headless, &views, black, request);
    assert!(!plan.settings.isotropic, "who has no quaternion must stay undrawn");
    let (plan, _) = same_within_the_bound(&scene, &views, RasterSettings::inria(), request);
    assert!(!plan.settings.isotropic, "Inria's quaternions are sizes too");
}

#[test]
fn faint_gaussians_are_taken_out_unless_rows_matter() {
    let Some(Scene { gaussians: mut scene, views, .. }) = Scene::synthetic() else { return };
    for opacity in scene.opacities.iter_mut().step_by(3) {
        *opacity = 0.003;
    }
    scene.opacities[1] = f32::NAN;
    let request = PlanRequest::new(RenderRequest::rgb());
    let (plan, work) = same_within_the_bound(&scene, &views, RasterSettings::default(), request);
    assert!(plan.drop_faint);
    let prepared = plan.prepare(scene.clone()).unwrap();
    let rows = prepared.rows().unwrap();
    assert_eq!(rows.len(), work[0].gaussians);
    assert!(rows.iter().all(|&r| scene.opacities[r as usize] >= 1.0 / 255.0));
    for (i, &row) in rows.iter().enumerate() {
        let (kept, row) = (prepared.gaussians(), row as usize);
        assert_eq!(kept.means[i], scene.means[row]);
        assert_eq!(kept.sh[i * 48..(i + 1) * 48], scene.sh[row * 48..(row + 1) * 48]);
    }
    let by_row = RenderRequest { contributions: true, ..RenderRequest::rgb() };
    let (plan, _) =
        same_within_the_bound(&scene, &views, RasterSettings::default(), PlanRequest::new(by_row));
    assert!(!plan.drop_faint);
    // A lower cut than the evidence's draws them.
    let low = RasterSettings { alpha_cut: 0.001, ..RasterSettings::default() };
    let (plan, _) = same_within_the_bound(&scene, &views, low, request);
    assert!(!plan.drop_faint && plan.sh_degree == 3);
}

#[test]
fn more_than_was_planned_is_refused_or_upgraded() {
    let Some(Scene { gaussians: scene, views, .. }) = Scene::synthetic() else { return };
    let asked = RenderRequest { sh_degree: Some(1), ..RenderRequest::rgb() };
    let [plan, full] = plans(&scene, RasterSettings::default(), PlanRequest::new(asked));
    let prepared = plan.prepare(scene.clone()).unwrap();
    let refused = |request: RenderRequest, name: &str| {
        let error = prepared.render(&views[0], &request).unwrap_err();
        assert!(matches!(error, PlanError::NotPlanned { .. }), "{error}");
        assert!(error.to_string().contains(name), "{error}");
    };
    let depth = |depth| RenderRequest { depth, ..asked };
    refused(depth(DepthRequest { median: true, ..DepthRequest::default() }), "median depth");
    refused(depth(DepthRequest { expected: true, ..DepthRequest::default() }), "expected depth");
    refused(RenderRequest { contributions: true, ..asked }, "weights per Gaussian");
    refused(RenderRequest { last: true, ..asked }, "last Gaussian");
    refused(RenderRequest { sh_degree: None, ..asked }, "higher band");
    refused(RenderRequest { sh_degree: Some(2), ..asked }, "higher band");
    let less = RenderRequest { sh_degree: Some(0), ..asked };
    assert_eq!(prepared.render(&views[0], &less).unwrap().work.sh_bands[1], 0);
    assert!(full.check(&all_depths()).is_err(), "the limit of the harmonics still holds");

    let more = PlanRequest::new(all_depths());
    let upgraded = plan.upgraded(more).unwrap();
    assert_eq!(upgraded.sh_degree, 3);
    let picture =
        upgraded.prepare(scene.clone()).unwrap().render(&views[0], &all_depths()).unwrap();
    assert!(picture.depth_median.is_some() && picture.rgb.is_some());

    let mut other = scene.clone();
    other.means.truncate(3);
    other.quats.truncate(3);
    other.scales.truncate(3);
    other.opacities.truncate(3);
    other.sh.truncate(3 * 48);
    assert!(matches!(plan.prepare(other), Err(PlanError::OtherScene { got: 3, .. })));
    let profile = SceneProfile::scan(&scene).unwrap();
    let degree = PlanRequest::new(RenderRequest { sh_degree: Some(4), ..RenderRequest::rgb() });
    assert!(RenderPlan::auto(&profile, RasterSettings::default(), degree).is_err());
}

#[test]
fn what_a_profile_finds() {
    let empty = SceneProfile::scan(&Gaussians::default()).unwrap();
    assert_eq!((empty.gaussians, empty.drawable, empty.harmonics.rows), (0, 0, 0));
    let n = 20_000;
    let mut scene = Gaussians {
        means: vec![[0.0; 3]; n],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
        scales: vec![[0.25; 3]; n],
        opacities: vec![0.55; n],
        sh: vec![0.0; n * 12],
        sh_degree: 1,
    };
    scene.means[3][1] = f32::NAN;
    scene.quats[4] = [f32::INFINITY, 0.0, 0.0, 0.0];
    scene.scales[5][2] = f32::NEG_INFINITY;
    scene.opacities[6] = f32::NAN;
    scene.opacities[7] = 0.0039;
    scene.scales[8] = [0.5, 1.0, 2.0];
    scene.scales[9] = [0.0; 3];
    scene.quats[10] = [0.0; 4];
    scene.quats[11] = [0.0, 1.0, 0.0, 0.0];
    scene.opacities[19_999] = 2.0;
    scene.sh[15_000 * 12 + 3] = -0.002;
    let profile = SceneProfile::scan(&scene).unwrap();
    assert_eq!((profile.not_finite, profile.faint, profile.drawable), (4, 1, n - 5));
    assert_eq!((profile.no_direction, profile.unrotated), (1, n - 6));
    assert_eq!((profile.anisotropy, profile.quat_off_unit), (3.0, 1.0));
    assert_eq!((profile.scale_min, profile.scale_max), (0.0, 2.0));
    assert_eq!(profile.scale_histogram[22], n - 7);
    assert_eq!((profile.scale_histogram[25], profile.scale_histogram[0]), (1, 1));
    assert_eq!((profile.opacity_max, profile.opacity_histogram[5]), (2.0, n - 6));
    let tail = profile.harmonics.tail;
    assert!((tail[0] - 0.002 * 0.488_603).abs() < 1e-8 && tail[1..] == [0.0; 3], "{tail:?}");
    assert_eq!((profile.harmonics.rows, profile.harmonics.witness), (n, Some(15_000)));
    // Every row needs the band: a probe is enough.
    scene.sh.iter_mut().for_each(|v| *v = 1.0);
    let probed = SceneProfile::scan(&scene).unwrap().harmonics;
    assert!(probed.rows < n / 2 && probed.tail[0] > 1.0, "{probed:?}");
    let on = |threads| on_threads(threads, || SceneProfile::scan(&scene).unwrap());
    assert_eq!(on(1), on(3));
    scene.opacities.pop();
    assert!(SceneProfile::scan(&scene).is_err());
}

#[test]
fn a_plan_says_what_and_why() {
    let Some(Scene { gaussians: mut scene, .. }) = Scene::synthetic() else { return };
    damp(&mut scene, 1, 0.0);
    let request = PlanRequest::new(RenderRequest::rgb());
    let [plan, full] = plans(&scene, RasterSettings::default(), request);
    let text = plan.to_string();
    for part in ["plan: auto", "degree 1 of 3", "bands above 1 are 0", "exact", "none asked for"] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
    assert!(full.to_string().contains("forced"));
}
