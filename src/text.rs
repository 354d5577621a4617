//! Class texts from any of the files that hold them.

use anyhow::{Context, bail};
use scenesplat_metrics::{MetricError, TextRows};
use scenesplat_models::weights::read_single_tensor;
use scenesplat_scene::label_set::read_names;
use scenesplat_scene::{LabelSet, SceneError};
use std::path::Path;

/// Re-exported: names and unit rows of a text embedding.
pub use scenesplat_scene::TextTable;

/// Reads text embeddings: `.safetensors` (names inside or beside), or `.pt`/`.pth` with one tensor
/// and a file of names.
///
/// # Errors
/// If the file cannot be read, names and rows disagree, or a row is zero or not finite.
pub fn read_text_table(path: &Path, names: Option<&Path>) -> anyhow::Result<TextTable> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    if !matches!(extension, "pt" | "pth") {
        return Ok(TextTable::read(path, names)?);
    }
    let tensor = read_single_tensor(path)?;
    let (_, dim) = tensor
        .dims2()
        .with_context(|| format!("{}: expected one row per class", path.display()))?;
    let Some(names) = names else {
        bail!(
            "{}: a PyTorch tensor holds no names; give them with --text-names FILE (one a line)",
            path.display()
        );
    };
    let names = read_names(names)?;
    let values = tensor.flatten_all()?.to_vec1::<f32>()?;
    TextTable::from_rows(names, values, dim)
        .map_err(|e| anyhow::anyhow!(e).context(path.display().to_string()))
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
