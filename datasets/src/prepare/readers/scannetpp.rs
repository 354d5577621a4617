//! ScanNet++: as ScanNet, under other names; a vertex in several objects belongs to the smallest.

use super::super::scan::ScanPoints;
use super::scannet::of_mesh;
use crate::DataError;
use scenesplat_scene::formats::ply::PlyFile;
use std::path::Path;

/// Without annotations (the hidden test set) nothing has a label.
pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let at = |name: &str| folder.join("scans").join(name);
    let mesh = PlyFile::open(&at("mesh_aligned_0.05.ply"))?;
    let (segments, groups) = (at("segments.json"), at("segments_anno.json"));
    match (segments.exists(), groups.exists()) {
        (false, false) => of_mesh(&mesh, None),
        _ => of_mesh(&mesh, Some((&segments, &groups))),
    }
}
