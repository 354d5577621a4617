//! Rows that are to have unit length, such as texts of classes: checked where they are read.

/// How far from 1 the length of a unit row may be: rows that were divided by their length in f32 by other
/// programs pass, and no cosine with them is wrong by more.
pub const UNIT_TOLERANCE: f64 = 1e-5;

/// Why values are no rows of unit length.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UnitRowError {
    /// The values do not divide into rows.
    #[error("{values} values cannot be rows of {dim} channels")]
    Shape {
        /// Values found.
        values: usize,
        /// Channels of a row.
        dim: usize,
    },
    /// A row has another length, or none: a NaN, an infinity, only zeros.
    #[error("row {row} has norm {norm}, expected 1")]
    Norm {
        /// The first such row.
        row: usize,
        /// Its Euclidean norm.
        norm: f64,
    },
}

/// Number of rows of `values`, `[R, dim]`, each of which has length 1 within [`UNIT_TOLERANCE`].
///
/// # Errors
/// If the values are no rows, or a row has another length.
///
/// ```
/// use scenesplat_kernels::unit_rows::check_unit_rows;
///
/// assert_eq!(check_unit_rows(&[0.6, 0.8, 1.0, 0.0], 2), Ok(2));
/// assert!(check_unit_rows(&[3.0, 4.0], 2).is_err());
/// ```
pub fn check_unit_rows(values: &[f32], dim: usize) -> Result<usize, UnitRowError> {
    if dim == 0 || !values.len().is_multiple_of(dim) {
        return Err(UnitRowError::Shape { values: values.len(), dim });
    }
    for (row, values) in values.chunks_exact(dim).enumerate() {
        let norm = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        // A NaN is not near to 1.
        let is_unit = (norm - 1.0).abs() <= UNIT_TOLERANCE;
        if !is_unit {
            return Err(UnitRowError::Norm { row, norm });
        }
    }
    Ok(values.len() / dim)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_row_of_another_length_is_named() {
        let norm = |values: &[f32]| match check_unit_rows(values, 2) {
            Err(UnitRowError::Norm { row, norm }) => Some((row, norm)),
            _ => None,
        };
        assert_eq!(norm(&[1.0, 0.0, 3.0, 4.0, 0.0, 0.0]), Some((1, 5.0)));
        assert_eq!(norm(&[0.0, 0.0]), Some((0, 0.0)));
        assert!(norm(&[f32::NAN, 1.0]).is_some_and(|(_, norm)| norm.is_nan()));
        assert_eq!(norm(&[f32::INFINITY, 1.0]), Some((0, f64::INFINITY)));
        assert_eq!(norm(&[1.000_02, 0.0]).map(|n| n.0), Some(0));
        assert_eq!(check_unit_rows(&[1.000_005, 0.0], 2), Ok(1));
        assert_eq!(check_unit_rows(&[], 2), Ok(0));
        for (values, dim) in [(&[1.0; 3][..], 2), (&[1.0; 3], 0)] {
            assert_eq!(check_unit_rows(values, dim), Err(UnitRowError::Shape { values: 3, dim }));
        }
    }
}
