//! What happens to values that a scene cannot use: one table, and the report of what was found.
//!
//! [`VALUE_RULES`] is the specification: the readers look up what they do there, the report quotes
//! it, and `docs/bad_values.md` shows it.

mod clean;
mod rules;

pub(crate) use clean::{clean_scene, unit};
pub use rules::{Action, DEFAULT_GREY, DEFAULT_SCALE, FLAT_SCALE, Rule, VALUE_RULES, ValueRule};

use crate::SceneError;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;

/// What to do about values that can be repaired.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// Repair them and report it.
    #[default]
    Repair,
    /// Refuse the file.
    Strict,
}

/// How often a rule applied while a file was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ValueFinding {
    /// Which rule.
    pub rule: Rule,
    /// Its field, as in the table.
    pub field: &'static str,
    /// Its bad value, as in the table.
    pub bad_value: &'static str,
    /// Whether the value was kept or repaired.
    pub action: Action,
    /// What was done, as in the table.
    pub done: &'static str,
    /// Number of rows concerned.
    pub count: usize,
    /// First row concerned, counted in the file from 0.
    pub first_element: usize,
    /// The value found there, as text.
    pub example: String,
}

/// Everything that was noticed while a file was read.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct RepairReport {
    /// Rows in the file.
    pub source_rows: usize,
    /// Rows left out because they could not be repaired.
    pub dropped_rows: usize,
    /// One entry for each rule that applied, in the order of the table.
    pub findings: Vec<ValueFinding>,
    /// Remarks that concern no value, such as label files that were not read.
    pub notes: Vec<String>,
}

impl RepairReport {
    /// Counts a rule; the example of the lowest row is kept.
    pub(crate) fn add(&mut self, rule: Rule, count: usize, first: usize, example: &str) {
        if count == 0 {
            return;
        }
        if let Some(old) = self.findings.iter_mut().find(|f| f.rule == rule) {
            old.count += count;
            if first < old.first_element {
                old.first_element = first;
                old.example = example.to_owned();
            }
            return;
        }
        let about = rule.about();
        let at = self.findings.partition_point(|f| f.rule < rule);
        self.findings.insert(
            at,
            ValueFinding {
                rule,
                field: about.field,
                bad_value: about.bad_value,
                action: about.action,
                done: about.done,
                count,
                first_element: first,
                example: example.to_owned(),
            },
        );
    }

    /// Counts a row, of which none before had a lower number.
    pub(crate) fn add_row(&mut self, rule: Rule, row: usize, value: impl FnOnce() -> String) {
        match self.findings.iter_mut().find(|f| f.rule == rule) {
            Some(finding) => finding.count += 1,
            None => self.add(rule, 1, row, &value()),
        }
    }

    /// Adds the findings of another report.
    pub(crate) fn merge(mut self, other: &Self) -> Self {
        for f in &other.findings {
            self.add(f.rule, f.count, f.first_element, &f.example);
        }
        self
    }

    /// The finding of that rule.
    pub fn finding(&self, rule: Rule) -> Option<&ValueFinding> {
        self.findings.iter().find(|f| f.rule == rule)
    }

    /// How many rows that rule applied to.
    pub fn count(&self, rule: Rule) -> usize {
        self.finding(rule).map_or(0, |f| f.count)
    }

    /// Whether nothing had to be repaired; values that are legal as they are do not count.
    pub fn is_clean(&self) -> bool {
        self.dropped_rows == 0 && self.findings.iter().all(|f| f.action == Action::Accept)
    }

    /// What users hear of in any case: repairs, and labels that are legal values, but lost or doubtful.
    pub fn worth_telling(&self) -> impl Iterator<Item = &ValueFinding> {
        const LABELS: [Rule; 3] = [Rule::SegmentNone, Rule::SegmentUnnamed, Rule::SegmentFromOne];
        self.findings.iter().filter(|f| f.action != Action::Accept || LABELS.contains(&f.rule))
    }

    /// Under [`Policy::Strict`], an error for the first finding that needed a repair.
    pub(crate) fn enforce(&self, policy: Policy, path: &Path) -> Result<(), SceneError> {
        let repaired = self.findings.iter().filter(|f| f.action != Action::Accept);
        match (policy, repaired.min_by_key(|f| f.first_element)) {
            (Policy::Strict, Some(finding)) => Err(SceneError::Value {
                path: path.to_owned(),
                element: finding.first_element,
                field: finding.field.to_owned(),
                value: match finding.example.as_str() {
                    "" => finding.bad_value.to_owned(),
                    example => example.to_owned(),
                },
                help: format!("{}; the repair policy: {}", finding.bad_value, finding.done),
            }),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for RepairReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.findings.is_empty() && self.notes.is_empty() {
            return write!(f, "{} rows, nothing unusual", self.source_rows);
        }
        write!(f, "{} rows, {} left out", self.source_rows, self.dropped_rows)?;
        let head = ["field", "value", "action", "rows", "first", "example", "done"];
        let rows: Vec<[String; 7]> = self
            .findings
            .iter()
            .map(|x| {
                [
                    x.field.to_owned(),
                    x.bad_value.to_owned(),
                    x.action.name().to_owned(),
                    x.count.to_string(),
                    x.first_element.to_string(),
                    x.example.clone(),
                    x.done.to_owned(),
                ]
            })
            .collect();
        let width = |i: usize| {
            let widest = rows.iter().map(|r| r[i].chars().count()).max().unwrap_or(0);
            widest.max(head[i].len())
        };
        let widths: Vec<usize> = (0..head.len()).map(width).collect();
        let lines = rows.iter().map(|r| r.each_ref().map(String::as_str));
        for cells in std::iter::once(head).chain(lines).filter(|_| !rows.is_empty()) {
            let line: Vec<String> =
                cells.iter().zip(&widths).map(|(c, &w)| format!("{c:<w$}")).collect();
            write!(f, "\n  {}", line.join("  ").trim_end())?;
        }
        self.notes.iter().try_for_each(|note| write!(f, "\n  note: {note}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn findings_merge_and_keep_the_first_row() {
        let mut report = RepairReport { source_rows: 10, ..RepairReport::default() };
        report.add(Rule::OpacityNan, 0, 0, "never");
        assert!(report.is_clean());
        report.add(Rule::OpacityInfinite, 1, 3, "inf");
        assert!(report.is_clean(), "a legal value needs no repair");
        report.add(Rule::QuatZero, 2, 7, "late");
        report.add(Rule::QuatZero, 1, 4, "early");
        report.add(Rule::CoordNotFinite, 1, 9, "NaN");
        assert!(!report.is_clean());
        let quat = report.finding(Rule::QuatZero).unwrap();
        assert_eq!((quat.count, quat.first_element, quat.example.as_str()), (3, 4, "early"));
        let order: Vec<_> = report.findings.iter().map(|f| f.rule).collect();
        assert_eq!(order, [Rule::CoordNotFinite, Rule::QuatZero, Rule::OpacityInfinite]);
    }

    #[test]
    fn the_report_is_a_table_and_json() {
        let mut report =
            RepairReport { source_rows: 10, dropped_rows: 1, ..RepairReport::default() };
        report.add(Rule::CoordNotFinite, 1, 9, "NaN");
        report.notes.push("segment20.npy was not read".into());
        let text = report.to_string();
        assert!(text.starts_with("10 rows, 1 left out\n"), "{text}");
        assert!(text.contains("coord") && text.contains("NaN") && text.contains("note: segment20"));
        let lengths: Vec<_> =
            text.lines().skip(1).take(2).map(|l| l.find("repair").or(l.find("action"))).collect();
        assert_eq!(lengths[0], lengths[1], "columns line up:\n{text}");
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["findings"][0]["rule"], "coord_not_finite");
        assert_eq!(json["findings"][0]["first_element"], 9);
    }

    #[test]
    fn strict_refuses_repairs_and_only_those() {
        let path = Path::new("a.ply");
        let mut report = RepairReport::default();
        report.add(Rule::QuatNotUnit, 5, 0, "2");
        assert!(report.enforce(Policy::Strict, path).is_ok());
        report.add(Rule::QuatZero, 5, 3, "0");
        assert!(report.enforce(Policy::Repair, path).is_ok());
        let error = report.enforce(Policy::Strict, path).unwrap_err().to_string();
        assert!(error.contains("a.ply") && error.contains("element 3"), "{error}");
        assert!(error.contains("quat"), "{error}");
    }
}
