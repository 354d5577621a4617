//! ARKitScenes: a mesh and upright boxes around furniture; a vertex has the name of the smallest box it is in.

use super::super::scan::{Names, ScanPoints, items, normals, read_json, vertices};
use super::boxes::{Box3, label};
use super::id_of;
use crate::DataError;
use scenesplat_scene::formats::ply::PlyFile;
use serde_json::Value;
use std::path::Path;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let id = id_of(folder);
    let mesh = PlyFile::open(&folder.join(format!("{id}_3dod_mesh.ply")))?;
    let path = folder.join(format!("{id}_3dod_annotation.json"));
    let json = read_json(&path)?;
    let mut names = Names::default();
    let mut boxes = Vec::new();
    for item in items(&path, &json, "data")? {
        let label = item.text("label")?;
        let aligned = item.value.pointer("/segments/obbAligned");
        let aligned = aligned.ok_or_else(|| item.lacks("segments.obbAligned"))?;
        let numbers = |key: &str| -> Option<Vec<f64>> {
            let flat = flat(aligned.get(key)?)?;
            flat.iter().all(|v| v.is_finite()).then_some(flat)
        };
        let three = |key: &str| -> Result<[f64; 3], DataError> {
            let found = numbers(key).and_then(|v| <[f64; 3]>::try_from(v).ok());
            found.ok_or_else(|| item.lacks(&format!("{key} of three numbers")))
        };
        let axes = numbers("normalizedAxes").and_then(|v| <[f64; 9]>::try_from(v).ok());
        let axes = axes.ok_or_else(|| item.lacks("normalizedAxes of nine numbers"))?;
        boxes.push(Box3 {
            center: three("centroid")?,
            half: three("axesLengths")?.map(|v| v / 2.0),
            axes: [0, 1, 2].map(|i| [axes[3 * i], axes[3 * i + 1], axes[3 * i + 2]]),
            name: names.number(label.trim()),
        });
    }
    let coord = vertices(&mesh)?;
    let (raw, instance) = label(&coord, &boxes);
    let normal = normals(&mesh, &coord)?;
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}

/// Numbers of a list, or of a list of lists.
fn flat(value: &Value) -> Option<Vec<f64>> {
    let lists = value.as_array()?.iter().map(|item| match item {
        Value::Array(inner) => inner.as_slice(),
        other => std::slice::from_ref(other),
    });
    lists.flatten().map(Value::as_f64).collect()
}
