//! Values, gradients and slow references for the tests.

use candle_core::{DType, Device, Result, Tensor, Var};
use scenesplat_losses::self_supervised::AttributeColumns;
use scenesplat_losses::{ClassHalves, IGNORE, LossInput};

/// Rounding to bf16, 2⁻⁹, adds up over the rows of a small mean to less than this.
pub const BF16_EPS: f64 = 2e-2;

/// Numbers in -1..1 without any pattern, the same everywhere.
pub fn noise(n: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x1234_5678;
    (0..n)
        .map(|_| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        })
        .collect()
}

pub fn matrix(values: &[f64], columns: usize, dtype: DType) -> Tensor {
    let rows = values.len() / columns;
    let wide = Tensor::from_vec(values.to_vec(), (rows, columns), &Device::Cpu).unwrap();
    wide.to_dtype(dtype).unwrap()
}

/// `[views, scenes, D]`
pub fn cube(values: &[f64], views: usize, scenes: usize, dtype: DType) -> Tensor {
    matrix(values, 1, dtype).reshape((views, scenes, values.len() / views / scenes)).unwrap()
}

/// Rows at unit length.
pub fn units(values: &[f64], width: usize) -> Vec<f64> {
    let unit = |row: &[f64]| {
        let norm = row.iter().map(|v| v * v).sum::<f64>().sqrt();
        row.iter().map(|v| v / norm).collect::<Vec<_>>()
    };
    values.chunks_exact(width).flat_map(unit).collect()
}

pub fn attribute(name: &str, columns: std::ops::Range<usize>) -> AttributeColumns {
    let name = name.to_owned();
    AttributeColumns { is_rotation: name == "quat", is_size: name == "scale", name, columns }
}

/// Attributes of rows of nine columns.
pub fn attributes() -> [AttributeColumns; 3] {
    [attribute("color", 0..2), attribute("quat", 2..6), attribute("scale", 6..9)]
}

pub fn wide(t: &Tensor) -> Vec<f64> {
    t.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

pub fn number(t: &Tensor) -> f64 {
    assert_eq!(t.rank(), 0, "a scalar");
    t.to_dtype(DType::F64).unwrap().to_scalar().unwrap()
}

/// Value and gradient of a loss of these predictions; `None` if it is off.
pub fn evaluate(
    pred: &Tensor,
    loss: impl FnOnce(&Tensor) -> Result<Option<Tensor>>,
) -> Result<Option<(f64, Vec<f64>)>> {
    let var = Var::from_tensor(pred)?;
    let Some(value) = loss(var.as_tensor())? else { return Ok(None) };
    let grads = value.backward()?;
    let gradient = grads.get(&var).expect("a gradient for the predictions");
    assert_eq!(gradient.dtype(), pred.dtype(), "type of the gradient");
    assert_eq!(gradient.dims(), pred.dims(), "shape of the gradient");
    let scalar = if pred.dtype() == DType::F64 { DType::F64 } else { DType::F32 };
    assert_eq!(value.dtype(), scalar, "type of the loss");
    Ok(Some((number(&value), wide(gradient))))
}

pub fn input<'a>(
    pred: &'a Tensor,
    target: Option<&'a Tensor>,
    label: Option<&'a [i32]>,
    valid: Option<&'a [bool]>,
) -> LossInput<'a> {
    LossInput { pred, target, label, valid, progress: 1.0, seed: 3 }
}

/// The losses from their formulas, in f64, for values that need no care.
pub mod reference {
    use super::*;

    fn dot(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    /// Mean of a cost of valid rows.
    fn mean(
        p: &[f64],
        t: &[f64],
        d: usize,
        valid: &[bool],
        cost: impl Fn(&[f64], &[f64]) -> f64,
    ) -> f64 {
        let rows = p.chunks_exact(d).zip(t.chunks_exact(d)).zip(valid).filter(|(_, v)| **v);
        let costs: Vec<f64> = rows.map(|((p, t), _)| cost(p, t)).collect();
        costs.iter().sum::<f64>() / costs.len() as f64
    }

    pub fn cosine(p: &[f64], t: &[f64], d: usize, valid: &[bool]) -> f64 {
        let norm = |v: &[f64]| dot(v, v).sqrt().max(1e-8);
        mean(p, t, d, valid, |p, t| 1.0 - dot(p, t) / norm(p) / norm(t))
    }

    pub fn l2(p: &[f64], t: &[f64], d: usize, valid: &[bool]) -> f64 {
        let square = |(p, t): (&f64, &f64)| (p - t) * (p - t);
        mean(p, t, d, valid, |p, t| p.iter().zip(t).map(square).sum())
    }

    pub fn smooth_l1(p: &[f64], t: &[f64], d: usize, valid: &[bool], beta: f64) -> f64 {
        let cost = |(p, t): (&f64, &f64)| match (p - t).abs() {
            near if near < beta => near * near / (2.0 * beta),
            far => far - beta / 2.0,
        };
        mean(p, t, d, valid, |p, t| p.iter().zip(t).map(cost).sum())
    }

    /// Products of rows with texts, by a temperature.
    pub fn logits(rows: &[f64], texts: &[f64], d: usize, temperature: f64) -> Vec<f64> {
        let of_row = |row| texts.chunks_exact(d).map(move |text| dot(row, text) / temperature);
        rows.chunks_exact(d).flat_map(of_row).collect()
    }

    /// Mean Kullback–Leibler divergence of softmaxes of logits `p` from those of `q`.
    pub fn divergence(p: &[f64], q: &[f64], classes: usize, valid: &[bool]) -> f64 {
        mean(p, q, classes, valid, |p, q| {
            let pairs = log_softmax(p).into_iter().zip(log_softmax(q));
            pairs.map(|(p, q)| q.exp() * (q - p)).sum()
        })
    }

    fn log_softmax(z: &[f64]) -> Vec<f64> {
        let largest = z.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let log_sum = largest + z.iter().map(|z| (z - largest).exp()).sum::<f64>().ln();
        z.iter().map(|z| z - log_sum).collect()
    }

    pub fn cross_entropy(
        z: &[f64],
        classes: usize,
        label: &[i32],
        smoothing: f64,
        weights: Option<&[f64]>,
    ) -> f64 {
        let weight = |c: usize| weights.map_or(1.0, |w| w[c]);
        let (mut total, mut weight_sum) = (0.0, 0.0);
        for (z, label) in z.chunks_exact(classes).zip(label) {
            if *label == IGNORE {
                continue;
            }
            let (log_p, y) = (log_softmax(z), *label as usize);
            let all: f64 = (0..classes).map(|c| -weight(c) * log_p[c]).sum();
            total += (1.0 - smoothing) * weight(y) * -log_p[y] + smoothing / classes as f64 * all;
            weight_sum += weight(y);
        }
        total / weight_sum
    }

    /// By the definition: differences of the Jaccard loss along the sorted errors.
    pub fn lovasz(z: &[f64], classes: usize, label: &[i32]) -> f64 {
        let rows: Vec<(Vec<f64>, usize)> = z
            .chunks_exact(classes)
            .zip(label)
            .filter(|(_, l)| **l != IGNORE)
            .map(|(z, l)| (log_softmax(z).iter().map(|v| v.exp()).collect(), *l as usize))
            .collect();
        let mut losses = Vec::new();
        for c in 0..classes {
            let total = rows.iter().filter(|(_, l)| *l == c).count() as f64;
            if total == 0.0 {
                continue;
            }
            let mut errors: Vec<(f64, bool)> = rows
                .iter()
                .map(|(p, l)| ((f64::from(u8::from(*l == c)) - p[c]).abs(), *l == c))
                .collect();
            errors.sort_by(|a, b| b.0.total_cmp(&a.0));
            let (mut hits, mut misses, mut before, mut loss) = (0.0, 0.0, 0.0, 0.0);
            for (error, own) in errors {
                if own {
                    hits += 1.0;
                } else {
                    misses += 1.0;
                }
                let jaccard = 1.0 - (total - hits) / (total + misses);
                loss += error * (jaccard - before);
                before = jaccard;
            }
            losses.push(loss);
        }
        losses.iter().sum::<f64>() / losses.len() as f64
    }

    pub fn contrastive(p: &[f64], d: usize, classes: &[ClassHalves], temperature: f64) -> f64 {
        let unit = |rows: &[u32]| -> Vec<f64> {
            let mut sum = vec![0.0; d];
            for row in rows {
                let row = &p[*row as usize * d..][..d];
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
            }
            let norm = dot(&sum, &sum).sqrt().max(1e-12);
            sum.iter().map(|v| v / norm).collect()
        };
        let a: Vec<_> = classes.iter().map(|c| unit(&c.first)).collect();
        let b: Vec<_> = classes.iter().map(|c| unit(&c.second)).collect();
        let one_way = |a: &[Vec<f64>], b: &[Vec<f64>]| -> f64 {
            let cost = |(i, a): (usize, &Vec<f64>)| {
                let logits: Vec<f64> = b.iter().map(|b| dot(a, b) / temperature).collect();
                -log_softmax(&logits)[i]
            };
            a.iter().enumerate().map(cost).sum::<f64>() / a.len() as f64
        };
        0.5 * (one_way(&a, &b) + one_way(&b, &a))
    }
}
