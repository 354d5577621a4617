//! Losses with their gradients: the formula in f64, and differences of it.

use super::compare::{Wide, compare, gradient};
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::noise;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, ensure};
use candle_core::{DType, Device, Tensor, Var};
use scenesplat_losses::{
    ClassHalves, Reduction, aggregated_contrastive, cosine, cross_entropy, l2, lovasz_softmax,
    smooth_l1,
};

/// Channels, or classes.
pub(super) const D: usize = 5;
/// Rows.
pub(super) const N: usize = 24;
/// Where the smooth L1 loss bends.
const BETA: f64 = 0.3;
/// Temperature of the contrastive loss.
pub(super) const TAU: f64 = 0.2;

/// A loss, and its formula in f64 without any care for range.
pub(super) struct Formula {
    pub(super) name: &'static str,
    pub(super) run: fn(&Tensor, &Problem) -> candle_core::Result<Option<Tensor>>,
    formula: fn(&[f64], &Problem) -> f64,
}

/// What a loss is asked about.
pub(super) struct Problem {
    pub(super) pred: Vec<f64>,
    pub(super) target: Vec<f64>,
    label: Vec<i32>,
    valid: Vec<bool>,
    pub(super) halves: Vec<ClassHalves>,
}

impl Problem {
    pub(super) fn of(size: f32) -> Self {
        let wide = |v: Vec<f32>| v.into_iter().map(f64::from).collect();
        let rows = |class: usize, half: usize| {
            (0..N as u32).filter(|r| *r as usize % 6 == 2 * class + half).collect()
        };
        let halves = |label| ClassHalves {
            label: label as i32,
            first: rows(label, 0),
            second: rows(label, 1),
        };
        Self {
            pred: wide(noise(N * D, 1, size)),
            target: wide(noise(N * D, 2, size)),
            label: (0..N as i32).map(|i| i % 6 - 1).collect(),
            valid: (0..N).map(|i| i % 7 != 3).collect(),
            halves: (0..3).map(halves).collect(),
        }
    }

    fn target(&self, like: &Tensor) -> candle_core::Result<Tensor> {
        matrix(&self.target, like.dtype())
    }

    /// Rows of prediction and target that count.
    fn rows<'a>(&'a self, pred: &'a [f64]) -> impl Iterator<Item = (&'a [f64], &'a [f64])> {
        let rows = pred.chunks_exact(D).zip(self.target.chunks_exact(D)).zip(&self.valid);
        rows.filter(|(_, valid)| **valid).map(|(pair, _)| pair)
    }
}

pub(super) fn matrix(values: &[f64], dtype: DType) -> candle_core::Result<Tensor> {
    Tensor::from_vec(values.to_vec(), (values.len() / D, D), &Device::Cpu)?.to_dtype(dtype)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn mean(costs: impl Iterator<Item = f64>) -> f64 {
    let costs: Vec<f64> = costs.collect();
    costs.iter().sum::<f64>() / f64::from(costs.len() as u32)
}

fn log_softmax(z: &[f64]) -> Vec<f64> {
    let largest = z.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum = largest + z.iter().map(|z| (z - largest).exp()).sum::<f64>().ln();
    z.iter().map(|z| z - sum).collect()
}

pub(super) const FORMULAS: &[Formula] = &[
    Formula {
        name: "cosine",
        run: |p, q| cosine(p, &q.target(p)?, Some(&q.valid), Reduction::Mean),
        formula: |p, q| {
            mean(q.rows(p).map(|(p, t)| 1.0 - dot(p, t) / dot(p, p).sqrt() / dot(t, t).sqrt()))
        },
    },
    Formula {
        name: "l2",
        run: |p, q| l2(p, &q.target(p)?, Some(&q.valid), Reduction::Mean),
        formula: |p, q| {
            mean(q.rows(p).map(|(p, t)| p.iter().zip(t).map(|(p, t)| (p - t).powi(2)).sum()))
        },
    },
    Formula {
        name: "smooth-l1",
        run: |p, q| smooth_l1(p, &q.target(p)?, Some(&q.valid), BETA, Reduction::Mean),
        formula: |p, q| {
            let cost = |x: f64| if x < BETA { x * x / 2.0 / BETA } else { x - BETA / 2.0 };
            mean(q.rows(p).map(|(p, t)| p.iter().zip(t).map(|(p, t)| cost((p - t).abs())).sum()))
        },
    },
    Formula {
        name: "cross-entropy",
        run: |p, q| cross_entropy(p, &q.label, 0.1, None),
        formula: |p, q| {
            let rows = p.chunks_exact(D).zip(&q.label).filter(|(_, label)| **label >= 0);
            mean(rows.map(|(z, label)| {
                let log_p = log_softmax(z);
                -0.9 * log_p[*label as usize] - 0.1 / D as f64 * log_p.iter().sum::<f64>()
            }))
        },
    },
    Formula { name: "lovasz", run: |p, q| lovasz_softmax(p, &q.label), formula: lovasz },
    Formula {
        name: "contrastive",
        run: |p, q| aggregated_contrastive(p, &q.halves, TAU, Reduction::Mean),
        formula: |p, q| contrastive(p, &q.halves, TAU),
    },
];

/// By the definition: differences of the Jaccard loss along the sorted errors.
fn lovasz(z: &[f64], problem: &Problem) -> f64 {
    let rows: Vec<(Vec<f64>, usize)> = z
        .chunks_exact(D)
        .zip(&problem.label)
        .filter(|(_, label)| **label >= 0)
        .map(|(z, label)| (log_softmax(z).iter().map(|v| v.exp()).collect(), *label as usize))
        .collect();
    let of_class = |class: usize| {
        let total = f64::from(rows.iter().filter(|(_, label)| *label == class).count() as u32);
        let mut errors: Vec<(f64, bool)> = rows
            .iter()
            .map(|(p, label)| {
                let own = *label == class;
                (if own { 1.0 - p[class] } else { p[class] }, own)
            })
            .collect();
        errors.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut hits, mut misses, mut before, mut loss) = (0.0, 0.0, 0.0, 0.0);
        for (error, own) in errors {
            *(if own { &mut hits } else { &mut misses }) += 1.0;
            let jaccard = 1.0 - (total - hits) / (total + misses);
            loss += error * (jaccard - before);
            before = jaccard;
        }
        (total > 0.0).then_some(loss)
    };
    mean((0..D).filter_map(of_class))
}

pub(super) fn contrastive(p: &[f64], classes: &[ClassHalves], tau: f64) -> f64 {
    let unit = |rows: &[u32]| -> Vec<f64> {
        let mut sum = vec![0.0; D];
        for row in rows {
            let row = &p[*row as usize * D..][..D];
            sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
        }
        let norm = dot(&sum, &sum).sqrt();
        sum.iter().map(|v| v / norm).collect()
    };
    let a: Vec<_> = classes.iter().map(|c| unit(&c.first)).collect();
    let b: Vec<_> = classes.iter().map(|c| unit(&c.second)).collect();
    let one_way = |a: &[Vec<f64>], b: &[Vec<f64>]| {
        mean(a.iter().enumerate().map(|(i, a)| {
            let logits: Vec<f64> = b.iter().map(|b| dot(a, b) / tau).collect();
            -log_softmax(&logits)[i]
        }))
    };
    0.5 * (one_way(&a, &b) + one_way(&b, &a))
}

/// Value and gradient; `None` where the loss is off.
pub(super) fn evaluate(
    pred: &Tensor,
    loss: impl FnOnce(&Tensor) -> candle_core::Result<Option<Tensor>>,
) -> Result<Option<(f64, Vec<f64>)>, Failure> {
    let var = Var::from_tensor(pred)?;
    let Some(value) = loss(var.as_tensor())? else { return Ok(None) };
    let grads = value.backward()?;
    let Some(gradient) = grads.get(&var) else {
        return Err(Failure("no gradient reaches the predictions".to_owned()));
    };
    let gradient = gradient.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
    Ok(Some((value.to_dtype(DType::F64)?.to_scalar()?, gradient)))
}

/// A loss that has to be on and finite.
pub(super) fn sound(
    pred: &Tensor,
    loss: impl FnOnce(&Tensor) -> candle_core::Result<Option<Tensor>>,
) -> Result<f64, Failure> {
    let Some((value, gradient)) = evaluate(pred, loss)? else {
        return Err(Failure("the loss is off".to_owned()));
    };
    let bad = gradient.iter().position(|g| !g.is_finite());
    ensure!(bad.is_none(), "gradient {bad:?} is not finite");
    Ok(value)
}

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for formula in FORMULAS {
        for dtype in [DType::F32, DType::BF16] {
            let name = format!("{}-{}", formula.name, dtype.as_str());
            cases.push(case(format!("loss-{name}"), move |_| value(formula, dtype)));
            cases.push(case(format!("gradient-{name}"), move |_| slope(formula, dtype)));
        }
    }
    cases
}

/// The problem, its predictions as the type stores them.
fn stored(dtype: DType) -> Result<(Problem, Tensor), Failure> {
    let mut problem = Problem::of(1.0);
    let pred = matrix(&problem.pred, dtype)?;
    problem.pred = pred.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
    problem.target = problem.target(&pred)?.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
    Ok((problem, pred))
}

fn value(formula: &Formula, dtype: DType) -> Result<Finding, Failure> {
    let (problem, pred) = stored(dtype)?;
    let got = sound(&pred, |p| (formula.run)(p, &problem))?;
    let want = (formula.formula)(&problem.pred, &problem);
    compare(&[got as f32], &[Wide::own(want)], |_| "the value".to_owned())
}

fn slope(formula: &Formula, dtype: DType) -> Result<Finding, Failure> {
    let (problem, pred) = stored(dtype)?;
    let Some((_, got)) = evaluate(&pred, |p| (formula.run)(p, &problem))? else {
        return Err(Failure("the loss is off".to_owned()));
    };
    let step = 1e-6;
    let want: Vec<f64> = (0..problem.pred.len())
        .map(|i| {
            let at = |h: f64| {
                let mut moved = problem.pred.clone();
                moved[i] += h;
                (formula.formula)(&moved, &problem)
            };
            (at(step) - at(-step)) / (2.0 * step)
        })
        .collect();
    gradient(&got, &want)
}
