//! JPEG, by the `zune-jpeg` crate, without its code for special processors: the same bits on any
//! machine.

use super::{Channels, Picture, Samples, check_size};
use crate::SceneError;
use std::io::Cursor;
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Begins like a JPEG file.
pub(super) fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\xff\xd8\xff")
}

pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Picture, SceneError> {
    let bad = |problem: String| {
        SceneError::format(path, format!("is a JPEG that cannot be read: {problem}"), "")
    };
    // Damage is an error, not gray blocks.
    let options = DecoderOptions::new_safe()
        .set_strict_mode(true)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX));
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(|e| bad(e.to_string()))?;
    let info = decoder.info().ok_or_else(|| bad("it has no header".to_owned()))?;
    check_size(info.width.into(), info.height.into(), path)?;
    let (channels, space) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (Channels::Gray, ColorSpace::Luma),
        Some(ColorSpace::YCbCr | ColorSpace::RGB) => (Channels::Rgb, ColorSpace::RGB),
        other => {
            let problem = format!("its colors are {other:?}");
            let help = "save it as RGB; colors for print look different on every device";
            return Err(SceneError::format(path, problem, help));
        }
    };
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    let pixels = decoder.decode().map_err(|e| bad(e.to_string()))?;
    Picture::new(info.width.into(), info.height.into(), channels, Samples::Eight(pixels))
        .ok_or_else(|| bad("pixels are missing".to_owned()))
}

/// The marker and content of each segment before the pixels, as far as the bytes go.
pub(crate) fn segments(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut rest = bytes.strip_prefix(b"\xff\xd8").unwrap_or_default();
    std::iter::from_fn(move || {
        loop {
            let (&marker, after) = rest.strip_prefix(b"\xff")?.split_first()?;
            match marker {
                // Filling, and markers without content.
                0xff => rest = &rest[1..],
                0x01 | 0xd0..=0xd7 => rest = after,
                0xda | 0xd9 => return None,
                _ => {
                    let length = usize::from(u16::from_be_bytes(*after.first_chunk()?));
                    let content = after.get(2..length)?;
                    rest = &after[length..];
                    return Some((marker, content));
                }
            }
        }
    })
}
