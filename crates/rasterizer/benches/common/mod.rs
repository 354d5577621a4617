//! What all benchmarks of this crate share.
#![allow(dead_code, reason = "each program uses a part")]

use criterion::Criterion;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::{ThreadPool, ThreadPoolBuilder};
use scenesplat_rasterizer::lifting::SegmentMap;
use std::time::Duration;

/// As the program: the system's allocator would add page faults to every picture.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Segments of a picture, as many as a segmenter of objects finds.
pub const SEGMENTS: usize = 50;

pub fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
}

pub fn pool(threads: usize) -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool")
}

/// Gradients that look like those of an L1 loss: ±1 per value.
pub fn signs(len: usize) -> Vec<f32> {
    (0..len as u32)
        .map(|i| if i.wrapping_mul(2_654_435_769) >> 31 == 0 { 1.0 } else { -1.0 })
        .collect()
}

/// Segments: cells around random points.
pub fn voronoi(width: u32, height: u32, seed: u64) -> SegmentMap {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let points: Vec<[i64; 2]> = (0..SEGMENTS)
        .map(|_| [rng.random_range(0..i64::from(width)), rng.random_range(0..i64::from(height))])
        .collect();
    let nearest = |i: u32| {
        let (x, y) = (i64::from(i % width), i64::from(i / width));
        let distance = |p: &[i64; 2]| (p[0] - x).pow(2) + (p[1] - y).pow(2);
        let best = (0..SEGMENTS).min_by_key(|&s| distance(&points[s]));
        best.unwrap_or(0) as u16
    };
    SegmentMap::new(width, height, (0..width * height).map(nearest).collect()).expect("a map")
}
