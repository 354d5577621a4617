//! Pictures as files.

use super::PreviewError;
use scenesplat_scene::AtomicFile;
use scenesplat_scene::picture::{Channels, Picture, RgbPicture, Samples};
use std::path::Path;

/// Writes a picture, which appears when it is complete. Returns the size of the file.
///
/// # Errors
/// If it cannot be encoded or written.
pub fn write_png(path: &Path, picture: &RgbPicture) -> Result<u64, PreviewError> {
    put_png(path, picture.encode_png())
}

/// As [`write_png`], of 16-bit gray values, row by row; `size`: width, height.
///
/// # Errors
/// As [`write_png`].
pub fn write_png16(path: &Path, values: &[u16], size: [u32; 2]) -> Result<u64, PreviewError> {
    let (expected, got) = (size[0] as usize * size[1] as usize, values.len());
    let picture = Picture::new(size[0], size[1], Channels::Gray, Samples::Sixteen(values.to_vec()))
        .ok_or(PreviewError::Rows { field: "depth", expected, got })?;
    put_png(path, picture.encode_png())
}

fn put_png(path: &Path, png: std::io::Result<Vec<u8>>) -> Result<u64, PreviewError> {
    let png = png.map_err(PreviewError::Encode)?;
    AtomicFile::write(path, &png)?;
    Ok(png.len() as u64)
}
