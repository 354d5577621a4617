//! Maps of segment ids as gray or palette PNG.

use crate::lifting::{LiftError, NO_SEGMENT, SegmentMap};
use scenesplat_scene::picture::{Channels, Samples, read_png_numbers};
use std::path::Path;

/// Reads a gray PNG, each value an id, or one with a palette, each index an id. Gives width, height, the values, and
/// the value of pixels without a segment unless another is given: 65535 of 16 bits, else 255.
///
/// # Errors
/// If it cannot be read, or has other channels.
pub fn read_ids(path: &Path) -> Result<(u32, u32, Vec<u16>, u16), LiftError> {
    let picture = read_png_numbers(path)?;
    let (width, height, channels) = (picture.width(), picture.height(), picture.channels());
    if channels != Channels::Gray {
        let help =
            "a gray PNG of up to 16 bits, or one with a palette, is expected: each value is an id";
        return Err(LiftError::file(path, format!("holds {channels:?} pixels"), help));
    }
    Ok(match picture.into_samples() {
        Samples::Eight(map) => {
            (width, height, map.into_iter().map(u16::from).collect(), u8::MAX.into())
        }
        Samples::Sixteen(map) => (width, height, map, u16::MAX),
    })
}

/// Reads ids below `segments`; `none` is the value of pixels without one, by default 255, or 65535 of 16 bits.
pub(super) fn read_id_png(
    path: &Path,
    segments: usize,
    none: Option<u16>,
) -> Result<SegmentMap, LiftError> {
    let (width, height, values, default) = read_ids(path)?;
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
