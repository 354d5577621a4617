//! Reference numbers.
#![allow(dead_code, reason = "each program uses a part")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set itself up should stop"
)]

use safetensors::{Dtype, SafeTensors};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// `goldens/raster/optimise.safetensors` of the shared data.
pub struct Golden {
    arrays: BTreeMap<String, (Vec<usize>, Vec<f64>)>,
    /// What its manifest says.
    pub scalars: serde_json::Value,
}

fn shared(relative: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let root = std::env::var_os("SCENESPLAT_SHARED").map_or(beside, PathBuf::from);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there; NOT RUN", path.display());
    None
}

impl Golden {
    /// `None`, with a line saying so, where the shared data are not installed.
    pub fn open() -> Option<Self> {
        let bytes = std::fs::read(shared("goldens/raster/optimise.safetensors")?).unwrap();
        let manifest = std::fs::read(shared("goldens/raster/manifest.json")?).unwrap();
        let manifest: serde_json::Value = serde_json::from_slice(&manifest).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let mut arrays = BTreeMap::new();
        for (name, view) in file.tensors() {
            let words = || view.data().as_chunks::<4>().0.iter().copied();
            let values: Vec<f64> = match view.dtype() {
                Dtype::F32 => words().map(|w| f64::from(f32::from_le_bytes(w))).collect(),
                Dtype::I32 => words().map(|w| f64::from(i32::from_le_bytes(w))).collect(),
                Dtype::U8 => view.data().iter().map(|v| f64::from(*v)).collect(),
                other => panic!("{name} is {other:?}"),
            };
            arrays.insert(name, (view.shape().to_vec(), values));
        }
        Some(Self { arrays, scalars: manifest["optimise"]["scalars"].clone() })
    }

    pub fn array(&self, name: &str) -> &[f64] {
        &self.arrays[name].1
    }

    pub fn shape(&self, name: &str) -> &[usize] {
        &self.arrays[name].0
    }

    pub fn f32(&self, name: &str) -> Vec<f32> {
        self.array(name).iter().map(|v| *v as f32).collect()
    }

    pub fn rows<const K: usize>(&self, name: &str) -> Vec<[f32; K]> {
        self.f32(name).as_chunks().0.to_vec()
    }

    /// A picture `[3, H, W]` as `[H, W, 3]`.
    pub fn picture(&self, name: &str) -> Vec<f32> {
        let (values, plane) = (self.f32(name), self.array(name).len() / 3);
        (0..3 * plane).map(|i| values[i % 3 * plane + i / 3]).collect()
    }

    pub fn number(&self, path: &str) -> f64 {
        self.scalars.pointer(path).and_then(serde_json::Value::as_f64).unwrap()
    }
}

/// Largest error, relative to the largest value.
pub fn error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let most = want.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let worst = got.iter().zip(want).map(|(g, w)| (f64::from(*g) - w).abs());
    worst.fold(0.0, |m: f64, e| if e.is_nan() { e } else { m.max(e) }) / most
}

/// Fails if an error is above the limit.
pub fn compare(name: &str, got: &[f32], want: &[f64], limit: f64) {
    let error = error(got, want);
    println!("{name}: {error:.2e}");
    assert!(error <= limit, "{name}: {error:e} of the largest value, more than {limit:e}");
}
