//! What is wrong with a scene, in words: names, counts, first rows and help.

use super::statistics::Counted;
use scenesplat_scene::LoadedScene;
use scenesplat_scene::value_policy::{self, Action, Rule};
use serde::Serialize;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Rows are lost, or a command will refuse the scene.
    Error,
    /// Results will be worse than they could be.
    Warning,
    /// Worth knowing; nothing is wrong.
    Note,
}

impl Severity {
    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warning => "warning",
            Self::Note => "note",
        }
    }
}

/// Something that was found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Its stable name: a rule of the value policy (`coord_not_finite`) or one of those listed in
    /// `docs/inspect.md`.
    pub name: String,
    /// How bad it is.
    pub severity: Severity,
    /// Number of rows concerned.
    pub count: usize,
    /// First row concerned, counted in the file from 0; `None` if it is about the scene as a whole.
    pub first_row: Option<usize>,
    /// A value found, as text; empty if there is nothing to show.
    pub example: String,
    /// What it is.
    pub message: String,
    /// What to do about it.
    pub help: String,
}

/// Collects findings and notes of a scene.
pub(super) struct Findings<'a> {
    loaded: &'a LoadedScene,
    pub(super) all: Vec<Finding>,
}

impl<'a> Findings<'a> {
    /// Begins with what was noticed while the file was read.
    pub(super) fn of_reading(loaded: &'a LoadedScene) -> Self {
        let rules = loaded.report.findings.iter().map(of_rule);
        let remarks = loaded.report.notes.iter().map(|text| Finding {
            name: "reading".to_owned(),
            severity: Severity::Note,
            count: 0,
            first_row: None,
            example: String::new(),
            message: text.clone(),
            help: String::new(),
        });
        Self { loaded, all: rules.chain(remarks).collect() }
    }

    /// Adds one; `rows` counts the usable Gaussians.
    pub(super) fn add(
        &mut self,
        severity: Severity,
        name: &str,
        rows: Counted,
        message: impl Into<String>,
    ) -> Added<'_> {
        let kept = self.loaded.kept_rows.as_ref();
        self.all.push(Finding {
            name: name.to_owned(),
            severity,
            count: rows.count,
            first_row: rows.first.map(|row| kept.map_or(row, |kept| kept[row] as usize)),
            example: String::new(),
            message: message.into(),
            help: String::new(),
        });
        Added(self.all.last_mut())
    }

    /// Findings, the worst first, and notes.
    pub(super) fn split(mut self) -> (Vec<Finding>, Vec<Finding>) {
        // Stable: those of equal severity stay in the order of the checks.
        self.all.sort_by_key(|f| f.severity);
        self.all.into_iter().partition(|f| f.severity != Severity::Note)
    }
}

/// A finding that was just added.
pub(super) struct Added<'a>(Option<&'a mut Finding>);

impl Added<'_> {
    pub(super) fn example(self, text: impl Into<String>) -> Self {
        let Self(mut finding) = self;
        let text = text.into();
        if let Some(finding) = &mut finding {
            finding.example = text;
        }
        Self(finding)
    }

    pub(super) fn help(self, text: &str) {
        if let Some(finding) = self.0 {
            text.clone_into(&mut finding.help);
        }
    }
}

/// A rule that applied while the file was read, in the words of the value policy.
fn of_rule(found: &value_policy::ValueFinding) -> Finding {
    let drops = matches!(
        found.rule,
        Rule::CoordNotFinite | Rule::ScaleNan | Rule::ScaleInfinite | Rule::OpacityNan
    );
    let severity = match found.action {
        Action::Accept => Severity::Note,
        _ if drops => Severity::Error,
        _ => Severity::Warning,
    };
    let help = match (severity, found.rule) {
        (Severity::Note, _) => "",
        (_, Rule::FileTrailing) => "export the scene again; the file may have been joined or cut",
        (Severity::Error, _) => {
            "find out which step made them (often a training that diverged) and export again; \
             everything else works without these rows"
        }
        _ => "check the program that wrote the file; commands use the repaired values",
    };
    Finding {
        name: rule_name(found.rule),
        severity,
        count: found.count,
        first_row: Some(found.first_element),
        example: found.example.clone(),
        message: format!("{}: {}; {}", found.field, found.bad_value, found.done),
        help: help.to_owned(),
    }
}

/// The name of a rule as in reports: `coord_not_finite`.
fn rule_name(rule: Rule) -> String {
    let mut name = String::new();
    for letter in format!("{rule:?}").chars() {
        if letter.is_ascii_uppercase() && !name.is_empty() {
            name.push('_');
        }
        name.push(letter.to_ascii_lowercase());
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::value_policy::VALUE_RULES;

    #[test]
    fn rules_have_the_names_of_the_repair_report() {
        for row in VALUE_RULES {
            let name = serde_json::to_value(row.rule).unwrap();
            assert_eq!(name, rule_name(row.rule));
        }
    }

    #[test]
    fn rules_that_leave_rows_out_are_errors() {
        for row in VALUE_RULES.iter().filter(|r| r.action != Action::Refuse) {
            let finding = of_rule(&value_policy::ValueFinding {
                rule: row.rule,
                field: row.field,
                bad_value: row.bad_value,
                action: row.action,
                done: row.done,
                count: 1,
                first_element: 3,
                example: String::new(),
            });
            let drops = row.done == "the Gaussian is left out";
            assert_eq!(finding.severity == Severity::Error, drops, "{row:?}");
            assert_eq!(finding.severity == Severity::Note, row.action == Action::Accept);
            assert_eq!(finding.help.is_empty(), row.action == Action::Accept);
        }
    }
}
