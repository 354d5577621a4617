//! The table of values that need a decision.

use serde::Serialize;

/// Thickness of Gaussians that have two scales only, meters.
pub const FLAT_SCALE: f32 = 1e-7;
/// Size of Gaussians without any scale, meters: half of the usual voxel.
pub const DEFAULT_SCALE: f32 = 0.01;
/// Gray of Gaussians without color, a byte.
pub const DEFAULT_GREY: u8 = 128;

/// What is done about a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// It is legal and kept, also by the strict policy.
    Accept,
    /// It is repaired and reported; the strict policy refuses the file.
    Repair,
    /// The file is refused.
    Refuse,
}

impl Action {
    /// The word for it in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Accept => "accept",
            Self::Repair => "repair",
            Self::Refuse => "refuse",
        }
    }
}

/// One row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ValueRule {
    /// Which rule it is.
    pub rule: Rule,
    /// The field of the scene, or `file`.
    pub field: &'static str,
    /// Which value or lack of values it is about.
    pub bad_value: &'static str,
    /// What becomes of the file.
    pub action: Action,
    /// What becomes of the value.
    pub done: &'static str,
}

impl ValueRule {
    /// The row as it stands in the documentation.
    pub fn markdown_row(&self) -> String {
        format!("| {} | {} | {} | {} |", self.field, self.bad_value, self.action.name(), self.done)
    }
}

/// Writes the enum and the table together, so that neither can lack an entry of the other.
macro_rules! value_rules {
    ($($rule:ident: $field:literal, $bad:literal, $action:ident, $done:literal;)*) => {
        /// A row of [`VALUE_RULES`], in the same order.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
        #[serde(rename_all = "snake_case")]
        #[non_exhaustive]
        pub enum Rule {
            $(#[doc = concat!("`", $field, "`: ", $bad, " → ", $done)] $rule,)*
        }

        /// Every value that needs a decision, and the decision.
        pub const VALUE_RULES: &[ValueRule] = &[$(ValueRule {
            rule: Rule::$rule,
            field: $field,
            bad_value: $bad,
            action: Action::$action,
            done: $done,
        },)*];
    };
}

value_rules! {
    FileEmpty: "file", "no Gaussian at all", Refuse, "an error";
    FileAllDropped: "file", "no Gaussian is usable", Refuse, "an error with the report";
    FileTrailing: "file", "bytes after the last row the header counts", Repair, "ignored";
    CoordMissing: "coord", "x, y or z missing", Refuse, "an error";
    CoordNotFinite: "coord", "NaN or infinite", Repair, "the Gaussian is left out";
    ScaleNan: "scale", "NaN; where sizes are stored as they are, also negative", Repair, "the Gaussian is left out";
    ScaleInfinite: "scale", "infinitely large", Repair, "the Gaussian is left out";
    ScaleZero: "scale", "standard deviation 0, logarithm -inf", Accept, "kept";
    ScaleTwo: "scale", "scale_2 missing (2D Gaussians)", Repair, "the third axis gets 1e-7 m";
    ScaleOne: "scale", "only one scale", Repair, "used along all three axes";
    ScaleMissing: "scale", "all scales missing", Repair, "0.01 m along all axes";
    QuatNotFinite: "quat", "NaN or infinite", Repair, "no rotation";
    QuatZero: "quat", "all four 0", Repair, "no rotation";
    QuatNotUnit: "quat", "norm other than 1", Accept, "divided by its norm";
    QuatHalfTurn: "quat", "w = 0", Accept, "kept: half a turn";
    QuatMissing: "quat", "rotation missing", Repair, "no rotation";
    OpacityNan: "opacity", "NaN", Repair, "the Gaussian is left out";
    OpacityInfinite: "opacity", "logit -inf or +inf", Accept, "kept: alpha 0 or 1";
    OpacityOutside: "opacity", "probability outside 0 to 1 (folder of .npy, glTF, USD)", Repair, "clipped to 0 or 1";
    OpacityMissing: "opacity", "opacity missing", Repair, "alpha 1";
    ColorNan: "color", "DC term NaN", Repair, "mid-gray, DC term 0";
    ColorInfinite: "color", "DC term infinite", Repair, "clipped to color 0 or 1";
    ColorOutside: "color", "DC term beyond color 0 to 1", Accept, "kept, clipped when turned into bytes";
    ColorFromBytes: "color", "red, green, blue instead of a DC term", Accept, "DC term of the same color";
    ColorClipped: "color", "red, green, blue outside 0 to 1, 255 or 65535", Repair, "clipped";
    ColorMissing: "color", "color missing", Repair, "mid-gray, byte 128";
    RestNotFinite: "sh_rest", "NaN or infinite", Repair, "the coefficient becomes 0";
    RestCount: "sh_rest", "a number of f_rest columns other than 0, 9, 24, 45, 72", Refuse, "an error";
    NormalNotFinite: "normal", "NaN or infinite", Repair, "becomes 0, 0, 0: unknown";
    NormalNotUnit: "normal", "norm other than 0 or 1", Accept, "divided by its norm";
    NormalAllZero: "normal", "0, 0, 0 in every row", Accept, "read as no normals";
    SegmentInvalid: "segment", "not a whole number of 32 bits", Repair, "becomes -1: no label";
    SegmentNone: "segment", "negative, 65535 in a 16-bit column, or 255 without a name", Accept, "becomes -1: no label";
    SegmentUnnamed: "segment", "an id that the list of classes has no name for", Accept, "becomes -1: no label";
    SegmentFromOne: "segment", "an id that may count from 1", Accept, "read as counted from 0; label_base says otherwise";
    ScoreNan: "score", "NaN", Repair, "becomes 0";
    InstanceInvalid: "instance", "not a whole number of 32 bits", Repair, "becomes -1: none";
    InstanceNone: "instance", "negative, or 65535 in a 16-bit column", Accept, "becomes -1: none";
    FeatureNotFinite: "lang_feat", "NaN or infinite", Repair, "the row becomes 0 and is masked out";
    CodeNotFinite: "lang_code", "NaN or infinite", Repair, "the code becomes 0: no feature";
    MaskInvalid: "valid_feat_mask", "neither 0 nor 1", Repair, "read as 1";
    PointNotFinite: "pc_coord", "NaN or infinite", Repair, "the labeled point is left out";
    AnyExtreme: "any", "denormal, huge, or -0", Accept, "kept";
    AnyUnreadable: "any", "text or bytes that are no number", Refuse, "an error";
}

impl Rule {
    /// Its row in the table.
    pub fn about(self) -> &'static ValueRule {
        // The enum and the table come from one list, so the discriminant is the index.
        &VALUE_RULES[self as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_enum() {
        for (i, row) in VALUE_RULES.iter().enumerate() {
            assert_eq!(row.rule as usize, i);
            assert_eq!(row.rule.about(), row);
        }
    }

    #[test]
    fn no_two_rows_are_about_the_same() {
        for (i, a) in VALUE_RULES.iter().enumerate() {
            for b in &VALUE_RULES[..i] {
                assert!((a.field, a.bad_value) != (b.field, b.bad_value), "{a:?}");
            }
        }
    }

    #[test]
    fn the_documentation_shows_every_row() {
        let path = scenesplat_test_support::repository().join("docs/bad_values.md");
        let text = std::fs::read_to_string(path).unwrap();
        let table = text.lines().skip_while(|l| !l.starts_with("| field | value"));
        let table = table.take_while(|l| l.starts_with('|'));
        let shown: Vec<&str> = table.filter(|l| l.starts_with("| ")).skip(1).collect();
        let due: Vec<String> = VALUE_RULES.iter().map(ValueRule::markdown_row).collect();
        assert_eq!(shown, due, "the table should read:\n{}", due.join("\n"));
    }
}
