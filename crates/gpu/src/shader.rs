//! Texts of kernels, with parts that depend on the case.
//!
//! WGSL has no preprocessor. Lines between `//#if NAME` and `//#endif` stay only if the flag is set
//! (`//#else` for the other case; no nesting), and each constant becomes a line in front of the text. `stored` is the type of
//! numbers in arrays of rows: f16 with the flag `F16`, else f32. The flag `GELU` brings the function `gelu`.

/// The text for these flags and constants.
///
/// # Panics
/// If the text has an `//#endif` too many or too few (a mistake in this crate; tests compile every kernel).
pub(crate) fn expand(text: &str, flags: &[&str], constants: &[(&str, u32)]) -> String {
    let mut out = String::with_capacity(text.len() + 256);
    if flags.contains(&"F16") {
        out.push_str("enable f16;\nalias stored = f16;\n");
    } else {
        out.push_str("alias stored = f32;\n");
    }
    for (name, value) in constants {
        out.push_str(&format!("const {name}: u32 = {value}u;\n"));
    }
    if flags.contains(&"GELU") {
        out.push_str(include_str!("../wgsl/gelu.wgsl"));
    }
    let mut keep: Option<bool> = None;
    for line in text.lines() {
        let word = line.trim();
        if let Some(name) = word.strip_prefix("//#if ") {
            assert!(keep.is_none(), "nested //#if {name}");
            keep = Some(flags.contains(&name.trim()));
        } else if word == "//#else" {
            keep = keep.map(|kept| !kept);
        } else if word == "//#endif" {
            assert!(keep.take().is_some(), "//#endif without //#if");
        } else if keep.unwrap_or(true) {
            out.push_str(line);
            out.push('\n');
        }
    }
    assert!(keep.is_none(), "//#if without //#endif");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_stay_by_flag() {
        let text = "a\n//#if X\nb\n//#else\nc\n//#endif\nd\n";
        assert_eq!(
            expand(text, &["X"], &[("N", 3)]),
            "alias stored = f32;\nconst N: u32 = 3u;\na\nb\nd\n"
        );
        assert_eq!(expand(text, &["F16"], &[]), "enable f16;\nalias stored = f16;\na\nc\nd\n");
    }
}
