//! Columns that are missing, half there or of another kind.

use super::files::{ROWS, columns, little, open, open_legal, refused};
use crate::doctor::case::Case;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{LoadedScene, Policy as ReadPolicy};

/// What is said about a file without some columns.
enum Fate {
    /// A default, under this rule; the function checks it.
    Default(Rule, fn(&LoadedScene) -> bool),
    /// Nothing to repair.
    Fine(fn(&LoadedScene) -> bool),
    /// An error with this word.
    Refused(&'static str),
}
use Fate::{Default, Fine, Refused};

/// Name, beginnings of the columns that are left out, and what becomes of the file.
type Missing = (&'static str, &'static [&'static str], Fate);

static MISSING: [Missing; 14] = [
    (
        "no-opacity",
        &["opacity"],
        Default(Rule::OpacityMissing, |l| (0..ROWS).all(|row| l.scene.opacity(row) == 1.0)),
    ),
    (
        "no-rotation",
        &["rot_"],
        Default(Rule::QuatMissing, |l| l.scene.quat.iter().all(|q| *q == [1.0, 0.0, 0.0, 0.0])),
    ),
    (
        "no-color",
        &["f_dc_", "f_rest_"],
        Default(Rule::ColorMissing, |l| (0..ROWS).all(|r| l.scene.color_u8(r) == [128; 3])),
    ),
    (
        "no-scale",
        &["scale_"],
        Default(Rule::ScaleMissing, |l| (l.scene.scale(1)[2] - 0.01).abs() < 1e-8),
    ),
    (
        "two-scales",
        &["scale_2"],
        Default(Rule::ScaleTwo, |l| (l.scene.scale(1)[2] / 1e-7 - 1.0).abs() < 1e-5),
    ),
    (
        "one-scale",
        &["scale_1", "scale_2"],
        Default(Rule::ScaleOne, |l| l.scene.log_scale.iter().all(|s| s[0] == s[2])),
    ),
    ("no-normals", &["nx", "ny", "nz"], Fine(|l| l.scene.normal.is_none())),
    ("no-harmonics", &["f_rest_"], Fine(|l| l.scene.sh_degree == 0 && l.scene.sh_rest.is_empty())),
    (
        "no-labels",
        &["segment", "score", "instance"],
        Fine(|l| l.scene.segment.is_none() && l.scene.instance.is_none()),
    ),
    ("no-z", &["z"], Refused("lack")),
    ("no-position", &["x", "y", "z"], Refused("x, y or z missing")),
    ("half-a-color", &["f_dc_1"], Refused("lack")),
    ("half-a-rotation", &["rot_2"], Refused("lack")),
    ("eight-harmonics", &["f_rest_8"], Refused("f_rest")),
];

pub(super) fn cases() -> Vec<Case> {
    let missing = |(name, without, fate): &'static Missing| {
        case(format!("ply-{name}"), move |t| check(t, without, fate))
    };
    MISSING.iter().map(missing).collect()
}

fn check(trial: &Trial<'_>, without: &[&str], fate: &Fate) -> Result<(), Failure> {
    let mut columns = columns(ROWS);
    columns.retain(|(name, _)| !without.iter().any(|begin| name.starts_with(begin)));
    let path = trial.file("scene.ply", &little(&columns))?;
    match *fate {
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
    Ok(())
}
