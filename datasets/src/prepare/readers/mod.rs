//! Layouts of benchmarks, one a file.

mod arkitscenes;
mod boxes;
pub(super) mod hypersim;
mod interiorgs;
mod matterport3d;
mod points;
mod replica;
mod scannet;
mod scannetpp;
mod three_r_scan;

use super::ScanPoints;
use crate::DataError;
use crate::files::name_of;
use scenesplat_scene::formats::ply::PlyLists;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::Path;

/// How the files of a scan are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ScanLayout {
    /// A folder `<id>` with `<id>_vh_clean_2.ply`, `<id>_vh_clean_2.0.010000.segs.json` and `<id>.aggregation.json`.
    Scannet,
    /// A folder with `scans/mesh_aligned_0.05.ply`, `scans/segments.json` and `scans/segments_anno.json`.
    ScannetPp,
    /// `region_segmentations/regionN.ply` with `regionN.fsegs.json` and `regionN.semseg.json` beside it.
    Matterport3d,
    /// A folder with `habitat/mesh_semantic.ply` and `habitat/info_semantic.json`.
    Replica,
    /// A folder with `labels.instances.annotated.v2.ply` and `semseg.v2.json`, or both without `.v2`.
    ThreeRScan,
    /// A folder `<id>` with `<id>_3dod_mesh.ply` and `<id>_3dod_annotation.json`: boxes.
    Arkitscenes,
    /// A folder with `_detail/metadata_scene.csv` and, in `images`, `scene_cam_XX_geometry_hdf5` of
    /// `frame.IIII.{position,semantic,semantic_instance}.hdf5`, `normal_world` too where it is there: pixels, of which
    /// each cube of 2 cm becomes one point.
    Hypersim,
    /// A folder with `3dgs_compressed.ply` and `labels.json`: boxes around things, of Gaussians instead of points.
    InteriorGs,
    /// A PLY file whose vertices have a number `segment` or `label`, and perhaps `instance`.
    Points,
}

impl ScanLayout {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Scannet,
        Self::ScannetPp,
        Self::Matterport3d,
        Self::Replica,
        Self::ThreeRScan,
        Self::Arkitscenes,
        Self::Hypersim,
        Self::InteriorGs,
        Self::Points,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scannet => "scannet",
            Self::ScannetPp => "scannetpp",
            Self::Matterport3d => "matterport3d",
            Self::Replica => "replica",
            Self::ThreeRScan => "3rscan",
            Self::Arkitscenes => "arkitscenes",
            Self::Hypersim => "hypersim",
            Self::InteriorGs => "interiorgs",
            Self::Points => "points",
        }
    }
}

/// Reads the labeled points of a scan.
///
/// # Errors
/// If a file is missing or is not what the layout says; names it and what is wrong.
pub fn read_scan(path: &Path, layout: ScanLayout) -> Result<ScanPoints, DataError> {
    match layout {
        ScanLayout::Scannet => scannet::read(path),
        ScanLayout::ScannetPp => scannetpp::read(path),
        ScanLayout::Matterport3d => matterport3d::read(path),
        ScanLayout::Replica => replica::read(path),
        ScanLayout::ThreeRScan => three_r_scan::read(path),
        ScanLayout::Arkitscenes => arkitscenes::read(path),
        ScanLayout::Hypersim => hypersim::read(path),
        ScanLayout::InteriorGs => interiorgs::read(path),
        ScanLayout::Points => points::read(path),
    }
}

/// The most frequent value of the faces around each vertex, of equals the smallest; `None` without a face.
fn majority(vertices: usize, faces: &PlyLists, value: impl Fn(usize) -> i64) -> Vec<Option<i64>> {
    let mut counts: Vec<BTreeMap<i64, u32>> = vec![BTreeMap::new(); vertices];
    for face in 0..faces.len() {
        for &corner in faces.row(face) {
            *counts[corner as usize].entry(value(face)).or_default() += 1;
        }
    }
    let most = |counts: BTreeMap<i64, u32>| {
        let most = counts.into_iter().max_by_key(|&(value, count)| (count, Reverse(value)));
        most.map(|(value, _)| value)
    };
    counts.into_iter().map(most).collect()
}

/// The name of a folder, which is that of the scan.
fn id_of(folder: &Path) -> String {
    name_of(&folder.canonicalize().unwrap_or_else(|_| folder.to_owned()))
}

#[cfg(test)]
mod tests;
