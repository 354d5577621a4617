//! Rotations: what has a direction keeps it, whatever its norm; what has none is named.

use super::files::{BAD, ROWS, check_quats, columns, little, open_legal, open_repaired};
use crate::doctor::case::{Case, Finding, Level, Policy};
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::value_policy::Rule;

/// Half a unit in the last place of a component of a unit quaternion, and the rounding of the norm.
const COMPONENT: f64 = 1.2e-7;

struct Rotation {
    name: &'static str,
    quat: [f32; 4],
    origin: &'static str,
    /// The rule that repairs it to no rotation; legal otherwise.
    repaired: Option<Rule>,
    /// The rule that mentions it.
    mentioned: Option<Rule>,
}

const LEGAL: Rotation =
    Rotation { name: "", quat: [1.0, 0.0, 0.0, 0.0], origin: "", repaired: None, mentioned: None };

const ROTATIONS: &[Rotation] = &[
    Rotation {
        name: "w-zero",
        quat: [0.0, 0.0, -1.0, 0.0],
        origin: "open_questions B 22: the original multiplies by the sign of w, 0 for a half turn, and \
            scipy raises",
        mentioned: Some(Rule::QuatHalfTurn),
        ..LEGAL
    },
    Rotation {
        name: "w-minus-zero",
        quat: [-0.0, 0.6, 0.0, 0.8],
        origin: "open_questions B 22, with the sign bit set",
        mentioned: Some(Rule::QuatHalfTurn),
        ..LEGAL
    },
    Rotation {
        name: "w-negative",
        quat: [-0.5, 0.5, -0.5, 0.5],
        origin: "demands 2a, level 2: continuity of the sign rule",
        ..LEGAL
    },
    Rotation {
        name: "norm-3",
        quat: [0.0, 3.0, 0.0, 0.0],
        origin: "3DGS writes quaternions before normalisation",
        mentioned: Some(Rule::QuatNotUnit),
        ..LEGAL
    },
    Rotation {
        name: "norm-1e-30",
        quat: [6e-31, 0.0, 8e-31, 0.0],
        origin: "demands 2a, level 1: norm 1e-30; the square underflows in f32",
        mentioned: Some(Rule::QuatNotUnit),
        ..LEGAL
    },
    Rotation {
        name: "norm-1e30",
        quat: [8e30, 0.0, 0.0, -6e30],
        origin: "demands 2a, level 1: norm 1e30; the square overflows in f32",
        mentioned: Some(Rule::QuatNotUnit),
        ..LEGAL
    },
    Rotation {
        name: "denormal",
        quat: [0.0, 0.0, 1e-42, 0.0],
        origin: "demands 2a, level 1: denormals",
        mentioned: Some(Rule::QuatNotUnit),
        ..LEGAL
    },
    Rotation {
        name: "max",
        quat: [f32::MAX; 4],
        origin: "demands 2a, level 1: f32::MAX",
        mentioned: Some(Rule::QuatNotUnit),
        ..LEGAL
    },
    Rotation {
        name: "zero",
        quat: [0.0; 4],
        origin: "demands 2a, level 1: zero quaternion",
        repaired: Some(Rule::QuatZero),
        ..LEGAL
    },
    Rotation {
        name: "minus-zero",
        quat: [-0.0; 4],
        origin: "demands 2a, level 1: zero quaternion, ±0",
        repaired: Some(Rule::QuatZero),
        ..LEGAL
    },
];

pub(super) fn cases() -> Vec<Case> {
    ROTATIONS
        .iter()
        .map(|rotation| Case {
            area: "rotations",
            origin: rotation.origin,
            policy: if rotation.repaired.is_some() { Policy::Repaired } else { Policy::Exact },
            tolerance: COMPONENT,
            reason: "one rounding to f32 of a component of at most 1, after a norm in f64",
            ..Case::new(format!("ply-quat-{}", rotation.name), Level::Inputs, move |t| {
                check(t, rotation)
            })
        })
        .collect()
}

fn check(trial: &Trial<'_>, rotation: &Rotation) -> Result<Finding, Failure> {
    let mut columns = columns(ROWS);
    for (i, value) in rotation.quat.into_iter().enumerate() {
        let name = format!("rot_{i}");
        columns.iter_mut().filter(|(n, _)| *n == name).for_each(|(_, v)| v[BAD] = value);
    }
    let path = trial.file("scene.ply", &little(&columns))?;
    let (loaded, want) = match rotation.repaired {
        Some(rule) => (open_repaired(&path, rule, BAD)?, [1.0, 0.0, 0.0, 0.0]),
        None => (open_legal(&path)?, unit(rotation.quat)),
    };
    ensure!(loaded.scene.len() == ROWS, "{} Gaussians of {ROWS}", loaded.scene.len());
    if let Some(rule) = rotation.mentioned {
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
    Ok(Finding::of(error, format!("{:?} became {got:?}", rotation.quat)))
}

/// The direction with a real part of at least 0.
fn unit(quat: [f32; 4]) -> [f64; 4] {
    let largest = quat.iter().fold(0.0, |m: f64, v| m.max(f64::from(*v).abs()));
    let scaled = quat.map(|v| f64::from(v) / largest);
    let norm = scaled.iter().map(|v| v * v).sum::<f64>().sqrt();
    let sign = if scaled[0] < 0.0 { -1.0 } else { 1.0 };
    scaled.map(|v| sign * v / norm)
}
