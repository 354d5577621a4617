//! Weight files: safetensors, PyTorch checkpoints, model folders, hashed test weights.

mod file;
mod folder;
mod hash_init;
mod pth;
mod source;

pub use file::{TensorEntry, WeightFile};
pub use folder::{ModelFolder, resolve};
pub use hash_init::{hashed_parameter, name_hash, unit};
pub use pth::{PickleValue, read_single_tensor, summarize};
pub use source::{SourceOptions, WeightSource};
