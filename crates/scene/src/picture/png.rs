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

/// Palettes become colors, fewer than 8 bits become 8.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Picture, SceneError> {
    decode_as(bytes, path, Transformations::EXPAND)
}

/// Palettes become the indices into them, fewer than 8 bits stay the numbers that they are.
pub(super) fn decode_numbers(bytes: &[u8], path: &Path) -> Result<Picture, SceneError> {
    decode_as(bytes, path, Transformations::IDENTITY)
}

fn decode_as(
    bytes: &[u8],
    path: &Path,
    transformations: Transformations,
) -> Result<Picture, SceneError> {
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
    decoder.set_transformations(transformations);
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
        ColorType::Grayscale | ColorType::Indexed => Channels::Gray,
        ColorType::GrayscaleAlpha => Channels::GrayAlpha,
        ColorType::Rgb => Channels::Rgb,
        ColorType::Rgba => Channels::Rgba,
    };
    let bits = info.bit_depth as usize;
    if bits < 8 {
        buffer = unpacked(&buffer, info.line_size, width as usize, bits);
    }
    let samples = if info.bit_depth == BitDepth::Sixteen {
        Samples::Sixteen(buffer.as_chunks::<2>().0.iter().map(|s| u16::from_be_bytes(*s)).collect())
    } else {
        Samples::Eight(buffer)
    };
    Picture::new(width, height, channels, samples).ok_or_else(|| {
        SceneError::format(path, "is no PNG that can be read: pixels are missing", "")
    })
}

/// Numbers of 1, 2 or 4 bits, the first of a byte in its upper bits; every row begins with a byte of its own.
fn unpacked(packed: &[u8], line: usize, width: usize, bits: usize) -> Vec<u8> {
    let largest = (1u8 << bits) - 1;
    let number = move |row: &[u8], x: usize| {
        let from_left = x * bits % 8;
        (row[x * bits / 8] >> (8 - bits - from_left)) & largest
    };
    let rows = packed.chunks_exact(line.max(1));
    rows.flat_map(|row| (0..width).map(move |x| number(row, x))).collect()
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
