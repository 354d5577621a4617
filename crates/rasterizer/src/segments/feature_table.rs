//! Tables of segment features: `[S, D]` in `.npy` or `.safetensors`.

use crate::lifting::{LiftError, NO_SEGMENT};
use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::input_file::read_file;
use std::path::Path;

/// The most values of a feature, four times those of the widest encoders of pictures.
///
/// A table without rows can claim any width, and every Gaussian gets a feature that wide.
const MAX_DIM: usize = 1 << 14;
/// The most bytes of a table: all segments of a picture with the widest features in f32.
const MAX_TABLE_BYTES: u64 = NO_SEGMENT as u64 * MAX_DIM as u64 * 4;

/// Features of segments.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FeatureTable {
    pub(super) dim: usize,
    /// `[S, dim]`, all finite.
    pub(super) values: Vec<f32>,
}

impl FeatureTable {
    pub(super) fn rows(&self) -> usize {
        self.values.len() / self.dim.max(1)
    }
}

/// Reads a table by the ending of its name.
pub(super) fn read_feature_table(path: &Path) -> Result<FeatureTable, LiftError> {
    let (shape, values) = if path.extension().is_some_and(|e| e == "safetensors") {
        read_safetensors(path)?
    } else {
        let file = NpyFile::open(path)?;
        check_shape(file.shape(), path)?;
        if !file.ty().is_float() {
            let problem = format!("holds {:?}, segment features are f16, f32 or f64", file.ty());
            return Err(LiftError::file(path, problem, "is this the map of ids?"));
        }
        (file.shape().to_vec(), file.read_f32()?)
    };
    let dim = shape[1];
    if let Some(at) = values.iter().position(|v| !v.is_finite()) {
        let problem = format!("row {}, column {}: {}", at / dim, at % dim, values[at]);
        return Err(LiftError::file(path, problem, "features have to be finite; encode again"));
    }
    Ok(FeatureTable { dim, values })
}

fn check_shape(shape: &[usize], path: &Path) -> Result<(), LiftError> {
    let help = "one row per segment is expected: [segments, channels]";
    let &[rows, dim] = shape else {
        return Err(LiftError::file(path, format!("holds an array of shape {shape:?}"), help));
    };
    if dim == 0 && rows > 0 {
        return Err(LiftError::file(path, format!("holds features of shape {shape:?}"), help));
    }
    if dim > MAX_DIM {
        let problem = format!("holds features of {dim} values, at most {MAX_DIM} are possible");
        return Err(LiftError::file(path, problem, help));
    }
    if rows > usize::from(NO_SEGMENT) {
        let problem = format!("has {rows} segments, more than {NO_SEGMENT}");
        return Err(LiftError::file(path, problem, "drop the smallest segments"));
    }
    Ok(())
}

/// The tensor `features`, or the only one.
fn read_safetensors(path: &Path) -> Result<(Vec<usize>, Vec<f32>), LiftError> {
    let bytes = read_file(path, MAX_TABLE_BYTES)?;
    let bad = |problem: String| {
        LiftError::file(path, problem, "write one tensor called features, [segments, channels]")
    };
    let file = SafeTensors::deserialize(&bytes)
        .map_err(|e| bad(format!("is no safetensors file: {e}")))?;
    let names = file.names();
    let name = match names.iter().find(|name| **name == "features") {
        Some(name) => *name,
        None if names.len() == 1 => names[0],
        None => return Err(bad(format!("holds the tensors {names:?}, none is called features"))),
    };
    let tensor = file.tensor(name).map_err(|e| bad(format!("tensor {name}: {e}")))?;
    check_shape(tensor.shape(), path)?;
    let data = tensor.data();
    let values = match tensor.dtype() {
        Dtype::F32 => {
            data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
        }
        Dtype::F16 => {
            data.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()).collect()
        }
        Dtype::BF16 => {
            data.chunks_exact(2).map(|b| bf16::from_le_bytes([b[0], b[1]]).to_f32()).collect()
        }
        ty => return Err(bad(format!("tensor {name} holds {ty:?}, f32, f16 or bf16 is expected"))),
    };
    Ok((tensor.shape().to_vec(), values))
}
