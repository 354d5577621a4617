//! Scenes of arrays.

use crate::arrays::{Input, optional};
use crate::errors::{argument, error};
use crate::scene::Scene;
use crate::work::{compute, warn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::gaussian_scene::SH_C0;
use scenesplat::scene::{ExtraColumn, GaussianScene, LoadedScene, NumberType, Policy};
use std::path::Path;

/// What messages call a scene that no file holds.
pub const NAME: &str = "<arrays>";

type Given<'a, 'py> = Option<&'a Bound<'py, PyAny>>;

/// One of two ways to say the same, and which.
fn one_of<'a, 'py>(
    (first, a): (&'static str, Given<'a, 'py>),
    (second, b): (&'static str, Given<'a, 'py>),
) -> PyResult<(&'static str, &'a Bound<'py, PyAny>)> {
    match (a, b) {
        (Some(a), None) => Ok((first, a)),
        (None, Some(b)) => Ok((second, b)),
        (None, None) => Err(argument(first, format!("is missing; give it, or {second}"))),
        (Some(_), Some(_)) => {
            Err(argument(first, format!("{second} says the same; give one of them")))
        }
    }
}

fn rows_of<const W: usize>(
    name: &'static str,
    given: &Bound<'_, PyAny>,
    rows: usize,
) -> PyResult<Vec<[f32; W]>> {
    let input = Input::<f32>::new(name, given)?;
    input.expect(&[Some(rows), Some(W)])?;
    Ok(input.rows::<W>()?.to_vec())
}

fn column_of<T: numpy::Element + Copy>(
    name: &'static str,
    given: Given<'_, '_>,
    rows: usize,
) -> PyResult<Option<Vec<T>>> {
    let input = optional::<T>(name, given)?;
    input.map(|input| Ok(input.column(Some(rows))?.to_vec())).transpose()
}

/// First and higher harmonics, and their degree.
fn harmonics(given: &Bound<'_, PyAny>, rows: usize) -> PyResult<(Vec<[f32; 3]>, Vec<f32>, u8)> {
    let input = Input::<f32>::new("sh", given)?;
    let count = input.shape().get(1).copied().unwrap_or_default();
    let Some(degree) = (0..=4u8).find(|d| (usize::from(*d) + 1).pow(2) == count) else {
        let shape = input.shape();
        let problem = format!("expected [N, (degree + 1)², 3] of degree 0 to 4, got {shape:?}");
        return Err(argument("sh", problem));
    };
    input.expect(&[Some(rows), Some(count), Some(3)])?;
    let (mut first, mut rest) = (Vec::with_capacity(rows), Vec::new());
    for row in input.values()?.chunks_exact(3 * count) {
        first.push([row[0], row[1], row[2]]);
        rest.extend_from_slice(&row[3..]);
    }
    Ok((first, rest, degree))
}

/// A column of any numbers.
fn extra(name: &str, given: &Bound<'_, PyAny>, rows: usize) -> PyResult<ExtraColumn> {
    let py = given.py();
    let wrong = |problem: String| argument(&format!("extra[{name:?}]"), problem);
    let numpy = py.import("numpy")?;
    let array = numpy.call_method1("ascontiguousarray", (given,))?;
    let ty = array.getattr("dtype")?;
    let (kind, size): (String, u8) =
        (ty.getattr("kind")?.extract()?, ty.getattr("itemsize")?.extract()?);
    let ty = match (kind.as_str(), size) {
        ("b", 1) => NumberType::Bool,
        ("i", 1 | 2 | 4 | 8) => NumberType::Int(size),
        ("u", 1 | 2 | 4 | 8) => NumberType::UInt(size),
        ("f", 2 | 4 | 8) => NumberType::Float(size),
        _ => return Err(wrong(format!("numbers are expected, got an array of {ty}"))),
    };
    let shape: Vec<usize> = array.getattr("shape")?.extract()?;
    if shape.first() != Some(&rows) || shape.contains(&0) {
        return Err(wrong(format!("expected {rows} rows of at least one number, got {shape:?}")));
    }
    let little = array.getattr("dtype")?.call_method1("newbyteorder", ("<",))?;
    let array = array.call_method1("astype", (little,))?;
    let bytes: Vec<u8> = array.call_method0("tobytes")?.extract()?;
    Ok(ExtraColumn { name: name.to_owned(), ty, row_shape: shape[1..].to_vec(), bytes })
}

#[pymethods]
impl Scene {
    /// A scene of arrays: numpy's, torch's by DLPack, or whatever numpy takes. They are copied.
    ///
    /// - `means`: centers, meters. `[N, 3]`
    /// - `rotations`: w, x, y, z, any norm above 0. `[N, 4]`
    /// - `log_scales` or `scales`: standard deviations in meters, as natural logarithms or as they are. `[N, 3]`
    /// - `opacity_logits` or `opacities`: before the sigmoid, or 0 to 1. `[N]`
    /// - `sh` `[N, (degree + 1)², 3]`, or `colors` 0 to 1 `[N, 3]`
    /// - `normals` `[N, 3]`, `segment`, `instances` `[N]` whole numbers, −1 = none
    /// - `extra`: further columns by name, `[N, …]` each
    /// - `strict`: refuses values that would be repaired; else what was repaired is a warning, as for files
    #[staticmethod]
    #[pyo3(signature = (*, means, rotations, log_scales=None, scales=None, opacity_logits=None, opacities=None, sh=None,
        colors=None, normals=None, segment=None, instances=None, extra=None, antialiased=false, strict=false))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn from_arrays(
        py: Python<'_>,
        means: &Bound<'_, PyAny>,
        rotations: &Bound<'_, PyAny>,
        log_scales: Option<&Bound<'_, PyAny>>,
        scales: Option<&Bound<'_, PyAny>>,
        opacity_logits: Option<&Bound<'_, PyAny>>,
        opacities: Option<&Bound<'_, PyAny>>,
        sh: Option<&Bound<'_, PyAny>>,
        colors: Option<&Bound<'_, PyAny>>,
        normals: Option<&Bound<'_, PyAny>>,
        segment: Option<&Bound<'_, PyAny>>,
        instances: Option<&Bound<'_, PyAny>>,
        extra: Option<&Bound<'_, PyDict>>,
        antialiased: bool,
        strict: bool,
    ) -> PyResult<Self> {
        let means = Input::<f32>::new("means", means)?;
        let coord = means.rows::<3>()?.to_vec();
        let n = coord.len();
        let (name, given) = one_of(("log_scales", log_scales), ("scales", scales))?;
        let mut log_scale = rows_of::<3>(name, given, n)?;
        if name == "scales" {
            log_scale.as_flattened_mut().iter_mut().for_each(|v| *v = v.ln());
        }
        let (name, given) = one_of(("opacity_logits", opacity_logits), ("opacities", opacities))?;
        let mut opacity_logit = column_of::<f32>(name, Some(given), n)?.unwrap_or_default();
        if name == "opacities" {
            if let Some(row) = opacity_logit.iter().position(|v| *v < 0.0 || *v > 1.0) {
                let value = opacity_logit[row];
                return Err(argument(
                    name,
                    format!("row {row} is {value}, not in 0 to 1; give logits as opacity_logits"),
                ));
            }
            opacity_logit.iter_mut().for_each(|v| *v = (*v / (1.0 - *v)).ln());
        }
        let (sh_dc, sh_rest, sh_degree) = match one_of(("sh", sh), ("colors", colors))? {
            ("sh", given) => harmonics(given, n)?,
            (name, given) => {
                let dc = |row: [f32; 3]| row.map(|v| (v - 0.5) / SH_C0);
                (rows_of::<3>(name, given, n)?.into_iter().map(dc).collect(), Vec::new(), 0)
            }
        };
        let mut columns = Vec::new();
        for (name, values) in extra.into_iter().flatten() {
            columns.push(self::extra(&name.extract::<String>()?, &values, n)?);
        }
        let scene = GaussianScene {
            coord,
            log_scale,
            quat: rows_of::<4>("rotations", rotations, n)?,
            opacity_logit,
            sh_dc,
            sh_rest,
            sh_degree,
            normal: normals.map(|given| rows_of::<3>("normals", given, n)).transpose()?,
            segment: column_of("segment", segment, n)?,
            instance: column_of("instances", instances, n)?,
            extra: columns,
            antialiased,
            ..GaussianScene::default()
        };
        let policy = if strict { Policy::Strict } else { Policy::Repair };
        let made = compute(py, || LoadedScene::of_arrays(scene, policy, Path::new(NAME)))?;
        let loaded = made.map_err(error)?;
        if !loaded.report.is_clean() {
            warn(py, &format!("{NAME}: {}", loaded.report))?;
        }
        Ok(Self::new(OpenedScene { loaded, converted: false }))
    }
}
