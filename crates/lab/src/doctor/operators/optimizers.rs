//! Optimizer, clipping and schedules at their ends.

use super::compare::gradient;
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::noise;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use candle_core::backprop::GradStore;
use candle_core::{Device, Tensor, Var};
use scenesplat_trainers::{
    AdamW, AdamWConfig, CosineSchedule, OneCycle, Optimizer, Schedule, StepHyperparameters,
    clip_grad_norm, ema_update, grad_norm, group_by_keyword,
};
use std::collections::BTreeMap;

type Params = BTreeMap<String, Var>;

fn params(values: &[f32]) -> Result<Params, Failure> {
    Ok(BTreeMap::from([("w".to_owned(), Var::new(values, &Device::Cpu)?)]))
}

fn grads(params: &Params, values: &[f32]) -> Result<GradStore, Failure> {
    let mut store = GradStore::default();
    store.insert(&params["w"], Tensor::new(values, &Device::Cpu)?);
    Ok(store)
}

fn values(params: &Params) -> Result<Vec<f64>, Failure> {
    Ok(params["w"].to_vec1::<f32>()?.into_iter().map(f64::from).collect())
}

fn adamw(params: &Params, lr: f64, decay: f64) -> Result<AdamW, Failure> {
    Ok(AdamW::new(group_by_keyword(params, lr, decay, &[]), AdamWConfig::default())?)
}

fn step(optimizer: &mut AdamW, grads: &GradStore) -> Result<(), Failure> {
    Ok(optimizer.step(grads, &StepHyperparameters::default())?)
}

pub(super) fn cases() -> Vec<Case> {
    vec![
        case("adamw-50-steps", fifty_steps),
        case("adamw-first-step", first_step),
        case("adamw-zero-gradient", zero_gradient),
        case("adamw-nan-gradient", nan_gradient),
        case("clipping", clipping),
        case("average-of-parameters", |_| {
            for (momentum, want) in [(0.0, 3.0), (1.0, 1.0), (0.75, 1.5)] {
                let (teacher, student) = (params(&[1.0])?, params(&[3.0])?);
                ema_update(&teacher, &student, momentum)?;
                let found = values(&teacher)?;
                ensure!(found == [want], "momentum {momentum}: {found:?}");
            }
            Ok(())
        }),
        case("one-cycle-at-its-ends", one_cycle),
        case("cosine-schedule-at-its-ends", |_| {
            let plain = CosineSchedule::new(1.0, 0.0);
            let found = [0, 5, 10, 11, u64::MAX].map(|n| plain.value(n, 10));
            ensure!(found == [1.0, 0.5, 0.0, 0.0, 0.0], "{found:?}");
            let warm = CosineSchedule { warmup: 0.3, warmup_from: 0.0, from: 1.0, to: 0.0 };
            let found = [0, 1, 2, 3].map(|n| warm.value(n, 10));
            ensure!(found == [0.0, 0.5, 1.0, 1.0], "{found:?}");
            ensure!(warm.value(0, 0) == 0.0, "a run of no step");
            Ok(())
        }),
    ]
}

fn first_step(_: &Trial<'_>) -> Result<(), Failure> {
    let params = params(&[1.0; 5])?;
    let mut optimizer = adamw(&params, 0.1, 0.0)?;
    step(&mut optimizer, &grads(&params, &[5.0, -1e-3, 0.0, 1e15, -1e-20])?)?;
    // 1e-20 is far below eps, which is 1e-8.
    for (got, want) in values(&params)?.into_iter().zip([0.9, 1.1, 1.0, 0.9, 1.0]) {
        ensure!((got - want).abs() < 2e-5, "{got}, {want} is right");
    }
    Ok(())
}

fn zero_gradient(_: &Trial<'_>) -> Result<(), Failure> {
    let params = params(&[2.0, -3.0])?;
    let mut optimizer = adamw(&params, 0.1, 0.5)?;
    for _ in 0..10 {
        step(&mut optimizer, &grads(&params, &[0.0; 2])?)?;
    }
    let decay = (1.0f64 - 0.1 * 0.5).powi(10);
    for (got, want) in values(&params)?.into_iter().zip([2.0 * decay, -3.0 * decay]) {
        ensure!((got / want - 1.0).abs() < 1e-6, "{got}, {want} is right");
    }
    Ok(())
}

fn nan_gradient(_: &Trial<'_>) -> Result<(), Failure> {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
        let params = params(&[1.0; 3])?;
        let mut optimizer = adamw(&params, 0.1, 0.1)?;
        let error = step(&mut optimizer, &grads(&params, &[0.0, bad, 0.0])?);
        ensure!(error.is_err_and(|e| e.0.contains('w')), "{bad} is taken or not named");
        ensure!(values(&params)? == [1.0; 3], "{bad}: the step was taken");
    }
    Ok(())
}

fn clipping(_: &Trial<'_>) -> Result<(), Failure> {
    for (size, factor) in [(1e-30f32, 1.0), (0.1, 1.0), (1e3, 1e-3), (1e25, 1e-25)] {
        let params = params(&[0.0; 2])?;
        let mut store = grads(&params, &[0.6 * size, -0.8 * size])?;
        let norm = clip_grad_norm(&params, &mut store, 1.0)?;
        ensure!((norm / f64::from(size) - 1.0).abs() < 1e-5, "norm {norm}, {size} is right");
        let (after, want) = (grad_norm(&params, &store)?, f64::from(size) * factor);
        ensure!((after / want - 1.0).abs() < 1e-4, "clipped to {after}, {want} is right");
    }
    Ok(())
}

fn one_cycle(_: &Trial<'_>) -> Result<(), Failure> {
    let schedule = OneCycle::default();
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs().max(1e-9);
    for (at, factor, beta) in
        [(0, 0.1, 0.95), (4, 1.0, 0.85), (99, 1e-4, 0.95), (u64::MAX, 1e-4, 0.95)]
    {
        let (f, b) = (schedule.factor(at, 100), schedule.beta1(at, 100));
        ensure!(near(f, factor), "step {at}: factor {f}, {factor} is right");
        ensure!(b.is_some_and(|b| near(b, beta)), "step {at}: beta1 {b:?}, {beta} is right");
    }
    for total in 0..60 {
        for at in 0..total + 2 {
            let factor = schedule.factor(at, total);
            ensure!((9.99e-5..=1.0).contains(&factor), "step {at} of {total}: {factor}");
        }
    }
    Ok(())
}

fn fifty_steps(_: &Trial<'_>) -> Result<Finding, Failure> {
    let start = noise(40, 1, 1.0);
    let params = params(&start)?;
    let (lr, decay) = (0.01, 0.05);
    let mut optimizer = adamw(&params, lr, decay)?;
    let (b1, b2, eps) = (0.9f64, 0.999f64, 1e-8);
    let mut p: Vec<f64> = start.iter().map(|v| f64::from(*v)).collect();
    let (mut m, mut v) = (vec![0.0; 40], vec![0.0; 40]);
    for t in 1..=50 {
        let g = noise(40, 100 + t as u64, 1.0);
        step(&mut optimizer, &grads(&params, &g)?)?;
        for i in 0..40 {
            let g = f64::from(g[i]);
            p[i] *= 1.0 - lr * decay;
            m[i] += (1.0 - b1) * (g - m[i]);
            v[i] = b2 * v[i] + (1.0 - b2) * g * g;
            let (c1, c2) = (1.0 - b1.powi(t), 1.0 - b2.powi(t));
            p[i] -= lr / c1 * m[i] / ((v[i] / c2).sqrt() + eps);
        }
    }
    gradient(&values(&params)?, &p)
}
