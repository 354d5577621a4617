//! Maps of segment ids as grey PNG.

use crate::lifting::{LiftError, NO_SEGMENT, SegmentMap};
use image::codecs::png::PngDecoder;
use image::{ColorType, DynamicImage, ImageDecoder};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// The most pixels of a map.
const MAX_PIXELS: u64 = 1 << 28;

/// Reads ids below `segments`; `none` is the value of pixels without one, by default the largest.
pub(super) fn read_id_png(
    path: &Path,
    segments: usize,
    none: Option<u16>,
) -> Result<SegmentMap, LiftError> {
    let help = "a grey PNG of 8 or 16 bits is expected";
    let io = LiftError::spool(path, "cannot read the map of segment ids");
    let file = BufReader::new(File::open(path).map_err(io)?);
    let bad = |e: image::ImageError| LiftError::file(path, format!("is no PNG: {e}"), help);
    let decoder = PngDecoder::new(file).map_err(bad)?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        let problem = format!("has {width}×{height} pixels, more than {MAX_PIXELS}");
        return Err(LiftError::file(path, problem, "maps have the size of their pictures"));
    }
    let color = decoder.color_type();
    if !matches!(color, ColorType::L8 | ColorType::L16) {
        return Err(LiftError::file(path, format!("holds {color:?} pixels"), help));
    }
    let (values, default): (Vec<u16>, u16) = match DynamicImage::from_decoder(decoder) {
        Ok(DynamicImage::ImageLuma8(map)) => {
            (map.into_raw().into_iter().map(u16::from).collect(), u16::from(u8::MAX))
        }
        Ok(DynamicImage::ImageLuma16(map)) => (map.into_raw(), u16::MAX),
        Ok(_) => return Err(LiftError::file(path, "holds no grey pixels", help)),
        Err(e) => return Err(bad(e)),
    };
    let none = none.unwrap_or(default);
    let outside = |id: u16| id != none && usize::from(id) >= segments;
    if let Some(at) = values.iter().position(|&id| outside(id)) {
        let (row, column) = (at / width as usize, at % width as usize);
        let problem = format!("row {row}, column {column}: id {}", values[at]);
        let help = format!("the feature table has {segments} rows; {none} is no segment");
        return Err(LiftError::file(path, problem, help));
    }
    let ids = values.into_iter().map(|id| if id == none { NO_SEGMENT } else { id }).collect();
    SegmentMap::new(width, height, ids)
}
