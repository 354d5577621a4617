use super::measure::Damaged;
use super::report::{checks, confidences, correlation_of};
use super::*;

#[test]
fn small_curves_are_drawn_and_written() {
    let settings = CurveSettings {
        effects: vec![Effect::Holes, Effect::Noise],
        severities: vec![0.0, 5.0],
        rooms: 1,
        gaussians: 2000,
        ..CurveSettings::default()
    };
    let mut shares = Vec::new();
    let report = severity_curves(&settings, &mut |_, share| {
        shares.push(share);
        true
    })
    .unwrap();
    assert!(shares.is_sorted() && shares.iter().all(|s| (0.0..=1.0).contains(s)), "{shares:?}");
    assert_eq!(report.curves.len(), 2);
    for curve in &report.curves {
        assert_eq!(curve.points.len(), 2);
        assert_eq!(curve.points[0], report.curves[0].points[0], "undamaged rooms are the same");
        for p in &curve.points {
            assert!(p.others.iter().all(|v| (0.0..=1.0).contains(v)), "{:?}", p.others);
            assert!(
                [p.f_miou, p.ece, p.confidence, p.unknown].iter().all(|v| (0.0..=1.0).contains(v))
            );
        }
    }
    // 15 % are missing; of what is left, everything has a label but the rooms' own floaters.
    let [clean, hurt] = &report.curves[0].points[..] else { panic!() };
    assert!((hurt.scored as f64 / clean.scored as f64 - 0.85).abs() < 0.01, "{report}");
    assert!((clean.unknown - 0.05).abs() < 0.02, "{report}");
    assert_ne!(report.curves[1].points[1].f_miou, clean.f_miou, "noise changes something");
    let folder = tempfile::tempdir().unwrap();
    let files = report.write(folder.path()).unwrap();
    for (path, bytes) in &files {
        assert_eq!(std::fs::metadata(path).unwrap().len(), *bytes, "{}", path.display());
    }
    let json = std::fs::read_to_string(&files[0].0).unwrap();
    assert_eq!(serde_json::from_str::<SeverityReport>(&json).unwrap(), report);
    let svg = std::fs::read_to_string(&files[1].0).unwrap();
    assert!(svg.contains("holes") && svg.contains("f-mIoU"));
    let stopped = severity_curves(&settings, &mut |_, share| share < 0.3);
    assert!(matches!(stopped, Err(SeverityError::Stopped)));
}

fn curve(quality: &[f64], confidence: &[f64], far_changed: f64) -> EffectCurve {
    let point = |(i, (q, c)): (usize, (&f64, &f64))| SeverityPoint {
        severity: i as f64,
        f_miou: *q,
        ece: 0.1,
        confidence: *c,
        unknown: 0.1,
        others: [0.5, 0.5, 0.5, 1.0 - *c],
        scored: 10,
    };
    let points = quality.iter().zip(confidence).enumerate().map(point).collect();
    let effect = "holes".to_owned();
    EffectCurve { effect, points, far_changed, far_changed_anchored: 0.0 }
}

#[test]
fn what_is_expected_can_be_missed() {
    let passed = |curve: EffectCurve| -> Vec<bool> {
        checks(&[curve]).iter().map(|check| check.passed).collect()
    };
    let fine = curve(&[0.5, 0.45, 0.36, 0.3], &[0.9, 0.8, 0.7, 0.6], 0.009);
    assert_eq!(passed(fine), [true; 4]);
    let steep = curve(&[0.5, 0.39, 0.36, 0.3], &[0.9, 0.8, 0.7, 0.6], 0.0);
    assert_eq!(passed(steep), [false, true, true, true]);
    let sure = curve(&[0.5, 0.45, 0.36, 0.3], &[0.6, 0.7, 0.8, 0.9], 0.0);
    assert_eq!(passed(sure), [true, false, true, false]);
    let avalanche = curve(&[0.5, 0.45, 0.36, 0.3], &[0.9, 0.8, 0.7, 0.6], 0.011);
    assert_eq!(passed(avalanche), [true, true, false, true]);
    // By hand: ranks 3 2 1 0 and 3 1 2 0.
    let found = correlation_of(&curve(&[0.5, 0.3, 0.4, 0.2], &[0.9, 0.8, 0.7, 0.6], 0.0).points);
    assert!((found.unwrap() - 0.8).abs() < 1e-12, "{found:?}");
    assert_eq!(correlation_of(&curve(&[0.5; 3], &[0.9, 0.8, 0.7], 0.0).points), None);
    // The fourth of the other measures turns the order round, the others do not change.
    let rows = confidences(&[curve(&[0.5, 0.3, 0.4, 0.2], &[0.9, 0.8, 0.7, 0.6], 0.0)]);
    let names: Vec<&str> = rows.iter().map(|row| row.measure.as_str()).collect();
    assert_eq!(names, ["confidence", "margin", "order", "tempered", "agreement"]);
    let near = |value: Option<f64>, want: f64| value.is_some_and(|v| (v - want).abs() < 1e-12);
    assert!(near(rows[0].all, 0.8) && near(rows[4].curves[0], -0.8), "{rows:?}");
    assert_eq!((rows[1].all, rows[3].curves[0]), (None, None));
}

#[test]
fn a_corner_is_damaged_and_the_rest_is_not() {
    let settings = CurveSettings { gaussians: 4000, ..CurveSettings::default() };
    let room = room(&settings, 0).unwrap();
    let set: EffectSet = "holes=5,floaters=5,surface=5".parse().unwrap();
    let damaged = Damaged::in_a_corner(&room, &simulate(&room, &set, 3).unwrap()).unwrap();
    let scene = &damaged.scene;
    scene.check_rows().unwrap();
    let edge = [0, 1].map(|axis| room.coord.iter().map(|p| p[axis]).fold(f32::MIN, f32::max));
    let inside = |p: &[f32; 3]| (0..2).all(|axis| p[axis] > edge[axis] - 1.0);
    let outside: Vec<_> = room.coord.iter().filter(|p| !inside(p)).collect();
    let kept: Vec<_> = scene.coord.iter().filter(|p| room.coord.contains(p)).collect();
    // All that was outside is there, in its order, with its bits.
    assert_eq!(
        kept.iter().filter(|p| !inside(p)).collect::<Vec<_>>(),
        outside.iter().collect::<Vec<_>>()
    );
    assert!(scene.len() - outside.len() > 0 && scene.coord.iter().any(|p| !room.coord.contains(p)));
    // The far labels: all others are told apart by one change each.
    let before = vec![1; room.len()];
    let after = vec![1; scene.len()];
    let (far, changed) = damaged.far_labels(&room, &before, &after);
    assert!(far as usize > room.len() / 4 && changed == 0);
    assert_eq!(damaged.far_labels(&room, &before, &vec![2; scene.len()]), (far, far));
}

#[test]
fn settings_that_make_no_curve_are_refused() {
    let fine = CurveSettings::default();
    for (settings, word) in [
        (CurveSettings { effects: Vec::new(), ..fine.clone() }, "effects"),
        (CurveSettings { rooms: 0, ..fine.clone() }, "rooms"),
        (CurveSettings { gaussians: 10, ..fine.clone() }, "gaussians"),
        (CurveSettings { severities: vec![1.0, 2.0], ..fine.clone() }, "severities"),
        (CurveSettings { severities: vec![0.0], ..fine.clone() }, "severities"),
        (CurveSettings { severities: vec![0.0, 2.0, 2.0], ..fine }, "severities"),
    ] {
        let error = severity_curves(&settings, &mut |_, _| true).unwrap_err().to_string();
        assert!(error.starts_with(word), "{error}");
    }
}
