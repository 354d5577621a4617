//! Labels of pictures onto Gaussians.

use crate::arrays::{Input, column, indices, optional, table};
use crate::camera::Camera;
use crate::errors::{argument, error};
use crate::rendering::preset;
use crate::scene::Scene;
use crate::work::compute;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use scenesplat::rasterizer::lifting::{
    DepthTolerance, FinaliseSettings, LabelledPicture, LiftSettings, Lifter, NO_SEGMENT, Robust,
    SegmentMap,
};
use scenesplat::rasterizer::{Gaussians, RasterSettings};

/// A picture as Python gives it: camera, ids of segments, their features, and depth.
type Picture<'py> =
    (Bound<'py, Camera>, Bound<'py, PyAny>, Bound<'py, PyAny>, Option<Bound<'py, PyAny>>);

/// Ids of a picture, −1 = none, of `features` rows.
fn segments(
    given: &Bound<'_, PyAny>,
    width: u32,
    height: u32,
    rows: usize,
) -> PyResult<SegmentMap> {
    let ids = Input::<i64>::new("segments", given)?;
    ids.expect(&[Some(height as usize), Some(width as usize)])?;
    let id = |id: &i64| match *id {
        -1 => Ok(NO_SEGMENT),
        id if usize::try_from(id).is_ok_and(|id| id < rows && id < usize::from(NO_SEGMENT)) => {
            Ok(id as u16)
        }
        id => Err(argument(
            "segments",
            format!("{id} is neither −1 nor one of {rows} rows of features"),
        )),
    };
    let ids = ids.values()?.iter().map(id).collect::<PyResult<_>>()?;
    SegmentMap::new(width, height, ids).map_err(error)
}

/// Lifts features of segments; takes one picture after the other from an iterator.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn lift<'py>(
    scene: &Bound<'py, Scene>,
    pictures: &Bound<'py, PyAny>,
    preset: &str,
    antialiased: Option<bool>,
    robust: &str,
    erosion: u32,
    depth: bool,
    min_coverage: f32,
) -> PyResult<Bound<'py, PyDict>> {
    let py = scene.py();
    let robust = match robust {
        "auto" => Robust::default(),
        "on" => Robust::On,
        "off" => Robust::Off,
        _ => {
            return Err(argument(
                "robust",
                format!("{robust:?} is none of \"auto\", \"on\", \"off\""),
            ));
        }
    };
    let of = &scene.get().opened().loaded.scene;
    let antialiased = antialiased.unwrap_or(of.antialiased);
    let raster = RasterSettings { antialiased, ..self::preset(preset)? };
    let depth = depth.then(DepthTolerance::default);
    let settings = LiftSettings { raster, erosion, depth, ..LiftSettings::default() };
    let gaussians = compute(py, || Gaussians::from_scene(of))?.map_err(error)?;
    let mut lifter: Option<(Lifter<'_>, usize)> = None;
    for picture in pictures.try_iter()? {
        py.check_signals()?;
        let (camera, ids, features, depth): Picture<'_> = picture?.extract()?;
        let view = camera.get().view(of.origin)?;
        let features = Input::<f32>::new("features", &features)?;
        features.expect(&[None, None])?;
        let [rows, dim] = [features.shape()[0], features.shape()[1]];
        let map = [segments(&ids, view.width, view.height, rows)?];
        let depth = optional::<f32>("depth", depth.as_ref())?;
        if let Some(depth) = &depth {
            depth.expect(&[Some(view.height as usize), Some(view.width as usize)])?;
        }
        let depth = depth.as_ref().map(Input::values).transpose()?;
        if lifter.is_none() {
            let made = Lifter::new(&gaussians, 1, dim, settings.clone()).map_err(error)?;
            lifter = Some((made, dim));
        }
        let Some((lifter, width)) = &mut lifter else { continue };
        if dim != *width {
            let problem = format!("{dim} numbers a row, those of the first picture have {width}");
            return Err(argument("features", problem));
        }
        let picture =
            LabelledPicture { view: &view, levels: &map, features: features.values()?, depth };
        compute(py, || lifter.add(&picture))?.map_err(error)?;
    }
    let Some((mut lifter, width)) = lifter else {
        return Err(argument("pictures", "there is none"));
    };
    let (is_robust, found) = compute(py, || {
        let measured = lifter.disagreement(0)?.value();
        let is_robust = robust.decide(measured);
        let base = if is_robust { FinaliseSettings::robust() } else { FinaliseSettings::default() };
        Ok((is_robust, lifter.collect(0, &FinaliseSettings { min_coverage, ..base })?))
    })?
    .map_err(|e: scenesplat::rasterizer::lifting::LiftError| error(e))?;
    let all = PyDict::new(py);
    all.set_item("features", table(py, found.features, width)?)?;
    all.set_item("valid", column(py, found.valid))?;
    all.set_item("confidence", column(py, found.confidence))?;
    all.set_item("views", indices(py, &found.views))?;
    all.set_item("coverage", column(py, found.coverage))?;
    all.set_item("robust", is_robust)?;
    Ok(all)
}
