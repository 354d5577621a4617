//! Adam, its schedules, regularizers.

use crate::support::{golden, number};
use scenesplat_optimisation::{Adam, AdamSettings, Model, Moments, Rates, Regularisers, Stored};
use scenesplat_rasterizer::backward::Gradients;
use scenesplat_test_support::compare_relative as compare;

#[test]
fn six_steps() {
    let Some(golden) = golden() else { return };
    let mut values = golden.f32s("adam_x0");
    let mut moments = Moments::zeros(values.len());
    let (gradients, wanted) = (golden.f32s("adam_grads"), &golden.f64s("adam_traj"));
    let n = values.len();
    for t in 0..6 {
        let mut g = gradients[t * n..(t + 1) * n].to_vec();
        moments.step(&mut values, &mut g, &AdamSettings::default(), t as u64 + 1, 0.005);
        assert!(g.iter().all(|g| *g == 0.0));
        compare(&format!("step {t}"), &values, &wanted[t * n..(t + 1) * n], 2e-7);
    }
}

/// Regularizers alone: one step of Adam of a gradient g is `−lr · sign(g)`, so the moments tell.
#[test]
fn regularisers() {
    let Some(golden) = golden() else { return };
    let (logits, log_scales) = (golden.f32s("reg_logit"), golden.rows::<3>("reg_logscale"));
    let row = |(logit, log_scale): (&f32, &[f32; 3])| Stored {
        mean: [0.0; 3],
        log_scale: *log_scale,
        quat: [1.0, 0.0, 0.0, 0.0],
        logit: *logit,
    };
    let rows: Vec<Stored> = logits.iter().zip(&log_scales).map(row).collect();
    let mut model = Model::from_arrays(&rows, vec![0.0; 3 * rows.len()], 0).unwrap();
    let mean = |v: &[f32]| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len() as f64;
    let g = model.gaussians();
    assert!((mean(&g.opacities) - number(&golden, "/reg/opacity")).abs() < 1e-6);
    assert!((mean(g.scales.as_flattened()) - number(&golden, "/reg/scale")).abs() < 1e-6);
    let mut gradients = Gradients::zeros(g, 0);
    // Beta of 0 makes the first moment the gradient itself; the second is its square.
    let settings = AdamSettings { betas: [0.0, 0.0], eps: 1.0 };
    let mut adam = Adam::new(&model, settings);
    let rates =
        Rates { means: 0.0, scales: 1.0, quats: 0.0, opacities: 1.0, sh0: 0.0, sh_rest: 0.0 };
    let before = model.clone();
    let all = Regularisers { opacity: 1.0, scale: 1.0 };
    adam.step(&mut model, &mut gradients, &rates, all, 0);
    // p' = p − g / (|g| + 1), so g = d / (1 − d) with d = p − p'.
    let back = |before: f32, after: f32| {
        let d = f64::from(before) - f64::from(after);
        (d / (1.0 - d)) as f32
    };
    let pairs = before.logits().iter().zip(model.logits());
    let got: Vec<f32> = pairs.map(|(b, a)| back(*b, *a)).collect();
    compare("opacity", &got, &golden.f64s("grad_opacity_reg"), 2e-3);
    let pairs = before.log_scales().as_flattened().iter().zip(model.log_scales().as_flattened());
    let got: Vec<f32> = pairs.map(|(b, a)| back(*b, *a)).collect();
    compare("scale", &got, &golden.f64s("grad_scale_reg"), 2e-3);
}

fn wave(i: usize, a: f64) -> f64 {
    ((i as f64 + 1.0) * a).sin()
}

/// Rows of all sorts and their harmonics.
fn waves(n: usize) -> (Vec<Stored>, Vec<f32>) {
    let row = |i: usize| Stored {
        mean: [0, 1, 2].map(|k| wave(3 * i + k, 0.7) as f32),
        log_scale: [0, 1, 2].map(|k| wave(3 * i + k, 1.3) as f32 - 3.0),
        quat: [0, 1, 2, 3].map(|k| wave(4 * i + k, 2.1) as f32),
        logit: wave(i, 0.3) as f32,
    };
    ((0..n).map(row).collect(), (0..n * 48).map(|i| wave(i, 0.9) as f32).collect())
}

/// Adam in f64 by hand, of all groups with derivatives of activated values, over many steps and with rows
/// that get no gradient.
#[test]
fn all_groups_against_f64() {
    let n = 37;
    let (rows, sh) = waves(n);
    let mut model = Model::from_arrays(&rows, sh.clone(), 3).unwrap();
    let mut adam = Adam::new(&model, AdamSettings::default());
    let mut gradients = Gradients::zeros(model.gaussians(), 0);
    let [means, quats, scales] = [1e-3, 1e-3, 5e-3];
    let rates = Rates { means, scales, quats, opacities: 5e-2, sh0: 2.5e-3, sh_rest: 1e-4 };
    let regularisers = Regularisers { opacity: 0.01, scale: 0.02 };
    let flat = |rows: &[Stored], of: &dyn Fn(&Stored) -> Vec<f32>| -> Vec<f64> {
        rows.iter().flat_map(of).map(f64::from).collect()
    };
    let mut groups = [
        Reference::new(flat(&rows, &|r| r.mean.to_vec())),
        Reference::new(flat(&rows, &|r| r.log_scale.to_vec())),
        Reference::new(flat(&rows, &|r| r.quat.to_vec())),
        Reference::new(flat(&rows, &|r| vec![r.logit])),
        Reference::new(sh.iter().map(|v| f64::from(*v)).collect()),
    ];
    for t in 1..=30u64 {
        let degree = if t < 10 { 1 } else { 3 };
        let bands = if t < 10 { 12 } else { 48 };
        let slope = |i: usize, a: f64| if i % 5 == 4 { 0.0 } else { wave(i + t as usize, a) * 0.1 };
        let fill = |to: &mut [f32], a: f64| {
            to.iter_mut().enumerate().for_each(|(i, g)| *g = slope(i, a) as f32);
        };
        fill(gradients.means.as_flattened_mut(), 0.11);
        fill(gradients.scales.as_flattened_mut(), 0.13);
        fill(gradients.quats.as_flattened_mut(), 0.17);
        fill(&mut gradients.opacities, 0.19);
        for (i, g) in gradients.sh.iter_mut().enumerate() {
            *g = if i % 48 < bands { slope(i, 0.23) as f32 } else { 0.0 };
        }
        groups[0].step(t, |i, _| slope(i, 0.11), |_| rates.means);
        let mean_scale = 0.02 / (3 * n) as f64;
        groups[1].step(t, |i, p| p.exp() * (slope(i, 0.13) + mean_scale), |_| rates.scales);
        groups[2].step(t, |i, _| slope(i, 0.17), |_| rates.quats);
        let opacity = |p: f64| 1.0 / (1.0 + (-p).exp());
        let of_logit =
            |i: usize, p: f64| opacity(p) * (1.0 - opacity(p)) * (slope(i, 0.19) + 0.01 / n as f64);
        groups[3].step(t, of_logit, |_| rates.opacities);
        let sh_rate = |i: usize| if i % 48 < 3 { rates.sh0 } else { rates.sh_rest };
        let of_sh = |i: usize, _: f64| if i % 48 < bands { slope(i, 0.23) } else { 0.0 };
        groups[4].step(t, of_sh, sh_rate);
        adam.step(&mut model, &mut gradients, &rates, regularisers, degree);
    }
    let g = model.gaussians();
    compare("means", g.means.as_flattened(), &groups[0].values, 3e-6);
    compare("log scales", model.log_scales().as_flattened(), &groups[1].values, 3e-6);
    compare("quats", g.quats.as_flattened(), &groups[2].values, 3e-6);
    compare("logits", model.logits(), &groups[3].values, 2e-5);
    compare("harmonics", &g.sh, &groups[4].values, 3e-6);
    for (i, scale) in g.scales.iter().enumerate() {
        assert_eq!(*scale, model.log_scales()[i].map(f32::exp), "drawn is what is stored");
    }
}

/// One group in f64.
struct Reference {
    values: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
}

impl Reference {
    fn new(values: Vec<f64>) -> Self {
        let zeros = vec![0.0; values.len()];
        Self { values, first: zeros.clone(), second: zeros }
    }

    fn step(&mut self, t: u64, slope: impl Fn(usize, f64) -> f64, rate: impl Fn(usize) -> f64) {
        for i in 0..self.values.len() {
            let g = slope(i, self.values[i]);
            self.first[i] = 0.9 * self.first[i] + 0.1 * g;
            self.second[i] = 0.999 * self.second[i] + 0.001 * g * g;
            let m = self.first[i] / (1.0 - 0.9f64.powf(t as f64));
            let v = self.second[i] / (1.0 - 0.999f64.powf(t as f64));
            self.values[i] -= rate(i) * m / (v.sqrt() + 1e-15);
        }
    }
}
