//! Cameras.

use crate::errors::{argument, error};
use numpy::{PyArray2, ToPyArray};
use pyo3::prelude::*;
use scenesplat::preview::LookAt;
use scenesplat::rasterizer::View;
use scenesplat::scene;
use scenesplat::scene::{Distortion, Up, open_cameras};
use std::path::PathBuf;

/// A camera with its pose: axes x right, y down, z forward; a point p of the world is at `rotation @ p + translation` in
/// them, in the units of the scene. The center of the first pixel is (0.5, 0.5).
#[pyclass(frozen, module = "scenesplat")]
pub struct Camera {
    camera: scene::Camera,
}

impl Camera {
    /// The view in a world from whose positions `origin` is subtracted.
    pub fn view(&self, origin: [f64; 3]) -> PyResult<View> {
        View::from_camera(&self.camera.relative_to(origin)).map_err(error)
    }
}

#[pymethods]
impl Camera {
    /// A pinhole camera: picture size and focal lengths in pixels, pose from the world to the camera. The principal point
    /// is the middle of the picture unless `cx`, `cy` say otherwise.
    #[new]
    #[pyo3(signature = (*, width, height, fx, fy=None, cx=None, cy=None, rotation, translation, name=""))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        width: u32,
        height: u32,
        fx: f64,
        fy: Option<f64>,
        cx: Option<f64>,
        cy: Option<f64>,
        rotation: [[f64; 3]; 3],
        translation: [f64; 3],
        name: &str,
    ) -> PyResult<Self> {
        let mut camera = scene::Camera {
            name: name.to_owned(),
            width,
            height,
            fx,
            fy: fy.unwrap_or(fx),
            cx: cx.unwrap_or(f64::from(width) / 2.0),
            cy: cy.unwrap_or(f64::from(height) / 2.0),
            distortion: Distortion::None,
            rotation,
            translation,
        };
        camera.check("<camera>".as_ref()).map_err(error)?;
        Ok(Self { camera })
    }

    /// A camera at `eye` with `target` in the middle of its picture: up in the scene is up in the picture. `fov`: angle of
    /// view across the shorter side, degrees.
    #[staticmethod]
    #[pyo3(signature = (eye, target, *, up="+z", fov=60.0, width=640, height=480, name=""))]
    fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        up: &str,
        fov: f64,
        width: u32,
        height: u32,
        name: &str,
    ) -> PyResult<Self> {
        let up: Up = up.parse().map_err(|problem: String| argument("up", problem))?;
        let camera = LookAt { eye, target, fov }.camera(name, up, [width, height]);
        let problem = "eye and target are the same or not finite, fov is not in 0 to 180, or the picture is empty";
        camera.map(|camera| Self { camera }).ok_or_else(|| argument("look_at", problem))
    }

    /// The cameras of a file: cameras.json, transforms.json or a COLMAP folder.
    #[staticmethod]
    fn open(path: PathBuf) -> PyResult<Vec<Self>> {
        let set = open_cameras(&path).map_err(error)?;
        Ok(set.cameras.into_iter().map(|camera| Self { camera }).collect())
    }

    /// The same camera with a picture of another size, pixels.
    fn resized(&self, width: u32, height: u32) -> PyResult<Self> {
        if width == 0 || height == 0 {
            return Err(argument("width, height", "are above 0"));
        }
        Ok(Self { camera: self.camera.resized([width, height]) })
    }

    /// Of its picture, as a file says it.
    #[getter]
    fn name(&self) -> &str {
        &self.camera.name
    }

    /// Pixels.
    #[getter]
    fn width(&self) -> u32 {
        self.camera.width
    }

    /// Pixels.
    #[getter]
    fn height(&self) -> u32 {
        self.camera.height
    }

    /// Focal lengths and principal point, pixels: fx, fy, cx, cy.
    #[getter]
    fn intrinsics(&self) -> (f64, f64, f64, f64) {
        let scene::Camera { fx, fy, cx, cy, .. } = self.camera;
        (fx, fy, cx, cy)
    }

    /// World to camera. `[3, 3]` float64
    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows: Vec<Vec<f64>> = self.camera.rotation.iter().map(|row| row.to_vec()).collect();
        PyArray2::from_vec2(py, &rows).map_err(error)
    }

    /// World to camera. `[3]` float64
    #[getter]
    fn translation<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.camera.translation.to_pyarray(py).into_any()
    }

    fn __repr__(&self) -> String {
        let scene::Camera { name, width, height, .. } = &self.camera;
        format!("Camera({name:?}, {width}x{height})")
    }
}
