//! Applies the table to a scene as it came from its file.

use super::{Policy, RepairReport, Rule};
use crate::SceneError;
use crate::gaussian_scene::{GaussianScene, SH_C0};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// Rows that one task looks at.
const ROWS_PER_TASK: usize = 16_384;

/// How far the squared norm of a quaternion or normal may be from 1 to be left as it is.
///
/// A vector divided by its norm and rounded to f32 is off by at most 1.2e-7, so cleaning a second
/// time changes no bit.
const UNIT_TOLERANCE: f64 = 4e-7;

/// Norms further from 1 than this are reported; closer ones are rounding of the writer.
const REPORTED_NORM_ERROR: f64 = 1e-3;

/// Counts of rules, with the first row and its value.
#[derive(Default)]
struct Tally(BTreeMap<Rule, (usize, usize, String)>);

impl Tally {
    fn add(&mut self, rule: Rule, row: usize, value: impl FnOnce() -> String) {
        // Rows come in ascending order, so the first example is that of the first row.
        self.0.entry(rule).or_insert_with(|| (0, row, value())).0 += 1;
    }

    fn merge(mut self, other: Self) -> Self {
        for (rule, (count, row, value)) in other.0 {
            let entry = self.0.entry(rule).or_insert_with(|| (0, row, value.clone()));
            entry.0 += count;
            if row < entry.1 {
                (entry.1, entry.2) = (row, value);
            }
        }
        self
    }
}

/// Runs `check(row, values, tally)` over rows of `width` values, in parallel.
fn scan<T: Send>(
    values: &mut [T],
    width: usize,
    report: &mut RepairReport,
    check: impl Fn(usize, &mut [T], &mut Tally) + Sync,
) {
    let tally = values
        .par_chunks_mut(ROWS_PER_TASK * width)
        .enumerate()
        .map(|(task, values)| {
            let mut tally = Tally::default();
            for (i, row) in values.chunks_exact_mut(width).enumerate() {
                check(task * ROWS_PER_TASK + i, row, &mut tally);
            }
            tally
        })
        .reduce(Tally::default, Tally::merge);
    for (rule, (count, row, value)) in tally.0 {
        report.add(rule, count, row, &value);
    }
}

/// Repairs a scene by the table and drops the rows that cannot be repaired.
///
/// `scene` is as read: quaternions of any norm, normals possibly all zero. `report` may already hold
/// findings of the reader. Gives the rows that are left if any were dropped.
pub(crate) fn clean_scene(
    mut scene: GaussianScene,
    report: &mut RepairReport,
    policy: Policy,
    path: &Path,
) -> Result<(GaussianScene, Option<Vec<u32>>), SceneError> {
    scene.check_rows()?;
    report.source_rows = scene.len();
    if scene.is_empty() {
        return Err(SceneError::format(
            path,
            Rule::FileEmpty.about().bad_value,
            "export the scene again; an empty one cannot be used",
        ));
    }
    if u32::try_from(scene.len()).is_err() {
        let problem = format!("has {} rows, more than {}", scene.len(), u32::MAX);
        return Err(SceneError::format(path, problem, "split the scene"));
    }
    let usable = find_usable_rows(&mut scene, report);
    repair_values(&mut scene, report);
    report.dropped_rows = usable.iter().filter(|&&ok| !ok).count();
    report.enforce(policy, path)?;
    if report.dropped_rows == 0 {
        return Ok((scene, None));
    }
    if report.dropped_rows == scene.len() {
        let problem = format!("{}: {report}", Rule::FileAllDropped.about().bad_value);
        return Err(SceneError::format(path, problem, "export the scene again"));
    }
    let rows: Vec<usize> = (0..scene.len()).filter(|&row| usable[row]).collect();
    let scene = scene.select_rows(&rows)?;
    // Fits: the number of rows was checked above.
    Ok((scene, Some(rows.into_iter().map(|row| row as u32).collect())))
}

/// Which rows have a position, a size and an opacity.
fn find_usable_rows(scene: &mut GaussianScene, report: &mut RepairReport) -> Vec<bool> {
    let (coord, scale, opacity) = (&scene.coord, &scene.log_scale, &scene.opacity_logit);
    let mut usable = vec![true; coord.len()];
    scan(&mut usable, 1, report, |row, ok, tally| {
        if let Some(bad) = coord[row].iter().find(|v| !v.is_finite()) {
            tally.add(Rule::CoordNotFinite, row, || bad.to_string());
            ok[0] = false;
        }
        if scale[row].iter().any(|v| v.is_nan()) {
            tally.add(Rule::ScaleNan, row, || format!("{:?}", scale[row]));
            ok[0] = false;
        } else if scale[row].contains(&f32::INFINITY) {
            tally.add(Rule::ScaleInfinite, row, || format!("{:?}", scale[row]));
            ok[0] = false;
        } else if scale[row].contains(&f32::NEG_INFINITY) {
            tally.add(Rule::ScaleZero, row, || format!("{:?}", scale[row]));
        }
        if opacity[row].is_nan() {
            tally.add(Rule::OpacityNan, row, || "NaN".to_owned());
            ok[0] = false;
        } else if opacity[row].is_infinite() {
            tally.add(Rule::OpacityInfinite, row, || opacity[row].to_string());
        }
    });
    usable
}

fn repair_values(scene: &mut GaussianScene, report: &mut RepairReport) {
    scan(&mut scene.quat, 1, report, |row, quat, tally| {
        let quat = &mut quat[0];
        let before = *quat;
        let example = || format!("{before:?}");
        let rule = match unit(before) {
            Ok((_, norm)) if (norm - 1.0).abs() > REPORTED_NORM_ERROR => Some(Rule::QuatNotUnit),
            Ok(_) => None,
            Err(NoDirection::Zero) => Some(Rule::QuatZero),
            Err(NoDirection::NotFinite) => Some(Rule::QuatNotFinite),
        };
        if let Some(rule) = rule {
            tally.add(rule, row, example);
        }
        *quat = unit(before).map_or([1.0, 0.0, 0.0, 0.0], |(q, _)| q);
        if quat[0] == 0.0 {
            tally.add(Rule::QuatHalfTurn, row, example);
        }
        if quat[0] < 0.0 {
            // The same rotation.
            *quat = quat.map(|v| -v);
        }
    });
    let saturated = 0.5 / SH_C0;
    scan(&mut scene.sh_dc, 1, report, |row, dc, tally| {
        let before = dc[0];
        let example = || format!("{before:?}");
        if before.iter().any(|v| v.is_nan()) {
            tally.add(Rule::ColorNan, row, example);
        }
        if before.iter().any(|v| v.is_infinite()) {
            tally.add(Rule::ColorInfinite, row, example);
        }
        dc[0] = before.map(|v| match v {
            v if v.is_nan() => 0.0,
            v if v.is_infinite() => saturated.copysign(v),
            v => v,
        });
    });
    let rest = scene.sh_rest_len() * 3;
    if rest > 0 {
        scan(&mut scene.sh_rest, rest, report, |row, values, tally| {
            if let Some(i) = values.iter().position(|v| !v.is_finite()) {
                let value = values[i];
                tally.add(Rule::RestNotFinite, row, || format!("{value} in coefficient {i}"));
                values.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = 0.0);
            }
        });
    }
    if scene.normal.as_ref().is_some_and(|n| n.par_iter().all(|n| n == &[0.0; 3])) {
        report.add(Rule::NormalAllZero, scene.len(), 0, "[0.0, 0.0, 0.0]");
        scene.normal = None;
    }
    if let Some(normal) = &mut scene.normal {
        scan(normal, 1, report, |row, normal, tally| {
            let before = normal[0];
            normal[0] = match unit(before) {
                Ok((normal, norm)) => {
                    if (norm - 1.0).abs() > REPORTED_NORM_ERROR {
                        tally.add(Rule::NormalNotUnit, row, || format!("{before:?}"));
                    }
                    normal
                }
                Err(NoDirection::Zero) => [0.0; 3],
                Err(NoDirection::NotFinite) => {
                    tally.add(Rule::NormalNotFinite, row, || format!("{before:?}"));
                    [0.0; 3]
                }
            };
        });
    }
    if let Some(feat) = &mut scene.lang_feat
        && feat.dim > 0
    {
        let valid = &mut scene.valid_feat_mask;
        let mut bad = vec![false; feat.values.len() / feat.dim];
        let flags = bad.par_iter_mut().zip(feat.values.par_chunks_exact_mut(feat.dim));
        flags.for_each(|(bad, values)| {
            *bad = values.iter().any(|v| !v.is_finite());
            if *bad {
                values.fill(half::f16::ZERO);
            }
        });
        for row in (0..bad.len()).filter(|&row| bad[row]) {
            report.add(Rule::FeatureNotFinite, 1, row, "");
            if let Some(valid) = valid {
                valid[row] = false;
            }
        }
    }
}

enum NoDirection {
    Zero,
    NotFinite,
}

/// The vector divided by its norm, and the norm; computed in f64, so that no finite f32 over- or
/// underflows when squared.
fn unit<const W: usize>(vector: [f32; W]) -> Result<([f32; W], f64), NoDirection> {
    let squared: f64 = vector.iter().map(|&v| f64::from(v) * f64::from(v)).sum();
    if !squared.is_finite() {
        return Err(NoDirection::NotFinite);
    }
    if squared == 0.0 {
        return Err(NoDirection::Zero);
    }
    let norm = squared.sqrt();
    if (squared - 1.0).abs() <= UNIT_TOLERANCE {
        return Ok((vector, norm));
    }
    Ok((vector.map(|v| (f64::from(v) / norm) as f32), norm))
}

#[cfg(test)]
mod tests;
