//! JSON by its first bytes.

/// JSON without the mark of UTF-8 that some editors put before it.
pub(super) fn without_mark(json: &[u8]) -> &[u8] {
    json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json)
}

/// Whether it may be JSON; spares every other file the attempt to parse it.
pub(super) fn is_json(bytes: &[u8]) -> bool {
    matches!(without_mark(bytes).trim_ascii_start(), [b'{' | b'[', ..])
}
