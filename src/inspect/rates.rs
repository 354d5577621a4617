//! How fast machines are: the only place where the estimates' constants stand.
//!
//! They are stated, not measured on the spot: a test of the speed beside other programs says more
//! about those than about the machine.

use scenesplat_kernels::simd::Isa;

/// What one thread does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rates {
    /// Multiply–adds of a network in f32, per second.
    pub(super) multiply_adds: f64,
    /// Tables, orders and gathers of a network, seconds per voxel.
    pub(super) voxel: f64,
    /// Neighbors that vote, and pictures, seconds per Gaussian.
    pub(super) row: f64,
}

/// Reading and writing, which one thread does, seconds per Gaussian.
pub(super) const ROW_ALONE: f64 = 1e-6;

/// Program, weights and an empty picture, seconds.
pub(super) const START: f64 = 0.6;

/// The least and the most that an estimate is off, as factors: scenes vary in how many neighbors a
/// voxel has, machines in clock and memory.
pub(super) const SPREAD: [f64; 2] = [0.7, 2.0];

/// Program, buffers of the allocator, tables, beside what a network is counted to need, bytes.
pub(crate) const PROCESS_BYTES: u64 = 64 << 20;

/// What drawing the preview takes, and per Gaussian, bytes; nothing of the network is left then.
pub(super) const PICTURE_BYTES: u64 = 218_000_000;
pub(super) const PICTURE_ROW_BYTES: u64 = 240;

/// The table. AVX-512: AMD EPYC (Zen 4), two threads, 2026-11: 100 000 voxels take the language
/// network 39.3 s and the segmentation network 1.73 s (`benches/README.md`). The others are that by
/// the width of their registers, and were not measured.
pub(super) fn rates(isa: Isa) -> Rates {
    let avx512 = Rates { multiply_adds: 52e9, voxel: 8e-6, row: 3e-6 };
    match isa {
        Isa::Avx512 | Isa::Avx512Bf16 | Isa::Amx => avx512,
        Isa::Avx2 => Rates { multiply_adds: avx512.multiply_adds / 2.0, ..avx512 },
        #[cfg(target_arch = "wasm32")]
        Isa::Simd128 => Rates { multiply_adds: avx512.multiply_adds / 8.0, ..avx512 },
        Isa::Portable => {
            Rates { multiply_adds: avx512.multiply_adds / 16.0, voxel: 16e-6, row: 4e-6 }
        }
    }
}
