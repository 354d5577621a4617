//! Submanifold convolution.

use super::offsets_of;
use crate::arrays::{Input, column, indices, optional, shaped};
use crate::errors::{argument, error};
use crate::work::compute;
use pyo3::prelude::*;
use scenesplat::kernels::Precision;
use scenesplat::kernels::kernel_map;
use scenesplat::kernels::sparse_conv::{
    PackedConv, backward_bias, backward_input, backward_weight, forward,
};

/// Which voxels a submanifold convolution joins. Made once for the voxels of a batch, and used by all convolutions of
/// this kernel size over them.
#[pyclass(frozen, module = "scenesplat.kernels")]
pub struct KernelMap {
    map: kernel_map::KernelMap,
}

/// Sides of weights `[cout, k, k, k, cin]`.
fn channels(weight: &Input<'_, f32>, k: usize) -> PyResult<(usize, usize)> {
    let shape = weight.shape();
    match *shape {
        [cout, a, b, c, cin] if [a, b, c] == [k; 3] && cin > 0 && cout > 0 => Ok((cout, cin)),
        _ => {
            let problem = format!("expected [cout, {k}, {k}, {k}, cin], got {shape:?}");
            Err(argument("weight", problem))
        }
    }
}

fn precision_of(name: &str) -> PyResult<Precision> {
    name.parse().map_err(|problem| argument("precision", problem))
}

#[pymethods]
impl KernelMap {
    #[new]
    #[pyo3(signature = (grid_coord, kernel_size=3, *, offsets=None))]
    fn new(
        py: Python<'_>,
        grid_coord: &Bound<'_, PyAny>,
        kernel_size: usize,
        offsets: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let cells = Input::<i32>::new("grid_coord", grid_coord)?;
        let cells = cells.rows::<3>()?;
        let offsets = offsets_of(offsets, cells.len())?;
        let build = || kernel_map::KernelMap::build(cells, &offsets, kernel_size);
        Ok(Self { map: compute(py, build)?.map_err(error)? })
    }

    /// Taps along one axis.
    #[getter]
    fn kernel_size(&self) -> usize {
        self.map.kernel_size()
    }

    /// Pairs of voxels over all taps.
    #[getter]
    fn num_pairs(&self) -> usize {
        self.map.num_pairs()
    }

    fn __len__(&self) -> usize {
        self.map.rows()
    }

    /// Input and output voxels of a tap, `(kx·k + ky)·k + kz`.
    fn pairs<'py>(
        &self,
        py: Python<'py>,
        tap: usize,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        if tap >= self.map.taps() {
            return Err(argument("tap", format!("{tap} is not below {}", self.map.taps())));
        }
        let (input, output) = self.map.tap_pairs(tap);
        Ok((indices(py, &input).into_any(), indices(py, &output).into_any()))
    }

    /// Convolves rows.
    #[pyo3(signature = (x, weight, bias=None, *, precision="f32"))]
    fn forward<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        weight: &Bound<'py, PyAny>,
        bias: Option<&Bound<'py, PyAny>>,
        precision: &str,
    ) -> PyResult<Bound<'py, PyAny>> {
        let precision = precision_of(precision)?;
        let weight = Input::<f32>::new("weight", weight)?;
        let (cout, cin) = channels(&weight, self.map.kernel_size())?;
        let x = Input::<f32>::new("x", x)?;
        x.expect(&[Some(self.map.rows()), Some(cin)])?;
        let bias = optional::<f32>("bias", bias)?;
        let bias = bias.as_ref().map(|bias| bias.column(Some(cout))).transpose()?;
        let (x, weight) = (x.values()?, weight.values()?);
        let out = compute(py, || {
            let packed = PackedConv::with_precision(precision, weight, cin, cout, self.map.taps());
            let mut out = vec![0.0; self.map.rows() * cout];
            forward(&self.map, x, &packed, bias, &mut out);
            out
        })?;
        shaped(py, out, &[self.map.rows(), cout])
    }

    /// Gradients of the rows, the weights and the bias.
    fn backward<'py>(
        &self,
        py: Python<'py>,
        grad: &Bound<'py, PyAny>,
        x: &Bound<'py, PyAny>,
        weight: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let weight = Input::<f32>::new("weight", weight)?;
        let k = self.map.kernel_size();
        let (cout, cin) = channels(&weight, k)?;
        let (x, grad) = (Input::<f32>::new("x", x)?, Input::<f32>::new("grad", grad)?);
        x.expect(&[Some(self.map.rows()), Some(cin)])?;
        grad.expect(&[Some(self.map.rows()), Some(cout)])?;
        let (x, grad, weight) = (x.values()?, grad.values()?, weight.values()?);
        let (dx, dw, db) = compute(py, || {
            let mut dx = vec![0.0; self.map.rows() * cin];
            let f32 = Precision::F32;
            backward_input(f32, &self.map, grad, weight, cin, cout, &mut dx);
            let mut dw = vec![0.0; weight.len()];
            backward_weight(f32, &self.map, x, grad, cin, cout, &mut dw);
            (dx, dw, backward_bias(grad, cout))
        })?;
        Ok((
            shaped(py, dx, &[self.map.rows(), cin])?,
            shaped(py, dw, &[cout, k, k, k, cin])?,
            column(py, db).into_any(),
        ))
    }
}
