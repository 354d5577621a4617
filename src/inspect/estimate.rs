//! What it will cost to run a network over a scene on this machine.

use crate::NetworkConfig;
use crate::inference::scene_bytes;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm};
use scenesplat_models::ModelConfig;
use scenesplat_scene::GaussianScene;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Operations of a network, as many as the same time buys in the product that is measured here.
///
/// From `benches/README.md`: 100 000 voxels take the language network 43.5 s and the segmentation
/// network 1.78 s on a machine whose product of this size (`gemm/100k/256_ch`) reaches 188 Gflop/s.
/// The language network's own operations are 7.78 Tflop, so it runs at 0.95 of that product's speed.
const LANGUAGE_FLOP_PER_VOXEL: f64 = 43.5 * 188e9 / 100e3;
const SEMSEG_FLOP_PER_VOXEL: f64 = 1.78 * 188e9 / 100e3;

/// The least and the most that an estimate is off, as factors: 20 000 voxels take 0.95 times as much
/// per voxel as 100 000; scenes vary in how many neighbours a voxel has, machines in their memory.
const SPREAD: [f64; 2] = [0.8, 1.6];

/// Inference adds this to the process: program, buffers of the allocator, tables.
const FIXED_BYTES: f64 = 64.0 * (1u64 << 20) as f64;

/// Rows and columns of the product that measures the machine.
const ROWS: usize = 4096;
const WIDTH: usize = 256;

/// Longest measurement.
const MEASURE: Duration = Duration::from_millis(150);

/// Time and memory of one pass of a network over the voxels of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimate {
    /// The network.
    pub network: String,
    /// Voxels it would compute.
    pub voxels: usize,
    /// Threads that the measurement used.
    pub threads: usize,
    /// Measured speed of a matrix product on those threads, Gflop/s.
    pub gflops_measured: f64,
    /// Likely time, seconds.
    pub seconds: f64,
    /// Shortest and longest time to expect on a quiet machine, seconds.
    pub seconds_range: [f64; 2],
    /// Likely peak of memory without `--max-memory`, bytes.
    pub bytes: u64,
}

/// Operations per voxel: as measured, scaled by the work of the blocks. Of the two networks that were
/// measured the one nearer in work sets the efficiency.
fn flop_per_voxel(config: &ModelConfig) -> f64 {
    let work = |config: &ModelConfig| config.backbone.get().cost().work_per_voxel();
    let own = work(config);
    let language = work(&ModelConfig::language());
    let semseg = work(&ModelConfig::semseg());
    if (own / language).ln().abs() <= (own / semseg).ln().abs() {
        LANGUAGE_FLOP_PER_VOXEL * own / language
    } else {
        SEMSEG_FLOP_PER_VOXEL * own / semseg
    }
}

/// Speed of a product of `[4096, 256]` by `[256, 256]` on the current threads, Gflop/s.
///
/// The best of as many repetitions as fit into 0.15 s: what disturbs a repetition only slows it.
pub fn measure_gflops() -> f64 {
    let value = |i: usize| (i % 17) as f32 * 0.01 - 0.08;
    let a: Vec<f32> = (0..ROWS * WIDTH).map(value).collect();
    let b: Vec<f32> = (0..WIDTH * WIDTH).map(value).collect();
    let b = PackedMatrix::from_strided(&b, WIDTH, WIDTH, WIDTH, 1);
    let mut out = vec![0.0; ROWS * WIDTH];
    let flop = 2.0 * (ROWS * WIDTH * WIDTH) as f64;
    let start = Instant::now();
    let mut best = f64::INFINITY;
    while best.is_infinite() || start.elapsed() < MEASURE {
        let before = Instant::now();
        gemm(&a, &b, Epilogue::default(), &mut out);
        best = best.min(before.elapsed().as_secs_f64().max(1e-9));
    }
    flop / best / 1e9
}

/// Estimates one fast pass of a network over a scene of `voxels` voxels, at a measured speed.
pub fn estimate(
    scene: &GaussianScene,
    voxels: usize,
    network: &str,
    config: &NetworkConfig,
    gflops: f64,
) -> Estimate {
    let seconds = flop_per_voxel(&config.model) * voxels as f64 / (gflops * 1e9);
    let (n, v) = (scene.len() as f64, voxels as f64);
    // As the encoder counts: scene, tables of the plan, weights, features, and the work per voxel.
    let bytes = scene_bytes(scene) as f64
        + v * (12 + 4 * config.model.in_channels() + 8) as f64
        + n * 8.0
        + 4.0 * config.model.num_values() as f64
        + v * 4.0 * config.model.out_channels() as f64
        + v * config.model.backbone.get().cost().bytes_per_voxel as f64
        + FIXED_BYTES;
    Estimate {
        network: network.to_owned(),
        voxels,
        threads: rayon::current_num_threads(),
        gflops_measured: gflops,
        seconds,
        seconds_range: SPREAD.map(|f| f * seconds),
        bytes: bytes as u64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_networks_cost_what_was_measured() {
        let scene = GaussianScene::default();
        for (name, config, seconds, bytes) in [
            ("language", NetworkConfig::language(), 43.5, 2.52e9),
            ("semseg", NetworkConfig::semseg(), 1.78, 0.62e9),
        ] {
            // 188 Gflop/s is the speed of the product on the machine of those measurements.
            let e = estimate(&scene, 100_000, name, &config, 188.0);
            assert!((e.seconds / seconds - 1.0).abs() < 1e-6, "{e:?}");
            let off = e.bytes as f64 / bytes;
            assert!((0.7..1.5).contains(&off), "{name}: {} of {bytes} bytes", e.bytes);
        }
        let tiny = estimate(&scene, 100_000, "tiny", &NetworkConfig::tiny(), 188.0);
        assert!(tiny.seconds > 0.01 && tiny.seconds < 1.78, "{tiny:?}");
    }

    #[test]
    fn the_machine_is_measured_in_time() {
        let start = Instant::now();
        let gflops = measure_gflops();
        assert!(gflops.is_finite() && gflops > 0.05, "{gflops}");
        assert!(start.elapsed() < Duration::from_secs(5), "even on a busy machine");
    }
}
