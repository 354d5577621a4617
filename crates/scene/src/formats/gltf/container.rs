//! The binary container: a header of 12 bytes, a chunk of JSON, a chunk of bytes.

use super::file_error;
use crate::SceneError;
use std::path::Path;

const MAGIC: &[u8] = b"glTF";
const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");
const HEADER: usize = 12;

/// Whether a file begins like a binary glTF file.
pub fn is_glb(head: &[u8]) -> bool {
    head.starts_with(MAGIC)
}

/// What comes before the bytes of the binary chunk of a `.glb`, whose number is `binary`, a multiple of 4. `None` if the file would
/// be longer than the 4 GiB that the container can hold.
pub fn glb_head(document: &serde_json::Value, binary: u64) -> Option<Vec<u8>> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    // A chunk without bytes is left out.
    let chunks = if binary > 0 { 2 } else { 1 };
    let total = u32::try_from(HEADER as u64 + 8 * chunks + text.len() as u64 + binary).ok()?;
    let mut head = MAGIC.to_vec();
    for word in [2, total, text.len() as u32, JSON] {
        head.extend(word.to_le_bytes());
    }
    head.append(&mut text);
    if binary > 0 {
        head.extend((binary as u32).to_le_bytes());
        head.extend(BIN.to_le_bytes());
    }
    Some(head)
}

/// The JSON chunk and the binary chunk of a `.glb`.
pub(super) fn chunks<'a>(
    bytes: &'a [u8],
    path: &Path,
) -> Result<(&'a [u8], Option<&'a [u8]>), SceneError> {
    let bad = |problem: String| file_error(path, problem);
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk::<4>()?))
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(bad(format!("is {} bytes long, less than a glb header", bytes.len())));
    };
    if version != 2 {
        let problem = format!("is glb version {version}; only version 2 is known");
        return Err(SceneError::format(path, problem, "export it as glTF 2.0"));
    }
    // More bytes than announced are padding of a transport, fewer are a broken file.
    if (length as usize) > bytes.len() || (length as usize) < HEADER {
        return Err(bad(format!("says it has {length} bytes, but has {}", bytes.len())));
    }
    let bytes = &bytes[..length as usize];
    let (mut json, mut bin, mut at, mut number) = (None, None, HEADER, 0usize);
    while at < bytes.len() {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            return Err(bad(format!("ends inside the header of chunk {number} at byte {at}")));
        };
        let start = at + 8;
        let end = start.checked_add(size as usize).filter(|&end| end <= bytes.len());
        let Some(end) = end else {
            return Err(bad(format!(
                "has a chunk {number} of {size} bytes at byte {at}, beyond its end"
            )));
        };
        match (number, kind) {
            (0, JSON) => json = Some(&bytes[start..end]),
            (0, _) => return Err(bad("does not begin with a chunk of JSON".to_owned())),
            (1, BIN) => bin = Some(&bytes[start..end]),
            // Chunks of other kinds are to be skipped.
            _ => {}
        }
        (at, number) = (end, number + 1);
    }
    let json = json.ok_or_else(|| bad("has no chunk of JSON".to_owned()))?;
    Ok((json, bin))
}
