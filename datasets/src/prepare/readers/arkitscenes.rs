//! ARKitScenes: a mesh and upright boxes around furniture; a vertex has the name of the smallest box it is in.

use super::super::bad_file;
use super::super::scan::{
    Names, ScanPoints, WRONG_FILE, faces, read_json, vertex_normals, vertices,
};
use super::id_of;
use crate::DataError;
use scenesplat_scene::formats::ply::PlyFile;
use serde_json::Value;
use std::path::Path;

struct Box3 {
    centre: [f64; 3],
    /// Half of the lengths.
    half: [f64; 3],
    /// Unit directions of the sides, one a row.
    axes: [[f64; 3]; 3],
    name: i32,
}

impl Box3 {
    fn contains(&self, p: [f32; 3]) -> bool {
        let to = [0, 1, 2].map(|k| f64::from(p[k]) - self.centre[k]);
        (0..3).all(|i| {
            let axis = self.axes[i];
            (axis[0] * to[0] + axis[1] * to[1] + axis[2] * to[2]).abs() <= self.half[i]
        })
    }

    fn volume(&self) -> f64 {
        self.half.iter().product()
    }
}

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let id = id_of(folder);
    let mesh = PlyFile::open(&folder.join(format!("{id}_3dod_mesh.ply")))?;
    let path = folder.join(format!("{id}_3dod_annotation.json"));
    let json = read_json(&path)?;
    let data = json.get("data").and_then(Value::as_array);
    let data = data.ok_or_else(|| bad_file(&path, "has no list data", WRONG_FILE))?;
    let mut names = Names::default();
    let mut boxes = Vec::with_capacity(data.len());
    for (number, item) in data.iter().enumerate() {
        let bad = |what: &str| bad_file(&path, format!("data[{number}] has no {what}"), WRONG_FILE);
        let label = item.get("label").and_then(Value::as_str).ok_or_else(|| bad("label"))?;
        let aligned =
            item.pointer("/segments/obbAligned").ok_or_else(|| bad("segments.obbAligned"))?;
        let numbers = |key: &str| -> Option<Vec<f64>> {
            let flat = flat(aligned.get(key)?)?;
            flat.iter().all(|v| v.is_finite()).then_some(flat)
        };
        let three = |key: &str| -> Result<[f64; 3], DataError> {
            let found = numbers(key).and_then(|v| <[f64; 3]>::try_from(v).ok());
            found.ok_or_else(|| bad(&format!("{key} of three numbers")))
        };
        let axes = numbers("normalizedAxes").and_then(|v| <[f64; 9]>::try_from(v).ok());
        let axes = axes.ok_or_else(|| bad("normalizedAxes of nine numbers"))?;
        boxes.push(Box3 {
            centre: three("centroid")?,
            half: three("axesLengths")?.map(|v| v / 2.0),
            axes: [0, 1, 2].map(|i| [axes[3 * i], axes[3 * i + 1], axes[3 * i + 2]]),
            name: names.number(label.trim()),
        });
    }
    let coord = vertices(&mesh)?;
    let smallest = |p: &[f32; 3]| {
        let inside = (0..).zip(&boxes).filter(|(_, b)| b.contains(*p));
        inside.min_by(|(_, a), (_, b)| a.volume().total_cmp(&b.volume()))
    };
    let found: Vec<_> = coord.iter().map(smallest).collect();
    let raw = found.iter().map(|b| b.as_ref().map_or(-1, |(_, b)| b.name)).collect();
    let instance = found.iter().map(|b| b.as_ref().map_or(-1, |(number, _)| *number)).collect();
    drop(found);
    let normal = match mesh.element("face").is_some_and(|e| e.count > 0) {
        true => Some(vertex_normals(&coord, &faces(&mesh, coord.len(), &[])?)),
        false => None,
    };
    Ok(ScanPoints { coord, normal, raw, names: names.list, instance })
}

/// Numbers of a list, or of a list of lists.
fn flat(value: &Value) -> Option<Vec<f64>> {
    let mut out = Vec::new();
    for item in value.as_array()? {
        match item {
            Value::Array(inner) => {
                for v in inner {
                    out.push(v.as_f64()?);
                }
            }
            other => out.push(other.as_f64()?),
        }
    }
    Some(out)
}
