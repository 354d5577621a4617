//! Groups of rows that become one.

use crate::arrays::{Input, shaped};
use crate::errors::{argument, error};
use crate::work::compute;
use pyo3::prelude::*;
use scenesplat::kernels::segment::{Groups, Reduce, reduce, reduce_backward};

fn groups(order: &Bound<'_, PyAny>, offsets: &Bound<'_, PyAny>) -> PyResult<Groups> {
    let numbers = |name: &'static str, given: &Bound<'_, PyAny>| -> PyResult<Vec<u32>> {
        let given = Input::<i64>::new(name, given)?;
        let number = |v: &i64| {
            u32::try_from(*v).map_err(|_| argument(name, format!("{v} is no row of a batch")))
        };
        given.column(None)?.iter().map(number).collect()
    };
    Groups::new(numbers("order", order)?, numbers("offsets", offsets)?).map_err(error)
}

fn reduce_of(name: &str) -> PyResult<Reduce> {
    match name {
        "mean" => Ok(Reduce::Mean),
        "max" => Ok(Reduce::Max),
        "sum" => Ok(Reduce::Sum),
        _ => Err(argument("how", format!("{name:?} is none of \"mean\", \"max\", \"sum\""))),
    }
}

/// One row for each group.
#[pyfunction]
pub fn segment_reduce<'py>(
    py: Python<'py>,
    x: &Bound<'py, PyAny>,
    order: &Bound<'py, PyAny>,
    offsets: &Bound<'py, PyAny>,
    how: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let how = reduce_of(how)?;
    let groups = groups(order, offsets)?;
    let x = Input::<f32>::new("x", x)?;
    x.expect(&[Some(groups.rows().len()), None])?;
    let (c, x) = (x.shape()[1], x.values()?);
    let out = compute(py, || {
        let mut out = vec![0.0; groups.len() * c];
        reduce(x, c, &groups, how, &mut out);
        out
    })?;
    shaped(py, out, &[groups.len(), c])
}

/// The gradient of the rows.
#[pyfunction]
pub fn segment_reduce_backward<'py>(
    py: Python<'py>,
    grad: &Bound<'py, PyAny>,
    x: &Bound<'py, PyAny>,
    order: &Bound<'py, PyAny>,
    offsets: &Bound<'py, PyAny>,
    how: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let how = reduce_of(how)?;
    let groups = groups(order, offsets)?;
    let (x, grad) = (Input::<f32>::new("x", x)?, Input::<f32>::new("grad", grad)?);
    x.expect(&[Some(groups.rows().len()), None])?;
    let c = x.shape()[1];
    grad.expect(&[Some(groups.len()), Some(c)])?;
    let sides = [groups.rows().len(), c];
    let (x, grad) = (x.values()?, grad.values()?);
    let out = compute(py, || {
        let mut dx = vec![0.0; x.len()];
        reduce_backward(x, c, &groups, how, grad, &mut dx);
        dx
    })?;
    shaped(py, out, &sides)
}
