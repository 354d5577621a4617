//! The features of all segments of all pictures.

use super::LiftError;
use std::ops::Range;

/// Feature rows of the segments, picture after picture.
///
/// Rows are unit vectors, or 0 for a segment without a feature; a picture's segments have global
/// numbers that follow each other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SegmentTables {
    dim: usize,
    values: Vec<f32>,
    /// First global segment of each picture, and one past the last.
    starts: Vec<u32>,
}

impl SegmentTables {
    /// No picture yet; rows of `dim` values.
    pub fn new(dim: usize) -> Self {
        Self { dim, values: Vec::new(), starts: vec![0] }
    }

    /// Values in a row.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// Segments of all pictures.
    pub fn len(&self) -> usize {
        self.starts.last().map_or(0, |&end| end as usize)
    }

    /// Whether there is no segment.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Global segments of a picture.
    pub fn segments_of(&self, view: usize) -> Range<u32> {
        self.starts[view]..self.starts[view + 1]
    }

    /// The picture that a global segment belongs to.
    pub fn view_of(&self, segment: u32) -> usize {
        self.starts.partition_point(|&start| start <= segment) - 1
    }

    /// The feature of a global segment.
    pub fn row(&self, segment: u32) -> &[f32] {
        let start = segment as usize * self.dim;
        &self.values[start..start + self.dim]
    }

    /// Adds a picture's segments and gives the global number of the first. `rows`: `[S, D]`, divided
    /// by their norms; a row of zeros is left as it is.
    ///
    /// # Errors
    /// If `rows` is no whole number of rows, a value is not finite, there are 2³² segments or more,
    /// or there is not enough memory.
    pub fn push(&mut self, rows: &[f32]) -> Result<u32, LiftError> {
        let dim = self.dim;
        if dim == 0 || !rows.len().is_multiple_of(dim) {
            let problem = format!("{} values are no rows of {dim}", rows.len());
            return Err(LiftError::argument("segment features", problem));
        }
        let first = self.len() as u32;
        let too_many = || LiftError::argument("segment features", "2³² segments or more");
        let end = u32::try_from(self.len() + rows.len() / dim).map_err(|_| too_many())?;
        if self.values.try_reserve(rows.len()).is_err() {
            let problem = format!("{end} segments of {dim} values do not fit into memory");
            return Err(LiftError::argument("segment features", problem));
        }
        let before = self.values.len();
        for (row, values) in rows.chunks_exact(dim).enumerate() {
            let norm = values.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt();
            if !norm.is_finite() {
                self.values.truncate(before);
                let problem = format!("row {row} holds a value that is not finite");
                return Err(LiftError::argument("segment features", problem));
            }
            let scale = if norm > 0.0 { 1.0 / norm } else { 0.0 };
            self.values.extend(values.iter().map(|&v| (f64::from(v) * scale) as f32));
        }
        self.starts.push(end);
        Ok(first)
    }
}
