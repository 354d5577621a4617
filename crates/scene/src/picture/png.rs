//! PNG, by the `png` crate.

use super::{Channels, Picture, Samples, check_size};
use crate::SceneError;
use crate::input_file::filled;
use png::{BitDepth, ColorType, Transformations};
use std::io::Cursor;
use std::path::Path;

/// Bytes that one byte of a deflate stream unpacks to at most, rounded up.
const MAX_INFLATION: u64 = 1040;

/// Begins like a PNG file.
pub(super) fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG\r\n\x1a\n")
}

pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Picture, SceneError> {
    let bad = |e: png::DecodingError| {
        SceneError::format(path, format!("is no PNG that can be read: {e}"), "")
    };
    // The first chunk is the header. Its size is looked at before the decoder plans for it.
    if let Some((width, rest)) = bytes.get(16..).and_then(<[u8]>::split_first_chunk::<4>)
        && let Some(height) = rest.first_chunk::<4>()
    {
        let [width, height] = [*width, *height].map(u32::from_be_bytes);
        check_size(width.into(), height.into(), path)?;
    }
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    // Palettes become colors, fewer than 8 bits become 8.
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    let mut reader = decoder.read_info().map_err(bad)?;
    let (width, height) = reader.info().size();
    let packed = reader.info().raw_bytes() as u64;
    if packed / MAX_INFLATION > bytes.len() as u64 {
        let problem = format!(
            "says it has {width} × {height} pixels, which its {} bytes cannot hold",
            bytes.len()
        );
        return Err(SceneError::format(path, problem, "the file is damaged or cut short"));
    }
    let size = reader.output_buffer_size().unwrap_or(usize::MAX);
    let mut buffer = filled(size, 0, path)?;
    let info = reader.next_frame(&mut buffer).map_err(bad)?;
    buffer.truncate(info.buffer_size());
    let channels = match info.color_type {
        ColorType::Grayscale => Channels::Gray,
        ColorType::GrayscaleAlpha => Channels::GrayAlpha,
        ColorType::Rgb => Channels::Rgb,
        ColorType::Rgba => Channels::Rgba,
        ColorType::Indexed => {
            return Err(SceneError::format(path, "holds numbers of a palette only", ""));
        }
    };
    let samples = if info.bit_depth == BitDepth::Sixteen {
        Samples::Sixteen(buffer.as_chunks::<2>().0.iter().map(|s| u16::from_be_bytes(*s)).collect())
    } else {
        Samples::Eight(buffer)
    };
    Picture::new(width, height, channels, samples).ok_or_else(|| {
        SceneError::format(path, "is no PNG that can be read: pixels are missing", "")
    })
}

pub(super) fn encode(picture: &Picture) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, picture.width(), picture.height());
    encoder.set_color(match picture.channels() {
        Channels::Gray => ColorType::Grayscale,
        Channels::GrayAlpha => ColorType::GrayscaleAlpha,
        Channels::Rgb => ColorType::Rgb,
        Channels::Rgba => ColorType::Rgba,
    });
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::Filter::Adaptive);
    let swapped: Vec<u8>;
    let bytes = match picture.samples() {
        Samples::Eight(values) => {
            encoder.set_depth(BitDepth::Eight);
            values.as_slice()
        }
        Samples::Sixteen(values) => {
            encoder.set_depth(BitDepth::Sixteen);
            swapped = values.iter().flat_map(|v| v.to_be_bytes()).collect();
            swapped.as_slice()
        }
    };
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bytes)?;
    writer.finish()?;
    Ok(out)
}
