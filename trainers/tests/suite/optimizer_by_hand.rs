//! AdamW, its settings and the schedules against the formulas written out in f64, all settings unequal.

use crate::support::values;
use candle_core::{DType, Device, Tensor, Var, backprop::GradStore};
use scenesplat_trainers::{
    AdamW, AdamWConfig, CosineSchedule, KeywordGroup, OneCycle, Optimizer, ParamGroup, Schedule,
    StepHyperparameters, WithWeightDecay, clip_grad_norm, ema_update, grad_norm,
};
use serde_json::json;
use std::collections::BTreeMap;

fn var(values: &[f64], dtype: DType) -> Var {
    Var::from_tensor(&Tensor::new(values, &Device::Cpu).unwrap().to_dtype(dtype).unwrap()).unwrap()
}

fn group(name: &str, var: &Var, lr: f64, weight_decay: f64) -> ParamGroup {
    ParamGroup { params: BTreeMap::from([(name.to_owned(), var.clone())]), lr, weight_decay }
}

/// p ← p (1 − η λ); m, v; p ← p − η m̂ / (√v̂ + ε), with t of the parameter itself.
struct ByHand {
    p: Vec<f64>,
    m: Vec<f64>,
    v: Vec<f64>,
    t: i32,
}

impl ByHand {
    fn step(&mut self, g: &[f64], eta: f64, decay: f64, [b1, b2, eps]: [f64; 3]) {
        self.t += 1;
        for (i, g) in g.iter().enumerate() {
            self.m[i] = b1 * self.m[i] + (1.0 - b1) * g;
            self.v[i] = b2 * self.v[i] + (1.0 - b2) * g * g;
            let m = self.m[i] / (1.0 - b1.powi(self.t));
            let v = self.v[i] / (1.0 - b2.powi(self.t));
            self.p[i] = self.p[i] * (1.0 - eta * decay) - eta * m / (v.sqrt() + eps);
        }
    }
}

#[test]
fn groups_keep_their_own_rates_decays_and_counts() {
    let defaults = AdamWConfig { beta1: 0.9, beta2: 0.999, eps: 1e-8 };
    assert_eq!(AdamWConfig::default(), defaults);
    let plain = StepHyperparameters { lr_scale: 1.0, beta1: None, weight_decay: None };
    assert_eq!(StepHyperparameters::default(), plain);
    let configs = [defaults, AdamWConfig { beta1: 0.7, beta2: 0.9, eps: 0.03 }];
    for (dtype, allowed) in [(DType::F64, 1e-12), (DType::F32, 1e-5)] {
        for config in configs {
            let starts = [vec![1.0, -2.0, 0.5], vec![3.0, 0.25]];
            let vars = starts.clone().map(|v| var(&v, dtype));
            let (rates, decays) = ([0.05, 0.2], [0.3, 0.1]);
            let groups = (0..2).map(|i| group(["b", "a"][i], &vars[i], rates[i], decays[i]));
            let mut optimizer = AdamW::new(groups.collect(), config).unwrap();
            let mut hands =
                starts.map(|p| ByHand { m: vec![0.0; p.len()], v: vec![0.0; p.len()], p, t: 0 });
            for n in 0..6 {
                // The second has no gradient in the third step; from the fourth on schedules decide.
                let controls = match n {
                    0..3 => plain,
                    _ => StepHyperparameters {
                        lr_scale: 0.5,
                        beta1: Some(0.8),
                        weight_decay: Some(0.4),
                    },
                };
                let mut store = GradStore::default();
                for i in (0..2).filter(|i| (n, *i) != (2, 1)) {
                    let g: Vec<f64> = (0..hands[i].p.len())
                        .map(|k| ((n * 7 + i * 3 + k * 2) as f64 * 0.9).sin() * (1.0 + k as f64))
                        .collect();
                    let grad = Tensor::new(g.clone(), &Device::Cpu).unwrap();
                    store.insert(&vars[i], grad.to_dtype(dtype).unwrap());
                    let betas = [controls.beta1.unwrap_or(config.beta1), config.beta2, config.eps];
                    let decay = controls.weight_decay.unwrap_or(decays[i]);
                    hands[i].step(&g, rates[i] * controls.lr_scale, decay, betas);
                }
                optimizer.step(&store, &controls).unwrap();
                for (hand, var) in hands.iter().zip(&vars) {
                    let got = values(var);
                    let near = got.iter().zip(&hand.p).all(|(a, b)| (a - b).abs() < allowed);
                    assert!(near, "{dtype:?}, step {n}: {got:?}, by hand {:?}", hand.p);
                }
            }
            let state = optimizer.state().unwrap();
            for (name, hand) in ["b", "a"].iter().zip(&hands) {
                let of = |part: &str| values(&state[&format!("{name}.{part}")]);
                assert_eq!(
                    state[&format!("{name}.step")].to_scalar::<i64>().unwrap(),
                    i64::from(hand.t)
                );
                assert!(of("exp_avg").iter().zip(&hand.m).all(|(a, b)| (a - b).abs() < allowed));
                assert!(of("exp_avg_sq").iter().zip(&hand.v).all(|(a, b)| (a - b).abs() < allowed));
            }
            let adamw = json!({"beta1": config.beta1, "beta2": config.beta2, "eps": config.eps});
            let group =
                |i: usize| json!({"lr": rates[i], "weight_decay": decays[i], "parameters": 1});
            let settings = json!({"adamw": adamw, "parameter_groups": [group(0), group(1)]});
            assert_eq!(optimizer.settings(), settings);
        }
    }
}

#[test]
fn limits_of_rates_gradients_and_settings_are_where_they_are_said_to_be() {
    let weight = var(&[1.0, 2.0], DType::F32);
    let make =
        |lr, decay, config| AdamW::new(vec![group("w", &weight, lr, decay)], config).map(drop);
    let config = AdamWConfig::default();
    let eps = f64::from(f32::MIN_POSITIVE);
    for (good, lr, decay, config) in [
        (true, 0.0, 0.0, AdamWConfig { beta1: 0.0, beta2: 0.0, eps }),
        (false, -1e-9, 0.0, config),
        (false, f64::INFINITY, 0.0, config),
        (false, 0.1, -1e-9, config),
        (false, 0.1, f64::NAN, config),
        (false, 0.1, 0.0, AdamWConfig { beta1: 1.0, ..config }),
        (false, 0.1, 0.0, AdamWConfig { beta1: -0.1, ..config }),
        (false, 0.1, 0.0, AdamWConfig { beta2: 1.0, ..config }),
        (false, 0.1, 0.0, AdamWConfig { beta2: -0.1, ..config }),
        (false, 0.1, 0.0, AdamWConfig { eps: 1e-38, ..config }),
        (false, 0.1, 0.0, AdamWConfig { eps: f64::INFINITY, ..config }),
    ] {
        assert_eq!(make(lr, decay, config).is_ok(), good, "{lr} {decay} {config:?}");
    }
    // The square of a norm of 10¹⁸ still fits; a norm is over all elements, in f64 and whatever the layout.
    let mut optimizer = AdamW::new(vec![group("w", &weight, 0.1, 0.0)], config).unwrap();
    for (grad, good) in [([0.6e18, 0.79e18], true), ([0.9e18, 0.9e18], false)] {
        let mut store = GradStore::default();
        store.insert(&weight, Tensor::new(&grad.map(|v| v as f32), &Device::Cpu).unwrap());
        assert_eq!(optimizer.step(&store, &StepHyperparameters::default()).is_ok(), good);
    }
    let [a, b] = [[1.0, 2.0, -3.0, 4.0], [5.0, -6.0, 7.0, 8.0]].map(|v| var(&v, DType::F32));
    let mut store = GradStore::default();
    // Columns 1 and 3 alone of each: 4 + 16, and in f64 36 + 64.
    let table = |var: &Var| var.reshape((2, 2)).unwrap().detach();
    store.insert(&a, table(&a).narrow(1, 1, 1).unwrap());
    store.insert(&b, table(&b).narrow(1, 1, 1).unwrap().to_dtype(DType::F64).unwrap());
    let params: BTreeMap<String, Var> =
        [("a".to_owned(), a.clone()), ("b".to_owned(), b.clone())].into();
    assert!((grad_norm(&params, &store).unwrap() - 120f64.sqrt()).abs() < 1e-9);
    // Clipped to 3: by 3 / (√120 + 1e-6), for all alike.
    let norm = clip_grad_norm(&params, &mut store, 3.0).unwrap();
    let factor = 3.0 / (120f64.sqrt() + 1e-6);
    assert!((norm - 120f64.sqrt()).abs() < 1e-9);
    let clipped = values(store.get(&b).unwrap());
    assert!((clipped[0] + 6.0 * factor).abs() < 1e-9 && (clipped[1] - 8.0 * factor).abs() < 1e-9);
    assert!((values(store.get(&a).unwrap())[1] - 4.0 * factor).abs() < 1e-6);
    // A tiny norm is the whole of what is added to it: 0.5e-6 becomes 1/3 of a limit of 1e-6.
    store.insert(&b, Tensor::new(&[[0.5e-6f64], [0.0]], &Device::Cpu).unwrap());
    let alone: BTreeMap<String, Var> = [("b".to_owned(), b.clone())].into();
    clip_grad_norm(&alone, &mut store, 1e-6).unwrap();
    assert!((values(store.get(&b).unwrap())[0] - 0.5e-6 / 1.5).abs() < 1e-15);

    // A teacher in f64 and one in f32, unequal shares.
    for dtype in [DType::F64, DType::F32] {
        let (teacher, student) = (var(&[1.0, -4.0], dtype), var(&[3.0, 6.0], dtype));
        let named = |v: &Var| BTreeMap::from([("w".to_owned(), v.clone())]);
        ema_update(&named(&teacher), &named(&student), 0.75).unwrap();
        assert_eq!((values(&teacher), values(&student)), (vec![1.5, -1.5], vec![3.0, 6.0]));
        assert!(ema_update(&named(&teacher), &named(&student), -0.1).is_err());
    }
    let rule: KeywordGroup =
        serde_json::from_value(json!({"keyword": "block", "lr": 0.5})).unwrap();
    assert_eq!((rule.keyword.as_str(), rule.lr), ("block", 0.5));
}

#[test]
fn schedules_of_other_settings_follow_the_formula() {
    let cycle = OneCycle {
        warmup: 0.05,
        div_factor: 10.0,
        final_div_factor: 1000.0,
        min_beta1: 0.85,
        max_beta1: 0.95,
    };
    assert_eq!(OneCycle::default(), cycle);
    let cycle = OneCycle {
        warmup: 0.3,
        div_factor: 4.0,
        final_div_factor: 50.0,
        min_beta1: 0.6,
        max_beta1: 0.9,
    };
    // Of 20 steps the rise ends at 5, the fall at 19.
    let anneal =
        |a: f64, b: f64, part: f64| b + (a - b) / 2.0 * (1.0 + (std::f64::consts::PI * part).cos());
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    for n in 0..25u64 {
        let at = n.min(19) as f64;
        let (rate, beta1) = match n {
            0..=5 => (anneal(0.25, 1.0, at / 5.0), anneal(0.9, 0.6, at / 5.0)),
            _ => (anneal(1.0, 0.005, (at - 5.0) / 14.0), anneal(0.6, 0.9, (at - 5.0) / 14.0)),
        };
        let got = cycle.hyperparameters(n, 20);
        near(got.lr_scale, rate);
        near(got.beta1.unwrap(), beta1);
        assert_eq!(got.weight_decay, None);
    }
    // The original's: at a quarter, a half and three quarters of the run.
    for (schedule, want) in [
        (CosineSchedule::teacher_momentum(), [0.9, 0.914_645, 0.95, 0.985_355, 1.0]),
        (CosineSchedule::weight_decay(), [0.04, 0.092_721, 0.22, 0.347_279, 0.4]),
        // 60 of 100 steps of warm-up, from 0 to 59.
        (CosineSchedule::teacher_temperature(), [0.04, 0.052_712, 0.065_424, 0.07, 0.07]),
    ] {
        for (step, want) in [0, 25, 50, 75, 100].into_iter().zip(want) {
            assert!((schedule.value(step, 100) - want).abs() < 1e-6, "{schedule:?} {step}");
        }
    }
    let decay = CosineSchedule { warmup: 0.5, warmup_from: 0.1, from: 0.3, to: 0.2 };
    let both = WithWeightDecay { rate: Box::new(cycle) as Box<dyn Schedule>, decay };
    let got = both.hyperparameters(3, 20);
    near(got.weight_decay.unwrap(), 0.1 + 0.2 * 3.0 / 9.0);
    assert_eq!((got.lr_scale, got.beta1), (cycle.factor(3, 20), cycle.beta1(3, 20)));
    let boxed: Box<dyn Schedule> = Box::new(both);
    assert_eq!(boxed.hyperparameters(3, 20), got);
    let of_decay =
        json!({"type": "cosine", "warmup": 0.5, "warmup_from": 0.1, "from": 0.3, "to": 0.2});
    let of_cycle = json!({"type": "one_cycle", "warmup": 0.3, "div_factor": 4.0, "final_div_factor": 50.0,
        "min_beta1": 0.6, "max_beta1": 0.9, "weight_decay": of_decay});
    assert_eq!(boxed.settings(), of_cycle);
    assert_eq!(Schedule::settings(&decay), of_decay);
    /// A schedule that says nothing of itself.
    struct Flat;
    impl Schedule for Flat {
        fn factor(&self, _: u64, _: u64) -> f64 {
            0.5
        }
    }
    let flat = WithWeightDecay { rate: Flat, decay };
    assert_eq!(flat.settings(), json!({"rate": null, "weight_decay": of_decay}));
    assert_eq!((flat.beta1(0, 9), Flat.weight_decay(0, 9)), (None, None));
    for (warmup, div, last, low, high) in [
        (1.1, 1.0, 1.0, 0.5, 0.5),
        (0.0, -1.0, 1.0, 0.5, 0.5),
        (0.0, f64::INFINITY, 1.0, 0.5, 0.5),
        (0.0, 1.0, 0.0, 0.5, 0.5),
        (0.0, 1.0, 1.0, 1.0, 0.5),
        (0.0, 1.0, 1.0, -0.1, 0.5),
        (0.0, 1.0, 1.0, 0.5, -0.1),
    ] {
        let (div_factor, final_div_factor, min_beta1, max_beta1) = (div, last, low, high);
        let bad = OneCycle { warmup, div_factor, final_div_factor, min_beta1, max_beta1 };
        assert!(bad.check().is_err(), "{bad:?}");
    }
    for bad in [
        CosineSchedule { warmup: -0.1, ..decay },
        CosineSchedule { warmup_from: f64::NAN, ..decay },
        CosineSchedule { from: f64::INFINITY, ..decay },
        CosineSchedule { to: f64::NAN, ..decay },
    ] {
        assert!(bad.check().is_err(), "{bad:?}");
    }
}
