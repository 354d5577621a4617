use super::strength::*;
use super::*;
use scenesplat_kernels::random::{sample_rng, unit};
use scenesplat_scene::LanguageFeatures;

/// A floor of 40 × 40 flat Gaussians five centimeters apart, 2 cm wide, 1 mm thick.
fn floor() -> GaussianScene {
    let n = 1600;
    let mut rng = sample_rng(1, 0, 0);
    let mut color = || [0; 3].map(|_: i32| unit(&mut rng) as f32 - 0.5);
    GaussianScene {
        coord: (0..n).map(|i| [0.05 * (i % 40) as f32, 0.05 * (i / 40) as f32, 1.0]).collect(),
        log_scale: vec![[0.02f32.ln(), 0.02f32.ln(), 0.001f32.ln()]; n],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logit: vec![2.0; n],
        sh_dc: (0..n).map(|_| color()).collect(),
        sh_rest: vec![0.1; 9 * n],
        sh_degree: 1,
        normal: Some(vec![[0.0, 0.0, 1.0]; n]),
        segment: Some((0..n as i32).map(|i| i % 7).collect()),
        instance: Some(vec![3; n]),
        lang_feat: Some(LanguageFeatures { values: vec![half::f16::ONE; 2 * n], dim: 2 }),
        ..GaussianScene::default()
    }
}

fn with(text: &str, seed: u64) -> Simulated {
    let out = simulate(&floor(), &text.parse().unwrap(), seed).unwrap();
    out.scene.check_rows().unwrap();
    assert_eq!(out.source.len(), out.scene.len());
    out
}

#[test]
fn nothing_is_the_scene_itself() {
    for text in ["none", "holes=0,blur=0,noise=0"] {
        let out = with(text, 5);
        assert!(out.scene == floor() && out.done.is_empty());
        assert!(out.source.iter().enumerate().all(|(row, source)| *source == Some(row)));
    }
    let empty = GaussianScene::default();
    let all: EffectSet =
        "holes=5,floaters=5,surface=5,blur=5,glass=5,light=5,noise=5".parse().unwrap();
    assert_eq!(simulate(&empty, &all, 1).unwrap().scene, empty);
}

#[test]
fn a_little_changes_little() {
    // Toward 0 every effect on values goes to the identity.
    let plain = floor();
    for effect in ["surface", "blur", "light", "noise"] {
        let out = with(&format!("{effect}=1e-6"), 1).scene;
        let far =
            |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far(out.coord.as_flattened(), plain.coord.as_flattened()) < 1e-6, "{effect}");
        assert!(far(out.sh_dc.as_flattened(), plain.sh_dc.as_flattened()) < 1e-4, "{effect}");
        assert!(far(&out.sh_rest, &plain.sh_rest) < 1e-4, "{effect}");
    }
}

#[test]
fn holes_are_balls_of_the_stated_share() {
    let out = with("holes=2.5", 9);
    let removed = (1600.0 * HOLES_SHARE * 2.5).round() as usize;
    assert_eq!((out.scene.len(), out.done[0].changed), (1600 - removed, removed));
    let plain = floor();
    // What is left is as it was, in its order.
    let rows: Vec<usize> = out.source.iter().map(|s| s.unwrap()).collect();
    assert!(rows.is_sorted() && out.scene == plain.select_rows(&rows).unwrap());
    // Three balls: what is missing lies close together, nothing of it among what stayed.
    let missing: Vec<usize> = (0..1600).filter(|row| !rows.contains(row)).collect();
    let near = |a: usize, b: usize| {
        let [p, q] = [plain.coord[a], plain.coord[b]];
        (p[0] - q[0]).hypot(p[1] - q[1]) < 0.051
    };
    let lonely = missing.iter().filter(|&&a| !missing.iter().any(|&b| a != b && near(a, b)));
    assert_eq!(lonely.count(), 0);
    assert_ne!(out.source, with("holes=2.5", 10).source);
    // One Gaussian always stays.
    let one = plain.select_rows(&[0]).unwrap();
    assert_eq!(simulate(&one, &"holes=5".parse().unwrap(), 1).unwrap().scene.len(), 1);
}

#[test]
fn floaters_are_unlabelled_and_between_the_middle_and_a_surface() {
    let out = with("floaters=5", 2);
    let count = (1600.0 * FLOATERS_SHARE * 5.0).round() as usize;
    let scene = &out.scene;
    assert_eq!(scene.len(), 1600 + count);
    assert!(out.source[..1600].iter().all(Option::is_some));
    assert!(out.source[1600..].iter().all(Option::is_none));
    assert_eq!(scene.select_rows(&(0..1600).collect::<Vec<_>>()).unwrap().coord, floor().coord);
    for row in 1600..scene.len() {
        assert_eq!(
            (scene.segment.as_ref().unwrap()[row], scene.instance.as_ref().unwrap()[row]),
            (-1, -1)
        );
        assert!((0.049..0.401).contains(&scene.opacity(row)), "{}", scene.opacity(row));
        // Medians are 1 m along both axes of the floor; at most 0.6 of the way out to a corner.
        let [x, y, z] = scene.coord[row];
        assert!((x - 1.0).abs() <= 0.61 && (y - 1.0).abs() <= 0.61 && z == 1.0, "{x} {y} {z}");
        let size = scene.scale(row)[0] / (0.02f32 * 0.02 * 0.001).cbrt();
        assert!((1.99..10.01).contains(&size), "{size}");
    }
    let valid = scene.valid_feat_mask.as_ref().unwrap();
    assert!(valid[..1600].iter().all(|v| *v) && valid[1600..].iter().all(|v| !*v));
}

#[test]
fn surfaces_move_along_their_normals_by_the_stated_amount() {
    let out = with("surface=3", 4).scene;
    let plain = floor();
    let moved: Vec<f64> = out.coord.iter().map(|c| f64::from(c[2]) - 1.0).collect();
    let sd = (moved.iter().map(|v| v * v).sum::<f64>() / 1600.0).sqrt();
    assert!((sd / (3.0 * SURFACE_METRES) - 1.0).abs() < 0.08, "{sd}");
    for (a, b) in out.coord.iter().zip(&plain.coord) {
        assert!((a[0] - b[0]).abs() < 1e-6 && (a[1] - b[1]).abs() < 1e-6, "only along the normal");
    }
    // The angle of a turn is twice the arc cosine of w.
    let angle = |q: &[f32; 4]| (2.0 * f64::from(q[0]).min(1.0).acos()).to_degrees();
    let sd = (out.quat.iter().map(|q| angle(q).powi(2)).sum::<f64>() / 1600.0).sqrt();
    assert!((sd / (3.0 * SURFACE_DEGREES) - 1.0).abs() < 0.08, "{sd}");
    assert!(out.normal.unwrap().iter().any(|n| n[2] < 0.99));
}

#[test]
fn blur_adds_the_variance_of_the_motion_and_keeps_means_of_colors() {
    let out = with("blur=4", 4).scene;
    let plain = floor();
    let trace = |s: &[f32; 3]| s.iter().map(|v| (2.0 * f64::from(*v)).exp()).sum::<f64>();
    let length = 4.0 * BLUR_METRES;
    for (a, b) in out.log_scale.iter().zip(&plain.log_scale) {
        let added = trace(a) - trace(b);
        assert!((added / (length * length / 12.0) - 1.0).abs() < 1e-3, "{added}");
    }
    for q in &out.quat {
        let norm: f64 = q.iter().map(|v| f64::from(*v).powi(2)).sum();
        assert!((norm - 1.0).abs() < 1e-6 && q[0] >= 0.0);
    }
    let mean = |s: &GaussianScene| s.sh_dc.iter().map(|c| f64::from(c[1])).sum::<f64>() / 1600.0;
    assert!((mean(&out) - mean(&plain)).abs() < 1e-6);
    let spread = |s: &GaussianScene| s.sh_dc.iter().map(|c| f64::from(c[1]).powi(2)).sum::<f64>();
    assert!(spread(&out) < 0.9 * spread(&plain), "colors mix");
}

#[test]
fn light_drifts_to_both_sides_and_noise_has_no_direction() {
    let gray = GaussianScene { sh_dc: vec![[0.0; 3]; 1600], ..floor() };
    let run = |text: &str| simulate(&gray, &text.parse().unwrap(), 3).unwrap().scene.sh_dc;
    let light = run("light=5");
    let green: Vec<f32> = light.iter().map(|c| c[1]).collect();
    let (low, high) = green.iter().fold((f32::MAX, f32::MIN), |(l, h), &v| (l.min(v), h.max(v)));
    assert!(low < -0.2 && high > 0.2, "{low} {high}");
    // Where there is more light there is more red.
    assert!(light.iter().all(|c| (c[0] - c[2]) * c[1] >= -1e-6));
    let noise = run("noise=5");
    let mean = |k: usize| noise.iter().map(|c| f64::from(c[k])).sum::<f64>() / 1600.0;
    let sd = (noise.iter().map(|c| f64::from(c[1]).powi(2)).sum::<f64>() / 1600.0).sqrt();
    assert!(sd > 0.02 && (0..3).all(|k| mean(k).abs() < 4.0 * sd / 40.0), "{sd} {}", mean(0));
}

#[test]
fn effects_do_not_change_each_others_draws() {
    let alone = with("noise=3", 8);
    let both = with("holes=3,floaters=3,noise=3", 8);
    for (row, source) in both.source.iter().enumerate() {
        if let Some(source) = source {
            assert_eq!(both.scene.sh_dc[row], alone.scene.sh_dc[*source]);
        }
    }
    let (holes, all) = (with("holes=3", 8), with("holes=3,surface=2,blur=1,light=1", 8));
    assert_eq!(holes.source, all.source);
    assert_ne!(with("noise=3", 9).scene, alone.scene);
    assert_eq!(
        all.done.iter().map(|d| d.effect.name()).collect::<Vec<_>>(),
        ["holes", "surface", "blur", "light"]
    );
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let all = "holes=3,floaters=3,surface=3,blur=3,light=3,noise=3";
    crate::transforms::testing::on_threads([1, 2, 7], || with(all, 6));
}

#[test]
fn hard_values_stay_and_nothing_else_becomes_one() {
    let mut scene = floor();
    scene.coord[5] = [f32::NAN, 0.0, f32::INFINITY];
    scene.quat[6] = [0.0; 4];
    scene.quat[7] = [0.0, 1.0, 0.0, 0.0];
    scene.log_scale[8] = [f32::NEG_INFINITY; 3];
    scene.log_scale[9] = [80.0; 3];
    scene.opacity_logit[10] = f32::INFINITY;
    scene.sh_dc[11] = [f32::NAN, 1e30, -1e30];
    // All in one place.
    (100..200).for_each(|row| scene.coord[row] = [0.5; 3]);
    let all: EffectSet =
        "holes=5,floaters=5,surface=5,blur=5,glass=5,light=5,noise=5".parse().unwrap();
    let out = simulate(&scene, &all, 1).unwrap();
    let at = |source: usize| out.source.iter().position(|s| *s == Some(source));
    assert!(at(5).is_some(), "what is nowhere is in no hole");
    for (row, source) in out.source.iter().enumerate() {
        let finite = out.scene.coord[row].iter().all(|v| v.is_finite());
        assert!(finite || *source == Some(5));
        assert!(out.scene.quat[row].iter().all(|v| v.is_finite()));
        let norm: f32 = out.scene.quat[row].iter().map(|v| v * v).sum();
        assert!((norm - 1.0).abs() < 1e-5);
        assert!(!out.scene.log_scale[row].iter().any(|v| v.is_nan()));
        let color = out.scene.sh_dc[row];
        assert!(color.iter().all(|v| v.is_finite()) || *source == Some(11));
    }
    if let Some(row) = at(11) {
        assert!(out.scene.sh_dc[row][1].is_finite() && out.scene.sh_dc[row][2].is_finite());
    }
    let two = floor().select_rows(&[0, 1]).unwrap();
    assert!(simulate(&two, &all, 1).unwrap().scene.len() >= 2);
}
