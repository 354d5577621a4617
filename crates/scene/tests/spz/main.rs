//! SPZ files: those that other programs wrote, what comes back of our own, and damaged ones.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

#[path = "../common/mod.rs"]
mod common;
mod hostile;
mod memory;
mod reading;
mod records;
mod writing;

use scenesplat_scene::formats::spz::{read_spz, write_spz};
use scenesplat_scene::{
    GaussianScene, LoadedScene, ReadOptions, SpzFrame, WriteOptions, WriteReport,
};
use std::io::{Read, Write};
use std::path::Path;

const HERE: &str = "a.spz";

fn read(bytes: &[u8]) -> LoadedScene {
    read_spz(bytes, Path::new(HERE), &ReadOptions::default()).unwrap()
}

fn read_raw(bytes: &[u8]) -> LoadedScene {
    let options = ReadOptions { spz_frame: SpzFrame::Raw, ..ReadOptions::default() };
    read_spz(bytes, Path::new(HERE), &options).unwrap()
}

fn write_with(scene: &GaussianScene, options: &WriteOptions) -> (Vec<u8>, WriteReport) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(HERE);
    let report = write_spz(scene, &path, options, &mut |_| true).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!((report.bytes, report.gaussians), (bytes.len() as u64, scene.len()));
    assert_eq!(report.files, [path]);
    (bytes, report)
}

fn write(scene: &GaussianScene, spz_version: u8) -> Vec<u8> {
    write_with(scene, &WriteOptions { spz_version, ..WriteOptions::default() }).0
}

fn close(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance}");
    }
}

fn flat<const W: usize>(rows: &[[f32; W]]) -> &[f32] {
    rows.as_flattened()
}

/// How far two rotations are apart, as the cosine of half the angle.
fn dot(a: &[f32; 4], b: &[f32; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>().abs()
}

/// `stored` is `scene` after it was an SPZ file.
fn compare_within_steps(scene: &GaussianScene, stored: &GaussianScene, version: u8) {
    assert_eq!((scene.len(), scene.sh_degree), (stored.len(), stored.sh_degree));
    close(flat(&scene.coord), flat(&stored.coord), 0.5 / 4096.0 * 1.001);
    let clip = |v: &[f32], min: f32, max: f32| -> Vec<f32> {
        v.iter().map(|v| v.clamp(min, max)).collect()
    };
    let dc = 0.5 / 0.15f32;
    close(&clip(flat(&scene.sh_dc), -dc, dc), flat(&stored.sh_dc), dc / 255.0 * 1.001);
    close(&clip(flat(&scene.log_scale), -10.0, 5.9375), flat(&stored.log_scale), 0.031_26);
    for row in 0..scene.len() {
        let (a, b) = (scene.opacity(row), stored.opacity(row));
        assert!((a - b).abs() <= 0.5 / 255.0 * 1.001, "{a} {b}");
        // 8 bits leave w to follow: worst where it is small. 10 bits: half a step in three.
        let due = if version == 2 { 0.995 } else { 0.999_996 };
        let dot = dot(&scene.quat[row], &stored.quat[row]);
        assert!(dot >= due, "row {row}: {dot}, {:?} {:?}", scene.quat[row], stored.quat[row]);
    }
    let width = scene.sh_rest_len() * 3;
    for (i, (a, b)) in scene.sh_rest.iter().zip(&stored.sh_rest).enumerate() {
        // Rounded to 1/128, then to a bucket of 8 or 16 of them; the sign of the frame may turn the
        // clipped end around.
        let bucket = if i % width < 9 { 8.0 } else { 16.0 };
        assert!((a.clamp(-1.0, 1.0) - b).abs() <= (bucket / 2.0 + 0.51) / 128.0, "{i}: {a} {b}");
    }
}

/// The decompressed streams of a file of version 4.
fn streams(file: &[u8]) -> Vec<Vec<u8>> {
    let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
    let (toc, num) = (word(16), usize::from(file[15]));
    let mut at = toc + 16 * num;
    let mut out = Vec::new();
    for i in 0..num {
        let size = word(toc + 16 * i);
        out.push(zstd::decode_all(&file[at..at + size]).unwrap());
        at += size;
    }
    assert_eq!(at, file.len());
    out
}

fn gunzip(file: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    flate2::read::GzDecoder::new(file).read_to_end(&mut body).unwrap();
    body
}

fn gzip(body: &[u8]) -> Vec<u8> {
    let mut to = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    to.write_all(body).unwrap();
    to.finish().unwrap()
}
