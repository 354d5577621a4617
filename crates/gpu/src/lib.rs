//! Kernels in WGSL, and the networks' operations made of them, for graphics processors of any maker.
//!
//! wgpu runs them through Vulkan, Metal or Direct3D 12; a software Vulkan (lavapipe) runs them in tests. Their
//! specification is the CPU code of `scenesplat-kernels`. There is no tensor library here: values are [`Array`]s on
//! the device, filled by the functions in [`ops`].
//!
//! Results are the same every time: no floating-point sum uses atomic operations, and a row is computed in the same
//! order whatever rows stand beside it.

mod adapter;
mod error;
mod gpu;
pub mod ops;
mod shader;

pub use adapter::{AdapterInfo, Choice, adapters};
pub use error::{GpuError, Result};
pub use gpu::{Array, Commands, Gpu, Memory};
