use crate::MetricError;
use crate::error::check_num_classes;

/// Text embeddings of the class names, one unit row each.
#[derive(Debug, Clone, PartialEq)]
pub struct TextTable {
    num_classes: usize,
    dim: usize,
    /// `[num_classes, dim]`, row-major, norm 1 up to f32 rounding.
    rows: Vec<f32>,
}

impl TextTable {
    /// A table from `[C, D]` embeddings of any norm, row-major; each row is scaled to norm 1.
    ///
    /// Rows that are equal stay equal.
    ///
    /// # Errors
    /// If `rows` is not a multiple of `dim`, `dim` or the number of rows is 0 (or the latter above
    /// 4096), or a row has no direction: a NaN, an infinity, or only zeros.
    pub fn new(rows: &[f32], dim: usize) -> Result<Self, MetricError> {
        if dim == 0 || !rows.len().is_multiple_of(dim) {
            return Err(MetricError::RowShape { what: "text embeddings", len: rows.len(), dim });
        }
        let num_classes = rows.len() / dim;
        check_num_classes(num_classes)?;
        let mut unit = Vec::with_capacity(rows.len());
        for (class, row) in rows.chunks_exact(dim).enumerate() {
            let norm = row.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt();
            if !norm.is_finite() || norm <= 0.0 {
                return Err(MetricError::TextRow { class, norm });
            }
            unit.extend(row.iter().map(|&v| (f64::from(v) / norm) as f32));
        }
        Ok(Self { num_classes, dim, rows: unit })
    }

    /// Number of classes `C`.
    pub fn num_classes(&self) -> usize {
        self.num_classes
    }

    /// Channels per row `D`.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// `[C, D]` unit rows, row-major.
    pub fn rows(&self) -> &[f32] {
        &self.rows
    }

    /// `[D]`, the unit row of one class, if it exists.
    pub fn row(&self, class: usize) -> Option<&[f32]> {
        self.rows.chunks_exact(self.dim).nth(class)
    }
}
