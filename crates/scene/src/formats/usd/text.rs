//! Words, numbers and arrays of a text layer.

use crate::SceneError;
use std::path::Path;
use std::str::FromStr;

/// Deepest nesting of brackets; beyond it a file is no scene.
const MAX_DEPTH: usize = 64;

/// A place in the text of a layer.
#[derive(Clone)]
pub(super) struct Text<'a> {
    bytes: &'a [u8],
    at: usize,
    path: &'a Path,
}

impl<'a> Text<'a> {
    pub(super) fn new(bytes: &'a [u8], path: &'a Path) -> Self {
        Self { bytes, at: 0, path }
    }

    /// An error at this place.
    pub(super) fn error(&self, problem: impl std::fmt::Display) -> SceneError {
        let before = &self.bytes[..self.at.min(self.bytes.len())];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        SceneError::format(self.path, format!("line {line}: {problem}"), super::CHECK)
    }

    fn expected(&self, what: &str) -> SceneError {
        let rest = &self.bytes[self.at.min(self.bytes.len())..];
        match rest.is_empty() {
            true => self.error(format!("the file ends where {what} was expected")),
            false => {
                let found = String::from_utf8_lossy(&rest[..rest.len().min(20)]).into_owned();
                self.error(format!("expected {what}, found {found:?}"))
            }
        }
    }

    /// The next byte behind white space and comments.
    pub(super) fn peek(&mut self) -> Option<u8> {
        loop {
            let rest = &self.bytes[self.at..];
            let comment: &[u8] = match rest {
                [b' ' | b'\t' | b'\r' | b'\n' | b';', ..] => {
                    self.at += 1;
                    continue;
                }
                [b'#', ..] | [b'/', b'/', ..] => b"\n",
                [b'/', b'*', ..] => b"*/",
                _ => return rest.first().copied(),
            };
            let end = rest.windows(comment.len()).position(|part| part == comment);
            self.at += end.map_or(rest.len(), |end| end + comment.len());
        }
    }

    /// Goes behind this byte if it is the next.
    pub(super) fn take(&mut self, byte: u8) -> bool {
        let is_next = self.peek() == Some(byte);
        self.at += usize::from(is_next);
        is_next
    }

    pub(super) fn expect(&mut self, byte: u8) -> Result<(), SceneError> {
        match self.take(byte) {
            true => Ok(()),
            false => Err(self.expected(&format!("{:?}", char::from(byte)))),
        }
    }

    /// A name, a keyword or a type: letters, digits, and what joins them.
    pub(super) fn word(&mut self) -> Result<&'a str, SceneError> {
        self.peek();
        let rest = &self.bytes[self.at..];
        let is_part =
            |byte: &u8| byte.is_ascii_alphanumeric() || b"_:.!".contains(byte) || !byte.is_ascii();
        let mut length = rest.iter().take_while(|byte| is_part(byte)).count();
        if length > 0 && rest[length..].starts_with(b"[]") {
            length += 2;
        }
        let word = std::str::from_utf8(&rest[..length]).ok().filter(|word| !word.is_empty());
        let Some(word) = word else { return Err(self.expected("a name")) };
        self.at += length;
        Ok(word)
    }

    /// Whether this word comes next.
    pub(super) fn next_is(&mut self, word: &str) -> bool {
        self.peek();
        let rest = self.bytes[self.at..].strip_prefix(word.as_bytes());
        rest.is_some_and(|rest| rest.first().is_none_or(|byte| !byte.is_ascii_alphanumeric()))
    }

    /// The text between quotes; what is escaped stays so.
    pub(super) fn string(&mut self) -> Result<&'a [u8], SceneError> {
        let quote = match self.peek() {
            Some(quote @ (b'"' | b'\'')) => quote,
            _ => return Err(self.expected("a string")),
        };
        let rest = &self.bytes[self.at..];
        let width = if rest.starts_with(&[quote; 3]) { 3 } else { 1 };
        let mut end = width;
        while !rest[end..].starts_with(&[quote; 3][..width]) {
            end += if rest.get(end) == Some(&b'\\') { 2 } else { 1 };
            if end >= rest.len() {
                return Err(self.error("a string does not end"));
            }
        }
        self.at += end + width;
        Ok(&rest[width..end])
    }

    /// A number of any type that a text can stand for.
    pub(super) fn number<T: FromStr>(&mut self) -> Result<T, SceneError> {
        self.peek();
        let rest = &self.bytes[self.at..];
        let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-.".contains(byte);
        let length = rest.iter().take_while(|byte| is_part(byte)).count();
        let number = std::str::from_utf8(&rest[..length]).ok().and_then(|text| text.parse().ok());
        let Some(number) = number else { return Err(self.expected("a number")) };
        self.at += length;
        Ok(number)
    }

    /// A tuple of `W` numbers, or a single number without parentheses.
    pub(super) fn tuple<T: FromStr + Default + Copy, const W: usize>(
        &mut self,
    ) -> Result<[T; W], SceneError> {
        let mut values = [T::default(); W];
        if W == 1 {
            values[0] = self.number()?;
            return Ok(values);
        }
        self.expect(b'(')?;
        for (i, value) in values.iter_mut().enumerate() {
            if i > 0 {
                self.expect(b',')?;
            }
            *value = self.number()?;
        }
        self.expect(b')')?;
        Ok(values)
    }

    /// An array of such tuples. Memory grows with what is there.
    pub(super) fn array<T: FromStr + Default + Copy, const W: usize>(
        &mut self,
    ) -> Result<Vec<[T; W]>, SceneError> {
        let mut values = Vec::new();
        self.expect(b'[')?;
        while !self.take(b']') {
            values.push(self.tuple()?);
            if !self.take(b',') {
                self.expect(b']')?;
                break;
            }
        }
        Ok(values)
    }

    /// Goes behind a value of any kind.
    pub(super) fn skip_value(&mut self) -> Result<(), SceneError> {
        match self.peek() {
            Some(b'(' | b'[' | b'{') => self.skip_brackets(),
            Some(b'"' | b'\'') => self.string().map(drop),
            Some(open @ (b'@' | b'<')) => {
                let rest = &self.bytes[self.at..];
                let close: &[u8] = match open {
                    b'@' if rest.starts_with(b"@@@") => b"@@@",
                    b'@' => b"@",
                    _ => b">",
                };
                let begun = if open == b'@' { close.len() } else { 1 };
                let end = rest[begun..].windows(close.len()).position(|part| part == close);
                let Some(end) = end else { return Err(self.error("a path does not end")) };
                self.at += begun + end + close.len();
                Ok(())
            }
            _ => {
                let rest = &self.bytes[self.at..];
                let is_part = |byte: &u8| !b" \t\r\n,()[]{};='\"@<".contains(byte);
                let length = rest.iter().take_while(|byte| is_part(byte)).count();
                if length == 0 {
                    return Err(self.expected("a value"));
                }
                self.at += length;
                Ok(())
            }
        }
    }

    /// Goes behind a value of the composition of a prim: a file may be followed by a prim of it, both by an offset of times.
    pub(super) fn skip_arc(&mut self) -> Result<(), SceneError> {
        self.skip_value()?;
        if self.peek() == Some(b'<') {
            self.skip_value()?;
        }
        if self.peek() == Some(b'(') {
            self.skip_brackets()?;
        }
        Ok(())
    }

    /// Goes behind a pair of brackets with all that is in it.
    pub(super) fn skip_brackets(&mut self) -> Result<(), SceneError> {
        let mut open = Vec::new();
        loop {
            match self.peek() {
                Some(bracket @ (b'(' | b'[' | b'{')) => {
                    if open.len() == MAX_DEPTH {
                        return Err(
                            self.error(format!("brackets are nested deeper than {MAX_DEPTH}"))
                        );
                    }
                    open.push(bracket);
                    self.at += 1;
                }
                Some(bracket @ (b')' | b']' | b'}')) => {
                    let pair = open.pop().map(|open| [open, bracket]);
                    if !pair.is_some_and(|pair| [*b"()", *b"[]", *b"{}"].contains(&pair)) {
                        return Err(self.error("brackets do not match"));
                    }
                    self.at += 1;
                    if open.is_empty() {
                        return Ok(());
                    }
                }
                Some(b',' | b'=' | b':') => self.at += 1,
                Some(_) => self.skip_value()?,
                None => return Err(self.expected("a closing bracket")),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> Text<'_> {
        Text::new(text.as_bytes(), Path::new("a.usda"))
    }

    #[test]
    fn values_of_any_kind_are_read_or_skipped() {
        let mut all = text(
            "# no\n/* (no */ point3f[] primvars:a.b = [(1, -2.5e-3, inf), (4,5,6),] 'it\\'s' \
             {string a=\"} #\";asset b=@x)@} <a/b> 12 @@@a@b@@@ end",
        );
        assert_eq!(all.word().unwrap(), "point3f[]");
        assert_eq!(all.word().unwrap(), "primvars:a.b");
        all.expect(b'=').unwrap();
        let values: Vec<[f32; 3]> = all.array().unwrap();
        assert_eq!(values, [[1.0, -2.5e-3, f32::INFINITY], [4.0, 5.0, 6.0]]);
        assert_eq!(all.string().unwrap(), b"it\\'s");
        (0..4).for_each(|_| all.skip_value().unwrap());
        assert_eq!(all.word().unwrap(), "end");
        assert_eq!(all.peek(), None);
    }

    #[test]
    fn broken_text_is_refused_with_its_line() {
        for (broken, said) in [
            ("\n\n[(1, 2)]", "line 3: expected ','"),
            ("[(1, 2, 3)", "the file ends where"),
            ("[(1, 2, x)]", "expected a number, found \"x)]\""),
            ("[1]", "expected '('"),
        ] {
            let found = text(broken).array::<f32, 3>().unwrap_err().to_string();
            assert!(found.contains(said), "{found}");
        }
        for (broken, said) in [
            ("\"abc", "does not end"),
            ("(]", "do not match"),
            ("(\n(", "line 2: the file ends"),
            ("@abc", "does not end"),
            ("", "the file ends"),
        ] {
            let found = text(broken).skip_value().unwrap_err().to_string();
            assert!(found.contains(said), "{broken}: {found}");
        }
        let deep = "(".repeat(1 << 20);
        assert!(text(&deep).skip_value().unwrap_err().to_string().contains("deeper than 64"));
    }
}
