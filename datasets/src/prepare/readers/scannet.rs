//! ScanNet: a mesh, its over-segmentation by vertices, groups of segments.

use super::super::scan::{Groups, Names, ScanPoints, normals, vertices};
use super::id_of;
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::formats::ply::PlyFile;
use std::path::Path;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let id = id_of(folder);
    let at = |ending: &str| folder.join(format!("{id}{ending}"));
    let segments = at("_vh_clean_2.0.010000.segs.json");
    of_mesh(&at("_vh_clean_2.ply"), &segments, &at(".aggregation.json"))
}

/// Points of a mesh whose vertices are in segments, and segments in objects. Without either file (the
/// hidden test set) nothing has a label.
pub(super) fn of_mesh(
    mesh: &Path,
    segments: &Path,
    groups: &Path,
) -> Result<ScanPoints, DataError> {
    let mesh = PlyFile::open(mesh)?;
    let coord = vertices(&mesh)?;
    let (count, normal) = (coord.len(), normals(&mesh, &coord)?);
    let (raw, instance) = (vec![-1; count], vec![-1; count]);
    let mut out = ScanPoints { coord, normal, raw, names: Vec::new(), instance };
    if !segments.exists() && !groups.exists() {
        return Ok(out);
    }
    let groups = Groups::read(segments, groups)?;
    if groups.segments.len() != count {
        let problem = format!(
            "has segments of {} vertices, {} has {count}",
            groups.segments.len(),
            mesh.path().display()
        );
        return Err(bad_file(segments, problem, "both have to be of one scan"));
    }
    let objects = groups.object_of_segment();
    let mut names = Names::default();
    let numbers: Vec<i32> = groups.objects.iter().map(|(_, name, _)| names.number(name)).collect();
    for (vertex, segment) in groups.segments.iter().enumerate() {
        if let Some(&object) = objects.get(segment) {
            out.raw[vertex] = numbers[object];
            out.instance[vertex] = i32::try_from(groups.objects[object].0).unwrap_or(-1);
        }
    }
    out.names = names.list;
    Ok(out)
}
