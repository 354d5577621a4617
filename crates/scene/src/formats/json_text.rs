//! JSON by its first bytes.

/// Whether it may be JSON; spares every other file the attempt to parse it.
pub(super) fn is_json(bytes: &[u8]) -> bool {
    // A mark of UTF-8 may come first.
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    matches!(text.trim_ascii_start(), [b'{' | b'[', ..])
}
