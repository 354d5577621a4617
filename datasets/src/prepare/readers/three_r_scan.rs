//! 3RScan: a cloud whose vertices name objects, and the objects' names.

use super::super::bad_file;
use super::super::scan::{
    Names, ScanPoints, WRONG_FILE, faces, read_json, vertex_normals, vertices,
};
use crate::DataError;
use scenesplat_scene::formats::ply::PlyFile;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    // The second version of the annotations, or the first.
    let version = if folder.join("semseg.v2.json").exists() { ".v2" } else { "" };
    let mesh = PlyFile::open(&folder.join(format!("labels.instances.annotated{version}.ply")))?;
    let path = folder.join(format!("semseg{version}.json"));
    let json = read_json(&path)?;
    let groups = json.get("segGroups").and_then(Value::as_array);
    let groups = groups.ok_or_else(|| bad_file(&path, "has no list segGroups", WRONG_FILE))?;
    let mut names = Names::default();
    let mut known: BTreeMap<i64, i32> = BTreeMap::new();
    for (number, group) in groups.iter().enumerate() {
        let bad =
            |what: &str| bad_file(&path, format!("segGroups[{number}] has no {what}"), WRONG_FILE);
        let id = group.get("objectId").or_else(|| group.get("id")).and_then(Value::as_i64);
        let label = group.get("label").and_then(Value::as_str).ok_or_else(|| bad("label"))?;
        known.insert(id.ok_or_else(|| bad("objectId"))?, names.number(label.trim()));
    }
    let coord = vertices(&mesh)?;
    let about = mesh.element("vertex");
    let property = ["objectId", "object_id"].into_iter().find(|p| about.is_some_and(|e| e.has(p)));
    let Some(property) = property else {
        return Err(bad_file(mesh.path(), "its vertices have no objectId", WRONG_FILE));
    };
    let ids = mesh.column_i64("vertex", property)?;
    let raw = ids.iter().map(|id| known.get(id).copied().unwrap_or(-1)).collect();
    let number =
        |id: &i64| i32::try_from(*id).ok().filter(|_| known.contains_key(id)).unwrap_or(-1);
    let instance = ids.iter().map(number).collect();
    let has_faces = mesh.element("face").is_some_and(|e| e.count > 0);
    let normal = match has_faces {
        true => Some(vertex_normals(&coord, &faces(&mesh, coord.len(), &[])?)),
        false => None,
    };
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}
