//! Kernels of point-cloud networks on plain slices.
//!
//! No tensor library: everything takes and fills slices, so a user of any framework can call it.
//! Each kernel is deterministic for any number of threads, computes a scene's rows without regard
//! to its batch mates, and has a slow f64 version in [`mod@reference`] that the tests compare with.
//!
//! | module | what |
//! |---|---|
//! | [`grid_sample`] | which points share a voxel |
//! | [`neighbors`] | the points nearest to a point |
//! | [`serialization`] | space-filling-curve codes and orders |
//! | [`patches`], [`patch_attention`] | attention inside patches of an order |
//! | [`point_rope`] | queries and keys that turn with their voxel |
//! | [`kernel_map`], [`sparse_conv`] | submanifold convolution |
//! | [`gemm`] | matrix products with fused endings, in the [`Precision`] asked for |
//! | [`layer_norm`], [`batch_norm`], [`normalize`], [`activation`] | normalization, rows of unit length, GELU |
//! | [`segment`], [`permute`] | groups of rows, row copies |
//! | [`eigenvectors`] | the directions along which rows differ most |
//! | [`unit_rows`] | whether rows have unit length |
//! | [`simd`] | instruction sets, and code compiled for each |
//! | [`settings!`] | settings of the crates above, each default beside its field |
//! | [`fallbacks`] | what was computed here for a device that has no kernel for it |
//!
//! Threads come from rayon's current pool. Row numbers are `u32` (a batch holds up to 2³² − 2
//! rows), element offsets `usize`.

pub mod activation;
pub mod batch_norm;
pub mod bench_peak;
pub mod bench_room;
pub mod eigenvectors;
pub mod error;
pub mod fallbacks;
pub mod gemm;
pub mod grid_sample;
pub mod kernel_map;
pub mod layer_norm;
pub mod neighbors;
pub mod normalize;
pub mod patch_attention;
pub mod patches;
pub mod permute;
pub mod point_rope;
pub mod precision;
pub mod random;
#[doc(hidden)]
pub mod reference;
pub mod segment;
pub mod serialization;
pub mod serialized_cloud;
mod settings;
mod shape;
pub mod simd;
pub mod sparse_conv;
pub mod symmetric_eigen;
#[cfg(test)]
mod tests;
pub mod unit_rows;

pub use error::{KernelError, check_offsets};
pub use precision::Precision;
