//! Text of unknown origin, made fit for a terminal.
//!
//! Names of files, properties, classes and cameras come from whoever made them. Control characters
//! in them move the cursor, change colors or the window's title; marks of writing direction make
//! a name read as another.

use std::borrow::Cow;
use std::ffi::OsStr;
use std::path::Path;

/// A name in which control characters are written as escapes (`\u{1b}`), line ends too.
///
/// What a path holds that is no Unicode is shown as U+FFFD.
///
/// ```
/// use scenesplat_scene::printable;
/// assert_eq!(printable("café"), "café");
/// assert_eq!(printable("a\u{1b}[2Jb"), "a\\u{1b}[2Jb");
/// ```
pub fn printable<S: AsRef<OsStr> + ?Sized>(name: &S) -> Cow<'_, str> {
    escape(name.as_ref().to_string_lossy(), is_unfit)
}

/// The same for a whole message, whose line ends and tabs stay.
pub fn printable_text(text: &str) -> Cow<'_, str> {
    escape(Cow::Borrowed(text), |c| is_unfit(c) && !matches!(c, '\n' | '\t'))
}

/// [`printable`] for a path in an error's message.
pub(crate) fn shown(path: &Path) -> Cow<'_, str> {
    printable(path)
}

fn is_unfit(c: char) -> bool {
    // Separators of lines and paragraphs, marks and overrides of writing direction.
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escape(text: Cow<'_, str>, unfit: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&unfit) {
        return text;
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if unfit(c) {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_reaches_a_terminal_that_it_would_obey() {
        for (raw, shown) in [
            ("plain name", "plain name"),
            ("Bär 床", "Bär 床"),
            ("a\nb\tc\r", "a\\nb\\tc\\r"),
            ("\u{1b}]0;title\u{7}", "\\u{1b}]0;title\\u{7}"),
            ("\u{9b}31m", "\\u{9b}31m"),
            ("abc\u{202e}ylp.exe", "abc\\u{202e}ylp.exe"),
            ("\u{7f}", "\\u{7f}"),
        ] {
            assert_eq!(printable(raw), shown);
        }
        assert_eq!(printable_text("one\n\ttwo\u{1b}[1m"), "one\n\ttwo\\u{1b}[1m");
        assert!(matches!(printable("as it is"), Cow::Borrowed(_)), "no copy without need");
    }
}
