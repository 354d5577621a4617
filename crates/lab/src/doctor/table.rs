//! What is said of each case stands in the tables of `docs/hard_cases.md`, the one place for it; the checks are here.

use super::case::{Case, Finding, Level, Policy};
use super::trial::{Failure, Trial};
use scenesplat::shipped::HARD_CASES;
use std::collections::HashMap;
use std::sync::LazyLock;

/// A case of the tables, with its check. What has no row has no area, origin and reason, which a test looks for.
pub(super) fn case<T: Into<Finding>>(
    name: impl Into<String>,
    check: impl Fn(&Trial<'_>) -> Result<T, Failure> + Send + Sync + 'static,
) -> Case {
    static ROWS: LazyLock<HashMap<&str, Row>> = LazyLock::new(|| rows().collect());
    let case = Case::new(name, Level::Inputs, check);
    let Some(Row { level, area, policy, tolerance, reason, origin, quick }) =
        ROWS.get(case.name.as_str()).cloned()
    else {
        return case;
    };
    Case { level, area, policy, tolerance, reason, origin, quick, ..case }
}

/// What the documentation says of a case.
#[derive(Clone)]
pub(super) struct Row {
    pub(super) level: Level,
    area: String,
    policy: Policy,
    tolerance: f64,
    reason: String,
    origin: String,
    pub(super) quick: bool,
}

/// The rows of the tables with their names.
pub(super) fn rows() -> impl Iterator<Item = (&'static str, Row)> {
    let (_, tables) = HARD_CASES.split_once("## Level 1").unwrap_or_default();
    Level::ALL
        .into_iter()
        .zip(tables.split("## Level "))
        .flat_map(|(level, table)| table.lines().filter_map(move |line| row(level, line)))
}

/// ``| `name` · | area | expected | tolerance: reason | origin |``, the point for the quick subset.
fn row(level: Level, line: &'static str) -> Option<(&'static str, Row)> {
    let cells: Vec<&str> = line.strip_prefix("| `")?.strip_suffix(" |")?.split(" | ").collect();
    let [name, area, expected, allowed, origin] = cells[..] else { return None };
    let (name, quick) = name.split_once('`')?;
    let (tolerance, reason) = allowed.split_once(": ")?;
    let text = |cell: &str| cell.replace("\\|", "|");
    let row = Row {
        level,
        area: area.to_owned(),
        policy: Policy::ALL.into_iter().find(|policy| policy.name() == expected)?,
        tolerance: tolerance.parse().ok()?,
        reason: text(reason),
        origin: text(origin),
        quick: quick == " ·",
    };
    Some((name, row))
}
