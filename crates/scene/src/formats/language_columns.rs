//! Language codes as columns of a PLY file, their codebook as an element after the vertices.
//!
//! Programs that do not know them skip the columns by their names and never reach the element.

use super::ply::{ColumnSource, NewElement, PlyElement, PlyFile};
use super::semantics::clean_code;
use crate::{LanguageCode, LanguageCodebook, RepairReport, SceneError};
use half::f16;

/// Columns of the code are called this and a number.
pub(super) const CODE_COLUMN: &str = "lang_code_";
/// The element with one row per number of a feature: `mean`, `axis_0`, `axis_1` …
pub(super) const CODEBOOK: &str = "lang_codebook";
const MEAN: &str = "mean";

/// The codebook as an element.
pub(super) fn codebook_element(codebook: &LanguageCodebook) -> NewElement<'_> {
    let width = codebook.feature_width();
    let mean = ColumnSource::Strided { values: &codebook.mean, width: 1, at: 0 };
    let mut columns = vec![(MEAN.to_owned(), mean)];
    for (j, axis) in codebook.axes.chunks_exact(width).enumerate() {
        columns.push((axis_name(j), ColumnSource::Strided { values: axis, width: 1, at: 0 }));
    }
    NewElement { name: CODEBOOK, count: width, columns }
}

fn axis_name(j: usize) -> String {
    format!("axis_{j}")
}

/// The codes of a scene, if it has any.
///
/// # Errors
/// If there are codes without a codebook of the same width.
pub(super) fn read_language_code(
    file: &PlyFile,
    vertex: &PlyElement,
    report: &mut RepairReport,
) -> Result<Option<LanguageCode>, SceneError> {
    let names: Vec<String> = (0..vertex.properties.len())
        .map(|i| format!("{CODE_COLUMN}{i}"))
        .take_while(|name| vertex.has(name))
        .collect();
    if names.is_empty() {
        return Ok(None);
    }
    let bad = |problem: String| {
        SceneError::format(file.path(), problem, "write the scene with its language codes again")
    };
    let k = names.len();
    let Some(element) = file.element(CODEBOOK) else {
        return Err(bad(format!("has columns {CODE_COLUMN}* but no element {CODEBOOK}")));
    };
    let axes: Vec<String> = (0..k).map(axis_name).collect();
    if element.properties.len() != k + 1 || !element.has(MEAN) || element.count == 0 {
        return Err(bad(format!(
            "has codes of {k}, but its element {CODEBOOK} has {} rows of {} properties",
            element.count,
            element.properties.len()
        )));
    }
    let mean = file.column_f32(CODEBOOK, MEAN)?;
    let mut flat = Vec::with_capacity(mean.len() * k);
    for axis in &axes {
        flat.extend(file.column_f32(CODEBOOK, axis)?);
    }
    let codebook = LanguageCodebook { mean, axes: flat };
    codebook.check()?;
    let mut values = vec![f16::ZERO; vertex.count * k];
    for (j, name) in names.iter().enumerate() {
        let column = file.column_f32(&vertex.name, name)?;
        for (row, value) in column.into_iter().enumerate() {
            values[row * k + j] = f16::from_f32(value);
        }
    }
    Ok(Some(clean_code(LanguageCode { values, codebook }, report)))
}
