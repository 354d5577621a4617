//! Maps of segment ids as `.npy`.

use crate::lifting::{LiftError, NO_SEGMENT, SegmentMap};
use scenesplat_scene::formats::npy::NpyFile;
use std::path::Path;

/// The most granularities of a picture.
pub(super) const MAX_LEVELS: usize = 4;

/// Reads the granularities `levels` of ids below `segments`.
pub(super) fn read_id_maps(
    path: &Path,
    levels: &[usize],
    segments: usize,
) -> Result<Vec<SegmentMap>, LiftError> {
    let file = NpyFile::open(path)?;
    let shape = file.shape();
    let (count, height, width) = match *shape {
        [height, width] => (1, height, width),
        [count @ 1..=MAX_LEVELS, height, width] => (count, height, width),
        _ => {
            let problem = format!("holds an array of shape {shape:?}");
            return Err(LiftError::file(path, problem, "ids are [levels ≤ 4, height, width]"));
        }
    };
    if height == 0 || width == 0 || height > 65_535 || width > 65_535 {
        let problem = format!("holds maps of {width}×{height} pixels");
        return Err(LiftError::file(path, problem, "1 to 65535 on each side are expected"));
    }
    if let Some(level) = levels.iter().find(|&&level| level >= count) {
        let problem = format!("has {count} levels, level {level} was asked for");
        return Err(LiftError::file(path, problem, "levels are counted from 0"));
    }
    let ids = file.read_i64()?;
    let pixels = height * width;
    let mut maps = Vec::with_capacity(levels.len());
    for &level in levels {
        let level_ids = &ids[level * pixels..(level + 1) * pixels];
        let mut map = Vec::with_capacity(pixels);
        for (at, &id) in level_ids.iter().enumerate() {
            map.push(match usize::try_from(id) {
                Ok(id) if id < segments => id as u16,
                Err(_) if id == -1 => NO_SEGMENT,
                _ => {
                    let problem = format!(
                        "level {level}, row {}, column {}: id {id}",
                        at / width,
                        at % width
                    );
                    let help = format!("the feature table has {segments} rows; -1 is no segment");
                    return Err(LiftError::file(path, problem, help));
                }
            });
        }
        // Sides are at most 65535.
        maps.push(SegmentMap::new(width as u32, height as u32, map)?);
    }
    Ok(maps)
}
