use crate::MetricError;
use crate::error::{check_num_classes, check_shape};
use scenesplat_kernels::unit_rows::{UnitRowError, check_unit_rows};

/// Borrowed text embeddings of the class names, one unit row each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextRows<'a> {
    num_classes: usize,
    dim: usize,
    /// `[num_classes, dim]`, row-major.
    rows: &'a [f32],
}

impl<'a> TextRows<'a> {
    /// `[C, D]` embeddings of unit length, row-major.
    ///
    /// # Errors
    /// If `rows` is not a multiple of `dim`, `dim` or the number of rows is 0 (or the latter above
    /// 4096), or a row does not have norm 1 within 1e-5.
    pub fn new(rows: &'a [f32], dim: usize) -> Result<Self, MetricError> {
        let text = Self::of(rows, dim)?;
        match check_unit_rows(rows, dim) {
            Err(UnitRowError::Norm { row: class, norm }) => {
                Err(MetricError::TextRow { class, norm })
            }
            _ => Ok(text),
        }
    }

    /// `[C, D]` embeddings of unit length, projected on fewer directions: rows of length 1 or less. They
    /// are not scaled back to length 1, so that products with features along those directions do not change.
    ///
    /// # Errors
    /// As [`new`](Self::new), but shorter rows are allowed.
    pub fn projected(rows: &'a [f32], dim: usize) -> Result<Self, MetricError> {
        let text = Self::of(rows, dim)?;
        for (class, row) in rows.chunks_exact(dim).enumerate() {
            let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            // A NaN is not below anything.
            let fits = norm <= 1.0 + 1e-4;
            if !fits {
                return Err(MetricError::TextRow { class, norm });
            }
        }
        Ok(text)
    }

    fn of(rows: &'a [f32], dim: usize) -> Result<Self, MetricError> {
        let num_classes = check_shape("text embeddings", rows.len(), dim)?;
        check_num_classes(num_classes)?;
        Ok(Self { num_classes, dim, rows })
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
    pub fn rows(&self) -> &'a [f32] {
        self.rows
    }

    /// `[D]`, the unit row of one class, if it exists.
    pub fn row(&self, class: usize) -> Option<&'a [f32]> {
        self.rows.chunks_exact(self.dim).nth(class)
    }
}
