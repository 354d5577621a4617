//! Masked Gaussian modeling: what a hidden Gaussian looks like.

use super::stored::stored_loss;
use crate::error::{LossError, check_len};
use crate::rows::check_target;
use crate::values::read_matrix;
use candle_core::{Result, Tensor};
use serde::{Deserialize, Serialize};
use std::ops::Range;

const NAME: &str = "masked_gaussians";
/// Where the smooth absolute difference turns from a square into a line.
const BETA: f64 = 0.1;
/// Norms of quaternions below this count as this.
const EPS: f64 = 1e-8;

/// How far a predicted attribute is from the true one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GaussianDistance {
    /// Mean square over all channels, as the original. A quaternion and its negative, which are one
    /// rotation, are as far apart as can be.
    #[default]
    MeanSquare,
    /// What fits each attribute, each with the same weight: a smooth absolute difference (β = 0.1),
    /// mean over its channels, for color, opacity and log-scale; for rotations `1 − ⟨q̂, q⟩²`, the
    /// squared sine of half of the angle between them, the same for both signs.
    Fitted,
    /// As `Fitted`, but the same for all 24 ways to write an ellipsoid as sizes and a rotation. Log-sizes are compared
    /// from the largest to the smallest, whatever axes they stand at, and axes as lines: the sum of the squared sine
    /// between the shortest axes, weighted by `1 − smallest / middle` size, and that between the longest, weighted by
    /// `1 − middle / largest`, as the normal of a ball or the direction of a disc is nobody's to know. Predictions
    /// follow one way of writing: first axis longest, third shortest. Needs rotations and sizes.
    Ellipsoid,
}

/// Which columns of the input an attribute has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttributeColumns {
    /// Name for logs: `color`, `opacity`, `quat`, `scale`, …
    pub name: String,
    /// Its columns.
    pub columns: Range<usize>,
    /// Whether they are a quaternion.
    pub is_rotation: bool,
    /// Whether they are the sizes along a Gaussian's axes; logarithms but for `MeanSquare`.
    pub is_size: bool,
}

/// Distance of predicted attributes from what masked Gaussians are: the mean over rows that count, and
/// of each attribute alone (for `MeanSquare` its mean over rows and channels). `None` if none counts.
///
/// # Shapes
/// `pred`, `target`: `[N, C]`, C the columns of all attributes; the target gets no gradient · `counts`:
/// `[N]` · second: one number for each attribute
///
/// # Errors
/// If shapes do not fit, attributes do not cover the columns once each, a rotation has not four, or a
/// value of a row that counts is not finite. A target rotation of zeros counts as none.
///
/// # Source
/// The original's `mae` term is `MeanSquare` over color, opacity, quaternion and scale. Where files spell orientations
/// at random, nobody can tell a rotation or which axis is long: the mean over all spellings of a quaternion's outer
/// product is that of no rotation at all.
pub fn masked_gaussians(
    pred: &Tensor,
    target: &Tensor,
    counts: Option<&[bool]>,
    attributes: &[AttributeColumns],
    distance: GaussianDistance,
) -> Result<Option<(Tensor, Vec<f64>)>> {
    check_target(NAME, pred, target)?;
    let (rows, width) = pred.dims2()?;
    check_attributes(attributes, width)?;
    if let Some(counts) = counts {
        check_len(NAME, "counts", rows, counts.len())?;
    }
    let used: Vec<usize> = (0..rows).filter(|&row| counts.is_none_or(|c| c[row])).collect();
    if used.is_empty() || width == 0 {
        return Ok(None);
    }
    let ellipsoid = match distance {
        GaussianDistance::Ellipsoid => Some(ellipsoid_columns(attributes)?),
        _ => None,
    };
    let (p, t) = (read(pred, "pred", &used)?, read(target, "target", &used)?);
    let mut gradient = vec![0.0; rows * width];
    let mut sums = vec![0.0; attributes.len()];
    for (i, &row) in used.iter().enumerate() {
        let ellipsoid = ellipsoid.as_ref().map(|e| e.of(&t[i * width..(i + 1) * width]));
        for (attribute, sum) in attributes.iter().zip(&mut sums) {
            let at = i * width + attribute.columns.start..i * width + attribute.columns.end;
            let to = row * width + attribute.columns.start..row * width + attribute.columns.end;
            let (p, t, out) = (&p[at.clone()], &t[at], &mut gradient[to]);
            *sum += match (distance, &ellipsoid) {
                (GaussianDistance::MeanSquare, _) => squares(p, t, out),
                (_, Some(e)) if attribute.is_rotation => axes(p, e, out),
                (_, Some(e)) if attribute.is_size => smooth(p, &e.sizes, out),
                (_, None) if attribute.is_rotation => rotation(p, t, out),
                _ => smooth(p, t, out),
            };
        }
    }
    let count = used.len() as f64;
    // Of a mean over all channels each attribute has as much as it has channels.
    let share = match distance {
        GaussianDistance::MeanSquare => 1.0 / (count * width as f64),
        GaussianDistance::Fitted | GaussianDistance::Ellipsoid => 1.0 / count,
    };
    gradient.iter_mut().for_each(|g| *g *= share);
    let loss = stored_loss(NAME, pred, sums.iter().sum::<f64>() * share, gradient)?;
    let alone = |(sum, a): (f64, &AttributeColumns)| match distance {
        GaussianDistance::MeanSquare => sum / (count * a.columns.len() as f64),
        GaussianDistance::Fitted | GaussianDistance::Ellipsoid => sum / count,
    };
    Ok(Some((loss, sums.into_iter().zip(attributes).map(alone).collect())))
}

fn check_attributes(attributes: &[AttributeColumns], width: usize) -> Result<()> {
    let mut next = 0;
    for AttributeColumns { name, columns, is_rotation, .. } in attributes {
        let good =
            columns.start == next && columns.end > next && (!is_rotation || columns.len() == 4);
        if !good {
            let value = format!("{name} = {columns:?}");
            let expected = "columns that follow each other, four for a rotation";
            return Err(
                LossError::Setting { loss: NAME, setting: "attributes", value, expected }.into()
            );
        }
        next = columns.end;
    }
    if next == width {
        return Ok(());
    }
    let expected = format!("[N, {next}]");
    Err(LossError::Shape { loss: NAME, field: "pred", expected, got: format!("[N, {width}]") }
        .into())
}

/// Rows that count, as f64.
fn read(tensor: &Tensor, field: &'static str, used: &[usize]) -> Result<Vec<f64>> {
    read_matrix(NAME, field, tensor, |matrix| {
        let (mut out, mut scratch) = (Vec::with_capacity(used.len() * matrix.columns), Vec::new());
        for &row in used {
            out.extend_from_slice(matrix.read::<f64>(row..row + 1, &mut scratch));
            if let Some(error) = matrix.not_finite(NAME, field, row) {
                return Err(error.into());
            }
        }
        Ok(out)
    })
}

fn squares(p: &[f64], t: &[f64], gradient: &mut [f64]) -> f64 {
    let mut sum = 0.0;
    for ((p, t), g) in p.iter().zip(t).zip(gradient) {
        sum += (p - t) * (p - t);
        *g = 2.0 * (p - t);
    }
    sum
}

fn smooth(p: &[f64], t: &[f64], gradient: &mut [f64]) -> f64 {
    let channels = p.len() as f64;
    let mut sum = 0.0;
    for ((p, t), g) in p.iter().zip(t).zip(gradient) {
        let d = p - t;
        sum += if d.abs() < BETA { 0.5 * d * d / BETA } else { d.abs() - 0.5 * BETA };
        *g = (d / BETA).clamp(-1.0, 1.0) / channels;
    }
    sum / channels
}

/// Length of a quaternion; 0 for one of zeros.
fn length(q: &[f64]) -> f64 {
    let largest = q.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    if largest == 0.0 {
        return 0.0;
    }
    largest * q.iter().map(|v| (v / largest).powi(2)).sum::<f64>().sqrt()
}

fn rotation(p: &[f64], t: &[f64], gradient: &mut [f64]) -> f64 {
    let (p_length, t_length) = (length(p), length(t));
    if t_length == 0.0 {
        // No rotation: nothing to be right or wrong about.
        return 0.0;
    }
    let divisor = p_length.max(EPS);
    let cosine: f64 = p.iter().zip(t).map(|(p, t)| (p / divisor) * (t / t_length)).sum();
    // Below EPS the divisor is a constant.
    let along = if p_length > EPS { cosine } else { 0.0 };
    for ((p, t), g) in p.iter().zip(t).zip(gradient) {
        *g = -2.0 * cosine * (t / t_length - along * p / divisor) / divisor;
    }
    1.0 - cosine * cosine
}

/// Where an ellipsoid is written.
struct EllipsoidColumns {
    rotation: Range<usize>,
    sizes: Range<usize>,
}

fn ellipsoid_columns(attributes: &[AttributeColumns]) -> Result<EllipsoidColumns> {
    let find = |is: fn(&AttributeColumns) -> bool| attributes.iter().find(|a| is(a));
    match (find(|a| a.is_rotation), find(|a| a.is_size && a.columns.len() == 3)) {
        (Some(rotation), Some(sizes)) => Ok(EllipsoidColumns {
            rotation: rotation.columns.clone(),
            sizes: sizes.columns.clone(),
        }),
        _ => {
            let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
            let (value, expected) = (names.join(", "), "a rotation and three sizes");
            Err(LossError::Setting { loss: NAME, setting: "attributes", value, expected }.into())
        }
    }
}

/// An ellipsoid however it is written.
struct Ellipsoid {
    /// Log-sizes, the largest first.
    sizes: [f64; 3],
    /// The longest and the shortest axis with what each counts: 0 where another is as long, or there is no rotation.
    longest: ([f64; 3], f64),
    shortest: ([f64; 3], f64),
}

impl EllipsoidColumns {
    fn of(&self, row: &[f64]) -> Ellipsoid {
        let sizes = &row[self.sizes.clone()];
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| sizes[*b].total_cmp(&sizes[*a]));
        let sizes = order.map(|axis| sizes[axis]);
        let q = &row[self.rotation.clone()];
        let length = length(q);
        let columns = columns_of([q[0], q[1], q[2], q[3]].map(|v| v / length.max(EPS)));
        let there = if length > 0.0 { 1.0 } else { 0.0 };
        Ellipsoid {
            sizes,
            longest: (columns[order[0]], there * (1.0 - (sizes[1] - sizes[0]).exp())),
            shortest: (columns[order[2]], there * (1.0 - (sizes[2] - sizes[1]).exp())),
        }
    }
}

/// The axes of a rotation by a quaternion (w, x, y, z) of unit length: columns of its matrix.
fn columns_of([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Squared sines between the first predicted axis and the longest, the third and the shortest.
fn axes(p: &[f64], target: &Ellipsoid, gradient: &mut [f64]) -> f64 {
    let p_length = length(p);
    let divisor = p_length.max(EPS);
    let q = [p[0] / divisor, p[1] / divisor, p[2] / divisor, p[3] / divisor];
    let [w, x, y, z] = q;
    let [first, _, third] = columns_of(q);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let ((long, of_long), (short, of_short)) = (target.longest, target.shortest);
    let (cos_long, cos_short) = (dot(first, long), dot(third, short));
    // Of ⟨axis, c⟩ to the quaternion.
    let [a, b, c] = long;
    let d_long =
        [b * z - c * y, b * y + c * z, b * x - c * w - 2.0 * a * y, b * w + c * x - 2.0 * a * z];
    let [a, b, c] = short;
    let d_short =
        [a * y - b * x, a * z - b * w - 2.0 * c * x, a * w + b * z - 2.0 * c * y, a * x + b * y];
    let of = |i: usize| -4.0 * (of_long * cos_long * d_long[i] + of_short * cos_short * d_short[i]);
    let to_unit = [of(0), of(1), of(2), of(3)];
    // Below EPS the divisor is a constant.
    let along: f64 = match p_length > EPS {
        true => to_unit.iter().zip(q).map(|(d, q)| d * q).sum(),
        false => 0.0,
    };
    for (i, g) in gradient.iter_mut().enumerate() {
        *g = (to_unit[i] - along * q[i]) / divisor;
    }
    of_long * (1.0 - cos_long * cos_long) + of_short * (1.0 - cos_short * cos_short)
}
