//! Weight files: safetensors, PyTorch checkpoints, model folders, hashed test weights.

mod file;
mod folder;
mod hash_init;
mod message;
mod pickle;
mod pth;
mod save;
mod source;
mod wrapper;

pub use file::{TensorEntry, WeightFile, read_single_tensor};
pub use folder::{ModelFolder, resolve};
pub use hash_init::{hashed_parameter, name_hash, unit};
pub use pth::{PickleValue, summarize};
pub use save::save_tensors;
pub(crate) use source::Found;
pub use source::{Shapes, SourceOptions, WeightSource};
