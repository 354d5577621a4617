//! The library.

use crate::VisionError;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// What the loader is asked for where nothing is said.
const DEFAULT: &str = if cfg!(target_os = "windows") {
    "onnxruntime.dll"
} else if cfg!(target_os = "macos") {
    "libonnxruntime.dylib"
} else {
    "libonnxruntime.so"
};
const HELP: &str = "name the file of ONNX Runtime 1.18 or newer, libonnxruntime.so; it is in the releases of ONNX Runtime, and \
                    in the Python package onnxruntime as onnxruntime/capi/libonnxruntime.so.1.…";

/// ONNX Runtime, loaded. A process loads it once.
#[derive(Debug, Clone)]
pub struct OnnxRuntime {
    library: PathBuf,
    build: String,
}

static LOADED: Mutex<Option<OnnxRuntime>> = Mutex::new(None);

impl OnnxRuntime {
    /// Loads the library from a file, or by the name `libonnxruntime.so` from where the system looks for libraries.
    ///
    /// # Errors
    /// If there is no such library, it is older than 1.18, or the process has already loaded another one.
    pub fn load(library: Option<&Path>) -> Result<Self, VisionError> {
        let library = library.map_or_else(|| PathBuf::from(DEFAULT), Path::to_owned);
        let bad =
            |problem: String| VisionError::Model { path: library.clone(), problem, help: HELP };
        // A panic elsewhere leaves nothing half done here.
        let mut loaded = LOADED.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(runtime) = &*loaded {
            return match runtime.library == library {
                true => Ok(runtime.clone()),
                false => {
                    let other = runtime.library.display();
                    Err(bad(format!(
                        "cannot be loaded: {other} is already, and one process has one"
                    )))
                }
            };
        }
        // A path without folders is a name for the system's loader; any other one is a file.
        let is_name = library.components().count() == 1 && !library.is_absolute();
        if !is_name && !library.is_file() {
            return Err(bad("is no file".to_owned()));
        }
        let file = if is_name {
            library.clone()
        } else {
            std::path::absolute(&library).unwrap_or(library.clone())
        };
        ort::init_from(&file)
            .map_err(|error| bad(format!("ONNX Runtime could not be loaded: {error}")))?
            .with_telemetry(false)
            .commit();
        let runtime = Self { library, build: ort::info().to_owned() };
        *loaded = Some(runtime.clone());
        Ok(runtime)
    }

    /// What the library says of its build, on one line: another build may give other bits.
    pub fn build(&self) -> &str {
        &self.build
    }
}
