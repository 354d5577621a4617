//! Losses of rows that do not count, of huge logits, of one class, of labels that are none.

use super::losses::{D, FORMULAS, N, Problem, TAU, contrastive, evaluate, matrix, sound};
use crate::doctor::case::{Case, Finding};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use candle_core::{DType, Device, Tensor};
use scenesplat_losses::{
    AggregatedContrastive, ClassHalves, CosineLoss, CrossEntropy, L2Loss, Loss, LossInput,
    LovaszSoftmax, Reduction, SmoothL1Loss, TermSchedule, aggregated_contrastive, cosine,
    cross_entropy, lovasz_softmax,
};

/// All losses as an objective has them.
fn all() -> [Box<dyn Loss>; 6] {
    let contrastive = AggregatedContrastive {
        schedule: TermSchedule::Always,
        min_points: 2,
        ..AggregatedContrastive::default()
    };
    [
        Box::new(CosineLoss::default()),
        Box::new(L2Loss::default()),
        Box::new(SmoothL1Loss::default()),
        Box::new(contrastive),
        Box::new(CrossEntropy::default()),
        Box::new(LovaszSoftmax),
    ]
}

fn input<'a>(
    pred: &'a Tensor,
    target: &'a Tensor,
    label: &'a [i32],
    valid: &'a [bool],
) -> LossInput<'a> {
    LossInput {
        pred,
        target: Some(target),
        label: Some(label),
        valid: Some(valid),
        progress: 1.0,
        seed: 3,
    }
}

/// Rows of one value each: name, values of prediction and target, their cosine loss.
const COSINES: [(&str, f64, f64, f64); 3] = [
    ("of-zero", 0.0, 1.0, 1.0),
    ("of-equal-rows", 0.3, 0.6, 0.0),
    ("of-opposite-rows", 2.0, -3.0, 2.0),
];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = vec![
        case("loss-without-a-row-that-counts", no_row),
        case("loss-of-a-nan-names-its-row", nan_is_named),
        case("loss-of-huge-logits", huge_logits),
        case("contrastive-of-one-class", few_classes),
        case("contrastive-of-identical-classes", |_| {
            let problem = Problem::of(1.0);
            let pred = matrix(&problem.pred[..D].repeat(N), DType::F32)?;
            let run = |p: &Tensor| aggregated_contrastive(p, &problem.halves, TAU, Reduction::Mean);
            let value = sound(&pred, run)?;
            ensure!((value - 3f64.ln()).abs() < 1e-5, "{value}, ln 3 is right");
            Ok(())
        }),
        case("contrastive-at-tau-1e-4", temperatures),
        case("losses-of-huge-and-tiny-features", sizes),
        case("classes-without-a-label", |_| {
            let pred = matrix(&Problem::of(1.0).pred, DType::F32)?;
            let label = vec![0; N];
            let none = cross_entropy(&pred, &label, 0.0, Some(&[0.0, 1.0, 1.0, 1.0, 1.0]))?;
            ensure!(none.is_none(), "labels without weight have a loss");
            sound(&pred, |p| lovasz_softmax(p, &label))?;
            Ok(())
        }),
        case("labels-that-are-no-class", no_class),
    ];
    cases.extend(COSINES.map(|(name, p, t, want)| {
        case(format!("cosine-{name}"), move |_| {
            let (pred, target) = (matrix(&[p; D], DType::F32)?, matrix(&[t; D], DType::F32)?);
            let value = sound(&pred, |p| cosine(p, &target, None, Reduction::Mean))?;
            Ok(Finding::of((value - want).abs(), format!("{value}, {want} is right")))
        })
    }));
    cases
}

fn no_row(_: &Trial<'_>) -> Result<(), Failure> {
    for rows in [0, 1, 7] {
        let nothing = Tensor::full(f32::NAN, (rows, D), &Device::Cpu)?;
        let (label, valid) = (vec![-1; rows], vec![false; rows]);
        for loss in all() {
            let value = loss.forward(&input(&nothing, &nothing, &label, &valid))?;
            ensure!(value.is_none(), "{} of {rows} rows that do not count is on", loss.name());
        }
    }
    Ok(())
}

fn nan_is_named(_: &Trial<'_>) -> Result<(), Failure> {
    let target = matrix(&Problem::of(1.0).target, DType::F32)?;
    let mut pred = Problem::of(1.0).pred;
    pred[8 * D + 2] = f64::NAN;
    let pred = matrix(&pred, DType::F32)?;
    let label: Vec<i32> = (0..N as i32).map(|i| i % 2).collect();
    for loss in all() {
        let Err(e) = loss.forward(&input(&pred, &target, &label, &[true; N])) else {
            return Err(Failure(format!("{} takes a NaN", loss.name())));
        };
        ensure!(e.to_string().contains("pred[8, 2]"), "{}: {e}", loss.name());
    }
    Ok(())
}

fn huge_logits(_: &Trial<'_>) -> Result<(), Failure> {
    for size in [1e4, 3e38] {
        let mut logits: Vec<f64> = Problem::of(1.0).pred.iter().map(|v| v * size).collect();
        (logits[0], logits[1]) = (size, -size);
        let label: Vec<i32> = (0..N as i32).map(|i| i % 3).collect();
        let pred = matrix(&logits, DType::F32)?;
        let lovasz = sound(&pred, |p| lovasz_softmax(p, &label))?;
        ensure!((0.0..=1.0).contains(&lovasz), "Lovász of logits of {size:e} is {lovasz}");
        let found = evaluate(&pred, |p| cross_entropy(p, &label, 0.1, None))?;
        let right =
            |(value, slope): (f64, Vec<f64>)| value > 0.0 && slope.iter().all(|g| g.abs() <= 1.0);
        ensure!(found.is_some_and(right), "cross entropy of logits of {size:e}");
    }
    Ok(())
}

fn few_classes(_: &Trial<'_>) -> Result<(), Failure> {
    let problem = Problem::of(1.0);
    let pred = matrix(&problem.pred, DType::F32)?;
    let of = |classes: &[ClassHalves]| {
        evaluate(&pred, |p| aggregated_contrastive(p, classes, TAU, Reduction::Mean))
    };
    ensure!(of(&[])?.is_none(), "no class has a loss");
    let one = of(&problem.halves[..1])?;
    ensure!(one.as_ref().is_some_and(|(v, _)| *v == 0.0), "one class alone: {one:?}");
    ensure!(of(&problem.halves[..2])?.is_some_and(|(v, _)| v > 0.0), "two classes");
    Ok(())
}

fn temperatures(_: &Trial<'_>) -> Result<(), Failure> {
    let problem = Problem::of(1.0);
    let pred = matrix(&problem.pred, DType::F32)?;
    for tau in [1.0, 1e-2, 1e-4] {
        let run = |p: &Tensor| aggregated_contrastive(p, &problem.halves, tau, Reduction::Mean);
        let value = sound(&pred, run)?;
        let want = contrastive(&problem.pred, &problem.halves, tau);
        // Logits of 1/τ, each a product of unit rows in f32.
        let allowed = 1e-5 * want.abs().max(1.0) + 2e-7 / tau;
        ensure!((value - want).abs() <= allowed, "τ = {tau}: {value}, {want} is right");
    }
    Ok(())
}

fn sizes(_: &Trial<'_>) -> Result<(), Failure> {
    for size in [1e-30f32, 1e-12, 1e15, 3e38] {
        let problem = Problem::of(size);
        let pred = matrix(&problem.pred, DType::F32)?;
        for formula in FORMULAS.iter().filter(|f| !["lovasz", "cross-entropy"].contains(&f.name)) {
            let Some((value, slope)) = evaluate(&pred, |p| (formula.run)(p, &problem))? else {
                return Err(Failure(format!("{} of size {size:e} is off", formula.name)));
            };
            ensure!(!value.is_nan(), "{} of size {size:e} is NaN", formula.name);
            let finite = slope.iter().all(|g| g.is_finite());
            ensure!(finite, "gradient of {} of size {size:e}", formula.name);
        }
    }
    Ok(())
}

fn no_class(_: &Trial<'_>) -> Result<(), Failure> {
    let pred = matrix(&Problem::of(1.0).pred, DType::F32)?;
    for bad in [D as i32, -2, i32::MAX, i32::MIN] {
        let mut label = vec![0; N];
        label[4] = bad;
        for error in [cross_entropy(&pred, &label, 0.0, None), lovasz_softmax(&pred, &label)] {
            let named = error.is_err_and(|e| e.to_string().contains("label[4]"));
            ensure!(named, "label {bad} is taken, or not named");
        }
    }
    Ok(())
}
