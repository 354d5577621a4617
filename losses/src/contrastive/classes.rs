//! Where classes come from.

use super::NAME;
use crate::IGNORE;
use crate::error::{LossError, check_len};
use crate::values::read_matrix;
use candle_core::{DType, Device, Result, Tensor};
use rayon::prelude::*;
use scenesplat_kernels::unit_rows::{UnitRowError, check_unit_rows};
use std::fmt;

/// Target rows that are compared with all texts at once: bounds the memory of the scores.
const BLOCK: usize = 4096;

/// Where the classes of the contrastive loss come from.
#[derive(Debug, Clone, Default)]
pub enum ClassSource {
    /// Nowhere: the loss is off.
    Off,
    /// The labels of the input: ground truth.
    #[default]
    Labels,
    /// The text nearest to the target feature: no label is used.
    PseudoLabels(TextColumns),
    /// The largest channel of the target feature, for targets whose channels are classes or codes.
    Argmax,
}

impl fmt::Display for ClassSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::Labels => f.write_str("given labels"),
            Self::PseudoLabels(texts) => {
                write!(f, "pseudo-labels, nearest of {} texts", texts.len())
            }
            Self::Argmax => f.write_str("pseudo-labels, largest channel of the target"),
        }
    }
}

/// Text embeddings at unit length, one for each class, as the columns of a matrix, which is how a product
/// with features takes them.
#[derive(Debug, Clone)]
pub struct TextColumns {
    /// `[D, C]` f32
    columns: Tensor,
}

impl TextColumns {
    /// From rows of unit length. `values`: `[C, dim]`, row-major
    ///
    /// # Errors
    /// If the values are no rows of `dim` channels, there is none, or a row does not have length 1
    /// within 1e-5.
    pub fn new(values: &[f32], dim: usize) -> Result<Self> {
        let wrong = |value: String, expected| LossError::Setting {
            loss: NAME,
            setting: "texts",
            value,
            expected,
        };
        let rows = match check_unit_rows(values, dim) {
            Ok(rows) if rows > 0 => rows,
            Err(UnitRowError::Norm { row, norm }) => {
                let value = format!("a row of norm {norm} (class {row})");
                return Err(wrong(value, "rows of unit length").into());
            }
            _ => {
                let value = format!("{} values for rows of {dim}", values.len());
                return Err(wrong(value, "one row for each class").into());
            }
        };
        let rows = Tensor::from_slice(values, (rows, dim), &Device::Cpu)?;
        Ok(Self { columns: rows.t()?.contiguous()? })
    }

    /// Number of classes.
    pub fn len(&self) -> usize {
        self.columns.dims()[1]
    }

    /// Width of a text.
    pub fn width(&self) -> usize {
        self.columns.dims()[0]
    }

    /// Products of rows with the texts, divided by a temperature. `[N, D]` to `[N, C]`, f32, or f64 if the
    /// rows are
    pub(crate) fn logits(
        &self,
        loss: &'static str,
        field: &'static str,
        rows: &Tensor,
        temperature: f64,
    ) -> Result<Tensor> {
        let dtype = if rows.dtype() == DType::F64 { DType::F64 } else { DType::F32 };
        let (n, width) = rows.dims2()?;
        if width != self.width() {
            let expected = format!("[N, {}]", self.width());
            return Err(LossError::shape(loss, field, expected, &[n, width]).into());
        }
        let texts = self.columns.to_dtype(dtype)?.to_device(rows.device())?;
        rows.to_dtype(dtype)?.matmul(&texts)? * (1.0 / temperature)
    }

    /// Never: there is no such matrix without a class.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// The class whose text has the largest cosine with the target feature, the smallest of equals;
/// [`IGNORE`] for rows that are not valid, and for zero rows, which are near to nothing.
///
/// The same in every step for the same targets. It costs a product of `[N, D]` and `[D, C]` a step:
/// at 768 channels and 200 classes about as much as a forward pass of a small network.
///
/// # Errors
/// If the widths differ, or a value of a valid row is not finite.
pub fn pseudo_labels(
    target: &Tensor,
    texts: &TextColumns,
    valid: Option<&[bool]>,
) -> Result<Vec<i32>> {
    let (rows, dim) = target.dims2()?;
    if dim != texts.width() {
        let expected = format!("[N, {}]", texts.width());
        return Err(LossError::shape(NAME, "target", expected, &[rows, dim]).into());
    }
    if let Some(valid) = valid {
        check_len(NAME, "valid", rows, valid.len())?;
    }
    let target = target.detach();
    let mut labels = Vec::with_capacity(rows);
    for start in (0..rows).step_by(BLOCK) {
        let block = target.narrow(0, start, BLOCK.min(rows - start))?;
        let block = block.to_dtype(DType::F32)?.contiguous()?;
        let scores = block.matmul(&texts.columns)?;
        let valid = valid.and_then(|v| v.get(start..));
        labels.extend(best_columns(&scores, &block, start, valid)?);
    }
    Ok(labels)
}

/// The largest channel of each target feature, the smallest of equals; [`IGNORE`] for rows that are
/// not valid, and for zero rows.
///
/// # Errors
/// If a value of a valid row is not finite.
pub fn argmax_labels(target: &Tensor, valid: Option<&[bool]>) -> Result<Vec<i32>> {
    if let Some(valid) = valid {
        check_len(NAME, "valid", target.dim(0)?, valid.len())?;
    }
    best_columns(target, target, 0, valid)
}

/// The column of the largest score of each row, where the feature has a direction.
fn best_columns(
    scores: &Tensor,
    feat: &Tensor,
    first: usize,
    valid: Option<&[bool]>,
) -> Result<Vec<i32>> {
    read_matrix(NAME, "target", scores, |scores| {
        read_matrix(NAME, "target", feat, |feat| {
            let best = |row: usize| {
                if valid.is_some_and(|v| !v[row]) {
                    return Ok(IGNORE);
                }
                let mut scratch = Vec::<f32>::new();
                let values = feat.read(row..row + 1, &mut scratch);
                if !values.iter().all(|v| v.is_finite()) {
                    return Err(row);
                }
                if values.iter().all(|v| *v == 0.0) {
                    return Ok(IGNORE);
                }
                let values = scores.read(row..row + 1, &mut scratch);
                let mut best = 0;
                for (column, value) in values.iter().enumerate() {
                    if *value > values[best] {
                        best = column;
                    }
                }
                Ok(best as i32)
            };
            let found: Vec<_> = (0..scores.rows).into_par_iter().map(best).collect();
            let label = |found: std::result::Result<i32, usize>| {
                found.map_err(|row| match feat.not_finite(NAME, "target", row) {
                    Some(LossError::NotFinite { loss, field, row, column, value }) => {
                        LossError::NotFinite { loss, field, row: first + row, column, value }.into()
                    }
                    other => candle_core::Error::msg(format!("{NAME}: target: {other:?}")),
                })
            };
            found.into_iter().map(label).collect()
        })
    })
}
