//! The native part of the Python package `scenesplat`.

#![allow(
    clippy::needless_pass_by_value,
    reason = "arguments of Python come as values of their own"
)]

mod arrays;
mod camera;
mod errors;
mod from_arrays;
mod kernels;
mod lifting;
mod network;
mod program;
mod rendering;
mod scene;
mod scene_arrays;
mod training;
mod work;

use pyo3::prelude::*;

/// Keeps pages between the large short-lived buffers of a network.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[pymodule]
mod _scenesplat {
    #[pymodule_export]
    use crate::camera::Camera;
    #[pymodule_export]
    use crate::errors::Error;
    #[pymodule_export]
    use crate::kernels::{
        KernelMap, grid_sample, knn, knn_vote, patch_attention, patch_attention_backward,
        segment_reduce, segment_reduce_backward, serialize,
    };
    #[pymodule_export]
    use crate::lifting::lift;
    #[pymodule_export]
    use crate::network::{
        NativeNetwork, align, evaluate, features, inspect, load_network, objects, query, segment,
    };
    #[pymodule_export]
    use crate::program::run_program;
    #[pymodule_export]
    use crate::rendering::{Drawing, Rasterized};
    #[pymodule_export]
    use crate::scene::Scene;
    #[pymodule_export]
    use crate::training::train;
    #[pymodule_export]
    use crate::work::{forget_threads, num_threads, set_num_threads};
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        scenesplat_cli::allocator::keep_pages();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
