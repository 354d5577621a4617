//! Attention inside patches of a serialized order.

use super::offsets_of;
use crate::arrays::{Input, shaped};
use crate::errors::argument;
use crate::work::compute;
use pyo3::prelude::*;
use scenesplat::kernels::check_offsets;
use scenesplat::kernels::patch_attention::{Heads, backward, forward};
use scenesplat::kernels::patches::{Patches, cut};

/// A batch that was checked: rows in their order, cut into patches.
struct Batch {
    rows: usize,
    heads: Heads,
    order: Vec<u32>,
    patches: Patches,
}

impl Batch {
    fn new(
        qkv: &Input<'_, f32>,
        order: &Bound<'_, PyAny>,
        patch_size: usize,
        offsets: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let &[rows, 3, count, dim] = qkv.shape() else {
            let problem = format!("expected [N, 3, heads, channels], got {:?}", qkv.shape());
            return Err(argument("qkv", problem));
        };
        if patch_size == 0 || count == 0 || dim == 0 {
            return Err(argument("patch_size", "patches, heads and channels are at least 1"));
        }
        let offsets = offsets_of(offsets, rows)?;
        check_offsets(&offsets, rows).map_err(crate::errors::error)?;
        let given = Input::<i64>::new("order", order)?;
        let mut order = Vec::with_capacity(rows);
        let mut seen = vec![false; rows];
        for &row in given.column(Some(rows))? {
            let at = usize::try_from(row).ok().filter(|at| *at < rows && !seen[*at]);
            let problem =
                || format!("is no order of {rows} rows: {row} is out of range or there twice");
            let at = at.ok_or_else(|| argument("order", problem()))?;
            seen[at] = true;
            order.push(at as u32);
        }
        let patches = cut(&offsets, patch_size);
        Ok(Self { rows, heads: Heads { count, dim }, order, patches })
    }
}

/// Attention of each row to the rows of its patch.
#[pyfunction]
pub fn patch_attention<'py>(
    py: Python<'py>,
    qkv: &Bound<'py, PyAny>,
    order: &Bound<'py, PyAny>,
    patch_size: usize,
    offsets: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let qkv = Input::<f32>::new("qkv", qkv)?;
    let batch = Batch::new(&qkv, order, patch_size, offsets)?;
    let Batch { rows, heads, order, patches } = &batch;
    let qkv = qkv.values()?;
    let out = compute(py, || {
        let mut out = vec![0.0; rows * heads.channels()];
        forward(qkv, *heads, patches, order, &mut out);
        out
    })?;
    shaped(py, out, &[*rows, heads.count, heads.dim])
}

/// The gradient of queries, keys and values.
#[pyfunction]
pub fn patch_attention_backward<'py>(
    py: Python<'py>,
    grad: &Bound<'py, PyAny>,
    qkv: &Bound<'py, PyAny>,
    order: &Bound<'py, PyAny>,
    patch_size: usize,
    offsets: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let qkv = Input::<f32>::new("qkv", qkv)?;
    let batch = Batch::new(&qkv, order, patch_size, offsets)?;
    let Batch { rows, heads, order, patches } = &batch;
    let grad = Input::<f32>::new("grad", grad)?;
    grad.expect(&[Some(*rows), Some(heads.count), Some(heads.dim)])?;
    let (qkv, grad) = (qkv.values()?, grad.values()?);
    let out = compute(py, || {
        let mut dqkv = vec![0.0; qkv.len()];
        backward(qkv, *heads, patches, order, grad, &mut dqkv);
        dqkv
    })?;
    shaped(py, out, &[*rows, 3, heads.count, heads.dim])
}
