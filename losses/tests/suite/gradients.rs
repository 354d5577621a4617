//! Gradients against central differences in f64, values against formulas, lower types against f64.

use crate::cases::{ROWS, WIDTH, all, supervised};
use crate::support::{BF16_EPS, evaluate, matrix, noise, number, wide};
use candle_core::{DType, Result, Tensor, Var};
use scenesplat_losses::{Reduction, cosine, l2, smooth_l1};

const STEP: f64 = 1e-6;

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m: f64, v| m.max(v.abs()))
}

#[test]
fn values_by_the_formulas() {
    for case in supervised() {
        let (got, want) = (case.run(DType::F64).0, case.want.unwrap());
        let close = (got - want).abs() < 1e-13 * want.abs().max(1.0);
        assert!(close, "{}: {got} and {want}", case.name);
    }
}

#[test]
fn central_differences() {
    for case in all() {
        let gradient = case.run(DType::F64).1;
        let largest = largest(&gradient);
        assert!(largest > 1e-3, "{}: nothing moves", case.name);
        let mut worst = 0.0f64;
        for (i, got) in gradient.iter().enumerate() {
            let at = |step: f64| {
                let mut values = case.pred.clone();
                values[i] += step;
                case.at(&case.tensor(&values, DType::F64)).0
            };
            let want = (at(STEP) - at(-STEP)) / (2.0 * STEP);
            // Rounding of a difference of f64 values near 1, divided by the step.
            let allowed = 2e-9 + 1e-7 * largest;
            assert!((got - want).abs() < allowed, "{} [{i}]: {got:e} and {want:e}", case.name);
            worst = worst.max((got - want).abs() / allowed);
        }
        println!("{}: {:.1} % of what is allowed", case.name, 100.0 * worst);
    }
}

/// The total of a sum of losses passes its factor on.
#[test]
fn a_factor_on_the_loss() {
    for case in all() {
        let pred = case.tensor(&case.pred, DType::F64);
        let once = case.run(DType::F64).1;
        let scaled = |p: &Tensor| (case.loss)(p)?.map(|l| l * -2.5).transpose();
        let (_, more) = evaluate(&pred, scaled).unwrap().unwrap();
        for (o, m) in once.iter().zip(&more) {
            assert!((m + 2.5 * o).abs() <= 1e-15 + 1e-14 * m.abs(), "{}", case.name);
        }
    }
}

#[test]
fn lower_types_are_near_f64() {
    for case in all() {
        let (want, gradient) = case.run(DType::F64);
        let largest = largest(&gradient);
        for (dtype, eps) in [(DType::F32, 1e-5), (DType::F16, 4e-3), (DType::BF16, BF16_EPS)] {
            let what = format!("{} {dtype:?}", case.name);
            let (got, rounded) = case.run(dtype);
            assert!((got - want).abs() < eps * want.abs().max(1.0), "{what}: {got} and {want}");
            assert!(dtype == DType::F32 || got != want, "{what}: nothing was rounded");
            // A swap of two nearly equal errors moves a weight of the Lovász loss by itself.
            if !case.name.contains("lovasz") {
                for (g, w) in rounded.iter().zip(&gradient) {
                    assert!((g - w).abs() < 3.0 * eps * largest, "{what}: {g} and {w}");
                }
            }
        }
    }
}

/// Losses computed from values that bf16 holds exactly differ from f64 by the type of the sums only.
#[test]
fn what_lower_types_hold_is_not_rounded_again() {
    for (dtype, eps) in [(DType::BF16, 1.0 / 256.0), (DType::F16, 1.0 / 1024.0)] {
        // Texts are multiplied in f32.
        for case in supervised().iter().filter(|case| !case.name.contains("text")) {
            let rounded = case.tensor(&case.pred, dtype);
            let (want, gradient) = case.at(&rounded.to_dtype(DType::F64).unwrap());
            let (got, low) = case.at(&rounded);
            let what = format!("{} {dtype:?}", case.name);
            assert!((got - want).abs() < 1e-6 * want.abs(), "{what}: {got} and {want}");
            let largest = largest(&gradient);
            for (g, w) in low.iter().zip(&gradient) {
                assert!((g - w).abs() < eps * largest, "{what}: {g} and {w}");
            }
        }
    }
}

/// A target of another type than the predictions is read for what it holds.
#[test]
fn targets_of_any_type() {
    let pred = matrix(&noise(ROWS * WIDTH, 1), WIDTH, DType::F32);
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
    for case in supervised().iter().filter(|case| !case.name.contains("text")) {
        let pred = case.tensor(&case.pred, DType::F32);
        let columns = pred.t().unwrap().contiguous().unwrap();
        let padded = Tensor::cat(&[&pred, &pred], 0).unwrap().narrow(0, ROWS, ROWS).unwrap();
        let (value, gradient) = case.at(&pred);
        for view in [&columns.t().unwrap(), &padded] {
            assert_eq!(number(&(case.loss)(view).unwrap().unwrap()), value, "{}", case.name);
        }
        let var = Var::from_tensor(&columns).unwrap();
        let grads = (case.loss)(&var.t().unwrap()).unwrap().unwrap().backward().unwrap();
        assert_eq!(wide(&grads.get(&var).unwrap().t().unwrap()), gradient, "{}", case.name);
    }
}
