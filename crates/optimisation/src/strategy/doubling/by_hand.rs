//! The default strategy row by row.

use super::*;
use crate::AdamSettings;

fn row(i: usize, scale: [f32; 3], opacity: f32) -> Stored {
    Stored {
        mean: [i as f32, -1.0, 2.0],
        log_scale: scale.map(f32::ln),
        quat: [1.0, 0.2 * i as f32, -0.4, 0.1],
        logit: logit(opacity),
    }
}

fn built(rows: &[Stored]) -> (Model, Adam) {
    let sh = (0..12 * rows.len()).map(|v| v as f32).collect();
    let model = Model::from_arrays(rows, sh, 1).unwrap();
    let mut adam = Adam::new(&model, AdamSettings::default());
    adam.means.first.iter_mut().enumerate().for_each(|(k, m)| *m = k as f32 + 1.0);
    (model, adam)
}

#[test]
fn the_defaults_are_those_of_gsplat_and_ranges_are_checked() {
    let good = DefaultSettings::default();
    let want = DefaultSettings {
        prune_opacity: 0.005,
        grow_gradient: 0.0002,
        grow_scale: 0.01,
        prune_scale: 0.1,
        refine_start: 500,
        refine_stop: 15_000,
        refine_every: 100,
        reset_every: 3000,
        cap: 3_000_000,
    };
    assert_eq!(good, want);
    good.check().unwrap();
    let cases = [
        (DefaultSettings { prune_opacity: 0.0, ..good }, "prune_opacity is 0;"),
        (DefaultSettings { prune_opacity: 0.5, ..good }, "prune_opacity is 0.5"),
        (DefaultSettings { refine_every: 0, ..good }, "refine_every is 0"),
        (DefaultSettings { reset_every: 0, ..good }, "reset_every is 0"),
        (DefaultSettings { grow_gradient: 0.0, ..good }, "grow_gradient is 0"),
        (DefaultSettings { grow_scale: f32::NAN, ..good }, "grow_scale is NaN"),
        (DefaultSettings { prune_scale: -1.0, ..good }, "prune_scale is -1"),
    ];
    for (settings, want) in cases {
        let error = settings.check().unwrap_err().to_string();
        assert!(error.starts_with(want), "{error}");
    }
}

#[test]
fn copies_halves_and_what_goes_are_in_order() {
    // In a scene of 4 units: up to 0.04 as it is, above 0.4 huge.
    let rows = [
        row(0, [0.01, 0.039, 0.02], 0.5),
        row(1, [0.05, 0.01, 0.2], 0.7),
        row(2, [0.01; 3], 0.004),
        row(3, [0.03; 3], 0.3),
        row(4, [0.01, 0.39, 0.01], 0.006),
        row(5, [0.01, 0.01, 0.41], 0.6),
    ];
    let (mut model, mut adam) = built(&rows);
    model.gaussians.sh[3 * 12 + 5] = f32::NAN;
    let given = model.clone();
    // Means over the pictures that saw it: 3e-4, 5e-4, -, 1 of 0 pictures, 2e-4, 1e-4.
    let sum = vec![6e-4, 5e-4, 0.0, 0.0, 4e-4, 1e-4];
    let mut state = DoublingState { sum, count: vec![2.0, 1.0, 0.0, 0.0, 2.0, 1.0] };
    let settings = DefaultSettings::default();
    let done = settings.refine(&mut state, (&mut model, &mut adam), 4.0, 6, 3100);
    // One copy, two halves; gone are the halved, the transparent, the broken and the huge.
    let want = Refined { added: 3, removed: 4, not_finite: 1, ..Refined::default() };
    assert_eq!(done, want);
    assert_eq!((model.len(), state.sum.len(), state.count.len()), (5, 5, 5));
    for (now, before) in [(0, 0), (1, 4), (2, 0)] {
        assert_eq!(model.row(now), given.row(before), "{now}");
        let sh = |model: &Model, i: usize| model.gaussians.sh[12 * i..12 * (i + 1)].to_vec();
        assert_eq!(sh(&model, now), sh(&given, before), "{now}");
    }
    let counter = Counter::new(6, Purpose::Split, 3100);
    let r = {
        let q = rows[1].quat.map(f64::from);
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        rotation(q.map(|v| v / norm))
    };
    for half in 0..2 {
        let (got, xi) = (model.row(3 + half), counter.normals(2 + half));
        for k in 0..3 {
            let along = |j: usize| r[k][j] * f64::from([0.05f32, 0.01, 0.2][j]) * f64::from(xi[j]);
            let want = f64::from(rows[1].mean[k]) + along(0) + along(1) + along(2);
            assert!((f64::from(got.mean[k]) - want).abs() < 1e-5, "{half} {k}");
            let want = f64::from([0.05f32, 0.01, 0.2][k]) / 1.6;
            let scale = f64::from(model.gaussians.scales[3 + half][k]);
            assert!((scale / want - 1.0).abs() < 1e-5, "{half} {k}: {scale}");
        }
        assert_eq!((got.quat, got.logit), (rows[1].quat, rows[1].logit));
        assert_eq!(model.gaussians.sh[12 * (3 + half)..][..12], given.gaussians.sh[12..24]);
    }
    // Moments stay with their rows; new rows have none.
    let moments: Vec<f32> = [1.0, 2.0, 3.0, 13.0, 14.0, 15.0].into_iter().chain([0.0; 9]).collect();
    assert_eq!(adam.means.first, moments);
}

#[test]
fn what_is_done_when() {
    let rows = [row(0, [0.005; 3], 0.5), row(1, [0.3; 3], 0.9)];
    let settings = DefaultSettings { refine_every: 50, reset_every: 700, ..Default::default() };
    let at = |step: u64| {
        let (mut model, mut adam) = built(&rows);
        let mut state = DoublingState { sum: vec![1.0, 0.0], count: vec![1.0; 2] };
        let done = settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, step);
        (done.added, done.removed, done.reset)
    };
    // Not at the start, nor at the stop; what is huge goes after the first reset, not at it.
    let due = [
        (0, (0, 0, false)),
        (500, (0, 0, false)),
        (549, (0, 0, false)),
        (550, (1, 0, false)),
        (700, (1, 0, true)),
        (750, (1, 1, false)),
        (14_700, (1, 1, true)),
        (14_950, (1, 1, false)),
        (15_000, (0, 0, false)),
        (15_400, (0, 0, false)),
    ];
    for (step, want) in due {
        assert_eq!(at(step), want, "{step}");
    }
    // A scene of which every Gaussian would go stays.
    let (mut model, mut adam) = built(&[row(0, [0.01; 3], 0.001), row(1, [0.01; 3], 0.002)]);
    let mut state = DoublingState::default();
    let done = settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 550);
    assert_eq!((done.removed, model.len(), done.is_any()), (0, 2, false));
}
