//! What does not move.

use crate::{TrainError, TrainerConfig};
use candle_core::{Tensor, Var};
use scenesplat_models::{FrozenStatistics, ParamStore};
use std::collections::BTreeMap;

/// The frozen part of a module.
pub(crate) struct Freeze {
    parts: Vec<String>,
    /// Batch statistics with the values that they keep.
    buffers: Vec<(String, Var, Tensor)>,
}

impl Freeze {
    /// What `freeze` names.
    ///
    /// # Errors
    /// If a part of `freeze` or `idle` is in no name, or nothing is left to train.
    pub(crate) fn new(config: &TrainerConfig, store: &ParamStore) -> Result<Self, TrainError> {
        let (params, buffers) = (store.parameters(), store.buffers());
        let names: Vec<String> = params.keys().chain(buffers.keys()).cloned().collect();
        for (setting, parts) in [("freeze", &config.freeze), ("idle", &config.idle)] {
            let unknown = parts.iter().find(|p| !names.iter().any(|n| n.contains(p.as_str())));
            if let Some(part) = unknown {
                return Err(TrainError::NoSuchParameter { setting, part: part.clone(), names });
            }
        }
        let parts = config.freeze.clone();
        let mut kept = Vec::new();
        for (name, var) in buffers {
            if is_frozen(&parts, &name) {
                let value = var.as_detached_tensor().copy().map_err(TrainError::tensor(&name))?;
                kept.push((name, var, value));
            }
        }
        let freeze = Self { parts, buffers: kept };
        if freeze.trained(store).is_empty() {
            return Err(TrainError::AllFrozen);
        }
        Ok(freeze)
    }

    /// The parameters that move.
    pub(crate) fn trained(&self, store: &ParamStore) -> BTreeMap<String, Var> {
        let mut params = store.parameters();
        params.retain(|name, _| !is_frozen(&self.parts, name));
        params
    }

    /// For the forward pass: layers of ours then neither use nor gather statistics of the batch.
    pub(crate) fn statistics(&self) -> FrozenStatistics {
        FrozenStatistics::new(self.buffers.iter().map(|(_, var, _)| var))
    }

    /// Sets frozen statistics back that a layer of someone else has moved.
    pub(crate) fn hold(&self) -> Result<(), TrainError> {
        for (name, var, value) in &self.buffers {
            var.set(value).map_err(TrainError::tensor(name))?;
        }
        Ok(())
    }
}

fn is_frozen(parts: &[String], name: &str) -> bool {
    parts.iter().any(|part| name.contains(part.as_str()))
}
