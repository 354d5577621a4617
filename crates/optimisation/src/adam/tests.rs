//! Rows, groups and single values of Adam.

use super::*;
use crate::Stored;

fn model(rows: std::ops::Range<usize>) -> Model {
    let row = |i: usize| Stored {
        mean: [i as f32, 1.0, -2.0],
        log_scale: [-1.0, -0.5 + 0.001 * i as f32, -2.0],
        quat: [1.0, 0.0, 0.1, 0.002 * i as f32],
        logit: 0.001 * i as f32 - 0.5,
    };
    let sh = rows.clone().flat_map(|i| (0..12).map(move |k| 0.1 * k as f32 + 0.01 * i as f32));
    let sh = sh.collect();
    Model::from_arrays(&rows.map(row).collect::<Vec<_>>(), sh, 1).unwrap()
}

#[test]
fn a_row_steps_as_it_would_alone_wherever_it_is() {
    let n = 4 * CHUNK / 3 + 2;
    let rates =
        Rates { means: 0.1, scales: 0.2, quats: 0.3, opacities: 0.4, sh0: 0.5, sh_rest: 0.6 };
    let stepped = |rows: std::ops::Range<usize>| {
        let mut model = model(rows.clone());
        let mut adam = Adam::new(&model, AdamSettings::default());
        for t in 0..2 {
            let mut g = Gradients::zeros(model.gaussians(), 0);
            for (k, i) in rows.clone().enumerate() {
                let slope = |a: usize| ((i * 7 + a + t) as f32 * 0.37).sin();
                g.means[k] = [0, 1, 2].map(slope);
                g.scales[k] = [3, 4, 5].map(slope);
                g.quats[k] = [6, 7, 8, 9].map(slope);
                g.opacities[k] = slope(10);
                (0..12).for_each(|c| g.sh[12 * k + c] = slope(11 + c));
            }
            adam.step(&mut model, &mut g, &rates, Regularisers::default(), 1);
            assert_eq!(g, Gradients::zeros(model.gaussians(), 0), "used up");
        }
        assert_eq!(adam.steps, 2);
        model
    };
    let all = stepped(0..n);
    for i in [0, 1, CHUNK - 1, CHUNK, n - 1] {
        let alone = stepped(i..i + 1);
        assert_eq!(
            (all.row(i), &all.gaussians.sh[12 * i..12 * (i + 1)]),
            (alone.row(0), &alone.gaussians.sh[..])
        );
        assert_eq!(all.gaussians.scales[i], alone.row(0).log_scale.map(f32::exp));
        assert_eq!(all.gaussians.opacities[i], sigmoid(alone.row(0).logit));
    }
}

#[test]
fn rows_of_moments_go_and_come_in_all_groups() {
    let numbered = |adam: &mut Adam| {
        let mut value = 1.0;
        for (moments, _) in adam.groups() {
            for v in moments.first.iter_mut().chain(&mut moments.second) {
                (*v, value) = (value, value + 1.0);
            }
        }
    };
    let mut adam = Adam::new(&model(0..3), AdamSettings::default());
    assert_eq!(
        adam.groups().map(|(m, width)| (m.first.len(), m.second.len(), width)),
        [(9, 9, 3), (9, 9, 3), (12, 12, 4), (3, 3, 1), (36, 36, 12)]
    );
    numbered(&mut adam);
    let mut given = adam.clone();
    adam.zero_row(1);
    for ((found, width), (before, _)) in adam.groups().into_iter().zip(given.groups()) {
        for (found, before) in [(&found.first, &before.first), (&found.second, &before.second)] {
            let mut want = before.clone();
            want[width..2 * width].fill(0.0);
            assert_eq!(found, &want);
        }
    }
    adam = given.clone();
    adam.retain(&[true, false, true]);
    adam.grow(2);
    for ((found, width), (before, _)) in adam.groups().into_iter().zip(given.groups()) {
        for (found, before) in [(&found.first, &before.first), (&found.second, &before.second)] {
            let want = [&before[..width], &before[2 * width..], &vec![0.0; 2 * width]].concat();
            assert_eq!(found, &want);
        }
    }
    adam.zero_opacities();
    assert_eq!((adam.opacities.first, adam.opacities.second), (vec![0.0; 4], vec![0.0; 4]));
    assert!(adam.means.first[0] > 0.0);
}

#[test]
fn moments_that_are_hardly_numbers_become_0() {
    let least = f32::MIN_POSITIVE;
    let settings = AdamSettings::default();
    assert_eq!((settings.betas, settings.eps), ([0.9, 0.999], 1e-15));
    let mut moments = Moments {
        first: vec![1.1 * least, -1.1 * least, 2.0 * least],
        second: vec![least, 1.01 * least, 0.0],
    };
    moments.step(&mut [0.0; 3], &mut [0.0; 3], &settings, 1, 0.0);
    assert_eq!(moments.first[..2], [0.0; 2]);
    assert!(moments.first[2] > 0.0 && moments.second[1] > 0.0 && moments.second[0] == 0.0);
    // The third step by hand: m = 0.9 · 2 + 0.1 · 3, v = 0.999 · 5 + 0.001 · 9.
    let mut moments = Moments { first: vec![2.0], second: vec![5.0] };
    let (mut p, mut g) = ([1.0], [3.0]);
    moments.step(&mut p, &mut g, &settings, 3, 0.01);
    let (m, v) = (2.1 / (1.0 - 0.729), 5.004 / (1.0 - 0.999f64.powi(3)));
    assert!((f64::from(p[0]) - (1.0 - 0.01 * m / v.sqrt())).abs() < 1e-6 && g == [0.0]);
    assert!((moments.first[0] - 2.1).abs() < 1e-6 && (moments.second[0] - 5.004).abs() < 1e-5);
    // What is added to the root.
    let mut moments = Moments::zeros(1);
    let half = AdamSettings { betas: [0.5, 0.5], eps: 1.5 };
    let mut p = [1.0];
    moments.step(&mut p, &mut [0.5], &half, 1, 1.0);
    assert!((p[0] - 0.75).abs() < 1e-6, "0.5 / (0.5 + 1.5): {p:?}");
}
