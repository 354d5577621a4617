//! What a scan says about its points, whatever its files look like.

use super::bad_file;
use crate::DataError;
use scenesplat_scene::formats::ply::{PlyFile, PlyLists};
use std::collections::BTreeMap;
use std::path::Path;

/// Labelled points of a scan: the vertices of its mesh, in the order of the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScanPoints {
    /// Positions, metres, in the frame of the scan. `[M, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Unit normals, 0 where a vertex has no face; absent without faces. `[M, 3]`
    pub normal: Option<Vec<[f32; 3]>>,
    /// Row of `names`; −1 = no label. `[M]`
    pub raw: Vec<i32>,
    /// What annotators wrote, each once, in the order in which they came up.
    pub names: Vec<String>,
    /// Number of the object as the benchmark counts it; −1 = none. `[M]`
    pub instance: Vec<i32>,
}

/// Gives numbers to names in the order in which they come up.
#[derive(Debug, Default)]
pub(super) struct Names {
    known: BTreeMap<String, i32>,
    pub(super) list: Vec<String>,
}

impl Names {
    pub(super) fn number(&mut self, name: &str) -> i32 {
        if let Some(&number) = self.known.get(name) {
            return number;
        }
        let number = self.list.len() as i32;
        self.list.push(name.to_owned());
        self.known.insert(name.to_owned(), number);
        number
    }
}

/// The vertices of a mesh; every position finite.
pub(super) fn vertices(file: &PlyFile) -> Result<Vec<[f32; 3]>, DataError> {
    let coord = file.rows_f32("vertex", ["x", "y", "z"])?;
    if let Some(row) = coord.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
        let problem = format!("vertex {row} is at {:?}", coord[row]);
        return Err(bad_file(file.path(), problem, "positions have to be finite"));
    }
    if coord.is_empty() {
        return Err(bad_file(file.path(), "has no vertices", "is it the right file?"));
    }
    Ok(coord)
}

/// The faces of a mesh, under either of the names that programs give them; every index that of a vertex.
pub(super) fn faces(
    file: &PlyFile,
    vertices: usize,
    columns: &[&str],
) -> Result<PlyLists, DataError> {
    let about = file.element("face");
    let is_there = |name: &str| about.and_then(|e| e.property(name)).is_some();
    let list = if is_there("vertex_index") { "vertex_index" } else { "vertex_indices" };
    let faces = file.lists("face", list, columns)?;
    let outside = |v: &&i64| !usize::try_from(**v).is_ok_and(|v| v < vertices);
    if let Some(vertex) = faces.values.iter().find(outside) {
        let problem = format!("a face names vertex {vertex}, there are {vertices}");
        return Err(bad_file(file.path(), problem, "the file is damaged, fetch it again"));
    }
    Ok(faces)
}

/// Normals of vertices: of the faces around each, weighted by their area, summed in f64.
///
/// # Shapes
/// `coord`: `[M, 3]` · `faces`: lists of at least three rows of `coord` · returns `[M, 3]`, unit; 0 where a vertex has
/// no face with an area
pub fn vertex_normals(coord: &[[f32; 3]], faces: &PlyLists) -> Vec<[f32; 3]> {
    let mut sums = vec![[0.0f64; 3]; coord.len()];
    let at = |v: i64| coord[v as usize].map(f64::from);
    for face in (0..faces.len()).map(|row| faces.row(row)).filter(|face| face.len() >= 3) {
        // A fan of triangles; twice the area is the length of the cross product.
        for pair in face[1..].windows(2) {
            let (a, b, c) = (at(face[0]), at(pair[0]), at(pair[1]));
            let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
            let n =
                [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            for &vertex in [face[0], pair[0], pair[1]].iter() {
                let sum = &mut sums[vertex as usize];
                (0..3).for_each(|k| sum[k] += n[k]);
            }
        }
    }
    let unit = |n: [f64; 3]| {
        let length = n.iter().map(|v| v * v).sum::<f64>().sqrt();
        n.map(|v| if length > 0.0 { (v / length) as f32 } else { 0.0 })
    };
    sums.into_iter().map(unit).collect()
}

/// Per-vertex segment numbers and the groups of segments that are objects, as ScanNet has them.
pub(super) struct Groups {
    /// Segment of each vertex or face.
    pub(super) segments: Vec<i64>,
    /// Objects: number, name, segments.
    pub(super) objects: Vec<(i64, String, Vec<i64>)>,
}

impl Groups {
    /// Reads `segIndices` of one file and `segGroups` of another.
    pub(super) fn read(segments: &Path, groups: &Path) -> Result<Self, DataError> {
        let segments_json = read_json(segments)?;
        let list = |value: Option<&serde_json::Value>| -> Option<Vec<i64>> {
            value?.as_array()?.iter().map(serde_json::Value::as_i64).collect()
        };
        let indices = list(segments_json.get("segIndices")).ok_or_else(|| {
            bad_file(segments, "has no list segIndices of whole numbers", WRONG_FILE)
        })?;
        let groups_json = read_json(groups)?;
        let found = groups_json.get("segGroups").and_then(serde_json::Value::as_array);
        let found = found.ok_or_else(|| bad_file(groups, "has no list segGroups", WRONG_FILE))?;
        let mut objects = Vec::with_capacity(found.len());
        for (number, group) in found.iter().enumerate() {
            let bad = |what: &str| {
                bad_file(groups, format!("segGroups[{number}] has no {what}"), WRONG_FILE)
            };
            let id = group.get("objectId").or_else(|| group.get("id"));
            let id = id.and_then(serde_json::Value::as_i64).ok_or_else(|| bad("objectId"))?;
            let label = group.get("label").and_then(serde_json::Value::as_str);
            let label = label.ok_or_else(|| bad("label"))?.trim().to_owned();
            let parts =
                list(group.get("segments")).ok_or_else(|| bad("list segments of whole numbers"))?;
            objects.push((id, label, parts));
        }
        Ok(Self { segments: indices, objects })
    }

    /// The object of each segment; of several the one with the fewest vertices or faces, of these the first.
    pub(super) fn object_of_segment(&self) -> BTreeMap<i64, usize> {
        let mut sizes: BTreeMap<i64, usize> = BTreeMap::new();
        for &segment in &self.segments {
            *sizes.entry(segment).or_default() += 1;
        }
        let size = |object: usize| -> usize {
            self.objects[object].2.iter().map(|s| sizes.get(s).copied().unwrap_or(0)).sum()
        };
        let mut out: BTreeMap<i64, usize> = BTreeMap::new();
        for (object, (_, _, parts)) in self.objects.iter().enumerate() {
            for &part in parts {
                let smaller = out.get(&part).is_none_or(|&other| size(object) < size(other));
                if smaller {
                    out.insert(part, object);
                }
            }
        }
        out
    }
}

pub(super) const WRONG_FILE: &str = "is it the file that the layout asks for?";

/// A JSON file.
pub(super) fn read_json(path: &Path) -> Result<serde_json::Value, DataError> {
    let bytes = scenesplat_scene::input_file::read_file(path, 1 << 30)?;
    serde_json::from_slice(&bytes).map_err(|e| {
        bad_file(path, format!("is no JSON: {e}"), "the file is damaged, fetch it again")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_are_weighted_by_area() {
        // A square of the floor (two triangles) and a wall of a quarter of its area that share an edge.
        let coord = [
            [0., 0., 0.],
            [2., 0., 0.],
            [2., 2., 0.],
            [0., 2., 0.],
            [0., 0., 0.5],
            [2., 0., 0.5],
            [9., 9., 9.],
        ];
        let faces = PlyLists {
            offsets: vec![0, 4, 8, 10],
            values: vec![0, 1, 2, 3, 1, 0, 4, 5, 2, 3],
            columns: Vec::new(),
        };
        let normals = vertex_normals(&coord, &faces);
        assert_eq!(normals[2], [0.0, 0.0, 1.0]);
        assert_eq!(normals[6], [0.0; 3]);
        // Vertex 3 is in one triangle of the floor alone; vertex 0 in two of it, one of the wall's two (it is not
        // the first of that fan), twice the areas 4, 4 and 1.
        assert_eq!(normals[3], [0.0, 0.0, 1.0]);
        let wall = normals[4];
        assert_eq!(wall.map(f32::abs), [0.0, 1.0, 0.0]);
        let n = normals[0];
        assert!((n[1].abs() / n[2] - 1.0 / 8.0).abs() < 1e-6, "{n:?}");
    }
}
