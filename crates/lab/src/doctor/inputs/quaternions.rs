//! Rotations: what has a direction keeps it, whatever its norm; what has none is named.

use super::files::{BAD, ROWS, check_quats, columns, little, open_legal, open_repaired, with};
use super::input;
use crate::doctor::case::{Case, Finding, Policy};
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::value_policy::Rule;

/// Half a unit in the last place of a component of a unit quaternion, and the rounding of the norm.
const COMPONENT: f64 = 1.2e-7;

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

const ROTATIONS: [(&str, [f32; 4], Fate, &str); 10] = [
    (
        "w-zero",
        [0.0, 0.0, -1.0, 0.0],
        Mentioned(Rule::QuatHalfTurn),
        "open_questions B 22: the original multiplies by the sign of w, 0 for a half turn, and \
         scipy raises",
    ),
    (
        "w-minus-zero",
        [-0.0, 0.6, 0.0, 0.8],
        Mentioned(Rule::QuatHalfTurn),
        "open_questions B 22, with the sign bit set",
    ),
    (
        "w-negative",
        [-0.5, 0.5, -0.5, 0.5],
        Legal,
        "demands 2a, level 2: continuity of the sign rule",
    ),
    (
        "norm-3",
        [0.0, 3.0, 0.0, 0.0],
        Mentioned(Rule::QuatNotUnit),
        "3DGS writes quaternions before normalisation",
    ),
    (
        "norm-1e-30",
        [6e-31, 0.0, 8e-31, 0.0],
        Mentioned(Rule::QuatNotUnit),
        "demands 2a, level 1: norm 1e-30; the square underflows in f32",
    ),
    (
        "norm-1e30",
        [8e30, 0.0, 0.0, -6e30],
        Mentioned(Rule::QuatNotUnit),
        "demands 2a, level 1: norm 1e30; the square overflows in f32",
    ),
    (
        "denormal",
        [0.0, 0.0, 1e-42, 0.0],
        Mentioned(Rule::QuatNotUnit),
        "demands 2a, level 1: denormals",
    ),
    ("max", [f32::MAX; 4], Mentioned(Rule::QuatNotUnit), "demands 2a, level 1: f32::MAX"),
    ("zero", [0.0; 4], Repaired(Rule::QuatZero), "demands 2a, level 1: zero quaternion"),
    ("minus-zero", [-0.0; 4], Repaired(Rule::QuatZero), "demands 2a, level 1: zero quaternion, ±0"),
];

pub(super) fn cases() -> Vec<Case> {
    let case = |(name, quat, fate, origin)| {
        let policy = if matches!(fate, Repaired(_)) { Policy::Repaired } else { Policy::Exact };
        let reason = "one rounding to f32 of a component of at most 1, after a norm in f64";
        input(format!("ply-quat-{name}"), origin, move |t| check(t, quat, fate))
            .within(COMPONENT, reason)
            .expects(policy)
    };
    ROTATIONS.map(case).into()
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
