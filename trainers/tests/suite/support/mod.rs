//! Finds and reads the shared golden files.
#![allow(dead_code, reason = "each test file uses a part")]

use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use std::path::PathBuf;

/// The folder with goldens, or `None` after saying why a test is skipped.
pub fn shared() -> Option<PathBuf> {
    let dir = std::env::var_os("SCENESPLAT_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
        PathBuf::from,
    );
    if dir.is_dir() {
        return Some(dir);
    }
    println!("skipped: no shared data at {}; set SCENESPLAT_SHARED", dir.display());
    None
}

/// One golden case: its tensors, configuration and tolerances.
pub struct Golden {
    bytes: Vec<u8>,
    pub config: Value,
    tensors: Value,
}

impl Golden {
    pub fn read(case: &str) -> Option<Self> {
        let dir = shared()?.join("goldens/network");
        let file = format!("{case}.safetensors");
        let bytes = std::fs::read(dir.join(&file)).expect(&file);
        let manifest = std::fs::read(dir.join("manifest.json")).expect("manifest");
        let manifest: Value = serde_json::from_slice(&manifest).expect("manifest");
        let entries = manifest["entries"].as_array().expect("entries");
        let entry = entries.iter().find(|e| e["file"] == *file).expect("the case is listed");
        Some(Self { bytes, config: entry["config"].clone(), tensors: entry["tensors"].clone() })
    }

    /// Shape and values, in f64 whatever the stored type.
    pub fn get(&self, name: &str) -> (Vec<usize>, Vec<f64>) {
        let file = SafeTensors::deserialize(&self.bytes).expect("safetensors");
        let view = file.tensor(name).expect(name);
        let values = match view.dtype() {
            Dtype::F64 => {
                view.data().as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
            }
            Dtype::F32 => {
                view.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b).into()).collect()
            }
            Dtype::I64 => {
                view.data().as_chunks().0.iter().map(|b| i64::from_le_bytes(*b) as f64).collect()
            }
            Dtype::U8 => view.data().iter().map(|b| f64::from(*b)).collect(),
            other => panic!("{name}: {other:?}"),
        };
        (view.shape().to_vec(), values)
    }

    pub fn values(&self, name: &str) -> Vec<f64> {
        self.get(name).1
    }

    pub fn tensor(&self, name: &str) -> candle_core::Tensor {
        let (shape, values) = self.get(name);
        let values: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
        candle_core::Tensor::from_vec(values, shape, &candle_core::Device::Cpu).expect(name)
    }

    /// Compares within the manifest's tolerance.
    pub fn check(&self, name: &str, got: &[f64]) {
        let tolerance = &self.tensors[name]["tol"];
        let part = |key: &str| tolerance[key].as_f64().unwrap_or(0.0);
        let (atol, rtol) = (part("atol"), part("rtol"));
        let expected = self.values(name);
        assert_eq!(got.len(), expected.len(), "{name}");
        for (i, (g, e)) in got.iter().zip(&expected).enumerate() {
            let allowed = atol + rtol * e.abs();
            assert!((g - e).abs() <= allowed, "{name}[{i}]: got {g}, expected {e} ± {allowed}");
        }
    }

    /// The largest error as part of what is allowed.
    pub fn worst_ratio(&self, name: &str, got: &[f64]) -> f64 {
        let part = |key: &str| self.tensors[name]["tol"][key].as_f64().unwrap_or(0.0);
        let pairs = got.iter().zip(self.values(name));
        let ratio = |(g, e): (&f64, f64)| (g - e).abs() / (part("atol") + part("rtol") * e.abs());
        pairs.map(ratio).fold(0.0, f64::max)
    }

    /// What an element may differ by; `None` if there is no such entry.
    pub fn tolerance(&self, name: &str) -> Option<f64> {
        self.tensors.get(name)?["tol"]["atol"].as_f64()
    }

    pub fn has(&self, name: &str) -> bool {
        self.tensors.get(name).is_some()
    }

    /// Names that begin so, without those whose value the manifest calls unstable.
    pub fn names(&self, prefix: &str) -> Vec<String> {
        let all = self.tensors.as_object().expect("tensors").iter();
        let stable = all.filter(|(_, about)| about["tol"].get("unstable").is_none());
        stable.map(|(name, _)| name.clone()).filter(|name| name.starts_with(prefix)).collect()
    }

    pub fn check_tensor(&self, name: &str, got: &candle_core::Tensor) {
        self.check(name, &values(got));
    }
}

pub fn values(tensor: &candle_core::Tensor) -> Vec<f64> {
    let flat = tensor.flatten_all().and_then(|t| t.to_dtype(candle_core::DType::F64));
    flat.and_then(|t| t.to_vec1()).expect("values")
}
