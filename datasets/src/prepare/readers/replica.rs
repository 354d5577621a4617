//! Replica: the mesh for AI Habitat, whose faces name objects.

use super::super::bad_file;
use super::super::scan::{
    Names, ScanPoints, WRONG_FILE, faces, read_json, vertex_normals, vertices,
};
use super::majority;
use crate::DataError;
use scenesplat_scene::formats::ply::PlyFile;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let mesh = PlyFile::open(&folder.join("habitat/mesh_semantic.ply"))?;
    let path = folder.join("habitat/info_semantic.json");
    let info = read_json(&path)?;
    let objects = info.get("objects").and_then(Value::as_array);
    let objects = objects.ok_or_else(|| bad_file(&path, "has no list objects", WRONG_FILE))?;
    let mut names = Names::default();
    let mut known: BTreeMap<i64, i32> = BTreeMap::new();
    for (number, object) in objects.iter().enumerate() {
        let bad =
            |what: &str| bad_file(&path, format!("objects[{number}] has no {what}"), WRONG_FILE);
        let id = object.get("id").and_then(Value::as_i64).ok_or_else(|| bad("id"))?;
        let name =
            object.get("class_name").and_then(Value::as_str).ok_or_else(|| bad("class_name"))?;
        known.insert(id, names.number(name));
    }
    let coord = vertices(&mesh)?;
    let faces = faces(&mesh, coord.len(), &["object_id"])?;
    let corners = |face: usize| faces.row(face).iter().map(|&v| v as usize).collect();
    let ids = &faces.columns[0];
    let found = majority(coord.len(), (0..faces.len()).map(|f| (corners(f), ids[f])));
    // An object that the list lacks has no name.
    let named = |id: &Option<i64>| id.filter(|id| known.contains_key(id));
    let raw = found.iter().map(|id| named(id).map_or(-1, |id| known[&id])).collect();
    let instance =
        found.iter().map(|id| named(id).and_then(|id| i32::try_from(id).ok()).unwrap_or(-1));
    let instance = instance.collect();
    let normal = Some(vertex_normals(&coord, &faces));
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}
