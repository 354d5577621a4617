//! Kernels of point-cloud networks on arrays.

mod attention;
mod convolution;
mod points;
mod segments;

pub use attention::{patch_attention, patch_attention_backward};
pub use convolution::KernelMap;
pub use points::{grid_sample, knn, knn_vote, serialize};
pub use segments::{segment_reduce, segment_reduce_backward};

use crate::arrays::Input;
use crate::errors::argument;
use pyo3::prelude::*;

/// Ends of scenes in a batch, `[B + 1]` from 0; one scene if not given.
fn offsets_of(given: Option<&Bound<'_, PyAny>>, rows: usize) -> PyResult<Vec<usize>> {
    let Some(given) = given else { return Ok(vec![0, rows]) };
    let given = Input::<i64>::new("offsets", given)?;
    let whole =
        |v: &i64| usize::try_from(*v).map_err(|_| argument("offsets", format!("{v} is below 0")));
    given.column(None)?.iter().map(whole).collect()
}
