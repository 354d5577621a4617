//! Inputs of the benchmarks: the shared rooms, or a room made here where there are none.
#![allow(dead_code, reason = "each benchmark uses a part")]

use criterion::Criterion;
use scenesplat_kernels::bench_room as room;
use std::path::{Path, PathBuf};
use std::time::Duration;

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

/// Distinct voxels of a room in random order; the shared data have 20 000, 50 000 and 100 000.
/// `[n, 3]`
pub fn voxels(n: usize) -> Vec<[i32; 3]> {
    match shared(&format!("scene_{}_grid_i32.npy", short(n))) {
        Some(found) => triples(&found, i32::from_le_bytes),
        None => room::voxels(n),
    }
}

/// Input features of these voxels. `[n, 11]`
pub fn features(n: usize) -> Vec<f32> {
    match shared(&format!("scene_{}_feat11_f32.npy", short(n))) {
        Some(found) => values(&found, f32::from_le_bytes),
        None => random(11 * n),
    }
}

/// A million points on the surfaces of a room, meters.
pub fn points() -> Vec<[f32; 3]> {
    match shared("room_points_1m_f32.npy") {
        Some(found) => triples(&found, f32::from_le_bytes),
        None => room::points(1_000_000),
    }
}

/// A million cells to sort along curves.
pub fn cells() -> Vec<[i32; 3]> {
    match shared("serialize_1m_grid_i32.npy") {
        Some(found) => triples(&found, i32::from_le_bytes),
        None => room::fine_cells(1_000_000),
    }
}

/// Values in -1..1.
pub fn random(n: usize) -> Vec<f32> {
    room::values(n, 1)
}

fn shared(file: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SCENESPLAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
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
