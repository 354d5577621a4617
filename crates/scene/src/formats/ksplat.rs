//! `.ksplat` files of the viewer GaussianSplats3D, version 0.1: sections of buckets.
//!
//! A header, the headers of the sections, then section by section how full its last buckets are,
//! the centers of its buckets and its records. Level 0 stores floats; levels 1 and 2 store
//! positions as 16-bit offsets from the center of the bucket, sizes and rotations as half floats,
//! and coefficients as half floats or bytes. Reading only; writing is left to that viewer's tools,
//! which reorder the scene and leave faint Gaussians out.

mod header;
mod record;

use super::scene_blocks::fill_scene;
use super::{LoadedScene, ReadOptions, SceneFormat, semantics};
use crate::value_policy::Rule;
use crate::{RepairReport, SceneError};
use header::{HEADER_BYTES, MAX_LEVEL, SECTION_HEADER_BYTES, parse, u16_at, u32_at};
use record::Decoder;
use std::path::Path;

/// Whether these bytes, a whole file, begin like a `.ksplat` file.
///
/// There is no magic number: the version, the level and the zeros after the header's fields must
/// be as every known file has them, and the headers of the sections must fit into the file.
pub fn is_ksplat(bytes: &[u8]) -> bool {
    let Some(header) = bytes.get(..HEADER_BYTES) else { return false };
    let sections = u64::from(u32_at(header, 4));
    header[0] == 0
        && header[1] >= 1
        && header[2..4] == [0, 0]
        && u16_at(header, 20) <= MAX_LEVEL
        && header[44..].iter().all(|&b| b == 0)
        && sections * SECTION_HEADER_BYTES as u64 <= (bytes.len() - HEADER_BYTES) as u64
}

/// Reads a scene from the bytes of a `.ksplat` file, and the labels beside it if there are any.
///
/// Rows follow the file, section by section. All headers of sections are used, however many the
/// file calls loaded, and positions are taken as they are: the center of the scene in the header
/// only informs. Both is what the viewer does. Where sections differ in the degree of their
/// harmonics the highest is used, with coefficients of 0 for the others. Degree 3, which that
/// viewer does not write, is read in the same pattern.
///
/// # Errors
/// As [`super::open_scene`]; also if the version or level is unknown, if a section does not fit
/// into the file, if its buckets do not add up, or if the header counts another number of
/// Gaussians than the sections hold.
pub fn read_ksplat(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    let file = parse(bytes).map_err(|problem| {
        let help = "the file is damaged or cut short; export the scene again";
        SceneError::format(path, problem, help)
    })?;
    let mut report = RepairReport::default();
    if file.end < bytes.len() {
        let example = format!("{} bytes", bytes.len() - file.end);
        report.add(Rule::FileTrailing, 1, file.rows, &example);
    }
    let degree = file.sections.iter().map(|s| s.sh_degree).max().unwrap_or(0);
    let degree = if options.sh_rest { degree } else { 0 };
    let decoder = Decoder::new(&file);
    let mut scene = fill_scene(file.rows, degree, |mut block| {
        let end = block.first_row + block.coord.len();
        let first = file.sections.partition_point(|s| s.first_row + s.rows <= block.first_row);
        for section in file.sections[first..].iter().take_while(|s| s.first_row < end) {
            decoder.fill(section, &mut block);
        }
    });
    semantics::read_sidecar(path, bytes, file.rows, options.policy, &mut scene, &mut report)?;
    LoadedScene::finish(scene, report, options.policy, path, SceneFormat::Ksplat)
}
