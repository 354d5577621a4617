//! Class texts from any of the files that hold them.

use scenesplat_metrics::{MetricError, TextRows};
use scenesplat_models::weights::read_single_tensor;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::label_set::read_names;
use scenesplat_scene::{LabelSet, SceneError};
use std::path::{Path, PathBuf};

/// Re-exported: names and unit rows of a text embedding.
pub use scenesplat_scene::TextTable;

/// Why class texts could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TextError {
    /// A file that cannot be read, or is no table of texts.
    #[error(transparent)]
    Table(#[from] SceneError),
    /// A checkpoint that cannot be read, or holds other than one tensor.
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
    /// A tensor that is no table.
    #[error("{}: expected one row per class", path.display())]
    Shape {
        /// Which file.
        path: PathBuf,
        /// Its shape.
        #[source]
        source: Box<candle_core::Error>,
    },
    /// Rows that cannot be used.
    #[error("{}", path.display())]
    Rows {
        /// Which file.
        path: PathBuf,
        /// Which row, and why.
        #[source]
        source: Box<SceneError>,
    },
    /// A tensor without the names of its rows.
    #[error("{}: a PyTorch tensor holds no names; a file of names is needed, one a line", path.display())]
    NoNames {
        /// Which file.
        path: PathBuf,
    },
}

/// Reads text embeddings: `.safetensors` (names inside or beside), or `.pt`/`.pth` with one tensor
/// and a file of names.
///
/// # Errors
/// If the file cannot be read, names and rows disagree, or a row is zero or not finite.
pub fn read_text_table(path: &Path, names: Option<&Path>) -> Result<TextTable, TextError> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    if !matches!(extension, "pt" | "pth") {
        return Ok(TextTable::read(path, names)?);
    }
    let tensor = read_single_tensor(path)?;
    let (_, dim) = tensor
        .dims2()
        .map_err(|source| TextError::Shape { path: path.to_owned(), source: source.into() })?;
    let Some(names) = names else {
        return Err(TextError::NoNames { path: path.to_owned() });
    };
    let names = read_names(names)?;
    let values = tensor.flatten_all()?.to_vec1::<f32>()?;
    TextTable::from_rows(names, values, dim)
        .map_err(|source| TextError::Rows { path: path.to_owned(), source: source.into() })
}

/// Reads the embedding of one text: `.npy`, or `.pt`/`.pth` with one tensor.
///
/// # Errors
/// If the file cannot be read.
pub fn read_text_vector(path: &Path) -> Result<Vec<f32>, TextError> {
    if path.extension().is_some_and(|e| e == "npy") {
        return Ok(NpyFile::open(path)?.read_f32()?);
    }
    Ok(read_single_tensor(path)?.flatten_all()?.to_vec1::<f32>()?)
}

/// The rows of a text table as the metrics crate reads them.
///
/// # Errors
/// If there is no row, or one does not have unit length.
pub fn text_rows(text: &TextTable) -> Result<TextRows<'_>, MetricError> {
    TextRows::new(&text.values, text.dim)
}

/// Indices of the classes of a comma-separated list.
///
/// # Errors
/// If a name is not among them; the message names the nearest.
pub fn class_list(labels: &LabelSet, list: &[String]) -> Result<Vec<usize>, SceneError> {
    list.iter().map(|name| labels.index_of(name)).collect()
}
