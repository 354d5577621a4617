//! Weights between those before and those trained: most of what was learned of the scene, and nearly all of what was known.

use super::error::AdaptError;
use super::settings::Folders;
use crate::experiment::ExperimentError;
use crate::experiment::export::write_model;
use crate::network::{NetworkConfig, NetworkError, WeightOptions};
use candle_core::{DType, Device, Tensor};
use scenesplat_models::weights::{Shapes, resolve};
use scenesplat_models::{LoadPolicy, ParamStore};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Writes the network whose weights lie `share` of the way from those at `start` to those that were trained, as the model of the
/// adaptation.
///
/// # Source
/// Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022.
///
/// # Errors
/// If weights cannot be read, do not fit the network, or cannot be written.
pub fn write_blend(
    config: &NetworkConfig,
    start: &Path,
    trained: &Path,
    share: f64,
    folders: &Folders,
) -> Result<(), AdaptError> {
    let mut known = values(config, start)?;
    let path = trained.join("model.safetensors");
    let trained = candle_core::safetensors::load(&path, &Device::Cpu).map_err(model)?;
    let trained: BTreeMap<String, Tensor> = trained.into_iter().collect();
    let mut blended = HashMap::new();
    for (name, value) in trained {
        let blend = |before: Tensor| -> candle_core::Result<Tensor> {
            let [before, after] = [before.to_dtype(DType::F64)?, value.to_dtype(DType::F64)?];
            ((before * (1.0 - share))? + (after * share)?)?.to_dtype(value.dtype())
        };
        let value = match known.remove(&name) {
            Some(before) if value.dtype().is_float() => blend(before).map_err(model)?,
            _ => value,
        };
        blended.insert(name, value);
    }
    Ok(write_model(&blended, config, &folders.model())?)
}

fn model(error: candle_core::Error) -> AdaptError {
    ExperimentError::from(error).into()
}

/// The values of a network by their names in it.
fn values(config: &NetworkConfig, start: &Path) -> Result<BTreeMap<String, Tensor>, AdaptError> {
    let read = || -> Result<_, NetworkError> {
        let fits = |shapes: &Shapes| config.model.fits(shapes);
        let source = WeightOptions::default().source(resolve(start)?.files, fits)?;
        let store = ParamStore::trainable_from(source, 0);
        config.model.build(store.builder())?;
        store.report().check(LoadPolicy::Strict, &start.display().to_string())?;
        let both = store.parameters().into_iter().chain(store.buffers());
        Ok(both.map(|(name, var)| (name, var.as_detached_tensor())).collect())
    };
    Ok(read()?)
}
