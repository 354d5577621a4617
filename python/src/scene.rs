//! Scenes.

use crate::errors::{argument, error};
use crate::work::{run, stopped, warn};
use pyo3::exceptions::PyFileNotFoundError;
use pyo3::prelude::*;
use scenesplat::input::open_input;
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::{
    Policy, ReadOptions, SceneError, SceneFormat, SpzFrame, WriteOptions, WriteReport, write_scene,
};
use std::path::PathBuf;
use std::sync::Arc;

/// A scene of 3D Gaussians, one row of every array for each Gaussian.
///
/// Arrays are views of the scene's memory, without a copy, and cannot be written to; each keeps the scene alive. To change
/// values, copy an array and make a scene of it with `Scene.from_arrays`.
///
/// Lengths are meters (or the unit of the file), in the axes of the file. Scales are stored as natural logarithms and
/// opacities as logits, as files have them; `scales` and `opacities` are what they stand for.
#[pyclass(frozen, module = "scenesplat")]
pub struct Scene {
    opened: Arc<OpenedScene>,
}

impl Scene {
    pub fn new(opened: OpenedScene) -> Self {
        Self { opened: Arc::new(opened) }
    }

    /// The scene with how it was read.
    pub fn opened(&self) -> &Arc<OpenedScene> {
        &self.opened
    }
}

/// `spz_frame`: rub or raw.
fn frame_of(name: &str) -> PyResult<SpzFrame> {
    match name {
        "rub" => Ok(SpzFrame::Rub),
        "raw" => Ok(SpzFrame::Raw),
        _ => Err(argument("spz_frame", format!("{name:?} is neither \"rub\" nor \"raw\""))),
    }
}

#[pymethods]
impl Scene {
    /// Reads a scene in any format that the program reads: PLY (trainers', compressed), SPZ, SOG, KSPLAT, splat, glTF, USD,
    /// folders of .npy, training folders; a labeled point cloud becomes Gaussians, with a warning.
    ///
    /// - `strict`: refuses files with values that would be repaired; else what was repaired is a warning
    /// - `segment_name`: which labels to read: a PLY property or the stem of a .npy file
    /// - `lod`: level of detail of a streamed scene, 0 = finest
    /// - `sh`, `lang_feat`, `extra`: whether to read harmonics beyond the first, language features, columns of unknown
    ///   meaning
    /// - `spz_frame`: "rub", as the format prescribes, or "raw", as in the PLY file it was made from
    #[staticmethod]
    #[pyo3(signature = (path, *, strict=false, segment_name=None, lod=0, sh=true, lang_feat=true, extra=true, spz_frame="rub"))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        strict: bool,
        segment_name: Option<String>,
        lod: usize,
        sh: bool,
        lang_feat: bool,
        extra: bool,
        spz_frame: &str,
    ) -> PyResult<Self> {
        let options = ReadOptions {
            policy: if strict { Policy::Strict } else { Policy::Repair },
            segment: segment_name,
            lang_feat,
            sh_rest: sh,
            spz_frame: frame_of(spz_frame)?,
            extra,
            lod,
        };
        if !path.exists() {
            // What numpy and `open` say, with its number.
            let text = "No such file or directory";
            return Err(PyFileNotFoundError::new_err((2, text, path)));
        }
        let (opened, remark) =
            run(py, None, move |_| open_input(&path, &options))?.map_err(error)?;
        let report = &opened.loaded.report;
        if let Some(remark) = remark {
            warn(py, &remark)?;
        }
        if !report.is_clean() {
            warn(py, &format!("{}: {report}", opened.loaded.path.display()))?;
        }
        if !extra && !opened.loaded.unread.is_empty() {
            let names: Vec<&str> = opened.loaded.unread.iter().map(|c| c.name.as_str()).collect();
            let path = opened.loaded.path.display();
            warn(py, &format!("{path}: columns that were not read: {}", names.join(", ")))?;
        }
        Ok(Self::new(opened))
    }

    /// Writes the scene. The format is that of the ending (.ply, .compressed.ply, .spz, .sog, .glb, .usda, .usdz, .splat, a folder, …)
    /// or `format`. What the format cannot hold is a warning.
    ///
    /// Returns the number of bytes written.
    #[pyo3(signature = (path, *, format=None, overwrite=false, spz_version=4, spz_frame="rub", lod_levels=4, progress=None))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn save(
        &self,
        py: Python<'_>,
        path: PathBuf,
        format: Option<&str>,
        overwrite: bool,
        spz_version: u8,
        spz_frame: &str,
        lod_levels: u8,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<u64> {
        let known = || format!("write one of {}", SceneFormat::writable_endings());
        let format = match format {
            Some(name) => SceneFormat::from_name(name)
                .ok_or_else(|| argument("format", format!("{name:?} is none; {}", known())))?,
            None => SceneFormat::from_path(&path).ok_or_else(|| {
                argument(
                    "path",
                    format!("{}: no format has this ending; {}", path.display(), known()),
                )
            })?,
        };
        let loaded = &self.opened.loaded;
        let options = WriteOptions {
            spz_version,
            spz_frame: frame_of(spz_frame)?,
            lod_levels,
            overwrite,
            stated_up: (loaded.stated_up != loaded.kind.stated_up())
                .then_some(loaded.stated_up.direction),
            ..WriteOptions::default()
        };
        let (opened, to) = (Arc::clone(&self.opened), path.clone());
        let written = run(py, progress, move |caller| {
            write_scene(&opened.loaded.scene, &to, format, &options, &mut |done| {
                caller.advance("writing", done);
                !caller.stops()
            })
        })?;
        let report: WriteReport = match written {
            Err(SceneError::Stopped) => return Err(stopped()),
            written => written.map_err(error)?,
        };
        if !report.limits.is_empty() {
            warn(py, &format!("{}: {report}", path.display()))?;
        }
        Ok(report.bytes)
    }

    fn __len__(&self) -> usize {
        self.opened.loaded.scene.len()
    }

    fn __repr__(&self) -> String {
        let loaded = &self.opened.loaded;
        format!("Scene({:?}, {} Gaussians)", loaded.path.display().to_string(), loaded.scene.len())
    }

    /// The file or folder it was read from; "<arrays>" for a scene of arrays.
    #[getter]
    fn path(&self) -> String {
        self.opened.loaded.path.display().to_string()
    }

    /// What the file is, such as "ply" or "spz".
    #[getter]
    fn format(&self) -> &'static str {
        self.opened.loaded.kind.name()
    }

    /// What was noticed and repaired while reading.
    #[getter]
    fn report(&self) -> String {
        self.opened.loaded.report.to_string()
    }

    /// Rows of the source, those left out included.
    #[getter]
    fn source_rows(&self) -> usize {
        self.opened.loaded.source_rows()
    }

    /// What is subtracted from all positions of the file: a center is at `means + origin` there. Zero for scenes near 0.
    #[getter]
    fn origin(&self) -> (f64, f64, f64) {
        self.opened.loaded.scene.origin.into()
    }

    /// Degree of the spherical harmonics, 0 to 4.
    #[getter]
    fn sh_degree(&self) -> u8 {
        self.opened.loaded.scene.sh_degree
    }

    /// Whether it was trained for antialiased rendering.
    #[getter]
    fn antialiased(&self) -> bool {
        self.opened.loaded.scene.antialiased
    }
}
