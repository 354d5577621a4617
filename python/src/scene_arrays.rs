//! The arrays of a scene as views of its memory, and the values that they stand for.

use crate::arrays::{column, shaped, table};
use crate::errors::error;
use crate::scene::Scene;
use crate::work::compute;
use numpy::ndarray::{ArrayView, IxDyn};
use numpy::{Element, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use scenesplat::rasterizer::Gaussians;
use scenesplat::scene::{ExtraColumn, NumberType};

/// Values of a scene as an array without a copy. It keeps the scene alive and cannot be written to.
fn view<'py, T: Element>(
    scene: &Bound<'py, Scene>,
    values: &[T],
    sides: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let values = ArrayView::from_shape(IxDyn(sides), values).map_err(error)?;
    // SAFETY: the values are in an allocation that the scene owns, and which nothing changes or moves: the class is
    // frozen and its data is behind an Arc that it keeps. The array holds the scene.
    let array = unsafe { PyArrayDyn::borrow_from_array(&values, scene.clone().into_any()) };
    array.call_method("setflags", (false,), None)?;
    Ok(array.into_any())
}

/// The same of values that may be missing.
fn view_some<'py, T: Element>(
    scene: &Bound<'py, Scene>,
    values: Option<&Vec<T>>,
) -> PyResult<Option<Bound<'py, PyAny>>> {
    values.map(|values| view(scene, values, &[values.len()])).transpose()
}

/// The numbers of an unknown column, in the type of its file.
fn extra<'py>(scene: &Bound<'py, Scene>, column: &ExtraColumn) -> PyResult<Bound<'py, PyAny>> {
    let (kind, size) = match column.ty {
        NumberType::Bool => ("b", 1),
        NumberType::Int(size) => ("i", size),
        NumberType::UInt(size) => ("u", size),
        NumberType::Float(size) => ("f", size),
    };
    let rows = scene.get().opened().loaded.scene.len();
    let mut sides = vec![rows];
    sides.extend(&column.row_shape);
    let bytes = view(scene, &column.bytes, &[column.bytes.len()])?;
    let ty = if kind == "b" { "?".to_owned() } else { format!("<{kind}{size}") };
    bytes.call_method1("view", (ty,))?.call_method1("reshape", (sides,))
}

#[pymethods]
impl Scene {
    /// Centers relative to `origin`, meters. `[N, 3]` float32, a view
    #[getter]
    fn means<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let values = slf.get().opened().loaded.scene.coord.as_flattened();
        view(slf, values, &[values.len() / 3, 3])
    }

    /// Natural logarithms of the standard deviations in meters. `[N, 3]` float32, a view
    #[getter]
    fn log_scales<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let values = slf.get().opened().loaded.scene.log_scale.as_flattened();
        view(slf, values, &[values.len() / 3, 3])
    }

    /// Orientations w, x, y, z, unit norm, w at least 0. `[N, 4]` float32, a view
    #[getter]
    fn rotations<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let values = slf.get().opened().loaded.scene.quat.as_flattened();
        view(slf, values, &[values.len() / 4, 4])
    }

    /// Opacities before the sigmoid; infinite ones are legal. `[N]` float32, a view
    #[getter]
    fn opacity_logits<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let values = &slf.get().opened().loaded.scene.opacity_logit;
        view(slf, values, &[values.len()])
    }

    /// First harmonic: color is 0.5 + 0.2820948 of it. `[N, 3]` float32, a view
    #[getter]
    fn sh_dc<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let values = slf.get().opened().loaded.scene.sh_dc.as_flattened();
        view(slf, values, &[values.len() / 3, 3])
    }

    /// Higher harmonics, (degree + 1)² − 1 for each channel. `[N, K, 3]` float32, a view
    #[getter]
    fn sh_rest<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let scene = &slf.get().opened().loaded.scene;
        view(slf, &scene.sh_rest, &[scene.len(), scene.sh_rest_len(), 3])
    }

    /// Unit normals, if the scene has any. `[N, 3]` float32, a view
    #[getter]
    fn normals<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let values = slf.get().opened().loaded.scene.normal.as_ref();
        values.map(|v| view(slf, v.as_flattened(), &[v.len(), 3])).transpose()
    }

    /// Classes that the scene carries, −1 = none, if it does. `[N]` int32, a view
    #[getter]
    fn segment<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        view_some(slf, slf.get().opened().loaded.scene.segment.as_ref())
    }

    /// How sure these classes are, if the scene says it. `[N]` float32, a view
    #[getter]
    fn segment_scores<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        view_some(slf, slf.get().opened().loaded.scene.segment_score.as_ref())
    }

    /// Instances that the scene carries, −1 = none, if it does. `[N]` int32, a view
    #[getter]
    fn instances<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        view_some(slf, slf.get().opened().loaded.scene.instance.as_ref())
    }

    /// Language features that the scene carries, if it does. `[N, D]` float16, a view
    #[getter]
    fn lang_feat<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let features = slf.get().opened().loaded.scene.lang_feat.as_ref();
        features.map(|f| view(slf, &f.values, &[f.values.len() / f.dim.max(1), f.dim])).transpose()
    }

    /// Whether a row of `lang_feat` holds a feature. `[N]` bool, a view
    #[getter]
    fn valid_feat_mask<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        view_some(slf, slf.get().opened().loaded.scene.valid_feat_mask.as_ref())
    }

    /// Rows of the source that the scene is made of, ascending; None if all. `[N]` uint32, a view
    #[getter]
    fn kept_rows<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        view_some(slf, slf.get().opened().loaded.kept_rows.as_ref())
    }

    /// Columns of the file whose meaning is not known, by name, in the types of the file. `[N, …]` each, views
    #[getter]
    fn extra<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(slf.py());
        for column in &slf.get().opened().loaded.scene.extra {
            all.set_item(&column.name, extra(slf, column)?)?;
        }
        Ok(all)
    }

    /// Standard deviations along the axes, meters. `[N, 3]` float32, computed
    #[getter]
    fn scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let scene = &self.opened().loaded.scene;
        let values = compute(py, || {
            (0..scene.len()).flat_map(|row| scene.scale(row)).collect::<Vec<f32>>()
        })?;
        Ok(table(py, values, 3)?.into_any())
    }

    /// Opacities, 0 to 1. `[N]` float32, computed
    #[getter]
    fn opacities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let scene = &self.opened().loaded.scene;
        let values = compute(py, || (0..scene.len()).map(|row| scene.opacity(row)).collect())?;
        Ok(column::<f32>(py, values).into_any())
    }

    /// All harmonics, the first in front. `[N, (degree + 1)², 3]` float32, a copy
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let scene = &self.opened().loaded.scene;
        let gaussians = compute(py, || Gaussians::from_scene(scene))?.map_err(error)?;
        let sides = [scene.len(), gaussians.sh_len(), 3];
        shaped(py, gaussians.sh, &sides)
    }

    /// Labeled points that benchmarks evaluate on, if the scene has any: "coord" `[M, 3]` float32 (meters, relative to
    /// `origin`), "segment" and "instance" `[M]` int32 or None. Views
    #[getter]
    fn labelled_points<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(points) = &slf.get().opened().loaded.scene.labelled_points else {
            return Ok(None);
        };
        let all = PyDict::new(slf.py());
        all.set_item("coord", view(slf, points.coord.as_flattened(), &[points.coord.len(), 3])?)?;
        all.set_item("segment", view_some(slf, points.segment.as_ref())?)?;
        all.set_item("instance", view_some(slf, points.instance.as_ref())?)?;
        Ok(Some(all))
    }
}
