//! ScanNet++: as ScanNet, under other names; a vertex in several objects belongs to the smallest.

use super::super::scan::ScanPoints;
use super::scannet::of_mesh;
use crate::DataError;
use std::path::Path;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let at = |name: &str| folder.join("scans").join(name);
    of_mesh(&at("mesh_aligned_0.05.ply"), &at("segments.json"), &at("segments_anno.json"))
}
