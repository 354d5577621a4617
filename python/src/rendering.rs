//! Pictures of scenes, and their gradients.

use crate::arrays::{Input, column, shaped, table};
use crate::camera::Camera;
use crate::errors::{argument, error};
use crate::scene::Scene;
use crate::work::compute;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use scenesplat::rasterizer::backward::{GradMask, Trace, TraceRequest, Upstream, backward, trace};
use scenesplat::rasterizer::{
    DepthRequest, Gaussians, PlanRequest, Prepared, RasterSettings, RenderPlan, RenderRequest,
    SceneProfile, View, render_features,
};

/// The constants of a renderer.
pub fn preset(name: &str) -> PyResult<RasterSettings> {
    match name {
        "gsplat-1.6" => Ok(RasterSettings::gsplat_1_6()),
        "gsplat-1.5" => Ok(RasterSettings::gsplat_1_5()),
        "inria" => Ok(RasterSettings::inria()),
        _ => {
            let known = "\"gsplat-1.6\", \"gsplat-1.5\", \"inria\"";
            Err(argument("preset", format!("{name:?} is none of {known}")))
        }
    }
}

/// Color, what is covered, and depth.
type Planes<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Option<Bound<'py, PyAny>>);

/// A scene that is ready to be drawn.
#[pyclass(frozen, module = "scenesplat._scenesplat")]
pub struct Drawing {
    prepared: Prepared,
    request: RenderRequest,
    settings: RasterSettings,
    origin: [f64; 3],
    rows: usize,
}

#[pymethods]
impl Drawing {
    /// Plans as `scenesplat render` does.
    #[new]
    fn new(
        scene: &Bound<'_, Scene>,
        depth: bool,
        preset: &str,
        antialiased: Option<bool>,
        background: Option<[f32; 3]>,
        sh_degree: Option<u8>,
    ) -> PyResult<Self> {
        let settings = self::preset(preset)?;
        let scene_of = &scene.get().opened().loaded.scene;
        let antialiased = antialiased.unwrap_or(scene_of.antialiased);
        let settings = RasterSettings { antialiased, background, ..settings };
        let depth = DepthRequest { expected: depth, ..DepthRequest::default() };
        let request = RenderRequest { depth, sh_degree, ..RenderRequest::rgb() };
        let prepared = compute(scene.py(), || {
            let gaussians = Gaussians::from_scene(scene_of)?;
            let profile = SceneProfile::scan(&gaussians)?;
            let plan = RenderPlan::auto(&profile, settings, PlanRequest::new(request))?;
            plan.prepare(gaussians).map_err(anyhow::Error::from)
        })?;
        let (origin, rows) = (scene_of.origin, scene_of.len());
        Ok(Self { prepared: prepared.map_err(error)?, request, settings, origin, rows })
    }

    /// Color `[H, W, 3]`, what is covered `[H, W]`, and depth `[H, W]` if it was asked for.
    fn draw<'py>(&self, py: Python<'py>, camera: &Camera) -> PyResult<Planes<'py>> {
        let view = camera.view(self.origin)?;
        let picture = compute(py, || self.prepared.render(&view, &self.request))?.map_err(error)?;
        let alpha = picture.alpha();
        let [h, w] = [view.height as usize, view.width as usize];
        let depth = picture.depth_expected.filter(|_| self.request.depth.expected);
        Ok((
            shaped(py, picture.rgb.unwrap_or_default(), &[h, w, 3])?,
            shaped(py, alpha, &[h, w])?,
            depth.map(|depth| shaped(py, depth, &[h, w])).transpose()?,
        ))
    }

    /// Any rows, blended as colors are, without background. `[H, W, D]`
    fn draw_features<'py>(
        &self,
        py: Python<'py>,
        camera: &Camera,
        features: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let view = camera.view(self.origin)?;
        let features = Input::<f32>::new("features", features)?;
        features.expect(&[Some(self.rows), None])?;
        let (dim, values) = (features.shape()[1], features.values()?);
        let rows = self.prepared.rows();
        let gaussians = self.prepared.gaussians();
        let out = compute(py, || match rows {
            // Gaussians that are never drawn were taken out, in order.
            Some(rows) => {
                let kept: Vec<f32> = (rows.iter())
                    .flat_map(|&row| &values[row as usize * dim..(row as usize + 1) * dim])
                    .copied()
                    .collect();
                render_features(gaussians, &view, &self.settings, &kept, dim)
            }
            None => render_features(gaussians, &view, &self.settings, values, dim),
        })?;
        shaped(py, out.map_err(error)?, &[view.height as usize, view.width as usize, dim])
    }
}

/// A picture with what its gradients need.
#[pyclass(frozen, module = "scenesplat")]
pub struct Rasterized {
    gaussians: Gaussians,
    view: View,
    settings: RasterSettings,
    trace: Trace,
}

impl Rasterized {
    fn plane<'py>(
        &self,
        py: Python<'py>,
        values: &[f32],
        channels: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let [h, w] = [self.view.height as usize, self.view.width as usize];
        match channels {
            1 => shaped(py, values.to_vec(), &[h, w]),
            _ => shaped(py, values.to_vec(), &[h, w, channels]),
        }
    }
}

#[pymethods]
impl Rasterized {
    /// Draws Gaussians by activated values: see `scenesplat.rasterize`.
    #[new]
    #[allow(clippy::too_many_arguments, reason = "one array for each property")]
    fn new(
        py: Python<'_>,
        means: &Bound<'_, PyAny>,
        rotations: &Bound<'_, PyAny>,
        scales: &Bound<'_, PyAny>,
        opacities: &Bound<'_, PyAny>,
        sh: &Bound<'_, PyAny>,
        camera: &Camera,
        preset: &str,
        antialiased: bool,
        background: Option<[f32; 3]>,
    ) -> PyResult<Self> {
        let means = Input::<f32>::new("means", means)?.rows::<3>()?.to_vec();
        let n = means.len();
        let sh = Input::<f32>::new("sh", sh)?;
        let count = sh.shape().get(1).copied().unwrap_or_default();
        let Some(sh_degree) = (0..=3u8).find(|d| (usize::from(*d) + 1).pow(2) == count) else {
            let problem =
                format!("expected [N, (degree + 1)², 3] of degree 0 to 3, got {:?}", sh.shape());
            return Err(argument("sh", problem));
        };
        sh.expect(&[Some(n), Some(count), Some(3)])?;
        let [rotations, scales] = [("rotations", rotations), ("scales", scales)]
            .map(|(name, given)| Input::<f32>::new(name, given));
        let gaussians = Gaussians {
            means,
            quats: rotations?.rows::<4>()?.to_vec(),
            scales: scales?.rows::<3>()?.to_vec(),
            opacities: Input::<f32>::new("opacities", opacities)?.column(Some(n))?.to_vec(),
            sh: sh.values()?.to_vec(),
            sh_degree,
        };
        let view = camera.view([0.0; 3])?;
        let settings = RasterSettings { antialiased, background, ..self::preset(preset)? };
        let draw = || trace(&gaussians, &view, &settings, TraceRequest::rgb_depth());
        let trace = compute(py, draw)?.map_err(error)?;
        Ok(Self { gaussians, view, settings, trace })
    }

    /// Color, at least 0. `[H, W, 3]` float32
    #[getter]
    fn rgb<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.plane(py, self.trace.picture.rgb.as_deref().unwrap_or_default(), 3)
    }

    /// What is covered, 0 to 1. `[H, W]` float32
    #[getter]
    fn alpha<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.plane(py, &self.trace.picture.alpha(), 1)
    }

    /// Mean depth along the camera's axis, units of the world; 0 where nothing is. `[H, W]` float32
    #[getter]
    fn depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.plane(py, self.trace.picture.depth_expected.as_deref().unwrap_or_default(), 1)
    }

    /// Gradients of `Σ grad · picture` with respect to the arrays that were given, by their names. What is not given is 0.
    #[pyo3(signature = (*, rgb=None, alpha=None, depth=None))]
    fn backward<'py>(
        &self,
        py: Python<'py>,
        rgb: Option<&Bound<'py, PyAny>>,
        alpha: Option<&Bound<'py, PyAny>>,
        depth: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let [h, w] = [self.view.height as usize, self.view.width as usize];
        let plane = |name, given: Option<&Bound<'py, PyAny>>, sides: &[usize]| {
            let sides: Vec<Option<usize>> = sides.iter().copied().map(Some).collect();
            let input = given.map(|given| Input::<f32>::new(name, given)).transpose()?;
            input.iter().try_for_each(|input| input.expect(&sides))?;
            PyResult::Ok(input)
        };
        let rgb = plane("rgb", rgb, &[h, w, 3])?;
        let [alpha, depth] =
            [("alpha", alpha), ("depth", depth)].map(|(name, given)| plane(name, given, &[h, w]));
        let (alpha, depth) = (alpha?, depth?);
        let upstream = Upstream {
            rgb: rgb.as_ref().map(Input::values).transpose()?,
            alpha: alpha.as_ref().map(Input::values).transpose()?,
            depth_expected: depth.as_ref().map(Input::values).transpose()?,
            ..Upstream::default()
        };
        let found = compute(py, || {
            let Self { gaussians, view, settings, trace } = self;
            backward(gaussians, view, settings, trace, &upstream, GradMask::all())
        })?;
        let found = found.map_err(error)?;
        let all = PyDict::new(py);
        all.set_item("means", table(py, found.means.as_flattened().to_vec(), 3)?)?;
        all.set_item("rotations", table(py, found.quats.as_flattened().to_vec(), 4)?)?;
        all.set_item("scales", table(py, found.scales.as_flattened().to_vec(), 3)?)?;
        all.set_item("opacities", column(py, found.opacities))?;
        let sides = [self.gaussians.len(), self.gaussians.sh_len(), 3];
        all.set_item("sh", shaped(py, found.sh, &sides)?)?;
        Ok(all)
    }
}
