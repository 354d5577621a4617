//! Applies the table to a scene as it came from its file.

use super::{Policy, RepairReport, Rule};
use crate::SceneError;
use crate::gaussian_scene::{GaussianScene, SH_C0};
use rayon::prelude::*;
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

/// Rows that are looked at together first: most blocks hold nothing to decide about.
const ROWS_PER_BLOCK: usize = 256;

/// Runs `check(row, values, tally)` over rows of `width` values, in parallel, but for blocks of which
/// `fine(first_row, values)` holds: there is nothing to change or to count in them.
fn scan<T: Send>(
    values: &mut [T],
    width: usize,
    report: &mut RepairReport,
    fine: impl Fn(usize, &[T]) -> bool + Sync,
    check: impl Fn(usize, &mut [T], &mut RepairReport) + Sync,
) {
    let tally = values
        .par_chunks_mut(ROWS_PER_TASK * width)
        .enumerate()
        .map(|(task, values)| {
            let mut tally = RepairReport::default();
            for (block, values) in values.chunks_mut(ROWS_PER_BLOCK * width).enumerate() {
                let first = task * ROWS_PER_TASK + block * ROWS_PER_BLOCK;
                if fine(first, values) {
                    continue;
                }
                for (i, row) in values.chunks_exact_mut(width).enumerate() {
                    check(first + i, row, &mut tally);
                }
            }
            tally
        })
        .reduce(RepairReport::default, |a, b| a.merge(&b));
    *report = std::mem::take(report).merge(&tally);
}

/// Whether every value is finite; without branches, so that many are tested at once.
fn all_finite(values: &[f32]) -> bool {
    const EXPONENT: u32 = 0x7f80_0000;
    let bad =
        values.iter().fold(0u32, |bad, v| bad | u32::from(v.to_bits() & EXPONENT == EXPONENT));
    bad == 0
}

/// Whether every quaternion has norm 1 and w above 0.
fn all_unit(quats: &[[f32; 4]]) -> bool {
    let bad = quats.iter().fold(false, |bad, q| {
        let squared: f64 = q.iter().map(|&v| f64::from(v) * f64::from(v)).sum();
        // Written so that NaN is bad.
        let unit = (squared - 1.0).abs() <= UNIT_TOLERANCE;
        bad | !(unit & (q[0] > 0.0))
    });
    !bad
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
    // Fits: the number of rows was checked above.
    let rows = (0..scene.len() as u32).filter(|&row| usable[row as usize]).collect();
    scene.retain_rows(&usable);
    Ok((scene, Some(rows)))
}

/// Which rows have a position, a size and an opacity.
fn find_usable_rows(scene: &mut GaussianScene, report: &mut RepairReport) -> Vec<bool> {
    let (coord, scale, opacity) = (&scene.coord, &scene.log_scale, &scene.opacity_logit);
    let mut usable = vec![true; coord.len()];
    let fine = |first: usize, ok: &[bool]| {
        let rows = first..first + ok.len();
        all_finite(coord[rows.clone()].as_flattened())
            && all_finite(scale[rows.clone()].as_flattened())
            && all_finite(&opacity[rows])
    };
    scan(&mut usable, 1, report, fine, |row, ok, tally| {
        if let Some(bad) = coord[row].iter().find(|v| !v.is_finite()) {
            tally.add_row(Rule::CoordNotFinite, row, || bad.to_string());
            ok[0] = false;
        }
        if scale[row].iter().any(|v| v.is_nan()) {
            tally.add_row(Rule::ScaleNan, row, || format!("{:?}", scale[row]));
            ok[0] = false;
        } else if scale[row].contains(&f32::INFINITY) {
            tally.add_row(Rule::ScaleInfinite, row, || format!("{:?}", scale[row]));
            ok[0] = false;
        } else if scale[row].contains(&f32::NEG_INFINITY) {
            tally.add_row(Rule::ScaleZero, row, || format!("{:?}", scale[row]));
        }
        if opacity[row].is_nan() {
            tally.add_row(Rule::OpacityNan, row, || "NaN".to_owned());
            ok[0] = false;
        } else if opacity[row].is_infinite() {
            tally.add_row(Rule::OpacityInfinite, row, || opacity[row].to_string());
        }
    });
    usable
}

fn repair_values(scene: &mut GaussianScene, report: &mut RepairReport) {
    repair_quats(&mut scene.quat, report);
    repair_colors(&mut scene.sh_dc, report);
    repair_rest(scene, report);
    if scene.normal.as_ref().is_some_and(|n| n.par_iter().all(|n| n == &[0.0; 3])) {
        report.add(Rule::NormalAllZero, scene.len(), 0, "[0.0, 0.0, 0.0]");
        scene.normal = None;
    }
    if let Some(normal) = &mut scene.normal {
        repair_normals(normal, report);
    }
    if let Some(score) = &mut scene.segment_score {
        // Infinite ones may be meant so; only NaN says nothing.
        let fine = |_, values: &[f32]| all_finite(values);
        scan(score, 1, report, fine, |row, score, tally| {
            if score[0].is_nan() {
                tally.add_row(Rule::ScoreNan, row, || "NaN".to_owned());
                score[0] = 0.0;
            }
        });
    }
    repair_features(scene, report);
}

fn repair_quats(quats: &mut [[f32; 4]], report: &mut RepairReport) {
    let fine = |_, quats: &[[f32; 4]]| all_unit(quats);
    scan(quats, 1, report, fine, |row, quat, tally| {
        let quat = &mut quat[0];
        let before = *quat;
        let example = || format!("{before:?}");
        let (rule, new) = match unit(before) {
            Ok((new, norm)) if (norm - 1.0).abs() > REPORTED_NORM_ERROR => {
                (Some(Rule::QuatNotUnit), new)
            }
            Ok((new, _)) => (None, new),
            Err(NoDirection::Zero) => (Some(Rule::QuatZero), [1.0, 0.0, 0.0, 0.0]),
            Err(NoDirection::NotFinite) => (Some(Rule::QuatNotFinite), [1.0, 0.0, 0.0, 0.0]),
        };
        if let Some(rule) = rule {
            tally.add_row(rule, row, example);
        }
        *quat = new;
        if quat[0] == 0.0 {
            tally.add_row(Rule::QuatHalfTurn, row, example);
        }
        if quat[0] < 0.0 {
            // The same rotation.
            *quat = quat.map(|v| -v);
        }
    });
}

fn repair_colors(sh_dc: &mut [[f32; 3]], report: &mut RepairReport) {
    let saturated = 0.5 / SH_C0;
    let fine = |_, dc: &[[f32; 3]]| all_finite(dc.as_flattened());
    scan(sh_dc, 1, report, fine, |row, dc, tally| {
        let before = dc[0];
        let example = || format!("{before:?}");
        if before.iter().any(|v| v.is_nan()) {
            tally.add_row(Rule::ColorNan, row, example);
        }
        if before.iter().any(|v| v.is_infinite()) {
            tally.add_row(Rule::ColorInfinite, row, example);
        }
        dc[0] = before.map(|v| match v {
            v if v.is_nan() => 0.0,
            v if v.is_infinite() => saturated.copysign(v),
            v => v,
        });
    });
}

fn repair_rest(scene: &mut GaussianScene, report: &mut RepairReport) {
    let rest = scene.sh_rest_len() * 3;
    if rest > 0 {
        let fine = |_, values: &[f32]| all_finite(values);
        scan(&mut scene.sh_rest, rest, report, fine, |row, values, tally| {
            if let Some(i) = values.iter().position(|v| !v.is_finite()) {
                let value = values[i];
                tally.add_row(Rule::RestNotFinite, row, || format!("{value} in coefficient {i}"));
                values.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = 0.0);
            }
        });
    }
}

fn repair_normals(normals: &mut [[f32; 3]], report: &mut RepairReport) {
    let fine = |_, _: &[[f32; 3]]| false;
    scan(normals, 1, report, fine, |row, normal, tally| {
        let before = normal[0];
        let (rule, new) = match unit(before) {
            Ok((new, norm)) if (norm - 1.0).abs() > REPORTED_NORM_ERROR => {
                (Some(Rule::NormalNotUnit), new)
            }
            Ok((new, _)) => (None, new),
            Err(NoDirection::Zero) => (None, [0.0; 3]),
            Err(NoDirection::NotFinite) => (Some(Rule::NormalNotFinite), [0.0; 3]),
        };
        if let Some(rule) = rule {
            tally.add_row(rule, row, || format!("{before:?}"));
        }
        normal[0] = new;
    });
}

fn repair_features(scene: &mut GaussianScene, report: &mut RepairReport) {
    let Some(feat) = scene.lang_feat.as_mut().filter(|feat| feat.dim > 0) else { return };
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
        if let Some(valid) = &mut scene.valid_feat_mask {
            valid[row] = false;
        }
    }
}

/// Why a vector cannot be divided by its norm.
pub(crate) enum NoDirection {
    Zero,
    NotFinite,
}

/// The vector divided by its norm, and the norm; computed in f64, so that no finite f32 over- or
/// underflows when squared.
pub(crate) fn unit<const W: usize>(vector: [f32; W]) -> Result<([f32; W], f64), NoDirection> {
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
