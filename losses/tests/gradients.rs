//! Gradients against central differences in f64, values against formulas, lower types against f64.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod support;

use candle_core::{DType, Result, Tensor};
use scenesplat_losses::{
    Reduction, aggregated_contrastive, cosine, cross_entropy, l2, lovasz_softmax, smooth_l1,
    split_classes,
};
use support::{BF16_EPS, evaluate, matrix, noise, reference, wide};

const STEP: f64 = 1e-6;
/// Rounding of a difference of f64 values near 1, divided by the step.
const DIFFERENCE_EPS: f64 = 2e-9;

const ROWS: usize = 24;
const WIDTH: usize = 5;

type LossFn = Box<dyn Fn(&Tensor) -> Result<Option<Tensor>>>;
type Case = (&'static str, LossFn, f64);

fn predictions() -> Vec<f64> {
    noise(ROWS * WIDTH, 1).iter().map(|v| 1.5 * v).collect()
}

/// Every loss, with settings that use all of its formula, and its value by the formula.
fn cases() -> Vec<Case> {
    let pred = predictions();
    let target = noise(ROWS * WIDTH, 2);
    let valid: Vec<bool> = (0..ROWS).map(|i| i % 4 != 2).collect();
    let label: Vec<i32> = (0..ROWS).map(|i| [0, 3, -1, 1, 3, 0][i % 6]).collect();
    let weights = vec![0.5, 2.0, 1.0, 0.0, 0.25];
    let halves = split_classes(&label, Some(&valid), 3, 9).unwrap();
    assert_eq!(halves.len(), 3);

    let wanted = [
        reference::cosine(&pred, &target, WIDTH, &valid),
        reference::l2(&pred, &target, WIDTH, &valid),
        reference::smooth_l1(&pred, &target, WIDTH, &valid, 0.4),
        reference::smooth_l1(&pred, &target, WIDTH, &valid, 1.0),
        reference::contrastive(&pred, WIDTH, &halves, 0.3),
        reference::cross_entropy(&pred, WIDTH, &label, 0.0, None),
        reference::cross_entropy(&pred, WIDTH, &label, 0.1, Some(&weights)),
        reference::lovasz(&pred, WIDTH, &label),
    ];
    let target = matrix(&target, WIDTH, DType::F64);
    let [t1, t2, t3, t4] = std::array::from_fn(|_| target.clone());
    let [v1, v2, v3, v4] = std::array::from_fn(|_| valid.clone());
    let [l1, l2_, l3] = [label.clone(), label.clone(), label];
    let losses: [(&'static str, LossFn); 8] = [
        ("cosine", Box::new(move |p| cosine(p, &t1, Some(&v1), Reduction::Mean))),
        ("l2", Box::new(move |p| l2(p, &t2, Some(&v2), Reduction::Mean))),
        ("smooth l1", Box::new(move |p| smooth_l1(p, &t3, Some(&v3), 0.4, Reduction::Mean))),
        ("smooth l1, wide", Box::new(move |p| smooth_l1(p, &t4, Some(&v4), 1.0, Reduction::Mean))),
        (
            "contrastive",
            Box::new(move |p| aggregated_contrastive(p, &halves, 0.3, Reduction::Mean)),
        ),
        ("cross entropy", Box::new(move |p| cross_entropy(p, &l1, 0.0, None))),
        (
            "cross entropy, smoothed and weighted",
            Box::new(move |p| cross_entropy(p, &l2_, 0.1, Some(&weights))),
        ),
        ("lovasz", Box::new(move |p| lovasz_softmax(p, &l3))),
    ];
    losses.into_iter().zip(wanted).map(|((name, loss), want)| (name, loss, want)).collect()
}

#[test]
fn values_by_the_formulas() {
    let pred = matrix(&predictions(), WIDTH, DType::F64);
    for (name, loss, want) in cases() {
        let (got, _) = evaluate(&pred, &loss).unwrap().unwrap();
        assert!((got - want).abs() < 1e-14 * want.abs().max(1.0), "{name}: {got} and {want}");
    }
}

#[test]
fn central_differences() {
    let values = predictions();
    for (name, loss, _) in cases() {
        let (_, gradient) = evaluate(&matrix(&values, WIDTH, DType::F64), &loss).unwrap().unwrap();
        let at = |i: usize, step: f64| {
            let mut values = values.clone();
            values[i] += step;
            evaluate(&matrix(&values, WIDTH, DType::F64), &loss).unwrap().unwrap().0
        };
        let mut largest = 0f64;
        for (i, got) in gradient.iter().enumerate() {
            let want = (at(i, STEP) - at(i, -STEP)) / (2.0 * STEP);
            assert!((got - want).abs() < DIFFERENCE_EPS, "{name} [{i}]: {got:e} and {want:e}");
            largest = largest.max(want.abs());
        }
        assert!(largest > 1e-3, "{name}: nothing moves");
    }
}

/// The total of a sum of losses passes its factor on.
#[test]
fn a_factor_on_the_loss() {
    let pred = matrix(&predictions(), WIDTH, DType::F64);
    for (name, loss, _) in cases() {
        let (_, once) = evaluate(&pred, &loss).unwrap().unwrap();
        let scaled = |p: &Tensor| loss(p)?.map(|l| l * -2.5).transpose();
        let (_, more) = evaluate(&pred, scaled).unwrap().unwrap();
        for (o, m) in once.iter().zip(&more) {
            assert!((m + 2.5 * o).abs() <= 1e-15 + 1e-14 * m.abs(), "{name}");
        }
    }
}

/// f32 to its rounding, bf16 and f16 to 2e-2, values and gradients (of the largest).
#[test]
fn lower_types() {
    let exact = matrix(&predictions(), WIDTH, DType::F64);
    for (dtype, eps) in [(DType::F32, 1e-6), (DType::F16, 2e-3), (DType::BF16, BF16_EPS)] {
        for (name, loss, _) in cases() {
            let (want, gradient) = evaluate(&exact, &loss).unwrap().unwrap();
            let (got, rounded) = evaluate(&exact.to_dtype(dtype).unwrap(), &loss).unwrap().unwrap();
            assert!((got - want).abs() < eps * want.abs(), "{name} {dtype:?}: {got} and {want}");
            assert!(dtype == DType::F32 || got != want, "{name} {dtype:?}: nothing was rounded");
            let largest = gradient.iter().fold(0f64, |a, v| a.max(v.abs()));
            // A swap of two nearly equal errors moves a weight of the Lovász loss by itself.
            if name != "lovasz" {
                for (g, w) in rounded.iter().zip(&gradient) {
                    assert!((g - w).abs() < eps * largest, "{name} {dtype:?}: {g} and {w}");
                }
            }
        }
    }
}

/// Losses computed from values that bf16 holds exactly differ from f64 by the type of the sums only.
#[test]
fn what_lower_types_hold_is_not_rounded_again() {
    for dtype in [DType::BF16, DType::F16] {
        let rounded = matrix(&predictions(), WIDTH, DType::F64).to_dtype(dtype).unwrap();
        let exact = rounded.to_dtype(DType::F64).unwrap();
        for (name, loss, _) in cases() {
            let (want, gradient) = evaluate(&exact, &loss).unwrap().unwrap();
            let (got, low) = evaluate(&rounded, &loss).unwrap().unwrap();
            assert!((got - want).abs() < 1e-6 * want.abs(), "{name} {dtype:?}: {got} and {want}");
            let largest = gradient.iter().fold(0f64, |a, v| a.max(v.abs()));
            let eps = if dtype == DType::BF16 { 1.0 / 256.0 } else { 1.0 / 1024.0 };
            for (g, w) in low.iter().zip(&gradient) {
                assert!((g - w).abs() < eps * largest, "{name} {dtype:?}: {g} and {w}");
            }
        }
    }
}

/// A target of another type than the predictions is read for what it holds.
#[test]
fn targets_of_any_type() {
    let pred = matrix(&predictions(), WIDTH, DType::F32);
    let target = matrix(&noise(ROWS * WIDTH, 2), WIDTH, DType::BF16);
    type RowLoss = fn(&Tensor, &Tensor) -> Result<Option<Tensor>>;
    let losses: [RowLoss; 3] = [
        |p, t| cosine(p, t, None, Reduction::Mean),
        |p, t| l2(p, t, None, Reduction::Mean),
        |p, t| smooth_l1(p, t, None, 0.5, Reduction::Mean),
    ];
    for f in losses {
        let value = |target: &Tensor| evaluate(&pred, |p| f(p, target)).unwrap().unwrap();
        let want = value(&target.to_dtype(DType::F32).unwrap());
        assert_eq!(value(&target), want);
        assert_eq!(value(&target.to_dtype(DType::F64).unwrap()), want);
    }
}

/// Columns of a transposed tensor, and rows of a larger one, are read as what they show.
#[test]
fn views() {
    let pred = matrix(&predictions(), WIDTH, DType::F32);
    let transposed = pred.t().unwrap().contiguous().unwrap().t().unwrap();
    let padded = Tensor::cat(&[&pred, &pred], 0).unwrap().narrow(0, ROWS, ROWS).unwrap();
    for (name, loss, _) in cases() {
        let want = loss(&pred).unwrap().unwrap();
        for view in [&transposed, &padded] {
            assert_eq!(wide(&loss(view).unwrap().unwrap()), wide(&want), "{name}");
        }
        let var = candle_core::Var::from_tensor(&pred.t().unwrap().contiguous().unwrap()).unwrap();
        let grads = loss(&var.t().unwrap()).unwrap().unwrap().backward().unwrap();
        let got = wide(&grads.get(&var).unwrap().t().unwrap());
        assert_eq!(got, evaluate(&pred, &loss).unwrap().unwrap().1, "{name}");
    }
}
