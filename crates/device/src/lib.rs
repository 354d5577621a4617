//! Kernels for graphics processors.
//!
//! The kernels are texts in CUDA, compiled when they are first used. They compute what
//! `scenesplat-kernels` computes on a CPU, which is their specification. [`modules()`] lists them; each
//! function of [`ops`] is an operation as a sequence of launches, over any [`Launcher`]: a graphics
//! processor (feature `cuda`) or the emulated grid of tests (feature `emulation`).
//!
//! No sum uses atomic additions of floating-point numbers: results are the same bits in every run.

#[cfg(feature = "cuda")]
pub mod cuda;
#[cfg(feature = "emulation")]
pub mod emulator;
pub mod launch;
mod modules;
#[cfg(feature = "cuda")]
pub mod nvrtc;
pub mod ops;

pub use launch::{
    Arg, Items, KernelEntry, KernelModule, LaunchPlan, Launcher, Scalar, TooManyItems,
};
pub use modules::{module_of, modules};
