//! The probe in f64, its channels and its settings.

use super::*;

/// Rows at mean 0 and variance 1; what never changes is 0.
fn standard(rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let n = rows.len() as f64;
    let of = |c: usize| {
        let mean = rows.iter().map(|r| r[c]).sum::<f64>() / n;
        let variance = rows.iter().map(|r| (r[c] - mean).powi(2)).sum::<f64>() / n;
        (mean, if variance == 0.0 { 0.0 } else { 1.0 / variance.sqrt() })
    };
    let stats: Vec<(f64, f64)> = (0..rows[0].len()).map(of).collect();
    rows.iter().map(|r| r.iter().zip(&stats).map(|(v, (m, i))| (v - m) * i).collect()).collect()
}

/// A linear probe in f64: cross entropy by AdamW on one cycle; the losses of all steps.
fn by_hand(
    rows: &[Vec<f64>],
    labels: &[i32],
    classes: usize,
    settings: &ProbeSettings,
) -> Vec<f64> {
    let (x, width, total) = (standard(rows), rows[0].len(), settings.steps);
    let store = ParamStore::trainable(settings.seed);
    Linear::new(width, classes, true, store.builder().pp("probe.0")).unwrap();
    let params = store.parameters();
    let first = |name: &str| -> Vec<f64> {
        let values = params[name].flatten_all().unwrap().to_vec1::<f32>().unwrap();
        values.into_iter().map(f64::from).collect()
    };
    let mut p = [first("probe.0.weight"), first("probe.0.bias")].concat();
    let (mut m, mut v) = (vec![0.0; p.len()], vec![0.0; p.len()]);
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    rng.set_stream(u64::MAX);
    let anneal =
        |a: f64, b: f64, part: f64| b + (a - b) / 2.0 * (1.0 + (std::f64::consts::PI * part).cos());
    let mut losses = Vec::new();
    for step in 0..total {
        let chosen: Vec<usize> = match rows.len() {
            n if n <= 4096 => (0..n).collect(),
            n => (0..4096)
                .map(|_| ((u128::from(rng.next_u64()) * n as u128) >> 64) as usize)
                .collect(),
        };
        let (mut g, mut loss, count) = (vec![0.0; p.len()], 0.0, chosen.len() as f64);
        for &row in &chosen {
            let logit = |c: usize| {
                (0..width).map(|k| p[c * width + k] * x[row][k]).sum::<f64>()
                    + p[classes * width + c]
            };
            let logits: Vec<f64> = (0..classes).map(logit).collect();
            let sum: f64 = logits.iter().map(|l| l.exp()).sum();
            let label = labels[row] as usize;
            loss += (sum.ln() - logits[label]) / count;
            for c in 0..classes {
                let slope = (logits[c].exp() / sum - f64::from(u8::from(c == label))) / count;
                (0..width).for_each(|k| g[c * width + k] += slope * x[row][k]);
                g[classes * width + c] += slope;
            }
        }
        losses.push(loss);
        // 5 % of the steps up from a tenth, then down to a ten-thousandth; momentum the other way.
        let (turn, last) = (0.05 * total as f64 - 1.0, total as f64 - 1.0);
        let n = step as f64;
        let (rate, beta1) = match n <= turn {
            true => (anneal(0.1, 1.0, n / turn), anneal(0.95, 0.85, n / turn)),
            false => {
                let part = (n - turn) / (last - turn);
                (anneal(1.0, 1e-4, part), anneal(0.85, 0.95, part))
            }
        };
        let t = step as i32 + 1;
        for i in 0..p.len() {
            m[i] = beta1 * m[i] + (1.0 - beta1) * g[i];
            v[i] = 0.999 * v[i] + 0.001 * g[i] * g[i];
            let eta = settings.lr * rate;
            let change =
                m[i] / (1.0 - beta1.powi(t)) / ((v[i] / (1.0 - 0.999f64.powi(t))).sqrt() + 1e-8);
            p[i] = p[i] * (1.0 - eta * settings.weight_decay) - eta * change;
        }
    }
    losses
}

fn learned(rows: &[Vec<f64>], labels: &[i32]) -> Learned {
    let values: Vec<f32> = rows.iter().flatten().map(|v| *v as f32).collect();
    let rows = Tensor::from_vec(values, (rows.len(), rows[0].len()), &Device::Cpu).unwrap();
    Learned { rows, labels: labels.to_vec() }
}

#[test]
fn training_is_what_the_same_in_f64_gives_and_the_loss_that_of_its_last_steps() {
    assert_eq!((HIDDEN, BATCH, LAST), (256, 4096, 20));
    let settings =
        ProbeSettings { steps: 45, lr: 0.05, weight_decay: 0.8, seed: 4, ..<_>::default() };
    let rows: Vec<Vec<f64>> = (0..9)
        .map(|i| vec![f64::from(i * i % 7), 50.0 + f64::from(i * 5 % 9) * 0.25, 3.0])
        .collect();
    let labels = [0, 1, 2, 1, 0, 2, 2, 1, 0];
    let losses = by_hand(&rows, &labels, 3, &settings);
    let near =
        |got: f64, want: f64| assert!((got - want).abs() < 2e-5 * want, "{got}, by hand {want}");
    let probe = Classifier::train(&learned(&rows, &labels), 3, &settings).unwrap();
    near(probe.loss, losses[25..].iter().sum::<f64>() / 20.0);
    assert_eq!((probe.width(), probe.layers.len()), (3, 1));
    let few = ProbeSettings { steps: 3, ..settings };
    let losses = by_hand(&rows, &labels, 3, &few);
    near(
        Classifier::train(&learned(&rows, &labels), 3, &few).unwrap().loss,
        losses.iter().sum::<f64>() / 3.0,
    );
    for kind in [ProbeKind::Mlp3, ProbeKind::Decoder] {
        let deep = ProbeSettings { kind, steps: 1, ..settings.clone() };
        assert_eq!(Classifier::train(&learned(&rows, &labels), 3, &deep).unwrap().layers.len(), 3);
    }
    // More rows than a step takes: 4096 of them are drawn, by the seed.
    let settings = ProbeSettings { steps: 2, lr: 0.5, seed: 5, ..<_>::default() };
    let rows: Vec<Vec<f64>> = (0..5000).map(|i| vec![f64::from(i)]).collect();
    let labels: Vec<i32> = (0..5000).map(|i| i32::from(i >= 4500)).collect();
    let losses = by_hand(&rows, &labels, 2, &settings);
    let data = learned(&rows, &labels);
    let probe = Classifier::train(&data, 2, &settings).unwrap();
    near(probe.loss, losses.iter().sum::<f64>() / 2.0);
    // In parts of 4096 rows each row still has its own class.
    let separate = ProbeSettings { steps: 60, lr: 0.5, ..settings };
    let halves: Vec<i32> = (0..5000).map(|i| i32::from(i >= 4600)).collect();
    let probe = Classifier::train(&learned(&rows, &halves), 2, &separate).unwrap();
    let all = probe.classes(&data.rows).unwrap();
    assert_eq!(all.len(), 5000);
    for at in [0, 4095, 4096, 4999] {
        assert_eq!(all[at], probe.classes(&data.rows.narrow(0, at, 1).unwrap()).unwrap()[0]);
    }
    assert_eq!((all[0], all[4999]), (0, 1));
}

#[test]
fn channels_are_fitted_one_by_one_and_settings_are_checked_at_their_ends() {
    let rows = Tensor::new(&[[1.0f32, 5.0, -2.0], [3.0, 5.0, -2.0], [5.0, 5.0, 7.0]], &Device::Cpu)
        .unwrap();
    let fit = Fit::new(&rows).unwrap();
    // Means 3, 5, 1; variances 8/3, 0 and 18.
    assert_eq!(fit.mean.to_vec2::<f32>().unwrap(), [[3.0, 5.0, 1.0]]);
    let inverse = &fit.inverse.to_vec2::<f32>().unwrap()[0];
    for (got, want) in inverse.iter().zip([(3.0f64 / 8.0).sqrt(), 0.0, 1.0 / 18f64.sqrt()]) {
        assert!((f64::from(*got) - want).abs() < 1e-6, "{inverse:?}");
    }
    let out = fit.apply(&Tensor::new(&[[5.0f32, 9.0, 1.0]], &Device::Cpu).unwrap()).unwrap();
    let out = out.to_vec2::<f32>().unwrap();
    assert!((out[0][0] - 1.5f32.sqrt()).abs() < 1e-6 && out[0][1..] == [0.0, 0.0], "{out:?}");
    // What differs by less than a millionth of its mean does not differ.
    let flat = |by: f32| {
        let rows = Tensor::new(&[[64.0f32 - by], [64.0 + by]], &Device::Cpu).unwrap();
        Fit::new(&rows).unwrap().inverse.to_vec2::<f32>().unwrap()[0][0]
    };
    assert_eq!((flat(f32::powi(2.0, -15)), flat(f32::powi(2.0, -13))), (0.0, 8192.0));

    let plain = ProbeSettings {
        kind: ProbeKind::Linear,
        labels: LabelRegime::All,
        steps: 500,
        lr: 0.005,
        weight_decay: 0.02,
        seed: 0,
        objects: true,
    };
    assert_eq!(ProbeSettings::default(), plain);
    let labels = |labels| ProbeSettings { labels, ..plain.clone() };
    for (says, settings) in [
        ("", labels(LabelRegime::Share(1.0))),
        ("", labels(LabelRegime::PerScene(1))),
        ("", ProbeSettings { steps: 1, weight_decay: 0.0, ..plain.clone() }),
        ("lr: inf", ProbeSettings { lr: f64::INFINITY, ..plain.clone() }),
        ("lr: -0.1", ProbeSettings { lr: -0.1, ..plain.clone() }),
        ("weight_decay: -0.1", ProbeSettings { weight_decay: -0.1, ..plain.clone() }),
        ("weight_decay: inf", ProbeSettings { weight_decay: f64::INFINITY, ..plain.clone() }),
        ("labels: 1.01", labels(LabelRegime::Share(1.01))),
        ("labels: NaN", labels(LabelRegime::Share(f64::NAN))),
    ] {
        let found = settings.check().err().map_or(String::new(), |e| e.to_string());
        assert!(found.starts_with(says) && found.is_empty() == says.is_empty(), "{says}: {found}");
    }
}
