//! Java properties files: Latin-1 text, `key=value` lines, escapes, lines that go on.

use std::collections::BTreeMap;

/// The values of all keys; of a key that is there twice the last, as Java has it.
pub(super) fn parse(bytes: &[u8]) -> BTreeMap<String, String> {
    let text: String = bytes.iter().map(|&b| char::from(b)).collect();
    let mut values = BTreeMap::new();
    // A line break is LF, CR or both; the empty lines between CR and LF are skipped as such.
    let mut lines = text.split(['\n', '\r']).map(|line| line.trim_start_matches(BLANK));
    while let Some(first) = lines.next() {
        if first.is_empty() || first.starts_with(['#', '!']) {
            continue;
        }
        let mut line = first.to_owned();
        while goes_on(&line) {
            line.pop();
            let Some(next) = lines.by_ref().find(|next| !next.is_empty()) else { break };
            line.push_str(next);
        }
        let (key, value) = split(&line);
        values.insert(unescape(key), unescape(value));
    }
    values
}

const BLANK: [char; 3] = [' ', '\t', '\u{c}'];

/// Whether an odd number of backslashes ends the line.
fn goes_on(line: &str) -> bool {
    line.chars().rev().take_while(|&c| c == '\\').count() % 2 == 1
}

/// Key and value, parted by the first `=`, `:` or blank that no backslash precedes.
fn split(line: &str) -> (&str, &str) {
    let mut escaped = false;
    let end = line.find(|c: char| {
        let ends = !escaped && (c == '=' || c == ':' || BLANK.contains(&c));
        escaped = c == '\\' && !escaped;
        ends
    });
    let Some(end) = end else { return (line, "") };
    let rest = line[end..].trim_start_matches(BLANK);
    let rest = rest.strip_prefix(['=', ':']).unwrap_or(rest);
    (&line[..end], rest.trim_start_matches(BLANK))
}

fn unescape(text: &str) -> String {
    let mut units: Vec<u16> = Vec::with_capacity(text.len());
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        if c != '\\' {
            units.extend(c.encode_utf16(&mut [0; 2]).iter());
            continue;
        }
        match chars.next() {
            Some('t') => units.push(u16::from(b'\t')),
            Some('n') => units.push(u16::from(b'\n')),
            Some('r') => units.push(u16::from(b'\r')),
            Some('f') => units.push(0xc),
            Some('u') => {
                let digits: String = chars.clone().take(4).collect();
                match u16::from_str_radix(&digits, 16) {
                    Ok(unit) if digits.len() == 4 => {
                        units.push(unit);
                        chars.nth(3);
                    }
                    // Java refuses such a file; a name with an odd letter is still a name.
                    _ => units.push(u16::from(b'u')),
                }
            }
            Some(other) => units.extend(other.encode_utf16(&mut [0; 2]).iter()),
            None => {}
        }
    }
    String::from_utf16_lossy(&units)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_escapes_and_accents() {
        let text = b"# a comment=1\r\n! another\n\n  id#1 = Oak#chair\r\nname#1:Caf\xe9 \\u00e0 c\\u00f4t\\u00e9\n\
            long#1=one, \\\n      two\\\n\\ three\nkey\\=with\\:both=v=w:x\nalone\ntwice=1\ntwice=2\n\
            path#1=a\\\\b\nend\\\\=no further\nbad=\\uzz1";
        let found = parse(text);
        let value = |key: &str| found.get(key).map(String::as_str);
        assert_eq!(value("id#1"), Some("Oak#chair"));
        assert_eq!(value("name#1"), Some("Caf\u{e9} \u{e0} c\u{f4}t\u{e9}"));
        assert_eq!(value("long#1"), Some("one, two three"));
        assert_eq!(value("key=with:both"), Some("v=w:x"));
        assert_eq!(value("alone"), Some(""));
        assert_eq!(value("twice"), Some("2"));
        assert_eq!(value("path#1"), Some("a\\b"));
        assert_eq!(value("end\\"), Some("no further"));
        assert_eq!(value("bad"), Some("uzz1"));
        assert_eq!(found.len(), 9);
    }
}
