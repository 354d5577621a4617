//! Columns that are missing, half there or of another kind.

use super::files::{ROWS, columns, little, open, open_legal, refused};
use crate::doctor::case::{Case, Finding, Level, Policy};
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{LoadedScene, Policy as ReadPolicy};

/// What is said about a file without some columns.
enum Fate {
    /// A default, under this rule; the function looks at it.
    Default(Rule, fn(&LoadedScene) -> bool),
    /// Nothing to repair.
    Fine(fn(&LoadedScene) -> bool),
    /// An error with this word.
    Refused(&'static str),
}
use Fate::{Default, Fine, Refused};

struct Missing {
    name: &'static str,
    /// Columns that begin so are left out.
    without: &'static [&'static str],
    fate: Fate,
}

const MISSING: &[Missing] = &[
    Missing {
        name: "no-opacity",
        without: &["opacity"],
        fate: Default(Rule::OpacityMissing, |l| (0..ROWS).all(|row| l.scene.opacity(row) == 1.0)),
    },
    Missing {
        name: "no-rotation",
        without: &["rot_"],
        fate: Default(Rule::QuatMissing, |l| {
            l.scene.quat.iter().all(|q| *q == [1.0, 0.0, 0.0, 0.0])
        }),
    },
    Missing {
        name: "no-color",
        without: &["f_dc_", "f_rest_"],
        fate: Default(Rule::ColorMissing, |l| (0..ROWS).all(|r| l.scene.color_u8(r) == [128; 3])),
    },
    Missing {
        name: "no-scale",
        without: &["scale_"],
        fate: Default(Rule::ScaleMissing, |l| (l.scene.scale(1)[2] - 0.01).abs() < 1e-8),
    },
    Missing {
        name: "two-scales",
        without: &["scale_2"],
        fate: Default(Rule::ScaleTwo, |l| (l.scene.scale(1)[2] / 1e-7 - 1.0).abs() < 1e-5),
    },
    Missing {
        name: "one-scale",
        without: &["scale_1", "scale_2"],
        fate: Default(Rule::ScaleOne, |l| l.scene.log_scale.iter().all(|s| s[0] == s[2])),
    },
    Missing {
        name: "no-normals",
        without: &["nx", "ny", "nz"],
        fate: Fine(|l| l.scene.normal.is_none()),
    },
    Missing {
        name: "no-harmonics",
        without: &["f_rest_"],
        fate: Fine(|l| l.scene.sh_degree == 0 && l.scene.sh_rest.is_empty()),
    },
    Missing {
        name: "no-labels",
        without: &["segment", "score", "instance"],
        fate: Fine(|l| l.scene.segment.is_none() && l.scene.instance.is_none()),
    },
    Missing { name: "no-z", without: &["z"], fate: Refused("lack") },
    Missing { name: "no-position", without: &["x", "y", "z"], fate: Refused("x, y or z missing") },
    Missing { name: "half-a-color", without: &["f_dc_1"], fate: Refused("lack") },
    Missing { name: "half-a-rotation", without: &["rot_2"], fate: Refused("lack") },
    Missing { name: "eight-harmonics", without: &["f_rest_8"], fate: Refused("f_rest") },
];

pub(super) fn cases() -> Vec<Case> {
    MISSING
        .iter()
        .map(|missing| Case {
            area: "columns",
            origin: "Pointcept #530: scenes without colour or normals; docs/bad_values.md, missing columns",
            policy: match missing.fate {
                Default(..) => Policy::Repaired,
                Fine(_) => Policy::Exact,
                Refused(_) => Policy::Refused,
            },
            reason: "a default is one stated value; the other columns are kept bit for bit",
            ..Case::new(format!("ply-{}", missing.name), Level::Inputs, move |t| check(t, missing))
        })
        .collect()
}

fn check(trial: &Trial<'_>, missing: &Missing) -> Result<Finding, Failure> {
    let mut columns = columns(ROWS);
    columns.retain(|(name, _)| !missing.without.iter().any(|begin| name.starts_with(begin)));
    let path = trial.file("scene.ply", &little(&columns))?;
    match missing.fate {
        Refused(word) => refused(open(&path, ReadPolicy::Repair), &["scene.ply", word])?,
        Fine(right) => {
            let loaded = open_legal(&path)?;
            ensure!(right(&loaded), "not read as it should be");
        }
        Default(rule, right) => {
            let loaded = open(&path, ReadPolicy::Repair)?;
            ensure!(loaded.report.count(rule) == ROWS, "not reported: {}", loaded.report);
            ensure!(right(&loaded), "the default is another");
            refused(open(&path, ReadPolicy::Strict), &[rule.about().field])?;
        }
    }
    Ok(Finding::right())
}
