//! Names of columns of unknown meaning in a file that is written, so that none gets a meaning by it.

use crate::extra_columns::ExtraColumn;

/// What is put before a name that would be taken for something else.
const PREFIX: &str = "extra_";

/// The names of each column, one for each number of a row if `split`, and what was renamed, in words.
///
/// `is_taken` says of a name whether it means something in the format; characters that `allowed` refuses
/// become `_`.
pub(super) fn output_names(
    columns: &[ExtraColumn],
    split: bool,
    allowed: impl Fn(char) -> bool,
    is_taken: impl Fn(&str) -> bool,
) -> (Vec<Vec<String>>, Vec<String>) {
    let (mut all, mut renamed) = (Vec::<Vec<String>>::new(), Vec::new());
    for column in columns {
        let clean: String = column.name.chars().map(|c| if allowed(c) { c } else { '_' }).collect();
        let names = |base: &str| match column.row_shape.as_slice() {
            [_, ..] if split => (0..column.width()).map(|i| format!("{base}_{i}")).collect(),
            _ => vec![base.to_owned()],
        };
        let free = |names: &[String]| {
            let same = |a: &String, b: &String| a.eq_ignore_ascii_case(b);
            names
                .iter()
                .all(|n| !n.is_empty() && !is_taken(n) && !all.iter().flatten().any(|a| same(a, n)))
        };
        let prefixed = format!("{PREFIX}{clean}");
        let numbered = (2..).map(|number| format!("{prefixed}_{number}"));
        let mut bases = [clean, prefixed.clone()].into_iter().chain(numbered);
        // There is always a number that is free.
        let base = bases.find(|base| free(&names(base))).unwrap_or(prefixed);
        if base != column.name {
            renamed.push(format!("column {} is called {base} in the file", column.name));
        }
        all.push(names(&base));
    }
    (all, renamed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extra_columns::NumberType;

    #[test]
    fn no_name_gets_a_meaning_or_is_there_twice() {
        let column = |name: &str, row_shape: &[usize]| ExtraColumn {
            name: name.to_owned(),
            ty: NumberType::UInt(1),
            row_shape: row_shape.to_vec(),
            bytes: Vec::new(),
        };
        let columns = [
            column("age", &[]),
            column("Age", &[]),
            column("opacity", &[]),
            column("../up", &[]),
            column("wide", &[2, 1]),
            column("wide_1", &[]),
        ];
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let (names, renamed) = output_names(&columns, true, allowed, |name| name == "opacity");
        let names: Vec<String> = names.into_iter().flatten().collect();
        let due =
            ["age", "extra_Age", "extra_opacity", "___up", "wide_0", "wide_1", "extra_wide_1"];
        assert_eq!(names, due);
        assert_eq!(renamed.len(), 4);
        assert!(renamed[1].contains("opacity is called extra_opacity"), "{renamed:?}");
    }
}
