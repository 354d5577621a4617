//! Random voxels for the tests of what is derived from them.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_gpu::Gpu;
use scenesplat_gpu::ops::scenes::Scenes;

/// Largest coordinate.
pub const MOST: i32 = (1 << 21) - 1;
/// Lengths around those of workgroups.
pub const LENGTHS: [usize; 12] = [0, 1, 2, 255, 256, 257, 2047, 2048, 2049, 4096, 4097, 65_537];

/// Whole numbers below `end`.
pub fn numbers(len: usize, end: u64, seed: u64) -> Vec<u64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(0..end)).collect()
}

/// Cells with coordinates below `end`; many of them twice where there are few.
pub fn cells(len: usize, end: i32, seed: u64) -> Vec<[i32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| std::array::from_fn(|_| rng.random_range(0..end))).collect()
}

/// Scenes of so many rows each.
pub fn offsets(counts: &[usize]) -> Vec<usize> {
    let mut offsets = vec![0];
    counts.iter().for_each(|n| offsets.push(offsets[offsets.len() - 1] + n));
    offsets
}

/// Scenes on the device.
pub fn scenes(gpu: &Gpu, offsets: &[usize]) -> Scenes {
    Scenes::upload(gpu, offsets.to_vec(), offsets[offsets.len() - 1]).unwrap()
}

/// Cells of scenes, and offsets: none, one, two, duplicates, empty scenes at every place, the largest coordinates, scenes of
/// different depths.
pub fn clouds() -> Vec<(Vec<[i32; 3]>, Vec<usize>)> {
    let mut all = vec![
        (vec![], vec![0]),
        (vec![], vec![0, 0, 0]),
        (vec![[0; 3]], vec![0, 1]),
        (vec![[MOST; 3]], vec![0, 0, 1, 1]),
        (vec![[5, 1, 2]; 2], vec![0, 2]),
        (vec![[0; 3]; 600], offsets(&[300, 0, 300])),
        (vec![[0, 0, 1], [MOST, MOST - 1, MOST], [MOST; 3], [0, MOST, 0]], vec![0, 1, 4]),
    ];
    for (i, counts) in
        [vec![255, 257], vec![256], vec![0, 700, 0, 1, 2100, 0], vec![5000, 3, 0, 2000]]
            .iter()
            .enumerate()
    {
        let mut of_scenes = Vec::new();
        for (scene, n) in counts.iter().enumerate() {
            let end = [9, 16, 40, MOST, 17, 2000][(i + scene) % 6];
            of_scenes.extend(cells(*n, end, scene as u64 + 10 * i as u64));
        }
        all.push((of_scenes, offsets(counts)));
    }
    all
}
