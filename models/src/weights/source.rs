//! Where a network's values come from.

use super::{WeightFile, hashed_parameter};
use crate::convert::{Branch, ConvLayout, Renamed, rename};
use candle_core::{Result, Tensor, bail};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Values by our names.
#[derive(Debug, Clone)]
pub struct WeightSource(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Empty,
    Hashed { seed: u64, prefix: String },
    Files { entries: BTreeMap<String, (usize, String)>, files: Arc<Vec<WeightFile>>, ignored: Vec<(String, String)>, layout: ConvLayout },
    Tensors(BTreeMap<String, Tensor>),
}

/// Choices in reading a checkpoint.
#[derive(Debug, Clone, Copy, Default)]
pub struct SourceOptions {
    /// Which half of a self-supervised checkpoint.
    pub branch: Branch,
    /// How sparse convolutions are stored.
    pub conv_layout: ConvLayout,
}

impl WeightSource {
    /// Nothing: every value is initial.
    pub fn empty() -> Self {
        Self(Kind::Empty)
    }

    /// Values from an integer hash of `prefix` + name: for tests and benchmarks, without meaning.
    pub fn hashed(seed: u64, prefix: &str) -> Self {
        Self(Kind::Hashed { seed, prefix: prefix.to_owned() })
    }

    /// Given tensors by our names.
    pub fn tensors(tensors: BTreeMap<String, Tensor>) -> Self {
        Self(Kind::Tensors(tensors))
    }

    /// Opened files, their names turned into ours by the table in [`crate::convert`].
    ///
    /// # Errors
    /// If two entries end up with the same name.
    pub fn files(files: Vec<WeightFile>, options: SourceOptions) -> Result<Self> {
        let mut entries = BTreeMap::new();
        let mut ignored = Vec::new();
        for (index, file) in files.iter().enumerate() {
            for name in file.entries().keys() {
                match rename(name, options.branch) {
                    Renamed::Weight(ours) => {
                        if let Some((_, other)) = entries.insert(ours.clone(), (index, name.clone())) {
                            bail!("{}: {other} and {name} both name {ours}", file.path().display());
                        }
                    }
                    Renamed::Ignored(origin) => ignored.push((name.clone(), origin.to_owned())),
                }
            }
            ignored.extend(file.skipped().iter().map(|n| (n.clone(), "not a tensor".to_owned())));
        }
        let layout = options.conv_layout;
        Ok(Self(Kind::Files { entries, files: Arc::new(files), ignored, layout }))
    }

    /// Whether this source never has a value.
    pub(crate) fn is_empty(&self) -> bool {
        matches!(self.0, Kind::Empty)
    }

    /// All names that have a value; none for hashed values, which know every name.
    pub(crate) fn names(&self) -> Vec<String> {
        match &self.0 {
            Kind::Empty | Kind::Hashed { .. } => Vec::new(),
            Kind::Files { entries, .. } => entries.keys().cloned().collect(),
            Kind::Tensors(tensors) => tensors.keys().cloned().collect(),
        }
    }

    /// Entries that the table knows to be no weights.
    pub(crate) fn ignored(&self) -> &[(String, String)] {
        match &self.0 {
            Kind::Files { ignored, .. } => ignored,
            _ => &[],
        }
    }

    /// The value of a name; its shape may differ from the one asked for.
    pub(crate) fn take(&self, name: &str, shape: &[usize]) -> Result<Option<Tensor>> {
        match &self.0 {
            Kind::Empty => Ok(None),
            Kind::Hashed { seed, prefix } => {
                // Heads stand beside the backbone, not inside it.
                let full = if name.starts_with("seg_head.") {
                    name.to_owned()
                } else {
                    format!("{prefix}{name}")
                };
                hashed_parameter(&full, shape, *seed).map(Some)
            }
            Kind::Tensors(tensors) => Ok(tensors.get(name).cloned()),
            Kind::Files { entries, files, layout, .. } => {
                let Some((file, original)) = entries.get(name) else { return Ok(None) };
                let value = files[*file].read(original)?;
                // Some exports keep single values as [1].
                let value = if shape.is_empty() && value.dims() == [1] { value.squeeze(0)? } else { value };
                if *layout == ConvLayout::KernelInOut && value.rank() == 5 {
                    return value.permute((4, 0, 1, 2, 3))?.contiguous().map(Some);
                }
                Ok(Some(value))
            }
        }
    }
}
