//! Where the bytes of a document are: its binary chunk, text in it, or files beside it.

use super::document::{Buffer, Document};
use super::file_error;
use crate::SceneError;
use crate::input_file::InputFile;
use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::borrow::Cow;
use std::path::{Component, Path, PathBuf};

/// Ordinary base64; some exporters leave the padding away.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

enum Bytes<'a> {
    Held(Cow<'a, [u8]>),
    Mapped(InputFile),
}

impl Bytes<'_> {
    fn get(&self) -> &[u8] {
        match self {
            Self::Held(bytes) => bytes,
            Self::Mapped(file) => file.bytes(),
        }
    }
}

/// The buffers of a document, those that are needed opened.
pub(super) struct Buffers<'a> {
    /// `None` for those that no Gaussian uses.
    buffers: Vec<Option<Bytes<'a>>>,
}

impl<'a> Buffers<'a> {
    /// Opens the buffers for which `needed` holds; others, such as textures, may even be missing.
    pub(super) fn open(
        document: &'a Document<'a>,
        bin: Option<&'a [u8]>,
        path: &Path,
        needed: &[bool],
    ) -> Result<Self, SceneError> {
        let open = |(i, buffer)| {
            let is_needed = needed.get(i) == Some(&true);
            is_needed.then(|| open_buffer(i, buffer, bin, path)).transpose()
        };
        let buffers = document.buffers.iter().enumerate().map(open).collect::<Result<_, _>>()?;
        Ok(Self { buffers })
    }

    /// The bytes of that buffer.
    fn bytes(&self, buffer: usize) -> Option<&[u8]> {
        self.buffers.get(buffer)?.as_ref().map(Bytes::get)
    }

    /// Bytes of all opened buffers together.
    pub(super) fn total(&self) -> usize {
        (0..self.buffers.len()).filter_map(|i| self.bytes(i)).map(<[u8]>::len).sum()
    }

    /// The bytes of a buffer view.
    pub(super) fn view(
        &self,
        document: &Document<'_>,
        view: usize,
        path: &Path,
    ) -> Result<&[u8], SceneError> {
        let bad = |problem: String| file_error(path, format!("buffer view {view} {problem}"));
        let Some(about) = document.buffer_views.get(view) else {
            return Err(bad(format!("is missing: there are {}", document.buffer_views.len())));
        };
        let compressed = about.extensions.keys().find(|name| name.contains("meshopt"));
        if let Some(name) = compressed {
            let problem = format!("buffer view {view} is compressed by {name}, which is not read");
            return Err(SceneError::format(path, problem, "export it without compression"));
        }
        let Some(buffer) = self.bytes(about.buffer) else {
            return Err(bad(format!("is in buffer {}, which is missing", about.buffer)));
        };
        let range = || {
            let start = usize::try_from(about.byte_offset).ok()?;
            let end = start.checked_add(usize::try_from(about.byte_length).ok()?)?;
            buffer.get(start..end)
        };
        range().ok_or_else(|| {
            let (length, offset) = (about.byte_length, about.byte_offset);
            bad(format!(
                "has {length} bytes at byte {offset} of buffer {}, which has {} bytes",
                about.buffer,
                buffer.len()
            ))
        })
    }
}

fn open_buffer<'a>(
    i: usize,
    buffer: &'a Buffer<'a>,
    bin: Option<&'a [u8]>,
    path: &Path,
) -> Result<Bytes<'a>, SceneError> {
    let bytes = match &buffer.uri {
        None => match bin {
            Some(bin) if i == 0 => Bytes::Held(bin.into()),
            _ => return Err(file_error(path, format!("buffer {i} has neither a uri nor bytes"))),
        },
        Some(uri) => match data_uri(&uri.0) {
            Some(text) => {
                let bad = |e| file_error(path, format!("buffer {i} is no base64 text: {e}"));
                Bytes::Held(BASE64.decode(text).map_err(bad)?.into())
            }
            None => Bytes::Mapped(open_beside(i, &uri.0, path)?),
        },
    };
    let has = bytes.get().len();
    if (has as u64) < buffer.byte_length {
        let due = buffer.byte_length;
        return Err(file_error(path, format!("buffer {i} should have {due} bytes, but has {has}")));
    }
    Ok(bytes)
}

/// The text after `data:…;base64,`.
fn data_uri(uri: &str) -> Option<&str> {
    let scheme = uri.get(..5)?;
    if !scheme.eq_ignore_ascii_case("data:") {
        return None;
    }
    uri[5..].split_once(',').filter(|(kind, _)| kind.ends_with(";base64")).map(|(_, text)| text)
}

fn open_beside(i: usize, uri: &str, path: &Path) -> Result<InputFile, SceneError> {
    let shown: String = uri.chars().take(80).collect();
    let Some(relative) = relative_path(uri) else {
        let problem = format!("buffer {i} is at {shown:?}, which is no file below this folder");
        let help = "only files beside the document are opened; export it as .glb";
        return Err(SceneError::format(path, problem, help));
    };
    let file = path.parent().unwrap_or(Path::new("")).join(relative);
    // Asked before opening: to open a pipe would wait for someone to write into it.
    let about = std::fs::metadata(&file).map_err(SceneError::io(&file, "cannot open a buffer"))?;
    if !about.is_file() {
        return Err(SceneError::format(&file, "is a buffer, but not a file", ""));
    }
    InputFile::open(&file)
}

/// The path that a relative reference means; `None` if it could lead out of the folder.
fn relative_path(uri: &str) -> Option<PathBuf> {
    // A colon is a scheme or a drive; a backslash separates folders on some systems only.
    let decoded = percent_decoded(uri)?;
    if decoded.is_empty() || decoded.contains([':', '\\', '\0']) {
        return None;
    }
    let path = PathBuf::from(decoded);
    let below = |c| matches!(c, Component::Normal(_) | Component::CurDir);
    path.components().all(below).then_some(path)
}

fn percent_decoded(text: &str) -> Option<String> {
    let mut out = Vec::with_capacity(text.len());
    let mut bytes = text.bytes();
    while let Some(byte) = bytes.next() {
        if byte != b'%' {
            out.push(byte);
            continue;
        }
        let mut digit = || char::from(bytes.next()?).to_digit(16);
        let (high, low) = (digit()?, digit()?);
        out.push((high * 16 + low) as u8);
    }
    String::from_utf8(out).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_stay_below_the_folder() {
        for (uri, path) in
            [("a.bin", "a.bin"), ("./b/a%20b.bin", "./b/a b.bin"), ("ä.bin", "ä.bin")]
        {
            assert_eq!(relative_path(uri), Some(PathBuf::from(path)));
        }
        for uri in [
            "",
            "/a",
            "../a",
            "b/../../a",
            "%2e%2e/a",
            "%2Fa",
            "http://x/a",
            "file:///a",
            "C:a",
            "..%5Ca",
            "a%00",
            "a%",
            "a%4",
            "a%zz",
            "%ff",
        ] {
            assert_eq!(relative_path(uri), None, "{uri}");
        }
    }

    #[test]
    fn embedded_buffers() {
        assert_eq!(data_uri("data:application/octet-stream;base64,AAAA"), Some("AAAA"));
        assert_eq!(data_uri("DATA:;base64,AA=="), Some("AA=="));
        assert_eq!(data_uri("data:text/plain,AAAA"), None);
        assert_eq!(data_uri("dat"), None);
        assert_eq!(BASE64.decode("AAECAw").unwrap(), [0, 1, 2, 3]);
        assert_eq!(BASE64.decode("AAECAw==").unwrap(), [0, 1, 2, 3]);
        assert!(BASE64.decode("AA EC").is_err());
    }
}
