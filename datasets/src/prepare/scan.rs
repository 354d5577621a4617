//! What a scan says about its points, whatever its files look like.

use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::formats::ply::{PlyFile, PlyLists};
use scenesplat_scene::vector::cross;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Labeled points of a scan: the vertices of its mesh, in the order of the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScanPoints {
    /// Positions, meters, in the frame of the scan. `[M, 3]`
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
            let n = cross(u, v);
            for vertex in [face[0], pair[0], pair[1]] {
                let sum = &mut sums[vertex as usize];
                (0..3).for_each(|k| sum[k] += n[k]);
            }
        }
    }
    sums.into_iter().map(unit_or_zero).collect()
}

/// A direction of length 1; 0 stays 0.
pub(super) fn unit_or_zero(n: [f64; 3]) -> [f32; 3] {
    let length = n.iter().map(|v| v * v).sum::<f64>().sqrt();
    n.map(|v| if length > 0.0 { (v / length) as f32 } else { 0.0 })
}

/// Normals of the vertices of a mesh; none if it has no faces.
pub(super) fn normals(
    file: &PlyFile,
    coord: &[[f32; 3]],
) -> Result<Option<Vec<[f32; 3]>>, DataError> {
    if file.element("face").is_none_or(|faces| faces.count == 0) {
        return Ok(None);
    }
    Ok(Some(vertex_normals(coord, &faces(file, coord.len(), &[])?)))
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
        let list = |value: &Value, name: &str| -> Option<Vec<i64>> {
            value.get(name)?.as_array()?.iter().map(Value::as_i64).collect()
        };
        let indices = list(&read_json(segments)?, "segIndices").ok_or_else(|| {
            bad_file(segments, "has no list segIndices of whole numbers", WRONG_FILE)
        })?;
        let mut objects = Vec::new();
        for group in items(groups, &read_json(groups)?, "segGroups")? {
            let id = group.whole(&["objectId", "id"])?;
            let label = group.text("label")?.trim().to_owned();
            let parts = list(group.value, "segments");
            let parts = parts.ok_or_else(|| group.lacks("list segments of whole numbers"))?;
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

/// One of the objects in a list of a JSON file.
pub(super) struct Item<'a> {
    path: &'a Path,
    list: &'a str,
    number: usize,
    pub(super) value: &'a Value,
}

/// The objects in the list of that name.
pub(super) fn items<'a>(
    path: &'a Path,
    json: &'a Value,
    list: &'a str,
) -> Result<Vec<Item<'a>>, DataError> {
    let found = json.get(list).and_then(Value::as_array);
    let found = found.ok_or_else(|| bad_file(path, format!("has no list {list}"), WRONG_FILE))?;
    Ok(found.iter().enumerate().map(|(number, value)| Item { path, list, number, value }).collect())
}

impl<'a> Item<'a> {
    pub(super) fn lacks(&self, what: &str) -> DataError {
        let problem = format!("{}[{}] has no {what}", self.list, self.number);
        bad_file(self.path, problem, WRONG_FILE)
    }

    pub(super) fn text(&self, key: &str) -> Result<&'a str, DataError> {
        self.value.get(key).and_then(Value::as_str).ok_or_else(|| self.lacks(key))
    }

    /// The whole number under the first of the names that is there.
    pub(super) fn whole(&self, keys: &[&str]) -> Result<i64, DataError> {
        let found = keys.iter().find_map(|key| self.value.get(key)).and_then(Value::as_i64);
        found.ok_or_else(|| self.lacks(keys[0]))
    }
}

/// A JSON file.
pub(super) fn read_json(path: &Path) -> Result<Value, DataError> {
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

    #[test]
    fn normals_point_where_corners_go_against_the_clock() {
        // One slanted triangle and a vertex of no face: (1, 0, 0) × (0, 2, 2) = (0, −2, 2), turned round with its corners.
        let coord = [[1., 1., 1.], [2., 1., 1.], [1., 3., 3.], [4., 4., 4.]];
        let lists = |values: &[i64], offsets: &[usize]| PlyLists {
            offsets: offsets.to_vec(),
            values: values.to_vec(),
            columns: Vec::new(),
        };
        let h = std::f32::consts::FRAC_1_SQRT_2;
        let normals = vertex_normals(&coord, &lists(&[0, 1, 2], &[0, 3]));
        let near = |a: [f32; 3], b: [f32; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-6);
        assert!(normals[..3].iter().all(|n| near(*n, [0.0, -h, h])), "{normals:?}");
        assert_eq!(normals[3], [0.0; 3]);
        let normals = vertex_normals(&coord, &lists(&[0, 2, 1], &[0, 3]));
        assert!(normals[..3].iter().all(|n| near(*n, [0.0, h, -h])), "{normals:?}");
        // Faces of two corners, and of no area, say nothing.
        assert_eq!(vertex_normals(&coord, &lists(&[0, 1, 2, 2, 2], &[0, 2, 5])), [[0.0; 3]; 4]);
        // A length of 3 by each axis.
        assert_eq!(unit_or_zero([1.0, -2.0, 2.0]), [1.0 / 3.0, -2.0 / 3.0, 2.0 / 3.0]);
    }

    #[test]
    fn of_several_objects_a_segment_belongs_to_the_one_with_the_fewest_vertices() {
        // Segment 5 is part of both: the first has two segments and eleven vertices, the second three segments and three.
        let segments = [vec![5], vec![6; 10], vec![7, 8]].concat();
        let object = |id: i64, parts: &[i64]| (id, id.to_string(), parts.to_vec());
        let groups = Groups { segments, objects: vec![object(0, &[5, 6]), object(1, &[5, 7, 8])] };
        let found = groups.object_of_segment();
        assert_eq!([5, 6, 7, 8].map(|segment| found[&segment]), [1, 0, 1, 1]);
    }
}
