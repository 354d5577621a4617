//! What `segment` will cost: time on a machine of this kind, and memory.

use super::rates::{PICTURE_BYTES, PICTURE_ROW_BYTES, ROW_ALONE, SPREAD, START, rates};
use crate::NetworkConfig;
use crate::inference::MemoryNeed;
use scenesplat_kernels::simd::Isa;
use scenesplat_scene::GaussianScene;
use serde::Serialize;

/// Time and memory of labeling a scene with one pass of a network: reading, network, vote, writing
/// and a picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimate {
    /// The network.
    pub network: String,
    /// Voxels it would compute, of its own size.
    pub voxels: usize,
    /// Threads that would work.
    pub threads: usize,
    /// Likely time, seconds.
    pub seconds: f64,
    /// Shortest and longest time to expect on a quiet machine, seconds.
    pub seconds_range: [f64; 2],
    /// Likely peak of memory without a limit, bytes.
    pub bytes: u64,
}

/// Estimates one fast pass of a network over a scene of `voxels` voxels of the network's size, with
/// `threads` threads of a CPU that has `isa`. The same for every call: nothing is measured.
pub fn estimate(
    scene: &GaussianScene,
    voxels: usize,
    network: &str,
    config: &NetworkConfig,
    threads: usize,
    isa: Isa,
) -> Estimate {
    let cost = config.model.cost();
    let rates = rates(isa);
    let (rows, v) = (scene.len() as f64, voxels as f64);
    let per_voxel = cost.work_per_voxel() / rates.multiply_adds + rates.voxel;
    let shared = v * per_voxel + rows * rates.row;
    let seconds = shared / threads.max(1) as f64 + rows * ROW_ALONE + START;
    let need = MemoryNeed {
        rows: scene.len(),
        scene: crate::inference::scene_bytes(scene),
        voxels,
        channels: config.model.in_channels(),
        slots: voxels,
        width: config.model.out_channels(),
        weights: 4 * config.model.num_values() as u64,
        per_voxel: cost.bytes_per_voxel as u64,
    };
    let picture = PICTURE_BYTES + PICTURE_ROW_BYTES * scene.len() as u64;
    Estimate {
        network: network.to_owned(),
        voxels,
        threads,
        seconds,
        seconds_range: SPREAD.map(|f| f * seconds),
        bytes: need.whole().max(picture),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(count: usize) -> GaussianScene {
        GaussianScene { coord: vec![[0.0; 3]; count], ..GaussianScene::default() }
    }

    #[test]
    fn networks_cost_what_was_measured() {
        // Seconds of 100 000 voxels and 2 threads, peak of the process: benches/README.md.
        for (name, config, seconds, bytes) in [
            ("language", NetworkConfig::language(), 39.3, 2.52e9),
            ("semseg", NetworkConfig::semseg(), 1.73, 0.56e9),
        ] {
            let e = estimate(&rows(0), 100_000, name, &config, 2, Isa::Avx512);
            let network = e.seconds - START;
            assert!((network / seconds - 1.0).abs() < 0.25, "{name}: {network} of {seconds} s");
            let off = e.bytes as f64 / bytes;
            assert!((0.75..1.25).contains(&off), "{name}: {} of {bytes} bytes", e.bytes);
        }
        let quarter = |threads| {
            estimate(&rows(0), 100_000, "tiny", &NetworkConfig::tiny(), threads, Isa::Avx512)
        };
        let (one, two) = (quarter(1), quarter(2));
        assert!(one.seconds > two.seconds && one == quarter(1), "{one:?} {two:?}");
    }

    #[test]
    fn the_embedded_network_needs_the_memory_that_was_measured() {
        let config = crate::embedded::config().unwrap();
        // Peaks of `segment` without flags: Gaussians, voxels of 6 cm, bytes.
        for (name, gaussians, voxels, peak) in [
            ("small house", 774_287, 200_360, 645e6),
            ("playbot", 500_000, 5_000, 339e6),
            ("PlayCanvas logo", 307_128, 19_761, 268e6),
            ("robocop", 267_776, 1_500, 283e6),
            ("biker", 152_746, 5_000, 230e6),
            ("room 0 of the demo", 87_625, 30_627, 256e6),
            ("hamburger", 52_709, 2_500, 238e6),
        ] {
            let e = estimate(&rows(gaussians), voxels, name, &config, 2, Isa::Avx512);
            let off = e.bytes as f64 / peak;
            assert!((0.75..1.25).contains(&off), "{name}: {} of {peak} bytes", e.bytes);
            assert!(e.seconds < 10.0, "{e:?}");
        }
    }
}
