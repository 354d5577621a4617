//! Large data of the library: inside it, or, where a program is to stay small, given to it before its first use.

use std::sync::OnceLock;

/// Bytes that are part of the library, such as weights. In a browser the page gives them, so that the program can be kept
/// and replaced without them.
#[derive(Debug)]
pub struct Asset {
    name: &'static str,
    inside: Option<&'static [u8]>,
    given: OnceLock<Vec<u8>>,
}

impl Asset {
    /// Bytes that are inside the library, or are to be given.
    pub const fn new(name: &'static str, inside: Option<&'static [u8]>) -> Self {
        Self { name, inside, given: OnceLock::new() }
    }

    /// Gives the bytes of a library that is without them.
    ///
    /// # Errors
    /// If it has them.
    pub fn give(&self, bytes: Vec<u8>) -> Result<(), String> {
        if self.inside.is_some() || self.given.set(bytes).is_err() {
            return Err(format!("{}: is there already", self.name));
        }
        Ok(())
    }

    /// The bytes.
    ///
    /// # Errors
    /// If the library is without them, and nobody gave them.
    pub fn bytes(&self) -> Result<&[u8], String> {
        let given = || self.given.get().map(Vec::as_slice);
        self.inside.or_else(given).ok_or_else(|| format!("{}: was not given", self.name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_inside_or_given_once() {
        let inside = Asset::new("weights", Some(b"abc"));
        assert_eq!(inside.bytes(), Ok(&b"abc"[..]));
        assert!(inside.give(vec![1]).unwrap_err().contains("weights"));
        let outside = Asset::new("weights", None);
        assert_eq!(outside.bytes(), Err("weights: was not given".to_owned()));
        outside.give(vec![1]).unwrap();
        assert!(outside.give(vec![2]).is_err());
        assert_eq!(outside.bytes(), Ok(&[1u8][..]));
    }
}
