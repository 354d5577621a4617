//! Model folders as the Hugging Face hub lays them out, on disk.

use super::WeightFile;
use super::message::about;
use candle_core::{Result, bail};
use scenesplat_scene::input_file::read_text_file;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Files of a model.
#[derive(Debug)]
pub struct ModelFolder {
    /// The weight files, in name order.
    pub files: Vec<WeightFile>,
    /// `config.json` or `config.toml` beside them.
    pub config: Option<PathBuf>,
}

/// Opens a weight file, or the weight files of a folder.
///
/// In a folder, the first of these counts: `model.safetensors.index.json` (shards),
/// `model.safetensors`, `pytorch_model.bin.index.json` (shards), `pytorch_model.bin`, or the only
/// file ending in `.safetensors`, `.pth` or `.pt`.
///
/// # Errors
/// If there is none or a shard is missing.
pub fn resolve(path: &Path) -> Result<ModelFolder> {
    if !path.is_dir() {
        return Ok(ModelFolder { files: vec![WeightFile::open(path)?], config: None });
    }
    let config =
        ["config.json", "config.toml"].map(|n| path.join(n)).into_iter().find(|p| p.is_file());
    for (index, single) in [
        ("model.safetensors.index.json", "model.safetensors"),
        ("pytorch_model.bin.index.json", "pytorch_model.bin"),
    ] {
        let index = path.join(index);
        if index.is_file() {
            let files = shards(&index)?
                .into_iter()
                .map(|name| WeightFile::open(&path.join(name)))
                .collect::<Result<_>>()?;
            return Ok(ModelFolder { files, config });
        }
        let single = path.join(single);
        if single.is_file() {
            return Ok(ModelFolder { files: vec![WeightFile::open(&single)?], config });
        }
    }
    let mut found: Vec<PathBuf> = std::fs::read_dir(path)?
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|p| {
            p.extension()
                .and_then(|e| e.to_str())
                .is_some_and(|e| matches!(e, "safetensors" | "pth" | "pt"))
        })
        .collect();
    found.sort();
    match found.as_slice() {
        [one] => Ok(ModelFolder { files: vec![WeightFile::open(one)?], config }),
        [] => bail!(
            "{}: no weights: expected model.safetensors, pytorch_model.bin, their index files, or \
             one .safetensors, .pth or .pt file",
            path.display()
        ),
        many => {
            let names: Vec<_> = many.iter().filter_map(|p| p.file_name()).take(8).collect();
            bail!("{}: {} weight files, name one: {names:?}", path.display(), many.len())
        }
    }
}

/// The shard files that an index names.
fn shards(index: &Path) -> Result<BTreeSet<String>> {
    let text = read_text_file(index).map_err(|e| about(index, e))?;
    let json: serde_json::Value = serde_json::from_str(&text)
        .map_err(|e| candle_core::Error::Msg(format!("{}: {e}", index.display())))?;
    let Some(map) = json.get("weight_map").and_then(|m| m.as_object()) else {
        bail!("{}: no weight_map", index.display());
    };
    let mut names = BTreeSet::new();
    for (tensor, file) in map {
        match file.as_str() {
            // The index speaks about its own folder only.
            Some(name) if !matches!(name, "" | "." | "..") && !name.contains(['/', '\\']) => {
                names.insert(name.to_owned());
            }
            _ => bail!("{}: weight_map[{tensor}] is not a file name: {file}", index.display()),
        }
    }
    if names.is_empty() {
        bail!("{}: weight_map names no file", index.display());
    }
    Ok(names)
}
