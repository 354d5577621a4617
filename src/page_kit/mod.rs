//! What the pages and pictures of this program share: one form of HTML file that loads nothing, one style sheet, a few
//! shapes in two forms, axes. Their programs are TypeScript in the folder `page`; what these share is `page/src/kit`.

mod document;
pub mod drawing;
pub mod scale;

#[cfg(test)]
pub(crate) use document::tests::is_closed;
pub use document::{Block, Document, Rights};

/// Colors, buttons and notes of all pages.
pub(crate) const KIT_STYLE: &str = include_str!("../../page/src/kit/kit.css");
/// What reports add: tables, plots.
pub const REPORT_STYLE: &str = include_str!("../../page/src/reports/report.css");

/// A text in markup; of very long ones the first 200 letters.
pub(crate) fn escaped(text: &str) -> String {
    let limit = if text.len() > 65_536 { 200 } else { usize::MAX };
    let mut out = String::with_capacity(text.len().min(65_536));
    for c in text.chars().take(limit) {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}
