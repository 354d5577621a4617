//! A trained network as others take it.

use anyhow::{Context, Result};
use candle_core::Tensor;
use scenesplat_models::PointTransformerV3Config;
use scenesplat_trainers::checkpoint::{best_checkpoint, newest_checkpoint, read_network};
use std::collections::HashMap;
use std::path::Path;

/// Writes `model.safetensors` and `config.json` into `folder`: the parameters of the best
/// checkpoint, or of the newest if none is marked, averaged ones where there is an average.
///
/// Gives remarks about which it was.
///
/// # Errors
/// If there is no checkpoint or a file cannot be read or written.
pub fn export_model(
    checkpoints: &Path,
    config: &PointTransformerV3Config,
    folder: &Path,
) -> Result<Vec<String>> {
    let (dir, remark) = match best_checkpoint(checkpoints)? {
        Some(best) => {
            let dir = checkpoints.join(&best.checkpoint);
            (dir, format!("{} of {} ({})", best.checkpoint, best.measurement, best.value))
        }
        None => {
            let newest = newest_checkpoint(checkpoints)?;
            let dir =
                newest.with_context(|| format!("{}: no checkpoint", checkpoints.display()))?;
            let name = dir.file_name().unwrap_or_default().to_string_lossy().into_owned();
            (dir, name)
        }
    };
    let tensors = read_network(&dir)?;
    let averaged = dir.join("average.safetensors").is_file();
    let tensors = tensors.into_iter().collect();
    write_model(&tensors, config, folder)?;
    let averaged = if averaged { ", averaged parameters" } else { "" };
    Ok(vec![format!("model: {remark}{averaged}")])
}

/// Writes a model folder, each file beside and renamed.
///
/// # Errors
/// If a file cannot be written.
pub fn write_model(
    tensors: &HashMap<String, Tensor>,
    config: &PointTransformerV3Config,
    folder: &Path,
) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let beside = folder.join("model.partial");
    candle_core::safetensors::save(tensors, &beside)?;
    std::fs::rename(&beside, folder.join("model.safetensors"))?;
    std::fs::write(&beside, serde_json::to_string_pretty(config)?)?;
    std::fs::rename(&beside, folder.join("config.json"))?;
    Ok(())
}
