//! Weight files that tests make.

use candle_core::{Device, Tensor};
use scenesplat_models::weights::save_tensors;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Shapes and values by name.
pub(crate) type Arrays = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Writes a safetensors file.
pub(crate) fn save(arrays: &Arrays, path: &Path) {
    let tensors: HashMap<&String, Tensor> = arrays
        .iter()
        .map(|(name, (shape, values))| {
            (name, Tensor::from_slice(values, shape.as_slice(), &Device::Cpu).unwrap())
        })
        .collect();
    save_tensors(&tensors, path).unwrap();
}
