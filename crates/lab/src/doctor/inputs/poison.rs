//! One bad value in one column of a PLY file: every attribute, every kind of bad value.

use super::files::{BAD, ROWS, check_quats, columns, little, open_legal, open_repaired, with};
use crate::doctor::case::{Case, Finding, Level, Policy};
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

/// A column, what a NaN, +∞ and −∞ in it become, and how to find its value in a scene.
struct Attribute {
    name: &'static str,
    column: &'static str,
    nan: Fate,
    infinite: [Fate; 2],
    /// Whether huge and tiny numbers are values like any other there.
    extremes: bool,
    value: fn(&GaussianScene) -> Option<f32>,
}

const ATTRIBUTES: &[Attribute] = &[
    Attribute {
        name: "coord",
        column: "y",
        nan: LeftOut(Rule::CoordNotFinite),
        infinite: [LeftOut(Rule::CoordNotFinite); 2],
        extremes: true,
        value: |s| Some(s.coord[BAD][1]),
    },
    Attribute {
        name: "scale",
        column: "scale_2",
        nan: LeftOut(Rule::ScaleNan),
        infinite: [LeftOut(Rule::ScaleInfinite), Kept],
        extremes: true,
        value: |s| Some(s.log_scale[BAD][2]),
    },
    Attribute {
        name: "opacity",
        column: "opacity",
        nan: LeftOut(Rule::OpacityNan),
        infinite: [Kept; 2],
        extremes: true,
        value: |s| Some(s.opacity_logit[BAD]),
    },
    Attribute {
        name: "quat",
        column: "rot_1",
        nan: Repaired(Rule::QuatNotFinite),
        infinite: [Repaired(Rule::QuatNotFinite); 2],
        // A huge component is a direction: it is divided by the norm.
        extremes: false,
        value: |_| None,
    },
    Attribute {
        name: "color",
        column: "f_dc_1",
        nan: Repaired(Rule::ColorNan),
        infinite: [Repaired(Rule::ColorInfinite); 2],
        extremes: true,
        value: |s| Some(s.sh_dc[BAD][1]),
    },
    Attribute {
        name: "sh-rest",
        column: "f_rest_4",
        nan: Repaired(Rule::RestNotFinite),
        infinite: [Repaired(Rule::RestNotFinite); 2],
        extremes: true,
        // Column 4 is the second coefficient of green.
        value: |s| Some(s.sh_rest[9 * BAD + 4]),
    },
    Attribute {
        name: "normal",
        column: "nz",
        nan: Repaired(Rule::NormalNotFinite),
        infinite: [Repaired(Rule::NormalNotFinite); 2],
        extremes: false,
        value: |_| None,
    },
    Attribute {
        name: "segment",
        column: "segment",
        nan: Repaired(Rule::SegmentInvalid),
        infinite: [Repaired(Rule::SegmentInvalid); 2],
        extremes: false,
        value: |_| None,
    },
    Attribute {
        name: "score",
        column: "score",
        nan: Repaired(Rule::ScoreNan),
        // Any range, says the field.
        infinite: [Kept; 2],
        extremes: false,
        value: |s| s.segment_score.as_ref().map(|s| s[BAD]),
    },
    Attribute {
        name: "instance",
        column: "instance",
        nan: Repaired(Rule::InstanceInvalid),
        infinite: [Repaired(Rule::InstanceInvalid); 2],
        extremes: false,
        value: |_| None,
    },
];

/// Legal in every attribute whose values are numbers of any size.
const EXTREMES: [(&str, f32); 4] =
    [("denormal", 1e-42), ("minus-zero", -0.0), ("max", f32::MAX), ("min", f32::MIN)];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for attribute in ATTRIBUTES {
        let bad = [
            ("nan", f32::NAN, attribute.nan),
            ("plus-inf", f32::INFINITY, attribute.infinite[0]),
            ("minus-inf", f32::NEG_INFINITY, attribute.infinite[1]),
        ];
        for (word, value, fate) in bad {
            cases.push(Case {
                origin: "demands 2a, level 1: NaN and ±∞ in every attribute; docs/bad_values.md",
                ..case(attribute, word, value, fate)
            });
        }
        for (word, value) in EXTREMES.into_iter().filter(|_| attribute.extremes) {
            cases.push(Case {
                origin: "demands 2a, check 5: valid but extreme values are not dropped (as brush tests)",
                ..case(attribute, word, value, Kept)
            });
        }
    }
    cases
}

fn case(attribute: &'static Attribute, word: &str, value: f32, fate: Fate) -> Case {
    let check = move |trial: &Trial<'_>| check(trial, attribute, value, fate);
    Case {
        area: "values",
        policy: if fate == Kept { Policy::Exact } else { Policy::Repaired },
        reason: "a value is kept bit for bit or replaced as the table says; nothing is rounded",
        ..Case::new(format!("ply-{}-{word}", attribute.name), Level::Inputs, check)
    }
}

fn check(
    trial: &Trial<'_>,
    attribute: &Attribute,
    value: f32,
    fate: Fate,
) -> Result<Finding, Failure> {
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
    if let (Kept, Some(kept)) = (fate, (attribute.value)(&loaded.scene)) {
        ensure!(kept.to_bits() == value.to_bits(), "{value:e} became {kept:e}");
    }
    if let Some(rule) = rule {
        let count = loaded.report.count(rule);
        ensure!(count == 1, "{rule:?} counted {count} times");
    }
    Ok(Finding::right())
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
