use crate::MetricError;
use crate::error::{check_num_rows, check_shape};
use std::error::Error;
use std::ops::Range;

/// Feature rows that are read in pieces.
///
/// A million splats with 768 channels are 3 GB; reading them piece by piece lets a caller keep them
/// in half precision, in a file, or nowhere at all. Pieces are asked for from several threads and
/// in any order.
pub trait FeatureRows: Sync {
    /// Number of rows `N`.
    fn num_rows(&self) -> usize;

    /// Channels per row `D`.
    fn dim(&self) -> usize;

    /// The rows `rows` as `[rows.len(), D]`, row-major; may be built in `scratch`.
    ///
    /// # Errors
    /// If the rows cannot be read.
    fn read<'a>(
        &'a self,
        rows: Range<usize>,
        scratch: &'a mut Vec<f32>,
    ) -> Result<&'a [f32], MetricError>;
}

/// Feature rows that lie in memory, row-major.
#[derive(Debug, Clone, Copy)]
pub struct FeatureSlice<'a> {
    data: &'a [f32],
    dim: usize,
}

impl<'a> FeatureSlice<'a> {
    /// `data` as rows of `dim` channels.
    ///
    /// # Errors
    /// If `dim` is 0 or does not divide the length.
    pub fn new(data: &'a [f32], dim: usize) -> Result<Self, MetricError> {
        check_shape("features", data.len(), dim)?;
        Ok(Self { data, dim })
    }
}

impl FeatureRows for FeatureSlice<'_> {
    fn num_rows(&self) -> usize {
        self.data.len() / self.dim
    }

    fn dim(&self) -> usize {
        self.dim
    }

    fn read<'a>(
        &'a self,
        rows: Range<usize>,
        _scratch: &'a mut Vec<f32>,
    ) -> Result<&'a [f32], MetricError> {
        let piece = rows.start.checked_mul(self.dim).zip(rows.end.checked_mul(self.dim));
        piece.and_then(|(start, end)| self.data.get(start..end)).ok_or(MetricError::RowCount {
            what: "features",
            expected: rows.end,
            got: self.num_rows(),
        })
    }
}

/// Feature rows that a function writes on demand.
///
/// The function gets a range of rows and a buffer of `rows.len() * dim` values, all zero.
pub struct FeatureFn<F> {
    num_rows: usize,
    dim: usize,
    fill: F,
}

impl<F> FeatureFn<F>
where
    F: Fn(Range<usize>, &mut [f32]) -> Result<(), Box<dyn Error + Send + Sync>> + Sync,
{
    /// `num_rows` rows of `dim` channels, written by `fill`.
    ///
    /// # Errors
    /// If `dim` is 0, or there are 2³² − 1 or more rows.
    pub fn new(num_rows: usize, dim: usize, fill: F) -> Result<Self, MetricError> {
        check_num_rows("features", num_rows)?;
        if dim == 0 {
            return Err(MetricError::RowShape { what: "features", len: num_rows, dim });
        }
        Ok(Self { num_rows, dim, fill })
    }
}

impl<F> FeatureRows for FeatureFn<F>
where
    F: Fn(Range<usize>, &mut [f32]) -> Result<(), Box<dyn Error + Send + Sync>> + Sync,
{
    fn num_rows(&self) -> usize {
        self.num_rows
    }

    fn dim(&self) -> usize {
        self.dim
    }

    fn read<'a>(
        &'a self,
        rows: Range<usize>,
        scratch: &'a mut Vec<f32>,
    ) -> Result<&'a [f32], MetricError> {
        let (what, len, dim) = ("features", rows.len(), self.dim);
        let size = len.checked_mul(dim).ok_or(MetricError::RowShape { what, len, dim })?;
        scratch.clear();
        scratch.resize(size, 0.0);
        let (start, end) = (rows.start, rows.end);
        (self.fill)(rows, scratch).map_err(|source| MetricError::Rows { start, end, source })?;
        Ok(scratch)
    }
}
