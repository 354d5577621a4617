//! Arrays that go in: anything that numpy takes, torch tensors among it; and arrays that go out.

use crate::errors::argument;
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayDescrMethods, PyArrayMethods,
    PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods, dtype,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// An array of numbers of one type, in memory row by row: what was given, or a copy where that is otherwise.
pub struct Input<'py, T: Element> {
    name: &'static str,
    array: PyReadonlyArrayDyn<'py, T>,
}

impl<'py, T: Element> Input<'py, T> {
    /// Takes an argument. Numbers of another type are rounded to this one, as long as that is no other kind of number.
    pub fn new(name: &'static str, given: &Bound<'py, PyAny>) -> PyResult<Self> {
        let py = given.py();
        let array = as_array(name, given)?;
        let ty = dtype::<T>(py);
        let kind = array.dtype().kind();
        let is_bool = ty.kind() == b'b';
        let fits = match ty.kind() {
            b'f' => b"fiu".contains(&kind),
            b'b' => kind == b'b',
            _ => b"iu".contains(&kind),
        };
        if !fits {
            let wanted = match ty.kind() {
                b'f' => "numbers",
                b'b' => "True and False",
                _ => "whole numbers",
            };
            return Err(PyTypeError::new_err(format!(
                "{name}: {wanted} are expected, got an array of {}",
                array.dtype()
            )));
        }
        let options = PyDict::new(py);
        options.set_item("dtype", &ty)?;
        let numpy = py.import("numpy")?;
        let flat = numpy.call_method("ascontiguousarray", (&array,), Some(&options))?;
        // `ascontiguousarray` makes one row of a single number.
        let flat = if array.ndim() == 0 { flat.call_method1("reshape", ((),))? } else { flat };
        if !is_bool && b"iu".contains(&ty.kind()) && !array.dtype().is_equiv_to(&ty) {
            let same = numpy.call_method1("array_equal", (&flat, &array))?.extract::<bool>()?;
            if !same {
                return Err(argument(name, format!("a number does not fit into {ty}")));
            }
        }
        Ok(Self { name, array: flat.extract::<PyReadonlyArrayDyn<'py, T>>()? })
    }

    /// Its sides.
    pub fn shape(&self) -> &[usize] {
        self.array.shape()
    }

    /// All numbers, row by row.
    pub fn values(&self) -> PyResult<&[T]> {
        self.array.as_slice().map_err(|_| argument(self.name, "is not in one piece"))
    }

    /// That it has these sides; `None`: any.
    pub fn expect(&self, sides: &[Option<usize>]) -> PyResult<()> {
        let shape = self.shape();
        let fits = shape.len() == sides.len()
            && shape.iter().zip(sides).all(|(got, side)| side.is_none_or(|side| side == *got));
        if fits {
            return Ok(());
        }
        let side = |side: &Option<usize>| side.map_or("N".to_owned(), |side| side.to_string());
        let sides: Vec<String> = sides.iter().map(side).collect();
        Err(argument(self.name, format!("expected [{}], got {shape:?}", sides.join(", "))))
    }
}

impl<T: Element + Copy> Input<'_, T> {
    /// Rows of so many numbers, `[N, W]`.
    pub fn rows<const W: usize>(&self) -> PyResult<&[[T; W]]> {
        self.expect(&[None, Some(W)])?;
        Ok(self.values()?.as_chunks().0)
    }

    /// One number for each of so many rows; any number of rows if `None`.
    pub fn column(&self, rows: Option<usize>) -> PyResult<&[T]> {
        self.expect(&[rows])?;
        self.values()
    }
}

/// As an array of numpy, without a copy where that is possible.
fn as_array<'py>(name: &str, given: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyUntypedArray>> {
    if let Ok(array) = given.cast::<PyUntypedArray>() {
        return Ok(array.clone());
    }
    let numpy = given.py().import("numpy")?;
    let has = |method: &str| given.hasattr(method).unwrap_or(false);
    let made = if has("__dlpack__") && numpy.hasattr("from_dlpack")? {
        let made = numpy.call_method1("from_dlpack", (given,));
        // A tensor of a type that numpy has not, or that must not be written to.
        made.or_else(|error| if has("__array__") { asarray(&numpy, given) } else { Err(error) })
    } else {
        asarray(&numpy, given)
    };
    let explained = |error: PyErr| {
        argument(
            name,
            format!(
                "numpy cannot take it ({error}); give an array, or a tensor by tensor.detach().cpu()"
            ),
        )
    };
    let made = made.map_err(explained)?;
    made.cast_into::<PyUntypedArray>().map_err(|_| argument(name, "is no array"))
}

fn asarray<'py>(
    numpy: &Bound<'py, PyModule>,
    given: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    numpy.call_method1("asarray", (given,))
}

/// Numbers that Python owns from now on.
pub fn column<T: Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    values.into_pyarray(py)
}

/// The same as rows of `width`.
pub fn table<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    width: usize,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let rows = values.len().checked_div(width).unwrap_or(0);
    values.into_pyarray(py).reshape([rows, width])
}

/// The same with any sides.
pub fn shaped<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    sides: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    Ok(values.into_pyarray(py).reshape(sides.to_vec())?.into_any())
}

/// Row numbers as numpy and torch index with.
pub fn indices<'py>(py: Python<'py>, rows: &[u32]) -> Bound<'py, PyArray1<i64>> {
    column(py, rows.iter().map(|row| i64::from(*row)).collect())
}

/// A column of an argument that may be missing.
pub fn optional<'py, T: Element>(
    name: &'static str,
    given: Option<&Bound<'py, PyAny>>,
) -> PyResult<Option<Input<'py, T>>> {
    given.map(|given| Input::new(name, given)).transpose()
}
