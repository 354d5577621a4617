//! AdamW, clipping and averages on hard gradients, and what is saved.

use crate::support::values;
use candle_core::{DType, Device, Tensor, Var, backprop::GradStore};
use scenesplat_trainers::{
    AdamW, AdamWConfig, KeywordGroup, Optimizer, ParamGroup, StepHyperparameters, TrainError,
    clip_grad_norm, ema_update, grad_norm, group_by_keyword,
};
use std::collections::BTreeMap;

type Params = BTreeMap<String, Var>;

fn var(values: &[f32]) -> Var {
    Var::new(values, &Device::Cpu).unwrap()
}

fn params<const N: usize>(vars: [(&str, Var); N]) -> Params {
    vars.map(|(name, var)| (name.to_owned(), var)).into()
}

fn grads<const N: usize>(pairs: [(&Var, &[f32]); N]) -> GradStore {
    let mut store = GradStore::default();
    for (var, grad) in pairs {
        store.insert(var, Tensor::new(grad, &Device::Cpu).unwrap());
    }
    store
}

fn adamw(params: &Params, lr: f64, weight_decay: f64) -> AdamW {
    let groups = group_by_keyword(params, lr, weight_decay, &[]);
    AdamW::new(groups, AdamWConfig::default()).unwrap()
}

/// A step without a schedule.
fn step(optimizer: &mut AdamW, grads: &GradStore) -> Result<(), TrainError> {
    optimizer.step(grads, &StepHyperparameters::default())
}

/// A gradient that differs from element to element and step to step.
fn wave(var: &Var, step: usize) -> GradStore {
    let n = var.elem_count();
    let grad: Vec<f32> = (0..n).map(|i| ((i + 7 * step) as f32 * 0.61).sin()).collect();
    let mut store = GradStore::default();
    store.insert(var, Tensor::from_vec(grad, var.shape(), &Device::Cpu).unwrap());
    store
}

#[test]
fn the_first_step_goes_by_the_sign() {
    let weight = var(&[1.0, 1.0, 1.0]);
    let mut optimizer = adamw(&params([("w", weight.clone())]), 0.1, 0.0);
    step(&mut optimizer, &grads([(&weight, &[5.0, -1e-3, 0.0])])).unwrap();
    for (got, expected) in values(&weight).iter().zip([0.9, 1.1, 1.0]) {
        assert!((got - expected).abs() < 2e-6, "{got} {expected}");
    }
}

#[test]
fn a_zero_gradient_decays_and_a_missing_one_does_nothing() {
    let (zero, missing) = (var(&[2.0]), var(&[2.0]));
    let both = params([("missing", missing.clone()), ("zero", zero.clone())]);
    let mut optimizer = adamw(&both, 0.1, 0.5);
    step(&mut optimizer, &grads([(&zero, &[0.0])])).unwrap();
    assert_eq!(values(&zero), [f64::from(2.0_f32 * 0.95)]);
    assert_eq!(values(&missing), [2.0]);
    let state = optimizer.state().unwrap();
    assert_eq!(state["missing.step"].to_scalar::<i64>().unwrap(), 0);
    assert_eq!(state["zero.step"].to_scalar::<i64>().unwrap(), 1);
}

#[test]
fn groups_and_controls_set_the_rate() {
    let names = ["enc.block0.w", "stem.w"];
    let both = params(names.map(|name| (name, var(&[0.0]))));
    let rule = |keyword: &str, lr| KeywordGroup { keyword: keyword.to_owned(), lr };
    let rules = [rule("block", 0.01), rule("enc", 5.0), rule("nothing", 1.0)];
    let groups = group_by_keyword(&both, 0.1, 0.0, &rules);
    assert_eq!(groups.iter().map(|g| g.params.len()).collect::<Vec<_>>(), [1, 1, 0, 0]);
    let mut optimizer = AdamW::new(groups, AdamWConfig::default()).unwrap();
    let (block, stem) = (&both[names[0]], &both[names[1]]);
    let controls =
        StepHyperparameters { lr_scale: 0.5, beta1: Some(0.95), weight_decay: Some(0.0) };
    optimizer.step(&grads([(block, &[1.0]), (stem, &[1.0])]), &controls).unwrap();
    assert!((values(block)[0] + 0.005).abs() < 1e-7);
    assert!((values(stem)[0] + 0.05).abs() < 1e-7);
    let still = StepHyperparameters { lr_scale: 0.0, ..StepHyperparameters::default() };
    let before = values(stem);
    optimizer.step(&grads([(stem, &[1.0])]), &still).unwrap();
    assert_eq!(values(stem), before);
}

#[test]
fn a_gradient_that_is_not_finite_is_named_and_changes_nothing() {
    let (good, bad) = (var(&[1.0; 2]), var(&[1.0; 3]));
    let both = params([("a.good", good.clone()), ("b.bad", bad.clone())]);
    let mut optimizer = adamw(&both, 0.1, 0.1);
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut store = grads([(&good, &[1.0, 1.0]), (&bad, &[0.0, value, 0.0])]);
        let errors = [
            step(&mut optimizer, &store).unwrap_err(),
            clip_grad_norm(&both, &mut store, 1.0).unwrap_err(),
            grad_norm(&both, &store).unwrap_err(),
        ];
        for error in errors {
            assert_eq!(error.to_string(), "gradient of b.bad is not finite");
        }
        assert_eq!(values(store.get(&good).unwrap()), [1.0, 1.0]);
    }
    assert_eq!((values(&good), values(&bad)), (vec![1.0; 2], vec![1.0; 3]));
    assert_eq!(values(&optimizer.state().unwrap()["a.good.exp_avg"]), [0.0, 0.0]);
}

#[test]
fn huge_gradients_are_clipped_or_refused() {
    let weight = var(&[1.0; 4]);
    let named = params([("w", weight.clone())]);
    let mut optimizer = adamw(&named, 0.1, 0.0);
    let huge = [f32::MAX, -f32::MAX, 0.0, f32::MAX];
    let error = step(&mut optimizer, &grads([(&weight, &huge)])).unwrap_err();
    assert!(matches!(error, TrainError::GradientTooLarge { .. }), "{error}");
    let mut store = grads([(&weight, &huge)]);
    let norm = clip_grad_norm(&named, &mut store, 2.0).unwrap();
    assert!((norm / (f64::from(f32::MAX) * 3_f64.sqrt()) - 1.0).abs() < 1e-12);
    let clipped = values(store.get(&weight).unwrap());
    let expected = 2.0 / 3_f64.sqrt();
    for (got, sign) in clipped.iter().zip([1.0, -1.0, 0.0, 1.0]) {
        assert!((got - sign * expected).abs() < 1e-6, "{clipped:?}");
    }
    step(&mut optimizer, &store).unwrap();
    assert!(values(&weight).iter().all(|v| v.is_finite()));
}

#[test]
fn clipping_leaves_small_gradients_alone_and_detaches_them() {
    let weight = var(&[3.0, 4.0]);
    let named = params([("w", weight.clone()), ("idle", var(&[1.0]))]);
    let loss = weight.sqr().unwrap().sum_all().unwrap();
    let mut store = loss.backward().unwrap();
    assert!((clip_grad_norm(&named, &mut store, 100.0).unwrap() - 10.0).abs() < 1e-12);
    let grad = store.get(&weight).unwrap();
    assert_eq!(values(grad), [6.0, 8.0]);
    assert!(!grad.track_op());
    clip_grad_norm(&named, &mut store, 1.0).unwrap();
    assert!((grad_norm(&named, &store).unwrap() - 1.0).abs() < 1e-6);
    clip_grad_norm(&named, &mut store, 0.0).unwrap();
    assert_eq!(values(store.get(&weight).unwrap()), [0.0, 0.0]);
    assert_eq!(clip_grad_norm(&named, &mut store, 1.0).unwrap(), 0.0);
    assert!(clip_grad_norm(&named, &mut store, f64::NAN).is_err());
    assert!(clip_grad_norm(&named, &mut store, -1.0).is_err());
    assert_eq!(clip_grad_norm(&Params::new(), &mut store, 1.0).unwrap(), 0.0);
}

#[test]
fn a_hundred_million_steps_later() {
    let weight = var(&[1.0, -1.0]);
    let mut optimizer = adamw(&params([("w", weight.clone())]), 0.1, 0.0);
    let mut state = optimizer.state().unwrap();
    state.insert("w.step".to_owned(), Tensor::new(100_000_000_i64, &Device::Cpu).unwrap());
    optimizer.load_state(&state).unwrap();
    step(&mut optimizer, &grads([(&weight, &[1.0, -1.0])])).unwrap();
    // No bias correction is left: m = 0.1 g, v = 0.001 g².
    let expected = 1.0 - 0.1 * 0.1 / 0.001_f64.sqrt();
    assert!((values(&weight)[0] - expected).abs() < 1e-6);
    let step = &optimizer.state().unwrap()["w.step"];
    assert_eq!(step.to_scalar::<i64>().unwrap(), 100_000_001);
}

#[test]
fn a_saved_state_continues_bit_for_bit() {
    for dtype in [DType::F32, DType::F64] {
        let start = Tensor::arange(0_f32, 40_000.0, &Device::Cpu).unwrap();
        let start = (start.reshape((200, 200)).unwrap() / 4e4).unwrap().to_dtype(dtype).unwrap();
        let new = || {
            let weight = Var::from_tensor(&start.copy().unwrap()).unwrap();
            let optimizer = adamw(&params([("w", weight.clone())]), 0.01, 0.05);
            (weight, optimizer)
        };
        let step = |weight: &Var, optimizer: &mut AdamW, i: usize| {
            let mut store = wave(weight, i);
            let grad = store.get(weight).unwrap().to_dtype(dtype).unwrap();
            store.insert(weight, grad);
            let controls = StepHyperparameters {
                beta1: Some(0.9 - 0.01 * i as f64),
                ..StepHyperparameters::default()
            };
            optimizer.step(&store, &controls).unwrap();
        };
        let (weight, mut optimizer) = new();
        (0..3).for_each(|i| step(&weight, &mut optimizer, i));
        let (saved, saved_weight) = (optimizer.state().unwrap(), weight.copy().unwrap());
        let before: Vec<Vec<f64>> = saved.values().map(values).collect();
        (3..6).for_each(|i| step(&weight, &mut optimizer, i));
        let after: Vec<Vec<f64>> = saved.values().map(values).collect();
        assert_eq!(before, after, "a saved state does not move");

        let (resumed, mut again) = new();
        resumed.set(&saved_weight).unwrap();
        again.load_state(&saved).unwrap();
        (3..6).for_each(|i| step(&resumed, &mut again, i));
        assert_eq!(values(&resumed), values(&weight), "{dtype:?}");
        assert_ne!(values(&resumed), values(&saved_weight));
        let after: Vec<Vec<f64>> = saved.values().map(values).collect();
        assert_eq!(before, after, "a loaded state does not move");
    }
}

#[test]
fn slices_and_tensor_operations_agree() {
    // f64 parameters take the way of other devices; a transposed gradient is straightened first.
    let make = |dtype| {
        let zeros = Tensor::full(0.5_f32, (30, 20), &Device::Cpu).unwrap();
        Var::from_tensor(&zeros.to_dtype(dtype).unwrap()).unwrap()
    };
    let (fast, slow) = (make(DType::F32), make(DType::F64));
    let mut optimizers = [&fast, &slow].map(|var| adamw(&params([("w", var.clone())]), 0.01, 0.1));
    for i in 0..5 {
        let grad = wave(&fast, i).remove(&fast).unwrap();
        let flipped = grad.t().unwrap().contiguous().unwrap().t().unwrap();
        let mut store = GradStore::default();
        store.insert(&fast, flipped);
        store.insert(&slow, grad.to_dtype(DType::F64).unwrap());
        for optimizer in &mut optimizers {
            step(optimizer, &store).unwrap();
        }
    }
    for (a, b) in values(&fast).iter().zip(values(&slow)) {
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }
}

#[test]
fn thread_count_does_not_matter() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let weight = var(&vec![0.1; 100_001]);
            let named = params([("w", weight.clone())]);
            let mut optimizer = adamw(&named, 0.01, 0.1);
            let mut norms = vec![];
            for i in 0..3 {
                let mut store = wave(&weight, i);
                norms.push(clip_grad_norm(&named, &mut store, 1.0).unwrap());
                step(&mut optimizer, &store).unwrap();
            }
            (values(&weight), norms)
        })
    };
    let one = run(1);
    assert!(run(2) == one && run(5) == one);
}

#[test]
fn states_that_do_not_fit_are_refused() {
    let weight = var(&[1.0, 2.0]);
    let mut optimizer = adamw(&params([("w", weight.clone())]), 0.1, 0.0);
    step(&mut optimizer, &grads([(&weight, &[1.0, 1.0])])).unwrap();
    let good = optimizer.state().unwrap();
    let mut refuse = |change: &dyn Fn(&mut BTreeMap<String, Tensor>), message: &str| {
        let mut state = good.clone();
        change(&mut state);
        let error = optimizer.load_state(&state).unwrap_err();
        assert_eq!(error.to_string(), message);
        let now = optimizer.state().unwrap();
        assert_eq!(values(&now["w.exp_avg"]), values(&good["w.exp_avg"]));
    };
    let tensor = |values: &[f32]| Tensor::new(values, &Device::Cpu).unwrap();
    refuse(&|s| drop(s.remove("w.exp_avg_sq")), "optimizer state: missing entry w.exp_avg_sq");
    refuse(&|s| drop(s.insert("x".into(), tensor(&[0.0]))), "optimizer state: unknown entry x");
    refuse(
        &|s| drop(s.insert("w.exp_avg".into(), tensor(&[0.0]))),
        "moment of w.exp_avg: expected F32 [2], got F32 [1]",
    );
    refuse(
        &|s| drop(s.insert("w.step".into(), Tensor::new(-1_i64, &Device::Cpu).unwrap())),
        "optimizer state: negative entry w.step",
    );
}

#[test]
fn malformed_inputs_are_named() {
    let weight = var(&[1.0, 2.0]);
    let group = |name: &str, var: &Var| ParamGroup {
        params: params([(name, var.clone())]),
        lr: 0.1,
        weight_decay: 0.0,
    };
    let new = |groups, config| AdamW::new(groups, config).map(|_| ()).unwrap_err().to_string();
    let plain = AdamWConfig::default();
    let twice = vec![group("a", &weight), group("b", &weight)];
    assert_eq!(new(twice, plain), "parameter b is given twice, the other time as a");
    let twice = vec![group("a", &weight), group("a", &var(&[1.0]))];
    assert_eq!(new(twice, plain), "parameter a is given twice, the other time as a");
    let half = Var::zeros(2, DType::BF16, &Device::Cpu).unwrap();
    assert!(new(vec![group("h", &half)], plain).starts_with("parameter h is BF16"));
    let bad = AdamWConfig { beta2: 1.0, ..plain };
    assert_eq!(new(vec![], bad), "beta2 is 1, expected in 0..1");
    let bad = AdamWConfig { eps: 0.0, ..plain };
    assert!(new(vec![], bad).starts_with("eps is 0"));
    let bad = vec![ParamGroup { lr: f64::NAN, ..group("a", &weight) }];
    assert_eq!(new(bad, plain), "lr is NaN, expected at least 0");

    let mut optimizer = adamw(&params([("w", weight.clone())]), 0.1, 0.0);
    let store = grads([(&weight, &[1.0, 1.0])]);
    let controls =
        |lr_scale, beta1, weight_decay| StepHyperparameters { lr_scale, beta1, weight_decay };
    for (controls, message) in [
        (controls(-1.0, None, None), "lr_scale is -1, expected at least 0"),
        (controls(1.0, Some(1.0), None), "beta1 is 1, expected in 0..1"),
        (controls(1.0, None, Some(f64::INFINITY)), "weight_decay is inf, expected at least 0"),
    ] {
        assert_eq!(optimizer.step(&store, &controls).unwrap_err().to_string(), message);
    }
    let store = grads([(&weight, &[1.0])]);
    assert_eq!(
        step(&mut optimizer, &store).unwrap_err().to_string(),
        "gradient of w: expected F32 [2], got F32 [1]"
    );
    assert_eq!(values(&weight), [1.0, 2.0]);
    // No parameters at all is fine.
    let mut empty = AdamW::new(vec![], plain).unwrap();
    step(&mut empty, &store).unwrap();
    assert!(empty.state().unwrap().is_empty());
}

#[test]
fn teachers_follow_and_mistakes_change_nothing() {
    let (a, b) = (var(&[0.0, 4.0]), var(&[1.0]));
    let teacher = params([("a", a.clone()), ("b", b.clone())]);
    let other = params([("a", var(&[2.0, 0.0])), ("b", var(&[1.0, 1.0]))]);
    let error = ema_update(&teacher, &other, 0.5).unwrap_err();
    assert_eq!(error.to_string(), "student of b: expected F32 [1], got F32 [2]");
    let error = ema_update(&teacher, &params([("a", var(&[2.0, 0.0]))]), 0.5).unwrap_err();
    assert_eq!(error.to_string(), "student: no parameter b");
    assert!(ema_update(&teacher, &teacher, 1.5).is_err());
    assert!(ema_update(&teacher, &teacher, f64::NAN).is_err());
    assert_eq!(values(&a), [0.0, 4.0]);
    let student = params([("a", var(&[2.0, 0.0])), ("b", var(&[3.0])), ("head", var(&[9.0]))]);
    ema_update(&teacher, &student, 0.5).unwrap();
    assert_eq!((values(&a), values(&b)), (vec![1.0, 2.0], vec![2.0]));
    ema_update(&teacher, &student, 1.0).unwrap();
    assert_eq!(values(&a), [1.0, 2.0]);
    ema_update(&teacher, &student, 0.0).unwrap();
    assert_eq!(values(&a), [2.0, 0.0]);
    ema_update(&teacher, &teacher, 0.3).unwrap();
    assert_eq!(values(&a), [2.0, 0.0]);
}
