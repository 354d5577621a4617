//! Input that nobody should have, and that everybody has.

use super::reference::compare;
use crate::support::{everything, join, one, random, view};
use scenesplat_rasterizer::*;
use scenesplat_scene::{Camera, Distortion, GaussianScene};

/// The values of the first Gaussian in a column.
type Column = fn(&mut Gaussians) -> &mut [f32];

/// Whether the Gaussian is in the picture, and the picture is finite.
fn visible(scene: &Gaussians) -> bool {
    let request = RenderRequest { contributions: true, ..RenderRequest::rgb() };
    let out = render(scene, &view(40, 30), &RasterSettings::default(), &request).unwrap();
    assert!(out.rgb.unwrap().iter().all(|v| v.is_finite()));
    assert!(out.transmittance.iter().all(|t| (0.0..=1.0).contains(t)));
    let culled = out.culled;
    let sum = culled.not_finite
        + culled.zero_quat
        + culled.depth
        + culled.overflow
        + culled.opacity
        + culled.outside
        + culled.color;
    assert_eq!(sum + out.work.visible, scene.len(), "every row is drawn or counted");
    out.contributions.unwrap().sum[0] > 0.0
}

#[test]
fn bad_values_one_at_a_time() {
    let good = one([0.0, 0.0, 2.0], 0.1, 0.8);
    assert!(visible(&good));
    let columns: [(&str, usize, Column); 4] = [
        ("mean", 3, |g| &mut g.means[0]),
        ("scale", 3, |g| &mut g.scales[0]),
        ("color", 3, |g| &mut g.sh),
        ("quaternion", 4, |g| &mut g.quats[0]),
    ];
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for (name, width, column) in columns {
            for k in 0..width {
                let mut scene = good.clone();
                column(&mut scene)[k] = bad;
                assert!(!visible(&scene), "{name} {k} = {bad}");
            }
        }
    }
    for opacity in [f32::NAN, f32::NEG_INFINITY, -1.0, 0.0, 0.003] {
        assert!(!visible(&one([0.0, 0.0, 2.0], 0.1, opacity)), "opacity {opacity}");
    }
    let mut scene = good;
    scene.quats[0] = [0.0; 4];
    assert!(!visible(&scene), "a quaternion without direction");
    scene.quats[0] = [1e-7, 0.0, 0.0, 0.0];
    assert!(!visible(&scene), "a quaternion almost without");
    for mean in [[0.0, 0.0, -2.0], [0.0; 3], [1e30, 0.0, 2.0], [0.0, 0.0, 1e20]] {
        assert!(!visible(&one(mean, 0.1, 0.8)), "mean {mean:?}");
    }
    for scale in [1e20, f32::MAX] {
        assert!(!visible(&one([0.0, 0.0, 2.0], scale, 0.8)), "scale {scale}");
    }
}

#[test]
fn extreme_but_valid() {
    let good = one([0.0, 0.0, 2.0], 0.1, 0.8);
    for scale in [0.0, 1e-30, -0.1, 1e3, 1e6] {
        assert!(visible(&one([0.0, 0.0, 2.0], scale, 0.8)), "scale {scale}");
    }
    for opacity in [1.0 / 255.0 + 1e-4, 1.0, 3.0, f32::INFINITY] {
        assert!(visible(&one([0.0, 0.0, 2.0], 0.5, opacity)), "opacity {opacity}");
    }
    for quat in [[1e-3, 0.0, 0.0, 0.0], [0.0, -30.0, 40.0, 0.0], [0.0, 0.0, 0.0, 1e15]] {
        let mut scene = good.clone();
        scene.quats[0] = quat;
        assert!(visible(&scene), "quaternion {quat:?}");
    }
    let mut needle = good;
    needle.scales[0] = [10.0, 1e-3, 1e-3];
    needle.quats[0] = [0.9, 0.1, 0.3, 0.4];
    assert!(visible(&needle));
    compare(&needle, &view(40, 30), &RasterSettings::default());
    assert!(visible(&one([0.0, 0.0, 0.010_001], 1e-4, 0.8)), "at the near plane");
    assert!(visible(&one([0.0, 0.0, 1e9], 1e7, 0.8)), "far away");
}

#[test]
fn bad_neighbours_change_nothing() {
    let good = random(60, 21);
    let mut bad = random(60, 22);
    for i in 0..60 {
        let value = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][i % 3];
        match i % 5 {
            0 => bad.means[i][i % 2] = value,
            1 => bad.scales[i][i % 3] = value,
            2 => bad.quats[i][i % 4] = value,
            3 => bad.opacities[i] = f32::NAN,
            _ => bad.sh[27 * i + i % 27] = value,
        }
    }
    let (view, settings) = (view(50, 40), RasterSettings::default());
    let clean = render(&good, &view, &settings, &RenderRequest::rgb()).unwrap();
    let request = RenderRequest::rgb();
    let after = render(&join(good.clone(), &bad), &view, &settings, &request).unwrap();
    let before = render(&join(bad, &good), &view, &settings, &request).unwrap();
    assert_eq!(clean.rgb, after.rgb);
    assert_eq!(clean.rgb, before.rgb);
    assert_eq!(clean.transmittance, after.transmittance);
}

#[test]
fn nothing_to_draw() {
    for scene in [Gaussians::default(), one([0.0, 0.0, -1.0], 0.1, 0.5)] {
        let background = Some([0.25, 0.5, 2.0]);
        let settings = RasterSettings { background, ..RasterSettings::default() };
        let out = render(&scene, &view(19, 3), &settings, &everything()).unwrap();
        assert!(out.rgb.unwrap().chunks_exact(3).all(|p| p == [0.25, 0.5, 2.0]));
        assert_eq!(out.transmittance, vec![1.0; 57]);
        for depth in [out.depth_accumulated, out.depth_expected, out.depth_median] {
            assert_eq!(depth.unwrap(), vec![0.0; 57]);
        }
        assert_eq!(out.last.unwrap(), vec![0; 57]);
        assert_eq!(out.contributions.unwrap().sum, vec![0.0; scene.len()]);
    }
}

#[test]
fn what_is_refused_says_why() {
    let scene = one([0.0, 0.0, 2.0], 0.1, 0.8);
    let good = view(20, 20);
    let settings = RasterSettings::default();
    let error = |scene: &Gaussians, view: &View, settings: &RasterSettings| {
        render(scene, view, settings, &RenderRequest::rgb()).unwrap_err().to_string()
    };
    let mut short = scene.clone();
    short.quats.clear();
    assert_eq!(error(&short, &good, &settings), "quats: expected 1 values, got 0");
    let degree = Gaussians { sh_degree: 4, ..scene.clone() };
    assert!(error(&degree, &good, &settings).contains("degree 4"));
    for (width, height) in [(0, 5), (5, 0), (70_000, 1), (60_000, 60_000)] {
        let view = View { width, height, ..good };
        let text = error(&scene, &view, &settings);
        assert!(text.contains(&format!("{width} × {height}")), "{text}");
    }
    for fx in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(error(&scene, &View { fx, ..good }, &settings).starts_with("fx is"));
    }
    for (row, column, value) in [(0, 0, 1.01), (0, 0, -1.0), (1, 2, f32::NAN), (2, 3, f32::NAN)] {
        let mut view = good;
        view.world_to_camera[row][column] = value;
        assert!(error(&scene, &view, &settings).contains("world"), "{row} {column} {value}");
    }
    for (field, bad) in [
        ("near", RasterSettings { near: 0.0, ..settings }),
        ("far", RasterSettings { far: f32::NAN, ..settings }),
        ("eps2d", RasterSettings { eps2d: 0.0, ..settings }),
        ("alpha_max", RasterSettings { alpha_max: 1.0, ..settings }),
        ("alpha_cut", RasterSettings { alpha_cut: 0.0, ..settings }),
        ("stop", RasterSettings { stop: 1.0, ..settings }),
        ("background", RasterSettings { background: Some([0.0, f32::NAN, 0.0]), ..settings }),
    ] {
        assert!(error(&scene, &good, &bad).starts_with(&format!("{field} is")), "{field}");
    }
}

#[test]
fn cameras_with_lenses_are_refused_by_name() {
    let mut camera = Camera {
        name: "left.png".to_owned(),
        width: 64,
        height: 48,
        fx: 50.0,
        fy: 50.0,
        cx: 32.0,
        cy: 24.0,
        distortion: Distortion::None,
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [1.0, 2.0, 3.0],
    };
    assert_eq!(View::from_camera(&camera).unwrap().centre(), [-1.0, -2.0, -3.0]);
    camera.distortion = Distortion::Fisheye { k: [0.1, 0.0, 0.0, 0.0] };
    let text = View::from_camera(&camera).unwrap_err().to_string();
    assert!(text.contains("left.png") && text.contains("fisheye"), "{text}");
}

#[test]
fn scenes_are_activated() {
    let scene = GaussianScene {
        coord: vec![[1.0, 2.0, 3.0]; 2],
        log_scale: vec![[0.0, f32::NEG_INFINITY, 1.0]; 2],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        opacity_logit: vec![0.0, f32::INFINITY],
        sh_dc: vec![[1.0, 2.0, 3.0], [f32::NAN, 0.0, 0.0]],
        sh_rest: vec![0.5; 18],
        sh_degree: 1,
        ..GaussianScene::default()
    };
    let gaussians = Gaussians::from_scene(&scene).unwrap();
    assert_eq!(gaussians.scales[0], [1.0, 0.0, std::f32::consts::E]);
    // The second has no color, and hides nothing.
    assert_eq!(gaussians.opacities, [0.5, 0.0]);
    assert_eq!(gaussians.sh[..6], [1.0, 2.0, 3.0, 0.5, 0.5, 0.5]);
    let high = GaussianScene { sh_degree: 4, ..scene };
    assert!(Gaussians::from_scene(&high).unwrap_err().to_string().contains("degree 4"));
}
