//! Text vectors of classes, as a language model embeds their names.

use crate::SceneError;
use crate::class_names::read_names;
use crate::input_file::{InputFile, read_text_file};
use half::{bf16, f16};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::Deserialize;
use std::path::Path;

/// Name of the tensor that holds the vectors.
const TENSOR: &str = "text_embeddings";
/// A file beside the vectors that names their classes.
const MANIFEST: &str = "manifest_text_embeddings.json";

/// One unit vector per class.
#[derive(Debug, Clone, PartialEq)]
pub struct TextTable {
    /// Names by row.
    pub names: Vec<String>,
    /// Length of a vector.
    pub dim: usize,
    /// Vectors of unit length, row by row. `[C, dim]`
    pub values: Vec<f32>,
}

impl TextTable {
    /// A table from vectors of any length, which are divided by their norm (computed in f64).
    ///
    /// `values` is `[C, dim]` for `C` names.
    ///
    /// # Errors
    /// If there is no row, names and rows differ in number, or a row is 0 or not finite.
    pub fn from_rows(
        names: Vec<String>,
        mut values: Vec<f32>,
        dim: usize,
    ) -> Result<Self, SceneError> {
        let bad =
            |problem: String, help: &str| Err(SceneError::Classes { problem, help: help.into() });
        if dim == 0 || values.is_empty() || !values.len().is_multiple_of(dim) {
            let count = values.len();
            return bad(format!("{count} values are no table of text vectors of length {dim}"), "");
        }
        let rows = values.len() / dim;
        if rows != names.len() {
            let count = names.len();
            return bad(
                format!("there are {count} class names for {rows} text vectors"),
                "give one name for each vector, in the same order",
            );
        }
        for (row, values) in values.chunks_exact_mut(dim).enumerate() {
            let norm = values.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt();
            if !norm.is_finite() || norm == 0.0 {
                let what = if norm == 0.0 { "0" } else { "not finite" };
                return bad(
                    format!("text vector {row} (class {:?}) is {what}", names[row]),
                    "encode the class names again",
                );
            }
            values.iter_mut().for_each(|v| *v = (f64::from(*v) / norm) as f32);
        }
        Ok(Self { names, dim, values })
    }

    /// Reads vectors from `.safetensors`.
    ///
    /// They are the tensor `text_embeddings`, else the only two-dimensional tensor of floats (f32,
    /// f16 or bf16). Names come from the file `names` if given ([`read_names`]), else from the
    /// list `labels` in the tensor file's metadata (JSON), else from
    /// `manifest_text_embeddings.json` in the same folder.
    ///
    /// # Errors
    /// If a file cannot be read, no tensor fits, no names are found, or as
    /// [`from_rows`](Self::from_rows).
    pub fn read(path: &Path, names: Option<&Path>) -> Result<Self, SceneError> {
        let file = InputFile::open(path)?;
        let bad = |problem: String, help: &str| SceneError::format(path, problem, help);
        let broken = |error| bad(format!("is not a .safetensors file: {error}"), "");
        let tensors = SafeTensors::deserialize(file.bytes()).map_err(broken)?;
        let (_, metadata) = SafeTensors::read_metadata(file.bytes()).map_err(broken)?;
        let tensor = find_tensor(&tensors)
            .map_err(|problem| bad(problem, "name the tensor of vectors text_embeddings"))?;
        let &[_, dim] = tensor.shape() else {
            return Err(bad(format!("{TENSOR} has shape {:?}", tensor.shape()), ""));
        };
        let values = floats(&tensor)
            .ok_or_else(|| bad(format!("{TENSOR} holds {:?}, no floats", tensor.dtype()), ""))?;
        let labels = metadata.metadata().as_ref().and_then(|m| m.get("labels"));
        file.check_length()?;
        let names = match (names, labels) {
            (Some(names), _) => read_names(names)?,
            (None, Some(json)) => serde_json::from_str(json)
                .map_err(|_| bad("has metadata labels that are no JSON list".to_owned(), ""))?,
            (None, None) => names_in_manifest(path)?,
        };
        Self::from_rows(names, values, dim).map_err(|error| match error {
            SceneError::Classes { problem, help } => bad(problem, &help),
            other => other,
        })
    }

    /// The table as a `.safetensors` file, which [`read`](Self::read) reads back bit for bit but for the last bit of
    /// rows that are no unit vectors: `text_embeddings` in f32, the names as the metadata `labels`.
    ///
    /// # Errors
    /// If the values are no rows of the table's width, one for each name.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, SceneError> {
        let bytes: Vec<u8> = self.values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let bad = |problem: String| SceneError::Classes { problem, help: String::new() };
        let view = TensorView::new(Dtype::F32, vec![self.names.len(), self.dim], &bytes)
            .map_err(|error| bad(format!("the text table does not hold together: {error}")))?;
        let labels = serde_json::Value::from(self.names.as_slice()).to_string();
        safetensors::serialize([(TENSOR, view)], Some([("labels".to_owned(), labels)].into()))
            .map_err(|error| bad(format!("the text table cannot be written: {error}")))
    }

    /// Number of classes.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there is no class.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// The unit vector of a class; `None` beyond the last.
    pub fn row(&self, class: usize) -> Option<&[f32]> {
        self.values.chunks_exact(self.dim.max(1)).nth(class)
    }
}

fn find_tensor<'a>(tensors: &SafeTensors<'a>) -> Result<TensorView<'a>, String> {
    if let Ok(tensor) = tensors.tensor(TENSOR) {
        return Ok(tensor);
    }
    let mut found: Vec<_> = tensors
        .tensors()
        .into_iter()
        .filter(|(_, t)| t.shape().len() == 2 && floats_size(t.dtype()).is_some())
        .collect();
    found.sort_by(|a, b| a.0.cmp(&b.0));
    match found.pop() {
        Some((_, tensor)) if found.is_empty() => Ok(tensor),
        Some((name, _)) => {
            let mut names: Vec<_> = found.into_iter().map(|(name, _)| name).collect();
            names.push(name);
            Err(format!("has several tensors that may be text vectors: {}", names.join(", ")))
        }
        None => Err("has no two-dimensional tensor of floats".to_owned()),
    }
}

fn floats_size(dtype: Dtype) -> Option<usize> {
    match dtype {
        Dtype::F32 => Some(4),
        Dtype::F16 | Dtype::BF16 => Some(2),
        _ => None,
    }
}

fn floats(tensor: &TensorView<'_>) -> Option<Vec<f32>> {
    let size = floats_size(tensor.dtype())?;
    let value = |b: &[u8]| match (tensor.dtype(), b) {
        (Dtype::F16, &[a, b]) => f16::from_le_bytes([a, b]).to_f32(),
        (Dtype::BF16, &[a, b]) => bf16::from_le_bytes([a, b]).to_f32(),
        (_, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
        _ => f32::NAN,
    };
    Some(tensor.data().chunks_exact(size).map(value).collect())
}

#[derive(Deserialize)]
struct Manifest {
    entries: Vec<ManifestEntry>,
}

#[derive(Deserialize)]
struct ManifestEntry {
    file: String,
    labels: Vec<String>,
}

/// The names that the manifest beside `path` gives for it.
fn names_in_manifest(path: &Path) -> Result<Vec<String>, SceneError> {
    let help = "give a file with one class name a line";
    let manifest = path.with_file_name(MANIFEST);
    if !manifest.exists() {
        return Err(SceneError::format(path, "does not name its classes", help));
    }
    let text = read_text_file(&manifest)?;
    let parsed: Manifest = serde_json::from_str(&text)
        .map_err(|error| SceneError::format(&manifest, format!("is no manifest: {error}"), help))?;
    let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    match parsed.entries.into_iter().find(|e| e.file == name) {
        Some(entry) => Ok(entry.labels),
        None => Err(SceneError::format(&manifest, format!("has no entry for {name}"), help)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(n: usize) -> Vec<String> {
        (0..n).map(|i| format!("class {i}")).collect()
    }

    #[test]
    fn rows_become_unit_vectors() {
        // Powers of two are exact in f32; the squares of these norms are not finite in f32.
        let (tiny, huge) = (2f32.powi(-100), 2f32.powi(100));
        let values = vec![3.0 * tiny, 4.0 * tiny, -3.0 * huge, 4.0 * huge];
        let table = TextTable::from_rows(names(2), values, 2).unwrap();
        assert_eq!(table.values, [0.6, 0.8, -0.6, 0.8]);
        assert_eq!(table.row(1), Some(&[-0.6, 0.8][..]));
        assert_eq!(table.row(2), None);
    }

    #[test]
    fn bad_rows_are_named() {
        let error = TextTable::from_rows(names(2), vec![1.0, 0.0, 0.0, 0.0], 2).unwrap_err();
        let error = error.to_string();
        assert!(error.contains("vector 1") && error.contains("class 1"), "{error}");
        assert!(TextTable::from_rows(names(1), vec![f32::NAN, 1.0], 2).is_err());
        assert!(TextTable::from_rows(names(1), vec![1.0, f32::INFINITY], 2).is_err());
    }

    #[test]
    fn counts_are_named() {
        let error = TextTable::from_rows(names(3), vec![1.0; 4], 2).unwrap_err().to_string();
        assert!(error.contains("3 class names") && error.contains("2 text vectors"), "{error}");
        assert!(TextTable::from_rows(names(1), vec![1.0; 3], 2).is_err());
        assert!(TextTable::from_rows(Vec::new(), Vec::new(), 2).is_err());
        assert!(TextTable::from_rows(names(1), vec![1.0], 0).is_err());
    }

    fn save(path: &Path, tensors: &[(&str, Dtype, &[usize], Vec<u8>)], labels: Option<&str>) {
        let views =
            tensors.iter().map(|(n, d, s, b)| (*n, TensorView::new(*d, s.to_vec(), b).unwrap()));
        let metadata = labels.map(|l| [("labels".to_owned(), l.to_owned())].into());
        std::fs::write(path, safetensors::serialize(views, metadata).unwrap()).unwrap();
    }

    #[test]
    fn half_precision_and_metadata_names() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.safetensors");
        let h: Vec<u8> = [3.0, 4.0].iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect();
        let b: Vec<u8> = [3.0, 4.0].iter().flat_map(|&v| bf16::from_f32(v).to_le_bytes()).collect();
        let f: Vec<u8> = [3.0f32, 4.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        for (dtype, bytes) in [(Dtype::F16, h), (Dtype::BF16, b), (Dtype::F32, f.clone())] {
            let other = ("scale", Dtype::F32, &[1][..], vec![0; 4]);
            save(&path, &[("any", dtype, &[1, 2], bytes), other], Some(r#"["bed"]"#));
            let table = TextTable::read(&path, None).unwrap();
            assert_eq!((table.values, table.names), (vec![0.6, 0.8], vec!["bed".to_owned()]));
        }
        let two =
            [("a", Dtype::F32, &[1, 2][..], f.clone()), ("b", Dtype::F32, &[1, 2], f.clone())];
        save(&path, &two, Some(r#"["bed"]"#));
        let error = TextTable::read(&path, None).unwrap_err().to_string();
        assert!(error.contains("a, b"), "{error}");
        save(&path, &[(TENSOR, Dtype::F32, &[2], f.clone())], None);
        assert!(TextTable::read(&path, None).is_err(), "one dimension");
        save(&path, &[(TENSOR, Dtype::I32, &[1, 2], f.clone())], None);
        assert!(TextTable::read(&path, None).is_err(), "integers");
        save(&path, &[(TENSOR, Dtype::F32, &[1, 2], f)], None);
        let error = TextTable::read(&path, None).unwrap_err().to_string();
        assert!(error.contains("does not name its classes"), "{error}");
        let list = dir.path().join("names.txt");
        std::fs::write(&list, "bed\nsofa\n").unwrap();
        let error = TextTable::read(&path, Some(&list)).unwrap_err().to_string();
        assert!(error.contains("2 class names for 1 text vectors"), "{error}");
        let manifest = r#"{"entries": [{"file": "t.safetensors", "labels": ["sofa"]}]}"#;
        std::fs::write(dir.path().join(MANIFEST), manifest).unwrap();
        assert_eq!(TextTable::read(&path, None).unwrap().names, ["sofa"]);
    }

    #[test]
    fn a_written_table_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.safetensors");
        let names = vec!["bed".to_owned(), "\"sofa\", \u{1f6cb}".to_owned()];
        let table = TextTable::from_rows(names, vec![0.6, 0.8, 1.0, 0.0], 2).unwrap();
        std::fs::write(&path, table.to_safetensors().unwrap()).unwrap();
        assert_eq!(TextTable::read(&path, None).unwrap(), table);
        let uneven = TextTable { dim: 3, ..table };
        assert!(uneven.to_safetensors().is_err());
    }
}
