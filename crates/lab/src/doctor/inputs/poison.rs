//! One bad value in one column of a PLY file: every attribute, every kind of bad value.

use super::files::{BAD, ROWS, check_quats, columns, little, open_legal, open_repaired, with};
use crate::doctor::case::Case;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{GaussianScene, LoadedScene};

/// What becomes of the row with the value.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fate {
    /// The value is in the scene as it was in the file.
    Kept,
    /// The Gaussian is there, as the rule repairs it.
    Repaired(Rule),
    /// The Gaussian is left out.
    LeftOut(Rule),
}
use Fate::{Kept, LeftOut, Repaired};

/// A column, what a NaN, +∞ and −∞ in it become, and where its value is in a scene, if it is kept as it is.
struct Attribute {
    name: &'static str,
    column: &'static str,
    fates: [Fate; 3],
    value: Option<fn(&GaussianScene) -> f32>,
}

const fn attribute(
    name: &'static str,
    column: &'static str,
    fates: [Fate; 3],
    value: Option<fn(&GaussianScene) -> f32>,
) -> Attribute {
    Attribute { name, column, fates, value }
}

static ATTRIBUTES: [Attribute; 10] = [
    attribute("coord", "y", [LeftOut(Rule::CoordNotFinite); 3], Some(|s| s.coord[BAD][1])),
    attribute(
        "scale",
        "scale_2",
        [LeftOut(Rule::ScaleNan), LeftOut(Rule::ScaleInfinite), Kept],
        Some(|s| s.log_scale[BAD][2]),
    ),
    attribute(
        "opacity",
        "opacity",
        [LeftOut(Rule::OpacityNan), Kept, Kept],
        Some(|s| s.opacity_logit[BAD]),
    ),
    // A huge component is a direction: it is divided by the norm.
    attribute("quat", "rot_1", [Repaired(Rule::QuatNotFinite); 3], None),
    attribute(
        "color",
        "f_dc_1",
        [Repaired(Rule::ColorNan), Repaired(Rule::ColorInfinite), Repaired(Rule::ColorInfinite)],
        Some(|s| s.sh_dc[BAD][1]),
    ),
    // Column 4 is the second coefficient of green.
    attribute(
        "sh-rest",
        "f_rest_4",
        [Repaired(Rule::RestNotFinite); 3],
        Some(|s| s.sh_rest[9 * BAD + 4]),
    ),
    attribute("normal", "nz", [Repaired(Rule::NormalNotFinite); 3], None),
    attribute("segment", "segment", [Repaired(Rule::SegmentInvalid); 3], None),
    attribute(
        SCORE,
        "score",
        [Repaired(Rule::ScoreNan), Kept, Kept],
        Some(|s| s.segment_score.as_ref().map_or(f32::NAN, |s| s[BAD])),
    ),
    attribute("instance", "instance", [Repaired(Rule::InstanceInvalid); 3], None),
];

/// An attribute of any range, says the field, so that no number is extreme.
const SCORE: &str = "score";
/// Not numbers, with the place of their fate.
const BAD_VALUES: [(&str, f32); 3] =
    [("nan", f32::NAN), ("plus-inf", f32::INFINITY), ("minus-inf", f32::NEG_INFINITY)];
/// Legal in every attribute whose values are numbers of any size.
const EXTREMES: [(&str, f32); 4] =
    [("denormal", 1e-42), ("minus-zero", -0.0), ("max", f32::MAX), ("min", f32::MIN)];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for attribute in &ATTRIBUTES {
        let mut add = |word: &str, value: f32, fate: Fate| {
            let name = format!("ply-{}-{word}", attribute.name);
            cases.push(case(name, move |t| check(t, attribute, value, fate)));
        };
        for ((word, value), fate) in BAD_VALUES.into_iter().zip(attribute.fates) {
            add(word, value, fate);
        }
        let has_extremes = attribute.value.is_some() && attribute.name != SCORE;
        for (word, value) in EXTREMES.into_iter().filter(|_| has_extremes) {
            add(word, value, Kept);
        }
    }
    cases
}

fn check(trial: &Trial<'_>, attribute: &Attribute, value: f32, fate: Fate) -> Result<(), Failure> {
    let clean = trial.file("clean.ply", &little(&columns(ROWS)))?;
    let clean = open_legal(&clean)?.scene;
    let bytes = little(&with(columns(ROWS), attribute.column, BAD, value));
    let path = trial.file("scene.ply", &bytes)?;
    let (loaded, rule) = match fate {
        Kept => (open_legal(&path)?, None),
        Repaired(rule) | LeftOut(rule) => (open_repaired(&path, rule, BAD)?, Some(rule)),
    };
    let left_out = matches!(fate, LeftOut(_));
    check_rows(&loaded, &clean, left_out)?;
    check_quats(&loaded.scene)?;
    if let (Kept, Some(of)) = (fate, attribute.value) {
        let kept = of(&loaded.scene);
        ensure!(kept.to_bits() == value.to_bits(), "{value:e} became {kept:e}");
    }
    if let Some(rule) = rule {
        let count = loaded.report.count(rule);
        ensure!(count == 1, "{rule:?} counted {count} times");
    }
    Ok(())
}

/// That the other rows are as in the file without the bad value, bit for bit.
fn check_rows(loaded: &LoadedScene, clean: &GaussianScene, left_out: bool) -> Result<(), Failure> {
    let rows: Vec<usize> = (0..ROWS).filter(|&row| !(left_out && row == BAD)).collect();
    let kept: Option<Vec<usize>> =
        loaded.kept_rows.as_ref().map(|rows| rows.iter().map(|&r| r as usize).collect());
    ensure!(kept == left_out.then(|| rows.clone()), "rows kept: {kept:?}");
    ensure!(loaded.scene.len() == rows.len(), "{} Gaussians", loaded.scene.len());
    ensure!(
        loaded.report.dropped_rows == usize::from(left_out),
        "{} rows reported as left out",
        loaded.report.dropped_rows
    );
    for (i, &row) in rows.iter().enumerate().filter(|(_, row)| **row != BAD) {
        let one = loaded.scene.select_rows(&[i])?;
        let want = clean.select_rows(&[row])?;
        ensure!(one == want, "row {row} changed, only row {BAD} is bad");
    }
    Ok(())
}
