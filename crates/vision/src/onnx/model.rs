//! One ONNX file.

use super::OnnxRuntime;
use crate::VisionError;
use ort::session::{Session, SessionInputValue};
use ort::value::{TensorElementType, TensorRef, ValueType};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

pub(super) const HELP: &str =
    "export the network with inputs and outputs in float32, named as docs/vision.md says";

/// An input or an output.
#[derive(Debug, Clone)]
pub(super) struct Port {
    pub name: String,
    /// −1 where a size may be any.
    pub shape: Vec<i64>,
}

/// Numbers and their shape.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Array {
    pub shape: Vec<i64>,
    pub values: Vec<f32>,
}

/// A network in a file.
pub(super) struct Model {
    path: PathBuf,
    pub inputs: Vec<Port>,
    pub outputs: Vec<Port>,
    // One run at a time; a run has threads of its own.
    session: Mutex<Session>,
}

impl Model {
    pub fn open(_: &OnnxRuntime, path: &Path) -> Result<Self, VisionError> {
        let bad =
            |problem: String| VisionError::Model { path: path.to_owned(), problem, help: HELP };
        if !path.is_file() {
            return Err(bad("is no file".to_owned()));
        }
        let text = |error: &dyn std::fmt::Display| bad(format!("ONNX Runtime refuses it: {error}"));
        let session = Session::builder()
            .map_err(|e| text(&e))?
            .with_intra_threads(rayon::current_num_threads())
            .map_err(|e| text(&e))?
            .with_deterministic_compute(true)
            .map_err(|e| text(&e))?
            .commit_from_file(path)
            .map_err(|e| text(&e))?;
        let ports = |list: &[ort::value::Outlet], what: &str| -> Result<Vec<Port>, VisionError> {
            let port = |outlet: &ort::value::Outlet| match outlet.dtype() {
                ValueType::Tensor { ty: TensorElementType::Float32, shape, .. } => {
                    Ok(Port { name: outlet.name().to_owned(), shape: shape.to_vec() })
                }
                other => {
                    Err(bad(format!("its {what} {:?} is {other:?}, not float32", outlet.name())))
                }
            };
            list.iter().map(port).collect()
        };
        let (inputs, outputs) =
            (ports(session.inputs(), "input")?, ports(session.outputs(), "output")?);
        Ok(Self { path: path.to_owned(), inputs, outputs, session: Mutex::new(session) })
    }

    pub fn bad(&self, problem: impl Into<String>) -> VisionError {
        VisionError::Model { path: self.path.clone(), problem: problem.into(), help: HELP }
    }

    /// The side of the square pictures that its input `[N, 3, side, side]` takes; 0 if it takes any.
    pub fn picture_side(&self, input: &Port) -> Result<usize, VisionError> {
        match input.shape[..] {
            [n, 3 | -1, h, w]
                if h == w && (h == -1 || (16..=4096).contains(&h)) && (n == -1 || n == 1) =>
            {
                Ok(usize::try_from(h).unwrap_or(0))
            }
            _ => {
                let Port { name, shape } = input;
                Err(self.bad(format!(
                    "its input {name:?} is {shape:?}, expected [1 or any, 3, side, side]"
                )))
            }
        }
    }

    /// Runs it once; gives the outputs that are asked for.
    pub fn run(
        &self,
        inputs: &[(&str, &Array)],
        wanted: &[&str],
    ) -> Result<Vec<Array>, VisionError> {
        let failed = |error: ort::Error| self.bad(format!("ONNX Runtime failed: {error}"));
        let mut values: Vec<(Cow<'_, str>, SessionInputValue<'_>)> =
            Vec::with_capacity(inputs.len());
        for (name, array) in inputs {
            let tensor = TensorRef::from_array_view((array.shape.clone(), array.values.as_slice()));
            values.push((Cow::Borrowed(*name), tensor.map_err(failed)?.into()));
        }
        let mut session = self.session.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let found = session.run(values).map_err(failed)?;
        let one = |name: &&str| {
            let value =
                found.get(*name).ok_or_else(|| self.bad(format!("gave no output {name:?}")))?;
            let (shape, values) = value.try_extract_tensor::<f32>().map_err(failed)?;
            if let Some(at) = values.iter().position(|v| !v.is_finite()) {
                return Err(self.bad(format!("its output {name:?} holds {} at {at}", values[at])));
            }
            Ok(Array { shape: shape.to_vec(), values: values.to_vec() })
        };
        wanted.iter().map(one).collect()
    }
}
