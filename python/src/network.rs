//! Networks, and what commands make of scenes with them.

use crate::arrays::{column, indices, table};
use crate::errors::failure;
use crate::scene::Scene;
use crate::work::run;
use pyo3::prelude::*;
use scenesplat::Network;
use scenesplat::outputs::OpenedScene;
use scenesplat_cli::called::{self, Call, Failure, Labelled};
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;

/// A network with the flags that it was loaded by.
#[pyclass(frozen, module = "scenesplat._scenesplat")]
pub struct NativeNetwork {
    network: Arc<Network>,
    flags: Vec<OsString>,
}

#[pymethods]
impl NativeNetwork {
    #[getter]
    fn out_channels(&self) -> usize {
        self.network.model().out_channels()
    }

    #[getter]
    fn grid_size(&self) -> f64 {
        self.network.grid_size()
    }

    #[getter]
    fn is_classifier(&self) -> bool {
        self.network.is_classifier()
    }

    #[getter]
    fn has_random_weights(&self) -> bool {
        self.network.has_random_weights()
    }

    #[getter]
    fn parameters(&self) -> usize {
        self.network.report().parameters
    }

    #[getter]
    fn files(&self) -> Vec<(PathBuf, String)> {
        self.network.files().to_vec()
    }
}

/// Flags of a call and the network that they are for.
struct Asked {
    flags: Vec<OsString>,
    network: Option<Arc<Network>>,
}

impl Asked {
    fn new(network: Option<&Bound<'_, NativeNetwork>>, flags: Vec<OsString>) -> Self {
        let Some(network) = network.map(Bound::get) else { return Self { flags, network: None } };
        let flags = network.flags.iter().cloned().chain(flags).collect();
        Self { flags, network: Some(Arc::clone(&network.network)) }
    }

    /// Runs a command on our threads.
    fn run<T: Send + 'static>(
        self,
        py: Python<'_>,
        progress: Option<&Bound<'_, PyAny>>,
        work: impl FnOnce(Call<'_>) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<T> {
        let done = run(py, progress, move |caller| {
            work(Call { flags: &self.flags, network: self.network, caller })
        })?;
        done.map_err(|error| failure(&error))
    }

    /// As [`run`](Self::run), on the rows of a scene that a network needs.
    fn run_on<T: Send + 'static>(
        self,
        scene: &Bound<'_, Scene>,
        progress: Option<&Bound<'_, PyAny>>,
        work: impl FnOnce(Call<'_>, OpenedScene) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<T> {
        let opened = Arc::clone(scene.get().opened());
        self.run(scene.py(), progress, move |call| work(call, called::for_network(&opened)))
    }
}

type Networks<'a, 'py> = Option<&'a Bound<'py, NativeNetwork>>;
type Progress<'a, 'py> = Option<&'a Bound<'py, PyAny>>;

#[pyfunction]
pub fn load_network(
    py: Python<'_>,
    flags: Vec<OsString>,
    progress: Progress<'_, '_>,
) -> PyResult<NativeNetwork> {
    let asked = Asked { flags: flags.clone(), network: None };
    let network = asked.run(py, progress, called::load_network)?;
    Ok(NativeNetwork { network, flags })
}

/// Distinct rows, the row of each Gaussian, rows that were read, how the scene was turned and scaled as JSON, and
/// the axes of codes.
type FeatureParts<'py> =
    (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, String, Option<Bound<'py, PyAny>>);

#[pyfunction]
pub fn features<'py>(
    scene: &Bound<'py, Scene>,
    network: Networks<'_, 'py>,
    flags: Vec<OsString>,
    progress: Progress<'_, 'py>,
) -> PyResult<FeatureParts<'py>> {
    let py = scene.py();
    let asked = Asked::new(network, flags);
    let (rows, found) = asked.run_on(scene, progress, |call, opened| {
        let found = called::features(call, opened)?;
        let rows = found.slot_rows(0..found.num_slots()).map_err(Failure::of)?;
        Ok((rows, found))
    })?;
    let axes = found.codes().map(|codes| table(py, codes.axes.clone(), codes.width)).transpose()?;
    let report = found.alignment.as_ref().map(|alignment| alignment.report());
    let report = serde_json::to_string(&report).map_err(crate::errors::error)?;
    Ok((
        table(py, rows, found.width())?.into_any(),
        indices(py, found.inverse()).into_any(),
        indices(py, found.sampled()).into_any(),
        report,
        axes.map(Bound::into_any),
    ))
}

/// Labels, scores and the names of the classes.
type LabelParts<'py> = (Bound<'py, PyAny>, Option<Bound<'py, PyAny>>, Vec<String>);

fn label_parts(py: Python<'_>, found: Labelled) -> LabelParts<'_> {
    let scores = found.scores.map(|scores| column(py, scores).into_any());
    (column(py, found.labels).into_any(), scores, found.names)
}

#[pyfunction]
pub fn segment<'py>(
    scene: &Bound<'py, Scene>,
    network: Networks<'_, 'py>,
    flags: Vec<OsString>,
    progress: Progress<'_, 'py>,
) -> PyResult<LabelParts<'py>> {
    let asked = Asked::new(network, flags);
    let found = asked.run_on(scene, progress, called::segment)?;
    Ok(label_parts(scene.py(), found))
}

#[pyfunction]
pub fn query<'py>(
    scene: &Bound<'py, Scene>,
    phrase: String,
    network: Networks<'_, 'py>,
    flags: Vec<OsString>,
    progress: Progress<'_, 'py>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let py = scene.py();
    let asked = Asked::new(network, flags);
    let found =
        asked.run_on(scene, progress, move |call, opened| called::query(call, &phrase, opened))?;
    let selected: Vec<u8> = found.selected.iter().map(|s| *s as u8).collect();
    Ok((column(py, found.scores).into_any(), column(py, selected).into_any()))
}

/// Labels as [`segment`] gives them, the object of each Gaussian, and the table as JSON.
#[pyfunction]
pub fn objects<'py>(
    scene: &Bound<'py, Scene>,
    network: Networks<'_, 'py>,
    flags: Vec<OsString>,
    progress: Progress<'_, 'py>,
) -> PyResult<(LabelParts<'py>, Bound<'py, PyAny>, String)> {
    let py = scene.py();
    let asked = Asked::new(network, flags);
    let (labelled, found, table) = asked.run_on(scene, progress, called::objects)?;
    let instances = column(py, found.instances()).into_any();
    Ok((label_parts(py, labelled), instances, table.to_string()))
}

/// Rotation, meters per unit, and the whole report as JSON.
#[pyfunction]
pub fn align<'py>(
    scene: &Bound<'py, Scene>,
    network: Networks<'_, 'py>,
    flags: Vec<OsString>,
    progress: Progress<'_, 'py>,
) -> PyResult<(Bound<'py, PyAny>, f64, String)> {
    let py = scene.py();
    let found = Asked::new(network, flags)
        .run_on(scene, progress, |call, opened| called::align(call, &opened))?;
    let report = serde_json::to_string(&found.report()).map_err(crate::errors::error)?;
    let rotation = table(py, found.rotation().as_flattened().to_vec(), 3)?.into_any();
    Ok((rotation, found.scale, report))
}

/// What is in a scene, as text and as JSON.
#[pyfunction]
pub fn inspect(
    scene: &Bound<'_, Scene>,
    network: Networks<'_, '_>,
    flags: Vec<OsString>,
    progress: Progress<'_, '_>,
) -> PyResult<(String, String)> {
    let opened = Arc::clone(scene.get().opened());
    let (text, json) = Asked::new(network, flags)
        .run(scene.py(), progress, move |call| called::inspect(call, &opened))?;
    Ok((text, json.to_string()))
}

/// The figures of an evaluation as JSON. `names`: all scenes, held or as the command line has them, in order.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    scenes: Vec<Bound<'_, Scene>>,
    names: Vec<PathBuf>,
    network: Networks<'_, '_>,
    flags: Vec<OsString>,
    progress: Progress<'_, '_>,
) -> PyResult<String> {
    let scenes: Vec<_> = scenes.iter().map(|scene| Arc::clone(scene.get().opened())).collect();
    let json = Asked::new(network, flags).run(py, progress, move |call| {
        let held = scenes.iter().map(|scene| called::for_network(scene)).collect();
        called::evaluate(call, held, &names)
    })?;
    Ok(json.to_string())
}
