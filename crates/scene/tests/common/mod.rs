//! What the tests of this crate share.
#![allow(dead_code, reason = "each test program uses a part of it")]

pub mod colmap;
pub mod gltf;
pub mod ksplat;
pub mod ply;
pub mod spz;

use half::f16;
use scenesplat_scene::{
    GaussianScene, LanguageCode, LanguageCodebook, LoadedScene, Policy, ReadOptions, SceneError,
    SceneFormat, WriteOptions, WriteReport, open_scene, write_scene,
};
pub use scenesplat_test_support::shared;
use std::path::{Path, PathBuf};

/// Pseudo-random numbers; the same for the same seed everywhere.
pub struct SplitMix(pub u64);

impl SplitMix {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    /// −1..1.
    pub fn float(&mut self) -> f32 {
        (self.next() >> 40) as f32 / 8_388_608.0 - 1.0
    }
}

/// A scene that cleaning leaves as it is.
pub fn random_scene(rows: usize, sh_degree: u8, seed: u64) -> GaussianScene {
    let mut rng = SplitMix(seed);
    let mut scene = GaussianScene { sh_degree, ..GaussianScene::default() };
    for _ in 0..rows {
        scene.coord.push([(); 3].map(|()| rng.float() * 10.0));
        scene.log_scale.push([(); 3].map(|()| rng.float() - 4.0));
        let quat = [(); 4].map(|()| f64::from(rng.float()));
        let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt().copysign(quat[0]);
        scene.quat.push(quat.map(|v| (v / norm) as f32));
        scene.opacity_logit.push(rng.float() * 8.0);
        scene.sh_dc.push([(); 3].map(|()| rng.float() * 1.5));
        for _ in 0..scene.sh_rest_len() * 3 {
            scene.sh_rest.push(rng.float());
        }
    }
    scene
}

/// A small `.npy` file, written independently of the crate.
pub fn npy_bytes(version: u8, dict: &str, data: &[u8]) -> Vec<u8> {
    let mut out = b"\x93NUMPY".to_vec();
    out.extend_from_slice(&[version, 0]);
    let text = format!("{dict}\n");
    if version == 1 {
        out.extend_from_slice(&(text.len() as u16).to_le_bytes());
    } else {
        out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    }
    out.extend_from_slice(text.as_bytes());
    out.extend_from_slice(data);
    out
}

/// Codes of `k` numbers for features of `width`, none of them special.
pub fn language_code(rows: usize, k: usize, width: usize) -> LanguageCode {
    let mut rng = SplitMix(rows as u64);
    let values = (0..rows * k).map(|_| f16::from_f32(rng.float())).collect();
    let mean = (0..width).map(|_| rng.float()).collect();
    let axes = (0..k * width).map(|_| rng.float()).collect();
    LanguageCode { values, codebook: LanguageCodebook { mean, axes } }
}

/// A scene with every label that all formats keep.
pub fn labelled(rows: usize, sh_degree: u8) -> GaussianScene {
    let mut scene = random_scene(rows, sh_degree, 4);
    scene.segment = Some((0..rows as i32).map(|i| i % 21 - 1).collect());
    scene.instance = Some((0..rows as i32).map(|i| i / 3 - 1).collect());
    scene.segment_score = Some((0..rows).map(|i| i as f32 / 7.0).collect());
    scene.lang_code = Some(language_code(rows, 3, 8));
    scene
}

/// Writes with these options.
pub fn write_as(
    scene: &GaussianScene,
    path: &Path,
    format: SceneFormat,
    options: &WriteOptions,
) -> Result<WriteReport, SceneError> {
    write_scene(scene, path, format, options, &mut |_| true)
}

/// Writes in place of what is there.
pub fn write(scene: &GaussianScene, path: &Path, format: SceneFormat) -> WriteReport {
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    write_as(scene, path, format, &options).unwrap()
}

/// Reads with the default options.
pub fn open(path: &Path) -> LoadedScene {
    open_scene(path, &ReadOptions::default()).unwrap()
}

/// The options that accept only files without a fault.
pub fn strict() -> ReadOptions {
    ReadOptions { policy: Policy::Strict, ..ReadOptions::default() }
}

/// A file `name` in `folder`.
pub fn save(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Every file and folder below `folder` with its bytes.
pub fn contents(folder: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        all.push((path.clone(), std::fs::read(&path).ok()));
        if path.is_dir() {
            all.extend(contents(&path));
        }
    }
    all.sort();
    all
}

/// The row of the scene that each row of the file holds.
pub fn order_of(report: &WriteReport) -> Vec<usize> {
    match &report.order {
        Some(order) => order.iter().map(|&row| row as usize).collect(),
        None => (0..report.gaussians).collect(),
    }
}

/// Rows, first row and largest change of the limit that names `field` and `word`.
pub fn limit(report: &WriteReport, field: &str, word: &str) -> (usize, usize, f64) {
    let mut found = report.limits.iter().filter(|l| l.field == field && l.limit.contains(word));
    let limit = found.next().unwrap_or_else(|| panic!("{field}, {word}: {report}"));
    (limit.rows, limit.first_row, limit.largest_change)
}

/// A pool of so many threads.
pub fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

/// Equal within `tolerance`.
pub fn close(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance}");
    }
}

/// The rows behind each other.
pub fn flat<const W: usize>(rows: &[[f32; W]]) -> &[f32] {
    rows.as_flattened()
}

/// The cosine of half the angle between two rotations.
pub fn dot(a: &[f32; 4], b: &[f32; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>().abs()
}

/// Rotations have a length of 1 and w is not negative.
pub fn check_unit(scene: &GaussianScene) {
    for q in &scene.quat {
        let norm: f64 = q.iter().map(|&v| f64::from(v).powi(2)).sum();
        assert!((norm - 1.0).abs() < 1e-6 && q[0] >= 0.0, "{q:?}");
    }
}
