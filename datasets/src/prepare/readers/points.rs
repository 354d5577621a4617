//! A cloud or mesh of one's own: numbers at the vertices.

use super::super::scan::{Names, ScanPoints, normals, vertices};
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::formats::ply::PlyFile;
use std::path::Path;

/// Names are the numbers as text; below 0 is no label.
pub(super) fn read(path: &Path) -> Result<ScanPoints, DataError> {
    let file = PlyFile::open(path)?;
    let coord = vertices(&file)?;
    let about = file.element("vertex");
    let has = |name: &str| about.is_some_and(|e| e.has(name));
    let Some(property) = ["segment", "label", "semantic"].into_iter().find(|p| has(p)) else {
        let help = "give the vertices a whole number called segment or label";
        return Err(bad_file(path, "its vertices have no labels", help));
    };
    let mut names = Names::default();
    let number = |v: i64| if v < 0 { -1 } else { names.number(&v.to_string()) };
    let raw = file.column_i64("vertex", property)?.into_iter().map(number).collect();
    let instance = match ["instance", "objectId"].into_iter().find(|p| has(p)) {
        Some(property) => file.column_i64("vertex", property)?,
        None => vec![-1; coord.len()],
    };
    let instance = instance.into_iter().map(|v| i32::try_from(v).unwrap_or(-1)).collect();
    let normal = normals(&file, &coord)?;
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}
