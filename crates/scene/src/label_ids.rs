//! What the ids of labels stand for: rows of a list of names.

use crate::value_policy::Rule;
use crate::{GaussianScene, RepairReport, SceneError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

/// What columns of bytes hold where nobody gave a label, unless it is the id of a name.
const NO_LABEL: i32 = 255;
/// Ids without a name that a message lists.
const LISTED: usize = 8;

/// The id that the first name of a list has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum LabelBase {
    /// Ids are rows of the list.
    #[default]
    Zero,
    /// Ids count from 1, and 0 is no label, as in `ScanNet`'s `*_vh_clean_2.labels.ply`.
    One,
}

impl TryFrom<u8> for LabelBase {
    type Error = String;

    fn try_from(value: u8) -> Result<Self, String> {
        match value {
            0 => Ok(Self::Zero),
            1 => Ok(Self::One),
            _ => Err(format!("{value}: the first name has the id 0 or 1")),
        }
    }
}

impl From<LabelBase> for u8 {
    fn from(base: LabelBase) -> Self {
        match base {
            LabelBase::Zero => 0,
            LabelBase::One => 1,
        }
    }
}

impl FromStr for LabelBase {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let value = text.parse::<u8>().map_err(|_| format!("{text:?}: write 0 or 1"))?;
        Self::try_from(value)
    }
}

impl fmt::Display for LabelBase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        u8::from(*self).fmt(f)
    }
}

/// How ids become rows of a list of names.
///
/// Ids below the first, ids that no name has, and 255 where no name has it, stand for no label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LabelIds {
    names: usize,
    base: Option<LabelBase>,
}

/// What ids a scene had.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct NumberedLabels {
    /// Names in the list.
    pub names: usize,
    /// Rows whose id is no name's, by id.
    pub unnamed: BTreeMap<i32, usize>,
    /// Rows with 255, where no name has it.
    pub left_out: usize,
    /// Whether the ids may count from 1, and nothing says from where they do.
    pub in_doubt: bool,
    labelled: usize,
    /// Rows with the first label, the first 255 and the first other id without a name, with that id.
    first_labelled: usize,
    first_left_out: usize,
    first_unnamed: Option<(usize, i32)>,
}

impl LabelIds {
    /// For a list of so many names. `base`: `None` if it is not known; ids are rows of the list then, unless
    /// they cannot be.
    pub fn new(names: usize, base: Option<LabelBase>) -> Self {
        Self { names, base }
    }

    /// The row of the list that an id stands for; -1 for none.
    pub fn row(&self, id: i32) -> i32 {
        let row = i64::from(id) - i64::from(u8::from(self.base.unwrap_or_default()));
        let is_name = usize::try_from(row).is_ok_and(|row| row < self.names);
        i32::try_from(row).ok().filter(|_| is_name).unwrap_or(-1)
    }

    /// Makes the labels of Gaussians and labeled points rows of the list, -1 for none.
    ///
    /// # Errors
    /// If `base` is not known and the ids are 1 to the number of names: all have a name only if they count from 1.
    pub fn number(&self, scene: &mut GaussianScene) -> Result<NumberedLabels, SceneError> {
        let points = scene.labelled_points.as_mut().and_then(|points| points.segment.as_mut());
        let mut columns: Vec<&mut Vec<i32>> = scene.segment.iter_mut().chain(points).collect();
        let ids = || columns.iter().flat_map(|column| column.iter()).copied();
        let least = ids().filter(|id| *id >= 0).min();
        let past_the_end = i32::try_from(self.names).ok().filter(|id| *id != NO_LABEL);
        let counts_past_the_end = ids().any(|id| Some(id) == past_the_end);
        let mut found = NumberedLabels { names: self.names, ..NumberedLabels::default() };
        if self.base.is_none() {
            if least == Some(1) && counts_past_the_end {
                let n = self.names;
                return Err(undecided(format!(
                    "labels have the ids 1 to {n}, and there are {n} names"
                )));
            }
            found.in_doubt = least == Some(1) || counts_past_the_end;
        }
        for (row, id) in columns.iter_mut().flat_map(|column| column.iter_mut().enumerate()) {
            found.count(row, *id, self);
            *id = self.row(*id);
        }
        Ok(found)
    }
}

fn undecided(problem: String) -> SceneError {
    let help = "say which id the first name has: 0, or 1, where 0 is no label".to_owned();
    SceneError::Classes { problem, help }
}

impl NumberedLabels {
    fn count(&mut self, row: usize, id: i32, ids: &LabelIds) {
        if id < i32::from(u8::from(ids.base.unwrap_or_default())) {
            return;
        }
        if self.labelled == 0 {
            self.first_labelled = row;
        }
        self.labelled += 1;
        if ids.row(id) >= 0 {
            return;
        }
        if id == NO_LABEL {
            if self.left_out == 0 {
                self.first_left_out = row;
            }
            self.left_out += 1;
        } else {
            *self.unnamed.entry(id).or_default() += 1;
            self.first_unnamed.get_or_insert((row, id));
        }
    }

    /// Which ids without a name there were, and how often; `None` if all have one.
    pub fn unnamed_text(&self) -> Option<String> {
        let rows: usize = self.unnamed.values().sum();
        let mut most: Vec<(&i32, &usize)> = self.unnamed.iter().collect();
        most.sort_by_key(|(_, rows)| std::cmp::Reverse(**rows));
        let each = most.iter().take(LISTED).map(|(id, rows)| format!("{id}: {rows}"));
        let mut each: Vec<String> = each.collect();
        if most.len() > LISTED {
            each.push(format!("and {} other ids", most.len() - LISTED));
        }
        let (names, each) = (self.names, each.join(", "));
        let are = if rows == 1 { "label has an id" } else { "labels have ids" };
        (rows > 0).then(|| format!("{rows} {are} without a name, of {names} names ({each})"))
    }

    /// What is doubtful about the ids; `None` if nothing is.
    pub fn doubt_text(&self) -> Option<String> {
        let n = self.names;
        self.in_doubt.then(|| match self.unnamed.contains_key(&(n as i32)) {
            true => format!("there are {n} names and labels {n}: ids may count from 1"),
            false => "the least label is 1: ids may count from 1".to_owned(),
        })
    }

    /// Refuses what is doubtful, where nobody would read a warning.
    ///
    /// # Errors
    /// If the ids may count from 1, and nothing says from where they do.
    pub fn decided(self) -> Result<Self, SceneError> {
        self.doubt_text().map_or(Ok(self), |doubt| Err(undecided(doubt)))
    }

    /// Adds what was lost, and what is doubtful, to what was noticed while the scene was read.
    pub fn report(&self, report: &mut RepairReport) {
        let none = NO_LABEL.to_string();
        report.add(Rule::SegmentNone, self.left_out, self.first_left_out, &none);
        if let Some((row, id)) = self.first_unnamed {
            report.add(Rule::SegmentUnnamed, self.unnamed.values().sum(), row, &id.to_string());
        }
        if self.in_doubt {
            report.add(Rule::SegmentFromOne, self.labelled, self.first_labelled, "");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LabelledPoints;

    fn scene(labels: &[i32]) -> GaussianScene {
        GaussianScene { segment: Some(labels.to_vec()), ..GaussianScene::default() }
    }

    fn numbered(
        names: usize,
        base: Option<LabelBase>,
        labels: &[i32],
    ) -> (Vec<i32>, NumberedLabels) {
        let mut scene = scene(labels);
        let found = LabelIds::new(names, base).number(&mut scene).unwrap();
        (scene.segment.unwrap(), found)
    }

    #[test]
    fn ids_count_from_where_they_are_said_to() {
        let ids = [0, 1, 2, 3, -1, -100, i32::MAX, i32::MIN];
        let (rows, found) = numbered(3, Some(LabelBase::One), &ids);
        assert_eq!(rows, [-1, 0, 1, 2, -1, -1, -1, -1]);
        assert_eq!(found.unnamed, BTreeMap::from([(i32::MAX, 1)]));
        let (rows, found) = numbered(3, Some(LabelBase::Zero), &ids);
        assert_eq!(rows, [0, 1, 2, -1, -1, -1, -1, -1]);
        assert_eq!(found.unnamed, BTreeMap::from([(3, 1), (i32::MAX, 1)]));
        assert!(!found.in_doubt, "it was said");
    }

    #[test]
    fn ids_without_a_name_are_no_labels_and_are_counted() {
        let (rows, found) = numbered(2, None, &[0, 50, 1, 50, 149]);
        assert_eq!(rows, [0, -1, 1, -1, -1]);
        let text = found.unnamed_text().unwrap();
        assert_eq!(text, "3 labels have ids without a name, of 2 names (50: 2, 149: 1)");
        let mut report = RepairReport::default();
        found.report(&mut report);
        let lost = report.finding(Rule::SegmentUnnamed).unwrap();
        assert_eq!((lost.count, lost.first_element, lost.example.as_str()), (3, 1, "50"));
        let all: Vec<i32> = (2..40).collect();
        let text = numbered(2, None, &all).1.unnamed_text().unwrap();
        assert!(text.starts_with("38 labels") && text.contains("and 30 other ids"), "{text}");
    }

    #[test]
    fn the_largest_byte_is_no_label_unless_a_name_has_it() {
        let (rows, found) = numbered(40, None, &[0, 255, 3]);
        assert_eq!((rows.as_slice(), found.left_out), ([0, -1, 3].as_slice(), 1));
        assert!(found.unnamed_text().is_none() && !found.in_doubt);
        assert_eq!(numbered(256, None, &[0, 255]).0, [0, 255]);
        assert_eq!(numbered(255, Some(LabelBase::One), &[1, 255]).0, [0, 254]);
        let (rows, found) = numbered(255, None, &[1, 255]);
        assert_eq!((rows.as_slice(), found.left_out), ([1, -1].as_slice(), 1));
    }

    #[test]
    fn ids_that_may_count_from_one_are_told() {
        let doubt = |labels: &[i32]| numbered(3, None, labels).1.doubt_text();
        assert!(doubt(&[1, 2, -1]).unwrap().contains("least label is 1"));
        assert!(doubt(&[0, 1, 3]).unwrap().contains("3 names and labels 3"));
        for labels in [&[0, 1, 2][..], &[2], &[-1], &[], &[0, 7], &[2, 255]] {
            assert_eq!(doubt(labels), None, "{labels:?}");
        }
        let mut report = RepairReport::default();
        numbered(3, None, &[-1, 1, 2]).1.report(&mut report);
        let told = report.finding(Rule::SegmentFromOne).unwrap();
        assert_eq!((told.count, told.first_element), (2, 1));
    }

    #[test]
    fn ids_that_have_names_only_from_one_are_asked_about() {
        let mut labels = scene(&[1, 2, 3, 255, 9, -1]);
        let before = labels.clone();
        let error = LabelIds::new(3, None).number(&mut labels).unwrap_err().to_string();
        assert!(error.contains("1 to 3") && error.contains("which id the first name has"));
        assert_eq!(labels, before, "nothing is changed");
        for base in [LabelBase::Zero, LabelBase::One] {
            assert!(LabelIds::new(3, Some(base)).number(&mut labels.clone()).is_ok());
        }
    }

    #[test]
    fn labelled_points_are_numbered_with_the_gaussians() {
        let points =
            LabelledPoints { coord: vec![[0.0; 3]; 2], segment: Some(vec![0, 2]), instance: None };
        let mut both = GaussianScene { labelled_points: Some(points), ..scene(&[1, 2]) };
        let found = LabelIds::new(2, Some(LabelBase::One)).number(&mut both).unwrap();
        assert_eq!(both.segment.unwrap(), [0, 1]);
        assert_eq!(both.labelled_points.unwrap().segment.unwrap(), [-1, 1]);
        assert_eq!(found.unnamed_text(), None);
        let mut none = GaussianScene::default();
        assert!(LabelIds::new(2, None).number(&mut none).unwrap().unnamed.is_empty());
    }

    #[test]
    fn bases_are_written_as_numbers() {
        assert_eq!("1".parse(), Ok(LabelBase::One));
        assert!("2".parse::<LabelBase>().unwrap_err().contains("0 or 1"));
        assert!("-1".parse::<LabelBase>().is_err());
        assert_eq!(serde_json::to_string(&LabelBase::One).unwrap(), "1");
        assert!(serde_json::from_str::<LabelBase>("7").is_err());
    }
}
