//! The tensors of a weight file, each taken once.

use crate::PhraseError;
use half::{bf16, f16};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use scenesplat_kernels::gemm::PackedMatrix;
use scenesplat_scene::input_file::read_file;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The most bytes of a weight file: many times those of any sentence encoder.
const MOST_BYTES: u64 = 8 << 30;

/// Parts of published models that a sentence vector does not need.
const UNUSED: &[&str] = &["pooler.", "cls.", "embeddings.position_ids"];

const HELP: &str = "give model.safetensors of the same sentence encoder, whole";

/// An open weight file.
pub(super) struct WeightFile {
    path: PathBuf,
    bytes: Vec<u8>,
    /// What stands before the names: nothing, or `bert.`.
    prefix: &'static str,
    left: BTreeSet<String>,
}

impl WeightFile {
    pub fn read(path: &Path) -> Result<Self, PhraseError> {
        let bytes = read_file(path, MOST_BYTES)?;
        let mut file = Self { path: path.to_owned(), bytes, prefix: "", left: BTreeSet::new() };
        file.left = file.tensors()?.names().into_iter().map(str::to_owned).collect();
        if file.left.iter().any(|name| name.starts_with("bert.")) {
            file.prefix = "bert.";
        }
        Ok(file)
    }

    fn bad(&self, problem: String) -> PhraseError {
        PhraseError::Model { path: self.path.clone(), problem, help: HELP }
    }

    fn tensors(&self) -> Result<SafeTensors<'_>, PhraseError> {
        SafeTensors::deserialize(&self.bytes)
            .map_err(|error| self.bad(format!("is no whole .safetensors file: {error}")))
    }

    /// The values of a tensor of that shape.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, PhraseError> {
        let name = format!("{}{name}", self.prefix);
        let tensors = self.tensors()?;
        let Ok(tensor) = tensors.tensor(&name) else {
            return Err(self.bad(format!("has no tensor {name}")));
        };
        if tensor.shape() != shape {
            let found = tensor.shape();
            return Err(
                self.bad(format!("{name} has shape {found:?}, config.json asks for {shape:?}"))
            );
        }
        let Some(values) = floats(&tensor) else {
            let dtype = tensor.dtype();
            return Err(self.bad(format!("{name} holds {dtype:?}; F32, F16 and BF16 are known")));
        };
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(self.bad(format!("{name}: value {at} is {}", values[at])));
        }
        self.left.remove(&name);
        Ok(values)
    }

    /// Weight and bias of a norm.
    pub fn norm(&mut self, name: &str, width: usize) -> Result<(Vec<f32>, Vec<f32>), PhraseError> {
        let weight = self.take(&format!("{name}.weight"), &[width])?;
        Ok((weight, self.take(&format!("{name}.bias"), &[width])?))
    }

    /// Linear layers of one input side by side: packed weight and bias.
    pub fn linear<S: AsRef<str>>(
        &mut self,
        names: &[S],
        cin: usize,
        cout: usize,
    ) -> Result<(PackedMatrix, Vec<f32>), PhraseError> {
        let (mut weight, mut bias) = (Vec::new(), Vec::new());
        for name in names {
            let name = name.as_ref();
            weight.extend(self.take(&format!("{name}.weight"), &[cout, cin])?);
            bias.extend(self.take(&format!("{name}.bias"), &[cout])?);
        }
        Ok((PackedMatrix::from_strided(&weight, cin, names.len() * cout, 1, cin), bias))
    }

    /// Refuses tensors that nobody took: the file is of another network.
    pub fn finish(self) -> Result<(), PhraseError> {
        let unused = |name: &&String| {
            let bare = name.strip_prefix(self.prefix).unwrap_or(name);
            !UNUSED.iter().any(|part| bare.starts_with(part) || name.starts_with(part))
        };
        match self.left.iter().find(unused) {
            None => Ok(()),
            Some(name) => {
                let problem = format!("has a tensor {name}, which config.json knows nothing of");
                Err(self.bad(problem))
            }
        }
    }
}

fn floats(tensor: &TensorView<'_>) -> Option<Vec<f32>> {
    let bytes = tensor.data();
    Some(match tensor.dtype() {
        Dtype::F32 => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        Dtype::F16 => bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect(),
        Dtype::BF16 => {
            bytes.as_chunks().0.iter().map(|b| bf16::from_le_bytes(*b).to_f32()).collect()
        }
        _ => return None,
    })
}
