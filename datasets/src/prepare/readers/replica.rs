//! Replica: the mesh for AI Habitat, whose faces name objects.

use super::super::scan::{Names, ScanPoints, faces, items, read_json, vertex_normals, vertices};
use super::majority;
use crate::DataError;
use scenesplat_scene::formats::ply::PlyFile;
use std::collections::BTreeMap;
use std::path::Path;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let mesh = PlyFile::open(&folder.join("habitat/mesh_semantic.ply"))?;
    let path = folder.join("habitat/info_semantic.json");
    let info = read_json(&path)?;
    let mut names = Names::default();
    let mut known: BTreeMap<i64, i32> = BTreeMap::new();
    for object in items(&path, &info, "objects")? {
        known.insert(object.whole(&["id"])?, names.number(object.text("class_name")?));
    }
    let coord = vertices(&mesh)?;
    let faces = faces(&mesh, coord.len(), &["object_id"])?;
    let found = majority(coord.len(), &faces, |face| faces.columns[0][face]);
    // An object that the list lacks has no name.
    let named = |id: &Option<i64>| id.filter(|id| known.contains_key(id));
    let raw = found.iter().map(|id| named(id).map_or(-1, |id| known[&id])).collect();
    let number = |id: &Option<i64>| named(id).and_then(|id| i32::try_from(id).ok()).unwrap_or(-1);
    let instance = found.iter().map(number).collect();
    let normal = Some(vertex_normals(&coord, &faces));
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}
