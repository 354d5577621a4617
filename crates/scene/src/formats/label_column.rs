//! Turns label columns of any type into `i32` with -1 for none.

use super::ply::{PlyElement, PlyFile, PlyPropertyKind, PlyType};
use crate::extra_columns::{UnreadColumn, label_names};
use crate::value_policy::Rule;
use crate::{RepairReport, SceneError};

/// Which rules the labels of a field are reported under.
#[derive(Clone, Copy)]
pub(crate) struct LabelRules {
    pub(crate) invalid: Rule,
    pub(crate) none: Rule,
}

pub(crate) const SEGMENT_RULES: LabelRules =
    LabelRules { invalid: Rule::SegmentInvalid, none: Rule::SegmentNone };
pub(crate) const INSTANCE_RULES: LabelRules =
    LabelRules { invalid: Rule::InstanceInvalid, none: Rule::InstanceNone };

/// Converts labels: negative, or `none`, means no label; beyond `i32` is invalid.
pub(crate) fn labels_from_i64(
    values: impl Iterator<Item = i64>,
    none: Option<i64>,
    rules: LabelRules,
    report: &mut RepairReport,
) -> Vec<i32> {
    let mut convert = |(row, value): (usize, i64)| match i32::try_from(value) {
        // -1 is how "no label" is written; only other spellings are worth a remark.
        Ok(-1) => -1,
        _ if value < 0 || Some(value) == none => {
            report.add(rules.none, 1, row, &value.to_string());
            -1
        }
        Ok(label) => label,
        Err(_) => {
            report.add(rules.invalid, 1, row, &value.to_string());
            -1
        }
    };
    values.enumerate().map(&mut convert).collect()
}

/// Converts labels stored as floats; anything but a whole number is invalid.
pub(crate) fn labels_from_f64(
    values: impl Iterator<Item = f64>,
    rules: LabelRules,
    report: &mut RepairReport,
) -> Vec<i32> {
    let mut convert = |(row, value): (usize, f64)| {
        if value == -1.0 {
            -1
        } else if value.fract() == 0.0 && (0.0..=f64::from(i32::MAX)).contains(&value) {
            value as i32
        } else {
            let whole = value.fract() == 0.0 && value < 0.0;
            report.add(if whole { rules.none } else { rules.invalid }, 1, row, &value.to_string());
            -1
        }
    };
    values.enumerate().map(&mut convert).collect()
}

/// Reads a column of labels of any type.
pub(crate) fn read_labels(
    file: &PlyFile,
    element: &str,
    property: &str,
    rules: LabelRules,
    report: &mut RepairReport,
) -> Result<Vec<i32>, SceneError> {
    let kind = file.element(element).and_then(|e| e.property(property)).map(|p| p.kind);
    match kind {
        Some(PlyPropertyKind::Scalar(ty)) if ty.is_float() => {
            Ok(labels_from_f64(file.column_f64(element, property)?.into_iter(), rules, report))
        }
        _ => {
            let none = match kind {
                Some(PlyPropertyKind::Scalar(PlyType::U16)) => Some(i64::from(u16::MAX)),
                Some(PlyPropertyKind::Scalar(PlyType::U32)) => Some(i64::from(u32::MAX)),
                _ => None,
            };
            let values = file.column_i64(element, property)?;
            Ok(labels_from_i64(values.into_iter(), none, rules, report))
        }
    }
}

/// Names of label columns, the first that is there counts.
const LABELS: [&str; 2] = ["segment", "label"];

/// The property that [`read_segment`] will read, if any.
pub(crate) fn segment_name<'a>(vertex: &PlyElement, wanted: Option<&'a str>) -> Option<&'a str> {
    wanted.or_else(|| LABELS.into_iter().find(|name| vertex.has(name))).filter(|n| vertex.has(n))
}

/// The labels of a scene: the property asked for, else `segment` or `label` if there.
pub(crate) fn read_segment(
    file: &PlyFile,
    vertex: &PlyElement,
    wanted: Option<&str>,
    report: &mut RepairReport,
) -> Result<Option<Vec<i32>>, SceneError> {
    let Some(name) = segment_name(vertex, wanted) else {
        let Some(name) = wanted else { return Ok(None) };
        let problem = format!("its vertices have no property {name} to read labels from");
        let help = match label_names(&columns(vertex)) {
            Some(names) => format!("those that look like labels: {names}"),
            None => "choose other labels".to_owned(),
        };
        return Err(SceneError::format(file.path(), problem, help));
    };
    read_labels(file, &vertex.name, name, SEGMENT_RULES, report).map(Some)
}

/// All columns, for messages on what could be labels.
pub(crate) fn columns(vertex: &PlyElement) -> Vec<UnreadColumn> {
    let scalar = vertex.properties.iter().filter(|p| !p.is_list());
    scalar.map(|p| UnreadColumn::of_numbers(&p.name, String::new(), true)).collect()
}

/// The instances of a scene: the property `instance` if there.
pub(crate) fn read_instance(
    file: &PlyFile,
    vertex: &PlyElement,
    report: &mut RepairReport,
) -> Result<Option<Vec<i32>>, SceneError> {
    if !vertex.has("instance") {
        return Ok(None);
    }
    read_labels(file, &vertex.name, "instance", INSTANCE_RULES, report).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spelling_of_no_label_is_minus_one() {
        let mut report = RepairReport::default();
        let values = [3, -1, -100, 65_535, 1 << 40];
        let labels = labels_from_i64(values.into_iter(), Some(65_535), SEGMENT_RULES, &mut report);
        assert_eq!(labels, [3, -1, -1, -1, -1]);
        assert_eq!(report.count(Rule::SegmentNone), 2);
        assert_eq!(report.finding(Rule::SegmentInvalid).unwrap().first_element, 4);
        let labels = labels_from_i64([65_535].into_iter(), None, SEGMENT_RULES, &mut report);
        assert_eq!(labels, [65_535]);
    }

    #[test]
    fn float_labels_must_be_whole() {
        let mut report = RepairReport::default();
        let values = [2.0, f64::NAN, 1.5, -3.0, -1.0, 1e300, f64::INFINITY];
        let labels = labels_from_f64(values.into_iter(), INSTANCE_RULES, &mut report);
        assert_eq!(labels, [2, -1, -1, -1, -1, -1, -1]);
        assert_eq!(report.count(Rule::InstanceInvalid), 4);
        assert_eq!(report.count(Rule::InstanceNone), 1);
    }
}
