//! Inputs of the benchmarks: the shared rooms, or a room made here where there are none.
#![allow(dead_code, reason = "each benchmark uses a part")]

use criterion::Criterion;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Side of a voxel of the made room, metres.
const VOXEL: f32 = 0.02;

/// Few samples: most of these take long enough that one is already an average over many rows.
pub fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args()
}

/// `100000` as `100k`.
pub fn short(n: usize) -> String {
    match n {
        1_000_000.. => format!("{}M", n / 1_000_000),
        _ => format!("{}k", n / 1000),
    }
}

/// Distinct voxels of a room in random order, for 20 000, 50 000 or 100 000 rows. `[n, 3]`
pub fn voxels(n: usize) -> Vec<[i32; 3]> {
    if let Some(found) = shared(&format!("scene_{}_grid_i32.npy", short(n))) {
        return triples(&found, i32::from_le_bytes);
    }
    // Each try is one point on a surface; points in voxels that are taken are dropped.
    let mut cells: Vec<[i32; 3]> = made_points(20 * n).iter().map(cell).collect();
    let mut taken = std::collections::HashSet::new();
    cells.retain(|&c| taken.insert(c));
    cells.truncate(n);
    assert_eq!(cells.len(), n, "the made room has too few voxels");
    cells
}

/// Input features of these voxels. `[n, 11]`
pub fn features(n: usize) -> Vec<f32> {
    match shared(&format!("scene_{}_feat11_f32.npy", short(n))) {
        Some(found) => values(&found, f32::from_le_bytes),
        None => random(11 * n),
    }
}

/// A million points on the surfaces of a room, metres.
pub fn points() -> Vec<[f32; 3]> {
    match shared("room_points_1m_f32.npy") {
        Some(found) => triples(&found, f32::from_le_bytes),
        None => made_points(1_000_000),
    }
}

/// A million cells to sort along curves.
pub fn cells() -> Vec<[i32; 3]> {
    match shared("serialize_1m_grid_i32.npy") {
        Some(found) => triples(&found, i32::from_le_bytes),
        None => made_points(1_000_000).iter().map(cell).collect(),
    }
}

/// Values in -1..1.
pub fn random(n: usize) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    (0..n).map(|_| rng.random_range(-1.0..1.0)).collect()
}

fn shared(file: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SCENESPLAT_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = root.join("goldens/bench_inputs").join(file);
    if path.exists() {
        return Some(path);
    }
    eprintln!("{file} is not in the shared data: a made room takes its place");
    None
}

/// The values of an `.npy` file of 4-byte numbers.
fn values<T>(path: &Path, parse: fn([u8; 4]) -> T) -> Vec<T> {
    let bytes = std::fs::read(path).expect("a readable file");
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    bytes[10 + header..].as_chunks().0.iter().map(|&word| parse(word)).collect()
}

fn triples<T: Copy>(path: &Path, parse: fn([u8; 4]) -> T) -> Vec<[T; 3]> {
    values(path, parse).as_chunks().0.to_vec()
}

fn cell(point: &[f32; 3]) -> [i32; 3] {
    point.map(|v| (v / VOXEL) as i32)
}

/// Points on floor, walls and the tops and sides of twelve boxes of a room of 6 × 5 × 2.6 m, in
/// random order.
fn made_points(n: usize) -> Vec<[f32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut boxes = vec![([0.0; 3], [6.0, 5.0, 2.6_f32])];
    for _ in 0..12 {
        let low = [rng.random_range(0.0..5.0), rng.random_range(0.0..4.0), 0.0_f32];
        let size = [1.0, 1.0, 1.5].map(|most| rng.random_range(0.3..most));
        boxes.push((low, std::array::from_fn(|i| low[i] + size[i])));
    }
    (0..n)
        .map(|_| {
            // The room has about as much surface as its boxes together.
            let index = if rng.random_bool(0.6) { 0 } else { rng.random_range(1..boxes.len()) };
            let (low, high) = boxes[index];
            let mut point: [f32; 3] = std::array::from_fn(|i| rng.random_range(low[i]..high[i]));
            let axis = rng.random_range(0..3);
            point[axis] = if rng.random_bool(0.5) { low[axis] } else { high[axis] };
            point
        })
        .collect()
}
