//! A trained network as others take it.

use anyhow::{Context, Result};
use candle_core::{Device, Tensor};
use scenesplat_models::PointTransformerV3Config;
use scenesplat_models::weights::save_tensors;
use scenesplat_scene::StagedFolder;
use scenesplat_trainers::checkpoint::{best_checkpoint, newest_checkpoint};
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
    let load = |name: &str| -> Result<HashMap<String, Tensor>> {
        let path = dir.join(name);
        candle_core::safetensors::load(&path, &Device::Cpu)
            .with_context(|| path.display().to_string())
    };
    let mut tensors = load("params.safetensors")?;
    let averaged = dir.join("average.safetensors").is_file();
    if averaged {
        tensors.extend(load("average.safetensors")?);
    }
    write_model(&tensors, config, folder)?;
    let averaged = if averaged { ", averaged parameters" } else { "" };
    Ok(vec![format!("model: {remark}{averaged}")])
}

/// Writes a model folder; its files appear together.
///
/// # Errors
/// If a file cannot be written.
pub fn write_model(
    tensors: &HashMap<String, Tensor>,
    config: &PointTransformerV3Config,
    folder: &Path,
) -> Result<()> {
    let mut staged = StagedFolder::create(folder)?;
    save_tensors(tensors, &staged.add("model.safetensors"))?;
    staged.write("config.json", serde_json::to_string_pretty(config)?.as_bytes())?;
    staged.commit::<&str>(&[])?;
    Ok(())
}
