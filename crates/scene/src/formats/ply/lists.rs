//! Elements with a list in each row: the faces of meshes.

use super::PlyFile;
use super::header::PlyPropertyKind;
use super::layout::Cell;
use crate::SceneError;
use crate::input_file::reserve;

/// Rows of an element with lists.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PlyLists {
    /// Where the list of each row begins in `values`, and where the last one ends. `[N + 1]`
    pub offsets: Vec<usize>,
    /// The lists, one after the other.
    pub values: Vec<i64>,
    /// The other columns that were asked for. `[columns][N]`
    pub columns: Vec<Vec<i64>>,
}

impl PlyLists {
    /// The list of a row.
    pub fn row(&self, row: usize) -> &[i64] {
        &self.values[self.offsets[row]..self.offsets[row + 1]]
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl PlyFile {
    /// A list of whole numbers per row, and single numbers beside it; floats are cut to their whole part.
    ///
    /// # Errors
    /// If the element, the list or a column does not exist.
    pub fn lists(
        &self,
        element: &str,
        list: &str,
        columns: &[&str],
    ) -> Result<PlyLists, SceneError> {
        let missing = |what: String| {
            let known: Vec<&str> = self.elements().iter().map(|e| e.name.as_str()).collect();
            let problem = format!("has no {what}; its elements are: {}", known.join(", "));
            SceneError::format(self.path(), problem, "is it the right file?")
        };
        let place = self.elements().iter().position(|e| e.name == element);
        let index = place.ok_or_else(|| missing(format!("element {element}")))?;
        let about = &self.elements()[index];
        let is_list = |name: &str| about.property(name).is_some_and(|p| p.is_list());
        if !is_list(list) {
            return Err(missing(format!("list {list} in {element}")));
        }
        if let Some(column) = columns.iter().find(|c| !about.has(c)) {
            return Err(missing(format!("property {column} in {element}")));
        }
        let bytes = self.bytes();
        let mut at = self.layouts[index].start;
        let mut out = PlyLists::default();
        reserve(&mut out.offsets, about.count + 1, self.path())?;
        out.offsets.push(0);
        out.columns = vec![Vec::with_capacity(about.count); columns.len()];
        for _ in 0..about.count {
            for property in &about.properties {
                match property.kind {
                    PlyPropertyKind::Scalar(ty) => {
                        if let Some(column) = columns.iter().position(|c| *c == property.name) {
                            let cell = Cell { offset: at, ty };
                            out.columns[column].push(cell.read_i64(bytes, self.big_endian));
                        }
                        at += ty.size();
                    }
                    PlyPropertyKind::List { count, item } => {
                        let cell = Cell { offset: at, ty: count };
                        // The walk over the file has found it whole.
                        let length = cell.read_i64(bytes, self.big_endian).max(0) as usize;
                        at += count.size();
                        if property.name == list {
                            let value = |k: usize| {
                                let cell = Cell { offset: at + k * item.size(), ty: item };
                                cell.read_i64(bytes, self.big_endian)
                            };
                            out.values.extend((0..length).map(value));
                        }
                        at += length * item.size();
                    }
                }
            }
            out.offsets.push(out.values.len());
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use std::path::Path;

    const HEADER: &str = "element vertex 2\nproperty float x\nelement face 3\n\
                          property list uchar int vertex_indices\nproperty ushort object_id\n\
                          end_header\n";

    #[test]
    fn faces_of_text_and_binary_files() {
        let text =
            format!("ply\nformat ascii 1.0\n{HEADER}0.5\n1.5\n3 0 1 1 7\n4 1 0 1 0 65535\n0 2\n");
        let mut binary = format!("ply\nformat binary_little_endian 1.0\n{HEADER}").into_bytes();
        binary.extend([0.5f32, 1.5].iter().flat_map(|v| v.to_le_bytes()));
        for (list, id) in [(&[0i32, 1, 1][..], 7u16), (&[1, 0, 1, 0], 65535), (&[], 2)] {
            binary.push(list.len() as u8);
            binary.extend(list.iter().flat_map(|v| v.to_le_bytes()));
            binary.extend(id.to_le_bytes());
        }
        for bytes in [text.as_bytes(), &binary] {
            let file = PlyFile::from_bytes(bytes, Path::new("mesh.ply")).unwrap();
            let faces = file.lists("face", "vertex_indices", &["object_id"]).unwrap();
            assert_eq!((faces.len(), faces.row(1)), (3, &[1, 0, 1, 0][..]));
            assert_eq!((faces.row(0), faces.row(2)), (&[0, 1, 1][..], &[][..]));
            assert_eq!(faces.columns, [[7, 65535, 2]]);
            assert_eq!(file.column_f32("vertex", "x").unwrap(), [0.5, 1.5]);
            for (element, list, column) in [
                ("faces", "vertex_indices", "object_id"),
                ("face", "object_id", "object_id"),
                ("face", "vertex_indices", "class"),
            ] {
                let error = file.lists(element, list, &[column]).unwrap_err().to_string();
                assert!(error.contains("mesh.ply: has no "), "{error}");
            }
        }
    }
}
