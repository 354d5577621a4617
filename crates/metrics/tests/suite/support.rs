//! Finds and reads the shared golden files, and makes random inputs.
#![allow(dead_code, reason = "each test file uses a part")]

use rand::Rng;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use safetensors::SafeTensors;
use std::path::PathBuf;

/// The folder with goldens, or `None` after saying why a test is skipped.
pub fn shared() -> Option<PathBuf> {
    let dir = std::env::var_os("SCENESPLAT_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    if dir.is_dir() {
        return Some(dir);
    }
    println!("skipped: no shared data at {}; set SCENESPLAT_SHARED", dir.display());
    None
}

/// Rows of unit length, as a table of texts brings them to it.
pub fn unit_rows(values: &[f32], dim: usize) -> Vec<f32> {
    let unit = |row: &[f32]| -> Vec<f32> {
        let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        row.iter().map(|v| (f64::from(*v) / norm) as f32).collect()
    };
    values.chunks_exact(dim).flat_map(unit).collect()
}

/// A safetensors file held in memory.
pub struct Golden {
    name: String,
    bytes: Vec<u8>,
}

impl Golden {
    pub fn read(path: &str) -> Option<Self> {
        let bytes = std::fs::read(shared()?.join(path)).expect(path);
        Some(Self { name: path.to_owned(), bytes })
    }

    fn get<const N: usize>(&self, tensor: &str, dtype: safetensors::Dtype) -> Vec<[u8; N]> {
        let file = SafeTensors::deserialize(&self.bytes).expect(&self.name);
        let view = file.tensor(tensor).unwrap_or_else(|e| panic!("{}: {e}", self.name));
        assert_eq!(view.dtype(), dtype, "{}: {tensor}", self.name);
        view.data().as_chunks::<N>().0.to_vec()
    }

    pub fn has(&self, tensor: &str) -> bool {
        let file = SafeTensors::deserialize(&self.bytes).expect(&self.name);
        file.names().contains(&tensor)
    }

    pub fn f32(&self, tensor: &str) -> Vec<f32> {
        let raw = self.get::<4>(tensor, safetensors::Dtype::F32);
        raw.into_iter().map(f32::from_le_bytes).collect()
    }

    pub fn scalar(&self, tensor: &str) -> f64 {
        let values = self.f32(tensor);
        assert_eq!(values.len(), 1, "{tensor}");
        values[0].into()
    }

    pub fn i64(&self, tensor: &str) -> Vec<i64> {
        let raw = self.get::<8>(tensor, safetensors::Dtype::I64);
        raw.into_iter().map(i64::from_le_bytes).collect()
    }

    pub fn labels(&self, tensor: &str) -> Vec<i32> {
        self.i64(tensor).into_iter().map(|v| i32::try_from(v).expect("a label")).collect()
    }

    pub fn counts(&self, tensor: &str) -> Vec<u64> {
        self.i64(tensor).into_iter().map(|v| u64::try_from(v).expect("a count")).collect()
    }

    pub fn u32(&self, tensor: &str) -> Vec<u32> {
        let raw = self.get::<4>(tensor, safetensors::Dtype::U32);
        raw.into_iter().map(u32::from_le_bytes).collect()
    }

    pub fn bytes(&self, tensor: &str) -> Vec<u8> {
        self.get::<1>(tensor, safetensors::Dtype::U8).into_iter().map(|[v]| v).collect()
    }

    pub fn mask(&self, tensor: &str) -> Vec<bool> {
        let raw = self.get::<1>(tensor, safetensors::Dtype::U8);
        raw.into_iter().map(|[v]| v != 0).collect()
    }

    pub fn coord(&self, tensor: &str) -> Vec<[f32; 3]> {
        self.f32(tensor).as_chunks::<3>().0.to_vec()
    }
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
