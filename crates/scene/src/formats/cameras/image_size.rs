//! Width and height of a picture, from the beginning of its file.

use crate::input_file::open_regular_file;
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
    png_size(&head).or_else(|| jpeg_size(&head))
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
    let mut rest = head.strip_prefix(b"\xff\xd8")?;
    loop {
        let [0xff, marker, ..] = *rest else { return None };
        if marker == 0xff {
            // Any number of these may fill up.
            rest = &rest[1..];
            continue;
        }
        let length = usize::from(u16::from_be_bytes(*rest.get(2..)?.first_chunk()?));
        // Starts of frames, all but tables of codes and arithmetic.
        if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            let number = |at: usize| Some(u16::from_be_bytes(*rest.get(at..)?.first_chunk()?));
            return Some((number(7)?.into(), number(5)?.into()));
        }
        rest = rest.get(2 + length.max(2)..)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_pictures() {
        let png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0\x03\x20\0\0\x02\x58";
        assert_eq!(png_size(png), Some((800, 600)));
        assert!((0..png.len()).all(|cut| png_size(&png[..cut]).is_none()));
        let jpeg = b"\xff\xd8\xff\xe0\0\x04ab\xff\xff\xc2\0\x11\x08\x02\x58\x03\x20\x03";
        assert_eq!(jpeg_size(jpeg), Some((800, 600)));
        assert!((0..jpeg.len() - 1).all(|cut| jpeg_size(&jpeg[..cut]).is_none()));
        assert_eq!(jpeg_size(b"\xff\xd8\xff\xe0\0\0\xff\xe0\0\0"), None);
    }
}
