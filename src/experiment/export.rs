//! A trained network as others take it.

use super::ExperimentError;
use crate::NetworkConfig;
use candle_core::Tensor;
use scenesplat_models::BackboneConfig;
use scenesplat_models::weights::save_tensors;
use scenesplat_scene::StagedFolder;
use scenesplat_trainers::checkpoint::{
    best_checkpoint, newest_checkpoint, read_network, read_store,
};
use scenesplat_trainers::tasks::self_supervised::{Export, is_head};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Writes `model.safetensors` and `config.json` into `folder`: the parameters of the best
/// checkpoint, or of the newest if none is marked, averaged ones where there is an average.
///
/// Gives remarks about which it was.
///
/// # Errors
/// If there is no checkpoint or a file cannot be read or written.
pub fn export_model(
    checkpoints: &Path,
    config: &NetworkConfig,
    folder: &Path,
) -> Result<Vec<String>, ExperimentError> {
    let (dir, remark) = exported_checkpoint(checkpoints)?;
    write_model(&read_network(&dir)?.into_iter().collect(), config, folder)?;
    Ok(vec![format!("model: {remark}{}", averaged(&dir))])
}

/// What is said of a checkpoint that has an average.
fn averaged(dir: &Path) -> &'static str {
    if dir.join("average.safetensors").is_file() { ", averaged parameters" } else { "" }
}

/// The checkpoint that becomes the model (the best, or the newest if none is marked), and which it is.
///
/// # Errors
/// If there is none.
pub fn exported_checkpoint(checkpoints: &Path) -> Result<(PathBuf, String), ExperimentError> {
    if let Some(best) = best_checkpoint(checkpoints)? {
        let dir = checkpoints.join(&best.checkpoint);
        return Ok((dir, format!("{} of {} ({})", best.checkpoint, best.measurement, best.value)));
    }
    let newest = newest_checkpoint(checkpoints)?;
    let none = || ExperimentError::NoCheckpoint { path: checkpoints.to_owned() };
    let dir = newest.ok_or_else(none)?;
    let name = dir.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok((dir, name))
}

/// As [`export_model`], of the student or the teacher of self-supervised training, without their heads.
/// The teacher has no mask token, as it masks nothing.
///
/// # Errors
/// As [`export_model`].
pub fn export_self_supervised(
    checkpoints: &Path,
    config: &NetworkConfig,
    which: Export,
    folder: &Path,
) -> Result<Vec<String>, ExperimentError> {
    let (dir, remark) = exported_checkpoint(checkpoints)?;
    let mut config = config.clone();
    let (tensors, who, averaged) = match which {
        Export::Student => (read_network(&dir)?, "student", averaged(&dir)),
        Export::Teacher => (read_store(&dir, "teacher")?, "teacher", ""),
    };
    if let (Export::Teacher, BackboneConfig::PointTransformerV3(backbone)) =
        (which, &mut config.model.backbone)
    {
        backbone.mask_token = false;
    }
    let tensors = tensors.into_iter().filter(|(name, _)| !is_head(name)).collect();
    write_model(&tensors, &config, folder)?;
    Ok(vec![format!("model: {remark}, the {who}{averaged}")])
}

/// Writes a model folder, whose files appear together: `config.json` says what the network is and
/// what it reads.
///
/// # Errors
/// If a file cannot be written.
pub fn write_model(
    tensors: &HashMap<String, Tensor>,
    config: &NetworkConfig,
    folder: &Path,
) -> Result<(), ExperimentError> {
    let mut staged = StagedFolder::create(folder)?;
    save_tensors(tensors, &staged.add("model.safetensors"))?;
    staged.write("config.json", serde_json::to_string_pretty(config)?.as_bytes())?;
    staged.commit::<&str>(&[])?;
    Ok(())
}
