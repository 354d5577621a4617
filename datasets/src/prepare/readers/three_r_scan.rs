//! 3RScan: a cloud whose vertices name objects, and the objects' names.

use super::super::scan::{Names, ScanPoints, WRONG_FILE, items, normals, read_json, vertices};
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::formats::ply::PlyFile;
use std::collections::BTreeMap;
use std::path::Path;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    // The second version of the annotations, or the first.
    let version = if folder.join("semseg.v2.json").exists() { ".v2" } else { "" };
    let mesh = PlyFile::open(&folder.join(format!("labels.instances.annotated{version}.ply")))?;
    let path = folder.join(format!("semseg{version}.json"));
    let json = read_json(&path)?;
    let mut names = Names::default();
    let mut known: BTreeMap<i64, i32> = BTreeMap::new();
    for group in items(&path, &json, "segGroups")? {
        let label = group.text("label")?;
        known.insert(group.whole(&["objectId", "id"])?, names.number(label.trim()));
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
    let normal = normals(&mesh, &coord)?;
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}
