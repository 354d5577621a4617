//! Columns of a file that nothing here reads, kept so that they come out again.

use crate::SceneError;
use serde::Serialize;

/// The type of numbers in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NumberType {
    /// One byte, 0 or 1.
    Bool,
    /// Signed integer of 1, 2, 4 or 8 bytes.
    Int(u8),
    /// Unsigned integer of 1, 2, 4 or 8 bytes.
    UInt(u8),
    /// Float of 2, 4 or 8 bytes.
    Float(u8),
}

impl NumberType {
    /// Bytes of one value.
    pub fn size(self) -> usize {
        match self {
            Self::Bool => 1,
            Self::Int(size) | Self::UInt(size) | Self::Float(size) => usize::from(size),
        }
    }

    /// Whether it is a float.
    pub fn is_float(self) -> bool {
        matches!(self, Self::Float(_))
    }
}

/// One or several numbers for each Gaussian, whose meaning is not known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExtraColumn {
    /// What the file calls it.
    pub name: String,
    /// The type of the numbers.
    pub ty: NumberType,
    /// Shape of a row; empty for one number.
    pub row_shape: Vec<usize>,
    /// The numbers, row by row, least significant byte first. `[N, row_shape…]`
    pub bytes: Vec<u8>,
}

impl ExtraColumn {
    /// Numbers of a row.
    pub fn width(&self) -> usize {
        self.row_shape.iter().product()
    }

    /// Bytes of a row.
    pub fn row_bytes(&self) -> usize {
        self.width() * self.ty.size()
    }

    /// The same column with other rows: those of the scene it came from, in this order.
    pub(crate) fn select(&self, rows: &[usize]) -> Self {
        let size = self.row_bytes();
        let mut bytes = Vec::with_capacity(rows.len() * size);
        rows.iter().for_each(|row| bytes.extend_from_slice(&self.bytes[row * size..][..size]));
        Self { bytes, name: self.name.clone(), row_shape: self.row_shape.clone(), ty: self.ty }
    }

    /// Whether the rows of both may follow each other.
    fn is_like(&self, other: &Self) -> bool {
        (&self.name, self.ty, &self.row_shape) == (&other.name, other.ty, &other.row_shape)
    }

    /// Checks the number of rows.
    pub(crate) fn check_rows(&self, rows: usize) -> Result<(), SceneError> {
        let (expected, got) = (rows.saturating_mul(self.row_bytes()), self.bytes.len());
        let fits = got == expected && self.row_bytes() > 0;
        let error = SceneError::RowCount { field: "extra (bytes)", expected, got };
        if fits { Ok(()) } else { Err(error) }
    }
}

/// The columns of several scenes, the rows one after the other, and what had to be done for that, with
/// the numbers, from 1, of the scenes concerned.
///
/// A column that a scene lacks is 0 in its rows. Columns of one name that differ in type or shape
/// are left out.
pub(crate) fn join_columns(
    scenes: &[(&[ExtraColumn], usize)],
) -> (Vec<ExtraColumn>, Vec<(String, Vec<usize>)>) {
    let (mut joined, mut notes) = (Vec::<ExtraColumn>::new(), Vec::new());
    let mut done = Vec::new();
    for first in scenes.iter().flat_map(|(columns, _)| *columns) {
        let name = first.name.as_str();
        if done.contains(&name) {
            continue;
        }
        done.push(name);
        let named = |columns: &'_ [ExtraColumn]| columns.iter().position(|c| c.name == name);
        let of_scene = |at: usize| named(scenes[at].0).map(|i| &scenes[at].0[i]);
        let numbers = |is_so: &dyn Fn(Option<&ExtraColumn>) -> bool| -> Vec<usize> {
            (0..scenes.len()).filter(|&at| is_so(of_scene(at))).map(|at| at + 1).collect()
        };
        let others = numbers(&|column| column.is_some_and(|c| !c.is_like(first)));
        if !others.is_empty() {
            notes.push((format!("column {name} was dropped: it is of another type"), others));
            continue;
        }
        let without = numbers(&|column| column.is_none());
        if !without.is_empty() {
            notes.push((format!("rows without column {name} got 0"), without));
        }
        let mut column = ExtraColumn { bytes: Vec::new(), ..first.clone() };
        for (at, (_, rows)) in scenes.iter().enumerate() {
            match of_scene(at) {
                Some(part) => column.bytes.extend_from_slice(&part.bytes),
                None => column.bytes.resize(column.bytes.len() + rows * first.row_bytes(), 0),
            }
        }
        joined.push(column);
    }
    (joined, notes)
}

/// Something in a file that was passed over: a column, an array, an element.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct UnreadColumn {
    /// What the file calls it.
    pub name: String,
    /// What it is: the type of its numbers, or what stands in the way of reading it.
    pub kind: String,
    /// Whether its name is one that people give to class labels, one whole number for each row.
    pub may_be_labels: bool,
}

impl UnreadColumn {
    /// A column of numbers, `single`: one for each row of the scene.
    pub(crate) fn of_numbers(name: &str, kind: String, single: bool) -> Self {
        let may_be_labels = single && names_labels(name);
        Self { name: name.to_owned(), kind, may_be_labels }
    }

    /// Something that is no column of the scene.
    pub(crate) fn other(name: &str, kind: impl Into<String>) -> Self {
        Self { name: name.to_owned(), kind: kind.into(), may_be_labels: false }
    }
}

/// Words of names of class labels. What CloudCompare made of a column begins with `scalar_`.
const LABEL_WORDS: [&str; 6] = ["class", "semantic", "label", "segment", "categor", "cls"];
/// Words of names of what comes with labels, and is none.
const OTHER_WORDS: [&str; 8] =
    ["score", "prob", "conf", "feat", "colo", "logit", "embed", "uncert"];

/// Whether a name is one that people give to class labels.
fn names_labels(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let has = |words: &[&str]| words.iter().any(|word| name.contains(word));
    let short = name.strip_prefix("scalar_").unwrap_or(&name);
    (has(&LABEL_WORDS) || matches!(short, "seg" | "sem")) && !has(&OTHER_WORDS)
}

/// The names of those that may be labels, for messages: `class or semantic`.
pub fn label_names(unread: &[UnreadColumn]) -> Option<String> {
    let names: Vec<&str> =
        unread.iter().filter(|c| c.may_be_labels).map(|c| c.name.as_str()).collect();
    (!names.is_empty()).then(|| names.join(" or "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(name: &str, values: &[i16]) -> ExtraColumn {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        ExtraColumn { name: name.to_owned(), ty: NumberType::Int(2), row_shape: vec![], bytes }
    }

    #[test]
    fn names_of_labels() {
        for name in [
            "class",
            "semantic",
            "label",
            "scalar_Classification",
            "scalar_label",
            "Class_ID",
            "segment20",
            "sem_class",
            "category",
            "seg",
            "scalar_seg",
            "cls_id",
        ] {
            assert!(names_labels(name), "{name}");
        }
        for name in ["confidence", "label_score", "class_prob", "sem_feat_0", "time", "obj_dc_0"] {
            assert!(!names_labels(name), "{name}");
        }
    }

    #[test]
    fn rows_follow_each_other_and_lacking_ones_are_0() {
        let (a, b) = ([column("age", &[1, 2]), column("x1", &[7, 8])], [column("age", &[3])]);
        let (joined, notes) = join_columns(&[(&a, 2), (&b, 1), (&[], 1)]);
        assert_eq!(joined, [column("age", &[1, 2, 3, 0]), column("x1", &[7, 8, 0, 0])]);
        assert_eq!(notes[0], ("rows without column age got 0".to_owned(), vec![3]));
        assert_eq!(notes[1].1, [2, 3]);
        let other = [ExtraColumn { ty: NumberType::UInt(2), ..column("age", &[3]) }];
        let (joined, notes) = join_columns(&[(&a[..1], 2), (&other, 1)]);
        assert!(joined.is_empty() && notes[0].0.contains("another type") && notes[0].1 == [2]);
        assert_eq!(a[0].select(&[1, 1, 0]), column("age", &[2, 2, 1]));
    }
}
