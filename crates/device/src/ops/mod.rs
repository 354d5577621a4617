//! Operations as sequences of launches.
//!
//! Arrays come and go as buffers of the launcher; `[N, C]` means rows of C values without gaps. Functions
//! panic where an array is too short for the sizes (a bug of the caller), as those on slices do; what the
//! arrays hold is not checked on the device, so row numbers must be in range.

pub mod activation;
pub mod batch_norm;
pub mod classify;
pub mod columns;
pub mod curves;
pub mod grid_sample;
pub mod kernel_map;
pub mod layer_norm;
pub mod neighbors;
pub mod patch_attention;
pub mod point_rope;
pub mod radix_sort;
pub mod rasterize;
pub mod rows;
pub mod scan;
pub mod segment;
pub mod sparse_conv;

/// Lists the kernels of a text: a constant for each, and `KERNELS`.
macro_rules! kernels {
    ($module:literal: $($(#[$doc:meta])* $constant:ident = $name:ident, $threads:literal, $items:expr;)*) => {
        $(
            $(#[$doc])*
            pub const $constant: $crate::launch::KernelEntry =
                $crate::launch::KernelEntry::new($module, stringify!($name), $threads, $items);
        )*
        pub(crate) const KERNELS: &[$crate::launch::KernelEntry] = &[$($constant),*];
    };
}
pub(crate) use kernels;
