//! What of the data did not reach training as it stands in the files.

use crate::SkippedScene;
use scenesplat_scene::RepairReport;
use scenesplat_scene::value_policy::ValueFinding;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Counts and reasons of what was left out or repaired so far, and of what scenes lack.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Scenes that were read, skipped ones too.
    pub scenes: usize,
    /// Rows in their files.
    pub rows: usize,
    /// Scenes that no batch holds, by name.
    pub skipped: BTreeMap<String, SkippedScene>,
    /// Scenes in which rows were left out or values repaired, by name.
    pub repaired: BTreeMap<String, RepairedScene>,
    /// Scenes without any label.
    pub without_labels: BTreeSet<String>,
    /// Scenes without language features.
    pub without_features: BTreeSet<String>,
}

/// What was done to one scene when it was read.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct RepairedScene {
    /// Rows in its file.
    pub rows: usize,
    /// Rows left out.
    pub dropped_rows: usize,
    /// One entry for each reason, such as `300 rows: position is not finite: row left out`.
    pub reasons: Vec<String>,
}

impl From<&RepairReport> for RepairedScene {
    fn from(report: &RepairReport) -> Self {
        let reason = |f: &ValueFinding| {
            format!("{} rows: {} is {}: {}", f.count, f.field, f.bad_value, f.done)
        };
        Self {
            rows: report.source_rows,
            dropped_rows: report.dropped_rows,
            reasons: report.worth_telling().map(reason).collect(),
        }
    }
}

impl LeftOut {
    /// Adds what another dataset says.
    pub fn add(&mut self, other: Self) {
        self.scenes += other.scenes;
        self.rows += other.rows;
        self.skipped.extend(other.skipped);
        self.repaired.extend(other.repaired);
        self.without_labels.extend(other.without_labels);
        self.without_features.extend(other.without_features);
    }

    /// Rows that were left out.
    pub fn dropped_rows(&self) -> usize {
        self.repaired.values().map(|scene| scene.dropped_rows).sum()
    }

    /// Numbers for a log, by name.
    pub fn counts(&self) -> [(&'static str, usize); 6] {
        [
            ("scenes", self.scenes),
            ("skipped_scenes", self.skipped.len()),
            ("repaired_scenes", self.repaired.len()),
            ("dropped_rows", self.dropped_rows()),
            ("scenes_without_labels", self.without_labels.len()),
            ("scenes_without_features", self.without_features.len()),
        ]
    }

    /// One line for each scene that was skipped or repaired, in the order of names, with the reasons.
    pub fn lines(&self) -> Vec<String> {
        let skipped = self.skipped.iter().map(|(name, scene)| {
            format!("scene {name} was left out of {} batches: {}", scene.times, scene.reason)
        });
        let repaired = self.repaired.iter().map(|(name, scene)| {
            let RepairedScene { rows, dropped_rows, reasons } = scene;
            format!("scene {name}: {dropped_rows} of {rows} rows left out; {}", reasons.join("; "))
        });
        skipped.chain(repaired).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_lines_name_everything() {
        let skipped = SkippedScene { times: 2, reason: "no rows".to_owned() };
        let repaired =
            RepairedScene { rows: 10, dropped_rows: 3, reasons: vec!["3 rows: x".to_owned()] };
        let mut all = LeftOut { scenes: 3, rows: 30, ..LeftOut::default() };
        all.skipped.insert("a".to_owned(), skipped);
        let mut other = LeftOut { scenes: 1, rows: 10, ..LeftOut::default() };
        other.repaired.insert("b".to_owned(), repaired);
        other.without_labels.insert("c".to_owned());
        all.add(other);
        assert_eq!((all.scenes, all.rows, all.dropped_rows()), (4, 40, 3));
        assert_eq!(all.counts().map(|(_, n)| n), [4, 1, 1, 3, 1, 0]);
        let lines = all.lines();
        assert!(lines[0].contains("a was left out of 2 batches: no rows"), "{lines:?}");
        assert!(lines[1].contains("b: 3 of 10 rows left out; 3 rows: x"), "{lines:?}");
    }
}
