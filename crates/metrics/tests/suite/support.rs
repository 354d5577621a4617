//! Comparisons and random inputs.

use rand::Rng;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use scenesplat_test_support::Golden;

/// Rows scaled to length 1.
pub fn unit_rows(values: &[f32], dim: usize) -> Vec<f32> {
    let unit = |row: &[f32]| -> Vec<f32> {
        let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        row.iter().map(|v| (f64::from(*v) / norm) as f32).collect()
    };
    values.chunks_exact(dim).flat_map(unit).collect()
}

/// The text embeddings of a published label set, `[C, 768]` unit rows; `None` where they are not installed.
pub fn published_texts(name: &str) -> Option<Vec<f32>> {
    let path = format!("real/text_embeddings/{name}_text_embeddings_siglip2.safetensors");
    Some(unit_rows(&Golden::open(&path)?.f32s("text_embeddings"), 768))
}

pub fn close(got: f64, expected: f64, atol: f64, what: &str) {
    assert!((got - expected).abs() <= atol, "{what}: got {got}, expected {expected} ± {atol}");
}

pub fn all_close(got: &[f32], expected: &[f32], atol: f64, what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    for (i, (&g, &e)) in got.iter().zip(expected).enumerate() {
        close(g.into(), e.into(), atol, &format!("{what}[{i}]"));
    }
}

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Uneven random labels, some of them -1.
pub fn random_labels(rng: &mut ChaCha8Rng, n: usize, num_classes: i32) -> Vec<i32> {
    (0..n)
        .map(|_| rng.random_range(-1..num_classes).min(rng.random_range(-1..num_classes)))
        .collect()
}

/// Points on the walls of a room, on a coarse grid, so that distances often tie and points repeat.
pub fn gridded_room(rng: &mut ChaCha8Rng, n: usize) -> Vec<[f32; 3]> {
    (0..n)
        .map(|_| {
            let mut c: [f32; 3] =
                std::array::from_fn(|_| f32::from(rng.random_range(0..12_u8)) * 0.25);
            c[rng.random_range(0..3)] = 0.0;
            c
        })
        .collect()
}

/// `n × dim` values in -1..1.
pub fn random_rows(rng: &mut ChaCha8Rng, n: usize, dim: usize) -> Vec<f32> {
    (0..n * dim).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// The result of `f` in pools of 1, 2 and 5 threads, which must be the same.
pub fn in_all_pools<T: PartialEq + std::fmt::Debug + Send>(f: impl Fn() -> T + Sync) -> T {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(&f)
    };
    let one = run(1);
    for threads in [2, 5] {
        assert!(run(threads) == one, "{threads} threads give another result");
    }
    one
}
