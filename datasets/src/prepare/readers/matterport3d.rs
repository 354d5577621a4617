//! Matterport3D: regions of a house; segments by faces, a vertex takes the name that most of its faces have.

use super::super::scan::{Groups, Names, ScanPoints, faces, vertex_normals, vertices};
use super::majority;
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::formats::ply::PlyFile;
use std::path::Path;

pub(super) fn read(region: &Path) -> Result<ScanPoints, DataError> {
    let mesh = PlyFile::open(region)?;
    let (segments, groups) =
        (region.with_extension("fsegs.json"), region.with_extension("semseg.json"));
    let coord = vertices(&mesh)?;
    let faces = faces(&mesh, coord.len(), &[])?;
    let annotation = Groups::read(&segments, &groups)?;
    if annotation.segments.len() != faces.len() {
        let problem = format!(
            "has segments of {} faces, {} has {}",
            annotation.segments.len(),
            region.display(),
            faces.len()
        );
        return Err(bad_file(&segments, problem, "both have to be of one region"));
    }
    let objects = annotation.object_of_segment();
    let object =
        |face: usize| objects.get(&annotation.segments[face]).map_or(-1, |&object| object as i64);
    let found = majority(coord.len(), &faces, object);
    let mut names = Names::default();
    let numbers: Vec<i32> =
        annotation.objects.iter().map(|(_, name, _)| names.number(name)).collect();
    let of = |object: &Option<i64>| object.and_then(|o| usize::try_from(o).ok());
    let raw = found.iter().map(|o| of(o).map_or(-1, |o| numbers[o])).collect();
    let id = |o: usize| i32::try_from(annotation.objects[o].0).unwrap_or(-1);
    let instance = found.iter().map(|o| of(o).map_or(-1, id)).collect();
    let normal = Some(vertex_normals(&coord, &faces));
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}
