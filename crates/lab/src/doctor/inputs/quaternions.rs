//! Rotations: what has a direction keeps it, whatever its norm; what has none is named.

use super::files::{BAD, ROWS, check_quats, columns, little, open_legal, open_repaired, with};
use crate::doctor::case::{Case, Finding};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::value_policy::Rule;

/// What is said of a rotation.
#[derive(Clone, Copy)]
enum Fate {
    /// Nothing: it is legal.
    Legal,
    /// It is legal, and mentioned by a rule.
    Mentioned(Rule),
    /// A rule repairs it to no rotation.
    Repaired(Rule),
}
use Fate::{Legal, Mentioned, Repaired};

const ROTATIONS: [(&str, [f32; 4], Fate); 10] = [
    ("w-zero", [0.0, 0.0, -1.0, 0.0], Mentioned(Rule::QuatHalfTurn)),
    ("w-minus-zero", [-0.0, 0.6, 0.0, 0.8], Mentioned(Rule::QuatHalfTurn)),
    ("w-negative", [-0.5, 0.5, -0.5, 0.5], Legal),
    ("norm-3", [0.0, 3.0, 0.0, 0.0], Mentioned(Rule::QuatNotUnit)),
    ("norm-1e-30", [6e-31, 0.0, 8e-31, 0.0], Mentioned(Rule::QuatNotUnit)),
    ("norm-1e30", [8e30, 0.0, 0.0, -6e30], Mentioned(Rule::QuatNotUnit)),
    ("denormal", [0.0, 0.0, 1e-42, 0.0], Mentioned(Rule::QuatNotUnit)),
    ("max", [f32::MAX; 4], Mentioned(Rule::QuatNotUnit)),
    ("zero", [0.0; 4], Repaired(Rule::QuatZero)),
    ("minus-zero", [-0.0; 4], Repaired(Rule::QuatZero)),
];

pub(super) fn cases() -> Vec<Case> {
    let rotation =
        |(name, quat, fate)| case(format!("ply-quat-{name}"), move |t| check(t, quat, fate));
    ROTATIONS.map(rotation).into()
}

fn check(trial: &Trial<'_>, quat: [f32; 4], fate: Fate) -> Result<Finding, Failure> {
    let turned = |columns, (i, v): (usize, &f32)| with(columns, &format!("rot_{i}"), BAD, *v);
    let columns = quat.iter().enumerate().fold(columns(ROWS), turned);
    let path = trial.file("scene.ply", &little(&columns))?;
    let (loaded, want) = match fate {
        Repaired(rule) => (open_repaired(&path, rule, BAD)?, [1.0, 0.0, 0.0, 0.0]),
        _ => (open_legal(&path)?, unit(quat)),
    };
    ensure!(loaded.scene.len() == ROWS, "{} Gaussians of {ROWS}", loaded.scene.len());
    if let Mentioned(rule) = fate {
        ensure!(loaded.report.count(rule) == 1, "{rule:?} is not mentioned: {}", loaded.report);
    }
    check_quats(&loaded.scene)?;
    let got = loaded.scene.quat[BAD];
    let error = |sign: f64| {
        let apart = got.iter().zip(want).map(|(g, w)| (f64::from(*g) - sign * w).abs());
        apart.fold(0.0, f64::max)
    };
    // Both signs are the same half turn.
    let error = if want[0] == 0.0 { error(1.0).min(error(-1.0)) } else { error(1.0) };
    Ok(Finding::of(error, format!("{quat:?} became {got:?}")))
}

/// The direction with a real part of at least 0.
fn unit(quat: [f32; 4]) -> [f64; 4] {
    let largest = quat.iter().fold(0.0, |m: f64, v| m.max(f64::from(*v).abs()));
    let scaled = quat.map(|v| f64::from(v) / largest);
    let norm = scaled.iter().map(|v| v * v).sum::<f64>().sqrt();
    let sign = if scaled[0] < 0.0 { -1.0 } else { 1.0 };
    scaled.map(|v| sign * v / norm)
}
