//! Several network inputs as one.

use crate::{DataError, NetworkInput};

/// Network inputs joined row by row; host memory.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Batch {
    /// Source row of each voxel, in its own scene. `[ΣM]`
    pub rows: Vec<u32>,
    /// Cells, each input with its own origin. `[ΣM, 3]`
    pub grid_coord: Vec<[i32; 3]>,
    /// Features, row-major. `[ΣM, channels]`
    pub feat: Vec<f32>,
    /// Width of a feature row.
    pub channels: usize,
    /// Input `b` owns rows `offsets[b]..offsets[b + 1]`. `[B + 1]`
    pub offsets: Vec<u32>,
}

/// Joins inputs in the given order. Empty inputs keep their (empty) place.
///
/// # Errors
/// If the inputs have different widths, arrays out of step, or more than `u32::MAX` rows together.
pub fn collate(inputs: &[NetworkInput]) -> Result<Batch, DataError> {
    let channels = inputs.first().map_or(0, |i| i.channels);
    let mut batch = Batch { channels, offsets: vec![0], ..Batch::default() };
    for input in inputs {
        if input.channels != channels {
            return Err(DataError::Length {
                field: "channels",
                expected: channels,
                got: input.channels,
            });
        }
        input.check()?;
        batch.rows.extend_from_slice(&input.rows);
        batch.grid_coord.extend_from_slice(&input.grid_coord);
        batch.feat.extend_from_slice(&input.feat);
        let end = u32::try_from(batch.rows.len()).map_err(|_| DataError::Setting {
            setting: "batch",
            value: batch.rows.len().to_string(),
            expected: "at most 4294967295 rows together",
        })?;
        batch.offsets.push(end);
    }
    Ok(batch)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(rows: std::ops::Range<u32>, channels: usize) -> NetworkInput {
        let len = rows.len();
        NetworkInput {
            slots: rows.clone().collect(),
            grid_coord: rows.clone().map(|r| [r as i32; 3]).collect(),
            feat: vec![0.5; len * channels],
            rows: rows.collect(),
            channels,
        }
    }

    #[test]
    fn offsets_count_rows() {
        let batch = collate(&[input(0..2, 3), input(0..0, 3), input(5..8, 3)]).unwrap();
        assert_eq!(batch.offsets, [0, 2, 2, 5]);
        assert_eq!(batch.rows, [0, 1, 5, 6, 7]);
        assert_eq!(batch.grid_coord[2], [5; 3]);
        assert_eq!(batch.feat.len(), 15);
    }

    #[test]
    fn no_inputs_and_wrong_widths() {
        assert_eq!(collate(&[]).unwrap().offsets, [0]);
        assert!(collate(&[input(0..2, 3), input(0..2, 4)]).is_err());
        let mut broken = input(0..2, 3);
        broken.feat.pop();
        assert!(matches!(collate(&[broken]), Err(DataError::Length { field: "feat", .. })));
    }
}
