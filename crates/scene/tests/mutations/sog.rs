//! Textures and archives that claim much: errors that need little memory.

use crate::ONE_AT_A_TIME;
use crate::common::{random_scene, write};
use crate::counting_allocator::peak_of;
use scenesplat_scene::formats::sog::{is_sog_archive, read_sog, read_sog_archive};
use scenesplat_scene::{LoadedScene, ReadOptions, SceneError, SceneFormat};
use serde_json::{Value, json};
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// The most that a file of this module may need, in bytes.
const ALLOWED: usize = 96 << 20;

/// What is wrong, found with little memory.
fn problem(read: impl FnOnce() -> Result<LoadedScene, SceneError>) -> String {
    let (result, peak) = peak_of(read);
    let text = result.unwrap_err().to_string();
    assert!(peak < ALLOWED, "{} MiB: {text}", peak >> 20);
    text
}

const NAMES: [&str; 7] = [
    "means_l.webp",
    "means_u.webp",
    "quats.webp",
    "scales.webp",
    "sh0.webp",
    "shN_centroids.webp",
    "shN_labels.webp",
];

/// A folder of 50 Gaussians of degree 1, and its description.
fn small_folder(folder: &Path) -> Value {
    let meta = folder.join("meta.json");
    write(&random_scene(50, 1, 3), &meta, SceneFormat::SogFolder);
    serde_json::from_slice(&std::fs::read(meta).unwrap()).unwrap()
}

fn error_of(folder: &Path, meta: &Value) -> String {
    std::fs::write(folder.join("meta.json"), meta.to_string()).unwrap();
    problem(|| read_sog(&folder.join("meta.json"), &ReadOptions::default()))
}

/// A lossless image that claims a size, with few bits after it that stand for any number of texels
/// of one color.
fn one_color(width: u32, height: u32) -> Vec<u8> {
    let mut payload = vec![0x2f];
    payload.extend_from_slice(&((width - 1) | (height - 1) << 14).to_le_bytes());
    // No transform, no cache, no groups; five codes of a single symbol, 0.
    let bits: u64 =
        [1u64, 1, 1, 1, 1].iter().enumerate().fold(0, |b, (i, &v)| b | v << (3 + 4 * i));
    payload.extend_from_slice(&bits.to_le_bytes());
    let mut out = b"RIFF".to_vec();
    out.extend_from_slice(&(payload.len() as u32 + 13).to_le_bytes());
    out.extend_from_slice(b"WEBPVP8L");
    out.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    out.extend_from_slice(&payload);
    out.push(0);
    out
}

#[test]
fn textures_that_claim_more_than_they_hold() {
    let _alone = ONE_AT_A_TIME.lock();
    let dir = tempfile::tempdir().unwrap();
    let mut meta = small_folder(dir.path());
    meta.as_object_mut().unwrap().remove("shN");
    // The image itself is legal: 50 Gaussians may well be alike.
    NAMES.iter().for_each(|name| std::fs::write(dir.path().join(name), one_color(8, 8)).unwrap());
    std::fs::write(dir.path().join("meta.json"), meta.to_string()).unwrap();
    assert_eq!(read_sog(dir.path(), &ReadOptions::default()).unwrap().scene.len(), 50);
    for (width, height) in [(16_384, 16_384), (16_383, 16_383), (16_383, 70), (7, 7)] {
        let bytes = one_color(width, height);
        std::fs::write(dir.path().join("sh0.webp"), &bytes).unwrap();
        let error = error_of(dir.path(), &meta);
        assert!(error.contains(&format!("{width}×{height} texels")), "{error}");
        for name in &NAMES[..5] {
            std::fs::write(dir.path().join(name), &bytes).unwrap();
        }
        for count in [16_383 * 16_383, 1_000_000] {
            meta["count"] = json!(count);
            let error = error_of(dir.path(), &meta);
            assert!(error.contains("bytes of positions"), "{error}");
        }
        meta["count"] = json!(50);
        NAMES.iter().for_each(|name| {
            std::fs::write(dir.path().join(name), one_color(8, 8)).unwrap();
        });
    }
}

/// An archive of the files of a small scene, some of them changed.
fn pack(method: CompressionMethod, change: &dyn Fn(&str, Vec<u8>) -> Vec<u8>) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    small_folder(dir.path());
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(method);
    for name in NAMES.into_iter().chain(["meta.json"]) {
        let bytes = std::fs::read(dir.path().join(name)).unwrap();
        zip.start_file(name, options).unwrap();
        zip.write_all(&change(name, bytes)).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn entries_that_unpack_to_too_much() {
    let deflated = CompressionMethod::Deflated;
    let _alone = ONE_AT_A_TIME.lock();
    let read = |bytes: &[u8]| {
        problem(|| read_sog_archive(bytes, Path::new("a.sog"), &ReadOptions::default()))
    };
    for (name, expected) in [("means_l.webp", "more than"), ("meta.json", "more than")] {
        let bomb = pack(deflated, &|n, mut bytes| {
            bytes.resize(if n == name { 100 << 20 } else { bytes.len() }, 0);
            bytes
        });
        assert!(bomb.len() < 1 << 20);
        let error = read(&bomb);
        assert!(error.contains(expected), "{error}");
    }
    // Sizes that are only claimed, in the central directory: bytes 20..28 of a record.
    for method in [deflated, CompressionMethod::Stored] {
        let good = pack(method, &|_, bytes| bytes);
        read_sog_archive(&good, Path::new("a"), &ReadOptions::default()).unwrap();
        let directory = good.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
        for (at, size) in
            [(24, 0xffff_fff0u32), (24, 4 << 20), (24, 10), (20, 0xffff_fff0), (20, 3)]
        {
            let mut bytes = good.clone();
            bytes[directory + at..directory + at + 4].copy_from_slice(&size.to_le_bytes());
            let error = read(&bytes);
            assert!(error.contains("means_l.webp"), "{at} {size}: {error}");
        }
    }
    let mut plain = ZipWriter::new(Cursor::new(Vec::new()));
    plain.start_file("a.txt", SimpleFileOptions::default()).unwrap();
    let plain = plain.finish().unwrap().into_inner();
    assert!(!is_sog_archive(&plain) && read(&plain).contains("without meta.json"));
}

#[test]
fn trees_that_are_deep_or_empty() {
    let _alone = ONE_AT_A_TIME.lock();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("lod-meta.json");
    let deep = ["{\"children\":[".repeat(5000), "]}".repeat(5000)].concat();
    for (tree, due) in [(deep.as_str(), ""), ("{}", "no Gaussian")] {
        let text = format!("{{\"lodLevels\":1,\"filenames\":[],\"tree\":{tree}}}");
        std::fs::write(&path, text).unwrap();
        let error = problem(|| read_sog(&path, &ReadOptions::default()));
        assert!(error.contains(due), "{error}");
    }
}
