//! The files of tensors in a checkpoint: written with checksums, read back only if they are what was
//! written.

use super::CheckpointState;
use crate::TrainError;
use candle_core::{DType, Device, Tensor};
use scenesplat_models::weights::save_tensors;
use scenesplat_scene::input_file::{open_regular_file, read_file};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::path::Path;

/// What a file was when it was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileSum {
    /// Its length.
    pub bytes: u64,
    /// CRC-32C of its content.
    pub crc32c: u32,
}

/// Writes tensors to a file, and to the disk.
pub(super) fn save(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<(), TrainError> {
    let tensors: HashMap<&str, Tensor> =
        tensors.iter().map(|(n, t)| (n.as_str(), t.clone())).collect();
    save_tensors(&tensors, path).map_err(TrainError::tensor(&path.display().to_string()))
}

/// Length and checksum of a file as it is on the disk.
pub(super) fn sum(path: &Path) -> Result<FileSum, TrainError> {
    let mut file = open_regular_file(path)?;
    let (mut buffer, mut found) = (vec![0; 1 << 20], FileSum { bytes: 0, crc32c: 0 });
    loop {
        match file.read(&mut buffer).map_err(TrainError::io(path, "cannot read"))? {
            0 => return Ok(found),
            n => {
                found.bytes += n as u64;
                found.crc32c = crc32c::crc32c_append(found.crc32c, &buffer[..n]);
            }
        }
    }
}

/// The tensors of a file of the checkpoint `dir`.
///
/// # Errors
/// If the checkpoint has no such file, it is missing or not what was written, or a value is NaN or
/// infinite; the file and the tensor are named.
pub(crate) fn read_tensors(
    dir: &Path,
    state: &CheckpointState,
    name: &str,
) -> Result<BTreeMap<String, Tensor>, TrainError> {
    let path = dir.join(name);
    let damaged = |problem: String| TrainError::Damaged { path: path.clone(), problem };
    let Some(expected) = state.files.get(name) else {
        return Err(damaged("is no part of this checkpoint".to_owned()));
    };
    if !path.is_file() {
        return Err(damaged("is missing".to_owned()));
    }
    let length = path.metadata().map_err(TrainError::io(&path, "cannot read"))?.len();
    if length != expected.bytes {
        return Err(damaged(format!("has {length} bytes, {} were written", expected.bytes)));
    }
    let bytes = read_file(&path, expected.bytes)?;
    if crc32c::crc32c(&bytes) != expected.crc32c {
        return Err(damaged("was changed after it was written".to_owned()));
    }
    let tensors = candle_core::safetensors::load_buffer(&bytes, &Device::Cpu)
        .map_err(|e| damaged(format!("cannot be understood: {e}")))?;
    let tensors: BTreeMap<String, Tensor> = tensors.into_iter().collect();
    for (tensor, values) in &tensors {
        if !is_finite(values).map_err(TrainError::tensor(tensor))? {
            return Err(damaged(format!("holds a value in {tensor} that is not finite")));
        }
    }
    Ok(tensors)
}

fn is_finite(tensor: &Tensor) -> candle_core::Result<bool> {
    if !tensor.dtype().is_float() {
        return Ok(true);
    }
    let values = tensor.flatten_all()?;
    Ok(match tensor.dtype() {
        DType::F64 => values.to_vec1::<f64>()?.iter().all(|v| v.is_finite()),
        _ => values.to_dtype(DType::F32)?.to_vec1::<f32>()?.iter().all(|v| v.is_finite()),
    })
}
