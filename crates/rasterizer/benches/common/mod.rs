//! What all benchmarks of this crate share.
#![allow(dead_code, reason = "each program uses a part")]

mod around_points;

use criterion::Criterion;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::{ThreadPool, ThreadPoolBuilder};
use scenesplat_rasterizer::lifting::SegmentMap;
use scenesplat_rasterizer::{Gaussians, View};
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_test_support::shared;
use std::io::Read;
use std::path::Path;
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

/// 138,766 Gaussians around the points of the garden, and its three views of 648×420 pixels.
///
/// `None` where the points are not installed; they are real, and not ours to ship.
pub fn garden() -> Option<(Gaussians, Vec<View>)> {
    let file = std::fs::File::open(shared("real/posed/test_garden.npz")?).expect("an archive");
    let mut archive = zip::ZipArchive::new(file).expect("an archive");
    let mut array = |name: &str| {
        let mut bytes = Vec::new();
        archive.by_name(name).expect(name).read_to_end(&mut bytes).expect(name);
        NpyFile::from_bytes(&bytes, Path::new(name)).expect(name)
    };
    let mut floats = |name| array(name).read_f32().expect(name);
    let points = floats("means3d.npy").as_chunks().0.to_vec();
    let poses = floats("viewmats.npy");
    let lenses = floats("Ks.npy");
    let colors = array("colors.npy").read_u8().expect("colors");
    let colors: Vec<[f32; 3]> =
        colors.as_chunks().0.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect();
    let view = |(pose, k): (&[f32; 16], &[f32; 9])| {
        let row = |r: usize| [0, 1, 2, 3].map(|c| pose[4 * r + c]);
        let world_to_camera = [row(0), row(1), row(2)];
        let [fx, fy, cx, cy] = [k[0], k[4], k[2], k[5]];
        View { world_to_camera, fx, fy, cx, cy, width: 648, height: 420 }
    };
    let views = poses.as_chunks().0.iter().zip(lenses.as_chunks().0).map(view).collect();
    Some((around_points::around_points(&points, &colors, 7), views))
}
