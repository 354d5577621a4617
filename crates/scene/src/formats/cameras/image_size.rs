//! Width and height of a picture, from the beginning of its file.

use crate::input_file::open_regular_file;
use crate::picture::jpeg::segments;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes that are read; the size of a JPEG file comes after its metadata.
const HEAD: u64 = 1 << 20;

/// The size of a PNG or JPEG file; a name without ending may mean either.
pub(super) fn image_size(path: &Path) -> Option<(u32, u32)> {
    let endings = ["png", "jpg", "jpeg"].map(|ending| with_ending(path, ending));
    let files = std::iter::once(path.to_owned()).chain(endings);
    let file = files.into_iter().find(|file| file.is_file())?;
    let mut head = Vec::new();
    open_regular_file(&file).ok()?.take(HEAD).read_to_end(&mut head).ok()?;
    picture_size(&head)
}

/// Width and height of a PNG or JPEG picture by the head of its file, which is not decoded; `None` if it is neither, or
/// says nothing of its size.
pub fn picture_size(head: &[u8]) -> Option<(u32, u32)> {
    png_size(head).or_else(|| jpeg_size(head))
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

fn png_size(head: &[u8]) -> Option<(u32, u32)> {
    let body = head.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    let header = body.get(4..)?.strip_prefix(b"IHDR")?;
    let number = |at: usize| Some(u32::from_be_bytes(*header.get(at..)?.first_chunk()?));
    Some((number(0)?, number(4)?))
}

fn jpeg_size(head: &[u8]) -> Option<(u32, u32)> {
    // Starts of frames, all but tables of codes and arithmetic.
    let is_frame = |m: u8| matches!(m, 0xc0..=0xcf) && !matches!(m, 0xc4 | 0xc8 | 0xcc);
    let (_, frame) = segments(head).find(|&(marker, _)| is_frame(marker))?;
    let number = |at: usize| Some(u16::from_be_bytes(*frame.get(at..)?.first_chunk()?));
    Some((number(3)?.into(), number(1)?.into()))
}
