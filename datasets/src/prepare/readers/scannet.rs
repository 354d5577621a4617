//! ScanNet: a mesh, its over-segmentation by vertices, groups of segments.

use super::super::bad_file;
use super::super::scan::{Groups, Names, ScanPoints, faces, vertex_normals, vertices};
use super::id_of;
use crate::DataError;
use scenesplat_scene::formats::ply::PlyFile;
use std::path::Path;

/// Without annotations (the hidden test set) nothing has a label.
pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let id = id_of(folder);
    let at = |ending: &str| folder.join(format!("{id}{ending}"));
    let mesh = PlyFile::open(&at("_vh_clean_2.ply"))?;
    let (segments, groups) = (at("_vh_clean_2.0.010000.segs.json"), at(".aggregation.json"));
    match (segments.exists(), groups.exists()) {
        (false, false) => of_mesh(&mesh, None),
        _ => of_mesh(&mesh, Some((&segments, &groups))),
    }
}

/// Points of a mesh whose vertices are in segments, and segments in objects.
pub(super) fn of_mesh(
    mesh: &PlyFile,
    annotation: Option<(&Path, &Path)>,
) -> Result<ScanPoints, DataError> {
    let coord = vertices(mesh)?;
    let normal = match mesh.element("face") {
        Some(_) => Some(vertex_normals(&coord, &faces(mesh, coord.len(), &[])?)),
        None => None,
    };
    let count = coord.len();
    let mut out = ScanPoints {
        coord,
        normal,
        raw: vec![-1; count],
        names: Vec::new(),
        instance: vec![-1; count],
    };
    let Some((segments, groups)) = annotation else { return Ok(out) };
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
