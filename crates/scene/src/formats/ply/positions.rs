//! Positions that a file holds as doubles, relative to an origin.

use super::{PlyFile, PlyType, ROWS_PER_TASK};
use crate::SceneError;
use crate::formats::memory::zeroed;
use crate::place::{NO_ORIGIN, less, origin_of, sample_rows};
use rayon::prelude::*;

const AXES: [&str; 3] = ["x", "y", "z"];

impl PlyFile {
    /// Positions `x y z` of an element relative to the origin that goes with them, if one of the
    /// three is a `double` and the positions are far from 0; else `None`: f32 holds them as well.
    /// No position is kept as f64.
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32).
    #[expect(clippy::type_complexity, reason = "rows, and the origin that goes with them")]
    pub(crate) fn far_positions(
        &self,
        element: &str,
    ) -> Result<Option<(Vec<[f32; 3]>, [f64; 3])>, SceneError> {
        let (rows, cells) = self.rows(element, &AXES)?;
        if cells.iter().all(|cell| cell.ty != PlyType::F64) {
            return Ok(None);
        }
        // Three cells are at least three bytes wide.
        let stride = rows.stride;
        let position = |row: &[u8]| [0, 1, 2].map(|i| cells[i].read_f64(row, self.big_endian));
        let sample = sample_rows(rows.count).map(|row| position(&rows.bytes[row * stride..]));
        let origin = origin_of(sample);
        if origin == NO_ORIGIN {
            return Ok(None);
        }
        let mut out = zeroed::<[f32; 3]>(rows.count, &self.path)?;
        let parts = rows.bytes.par_chunks(stride * ROWS_PER_TASK);
        out.par_chunks_mut(ROWS_PER_TASK).zip(parts).for_each(|(out, bytes)| {
            for (out, row) in out.iter_mut().zip(bytes.chunks_exact(stride)) {
                *out = less(position(row), origin);
            }
        });
        Ok(Some((out, origin)))
    }
}
