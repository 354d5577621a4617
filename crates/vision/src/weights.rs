//! The tensors of a model, each taken once by its name.

use crate::VisionError;
use crate::layers::{Linear, Norm};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::PackedMatrix;
use scenesplat_models::weights::{TensorEntry, WeightFile, hashed_parameter, resolve};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Where values come from.
enum Source {
    Files {
        files: Vec<WeightFile>,
        place: BTreeMap<String, usize>,
    },
    /// A hash of the name: for tests and benchmarks, without meaning.
    Seeded(u64),
}

/// Named tensors; what was taken is remembered.
pub(crate) struct Weights {
    path: PathBuf,
    source: Source,
    left: BTreeSet<String>,
    precision: Precision,
    help: &'static str,
}

impl Weights {
    /// A weight file, or the weight files of a folder.
    pub fn open(
        path: &Path,
        precision: Precision,
        help: &'static str,
    ) -> Result<Self, VisionError> {
        let files = resolve(path)?.files;
        let mut place = BTreeMap::new();
        for (index, file) in files.iter().enumerate() {
            place.extend(file.entries().keys().map(|name| (name.clone(), index)));
        }
        let left = place.keys().cloned().collect();
        let path = match files.as_slice() {
            [one] => one.path().to_owned(),
            _ => path.to_owned(),
        };
        Ok(Self { path, source: Source::Files { files, place }, left, precision, help })
    }

    /// Values from a seed.
    pub fn seeded(seed: u64, precision: Precision) -> Self {
        let source = Source::Seeded(seed);
        Self { path: PathBuf::new(), source, left: BTreeSet::new(), precision, help: "" }
    }

    /// What is packed from now on is for products of this precision.
    pub fn use_precision(&mut self, precision: Precision) {
        self.precision = precision;
    }

    /// Shape and type of an entry; of seeded values `None`.
    pub fn entry(&self, name: &str) -> Option<&TensorEntry> {
        match &self.source {
            Source::Files { files, place } => files[*place.get(name)?].entries().get(name),
            Source::Seeded(_) => None,
        }
    }

    /// An error about the weights.
    pub fn bad(&self, problem: String) -> VisionError {
        VisionError::Model { path: self.path.clone(), problem, help: self.help }
    }

    /// The values of a tensor of that shape.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, VisionError> {
        let values = match &self.source {
            Source::Seeded(seed) => {
                hashed_parameter(name, shape, *seed)?.flatten_all()?.to_vec1()?
            }
            Source::Files { files, place } => {
                let Some(file) = place.get(name).map(|index| &files[*index]) else {
                    return Err(self.bad(format!("has no tensor {name}")));
                };
                let stored = &file.entries()[name].shape;
                if stored != shape {
                    return Err(
                        self.bad(format!("{name} has shape {stored:?}, {shape:?} was expected"))
                    );
                }
                file.read(name)?.flatten_all()?.to_vec1()?
            }
        };
        let values: Vec<f32> = values;
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(self.bad(format!("{name}: value {at} is {}", values[at])));
        }
        self.left.remove(name);
        Ok(values)
    }

    /// Says that a tensor is known and not needed.
    pub fn ignore(&mut self, unused: impl Fn(&str) -> bool) {
        self.left.retain(|name| !unused(name));
    }

    /// Weight and bias of a norm.
    pub fn norm(&mut self, name: &str, width: usize, eps: f32) -> Result<Norm, VisionError> {
        let weight = self.take(&format!("{name}.weight"), &[width])?;
        let bias = self.take(&format!("{name}.bias"), &[width])?;
        Ok(Norm { weight, bias, eps })
    }

    /// A linear layer.
    pub fn linear(&mut self, name: &str, cin: usize, cout: usize) -> Result<Linear, VisionError> {
        self.linear_of(name, cin, cout, &[cout, cin])
    }

    /// A linear layer whose weight is stored in another shape with as many values, such as a convolution's.
    pub fn linear_of(
        &mut self,
        name: &str,
        cin: usize,
        cout: usize,
        shape: &[usize],
    ) -> Result<Linear, VisionError> {
        let weight = self.take(&format!("{name}.weight"), shape)?;
        let bias = self.take(&format!("{name}.bias"), &[cout])?;
        Ok(self.pack(&weight, cin, cout, bias))
    }

    /// Linear layers of one input side by side.
    pub fn linears(
        &mut self,
        names: &[String],
        cin: usize,
        cout: usize,
    ) -> Result<Linear, VisionError> {
        let (mut weight, mut bias) = (Vec::new(), Vec::new());
        for name in names {
            weight.extend(self.take(&format!("{name}.weight"), &[cout, cin])?);
            bias.extend(self.take(&format!("{name}.bias"), &[cout])?);
        }
        Ok(self.pack(&weight, cin, names.len() * cout, bias))
    }

    /// `weight`: `[cout, cin]`
    pub fn pack(&self, weight: &[f32], cin: usize, cout: usize, bias: Vec<f32>) -> Linear {
        let weight = PackedMatrix::from_strided_with(self.precision, weight, cin, cout, 1, cin);
        Linear { weight, bias }
    }

    /// Refuses tensors that nobody took: the file is of another network.
    pub fn finish(self) -> Result<(), VisionError> {
        match self.left.iter().next() {
            None => Ok(()),
            Some(name) => Err(self.bad(format!(
                "has {} tensors that belong to no part of this network, such as {name}",
                self.left.len()
            ))),
        }
    }
}
