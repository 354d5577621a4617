//! Damaged and hostile textures, descriptions and archives: an error each, and little memory.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

mod common;

use common::{SplitMix, random_scene};
use scenesplat_scene::formats::sog::{
    is_lod_meta_json, is_sog_archive, is_sog_meta_json, read_sog, read_sog_archive, write_sog,
    write_sog_folder,
};
use scenesplat_scene::{ReadOptions, WriteOptions};
use serde_json::{Value, json};
use std::alloc::{GlobalAlloc, Layout, System};
use std::io::{Cursor, Write};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Counts what the process holds, and the most it held.
struct Counting;

static HELD: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator unchanged; only sizes are counted.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let held = HELD.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(held, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        let held = HELD.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(held, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// No test in this file may make the process hold more than this, in bytes, all threads together.
const ALLOWED: usize = 192 << 20;

fn check_memory() {
    let most = MOST.load(Ordering::Relaxed);
    assert!(most < ALLOWED, "{} MiB were held", most >> 20);
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
    let scene = random_scene(50, 1, 3);
    write_sog_folder(&scene, &meta, &WriteOptions::default(), &mut |_| true).unwrap();
    serde_json::from_slice(&std::fs::read(meta).unwrap()).unwrap()
}

fn error_of(folder: &Path, meta: &Value) -> String {
    std::fs::write(folder.join("meta.json"), meta.to_string()).unwrap();
    read_sog(&folder.join("meta.json"), &ReadOptions::default()).unwrap_err().to_string()
}

#[test]
fn descriptions_with_wrong_values() {
    let dir = tempfile::tempdir().unwrap();
    let good = small_folder(dir.path());
    let long = vec![0.5; 257];
    for (at, value, expected) in [
        ("/count", json!(-5), "count is -5, not a whole number"),
        ("/count", json!(50.5), "count is 50.5"),
        ("/count", json!("50"), "count is \"50\""),
        ("/count", json!(null), "no field count"),
        ("/count", json!(65), "8×8 texels for 65 Gaussians"),
        ("/count", json!(0), "no Gaussian"),
        ("/count", json!(1u64 << 40), "only"),
        ("/count", json!(u64::MAX), "only"),
        ("/count", json!(1e300), "count is 1e+300"),
        ("/version", json!(3), "version 3"),
        ("/version", json!("2"), "version is \"2\""),
        ("/version", json!(1), "scales"),
        ("/means/mins", json!([0.0, 1.0]), "means.mins has 2 entries, not 3"),
        ("/means/mins/1", json!("x"), "means.mins[1] is \"x\", not a number"),
        ("/means/maxs", json!(1.0), "means.maxs is 1.0, not a list"),
        ("/means/files", json!(["means_l.webp"]), "means.files has 1 entries"),
        ("/means/files/0", json!(7), "means.files[0] is 7, not a text"),
        ("/means/files/0", json!("../means_l.webp"), "not a file of this folder"),
        ("/means/files/0", json!("/etc/passwd"), "not a file of this folder"),
        ("/means/files/0", json!("no.webp"), "names the file no.webp, which is not there"),
        ("/means/files/0", json!("meta.json"), "is no WebP image"),
        ("/means/files/0", json!("."), "not a file of this folder"),
        ("/scales/codebook", json!(long), "scales.codebook has 257 entries, not 256"),
        ("/scales/codebook/3", json!(null), "scales.codebook[3] is null"),
        ("/scales/codebook/3", json!({}), "scales.codebook[3] is {}"),
        ("/sh0", json!([]), "no field codebook in sh0"),
        ("/shN/bands", json!(4), "shN.bands is 4"),
        ("/shN/bands", json!(2), "192 texels wide, not 512 for 2 bands"),
        ("/shN/count", json!(1 << 20), "texels high for 1048576 centroids"),
        ("/shN/count", json!(10), "of 10 centroids"),
        ("/shN/files/0", json!("means_l.webp"), "8 texels wide"),
        ("/shN/files/1", json!("shN_centroids.webp"), "of 50 centroids"),
        ("/scenesplat/labels", json!("no"), "names the file no, which"),
        ("/scenesplat/labels", json!("means_l.webp"), "block of labels"),
    ] {
        let mut meta = good.clone();
        meta["scenesplat"] =
            if at.starts_with("/scenesplat") { json!({"labels": 0}) } else { json!(null) };
        if at == "/version" && value == json!(1) {
            meta["scales"] = json!({"files": ["scales.webp"]});
        }
        *meta.pointer_mut(at).unwrap() = value.clone();
        let error = error_of(dir.path(), &meta);
        assert!(error.contains(expected), "{at} = {value}: {error}");
    }
    for text in ["", "{", "[]", "null", "{}", "\u{feff}{}", &"[".repeat(100_000)] {
        std::fs::write(dir.path().join("meta.json"), text).unwrap();
        assert!(read_sog(dir.path(), &ReadOptions::default()).is_err());
        assert!(read_sog(&dir.path().join("meta.json"), &ReadOptions::default()).is_err());
        assert!(!is_sog_meta_json(text.as_bytes()) && !is_lod_meta_json(text.as_bytes()));
    }
    std::fs::write(dir.path().join("lod-meta.json"), "{\"lodLevels\": 1}").unwrap();
    assert!(read_sog(&dir.path().join("lod-meta.json"), &ReadOptions::default()).is_err());
    assert!(read_sog(&dir.path().join("nowhere"), &ReadOptions::default()).is_err());
}

/// A lossless image that claims a size, with few bits after it that stand for any number of texels
/// of one colour.
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
    check_memory();
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
    let read = |bytes: &[u8]| {
        read_sog_archive(bytes, Path::new("a.sog"), &ReadOptions::default())
            .unwrap_err()
            .to_string()
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
    // The buffer of this test is the largest block of all.
    check_memory();
}

#[test]
fn archives_cut_anywhere() {
    let bytes = pack(CompressionMethod::Stored, &|_, bytes| bytes);
    for cut in (0..bytes.len()).step_by(23).chain(bytes.len() - 300..bytes.len()) {
        let part = &bytes[..cut];
        assert!(!is_sog_archive(part), "{cut}");
        read_sog_archive(part, Path::new("a.sog"), &ReadOptions::default()).unwrap_err();
    }
}

/// Changes some bytes, cuts, repeats or inserts.
fn damage(bytes: &[u8], rng: &mut SplitMix) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..=rng.below(3) {
        let at = rng.below(out.len().max(1)).min(out.len().saturating_sub(1));
        match rng.below(6) {
            0 => out.truncate(at),
            1 => out.insert(at, rng.next() as u8),
            2 => out.splice(at..at, bytes[..rng.below(bytes.len())].to_vec()).for_each(drop),
            _ if out.is_empty() => {}
            3 => out[at] = rng.next() as u8,
            4 => out[at] ^= 1 << rng.below(8),
            _ => out[at] = [0, 255, b'9', b'-', b'e'][rng.below(5)],
        }
    }
    out
}

#[test]
fn two_thousand_damaged_archives() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.sog");
    let scene = random_scene(50, 1, 3);
    write_sog(&scene, &path, &WriteOptions::default(), &mut |_| true).unwrap();
    let stored = std::fs::read(path).unwrap();
    let packed = pack(CompressionMethod::Deflated, &|_, bytes| bytes);
    let mut rng = SplitMix(1);
    let mut intact = 0;
    for i in 0..2000 {
        let bytes = damage(if i % 2 == 0 { &stored } else { &packed }, &mut rng);
        let _ = is_sog_archive(&bytes);
        // Entries have checksums: what is read is what was written.
        if let Ok(loaded) = read_sog_archive(&bytes, Path::new("a"), &ReadOptions::default()) {
            assert_eq!(loaded.source_rows(), 50, "case {i}");
            intact += 1;
        }
    }
    assert!(intact > 0, "names of other headers and dates may be damaged");
    check_memory();
}

#[test]
fn two_thousand_damaged_folders() {
    let dir = tempfile::tempdir().unwrap();
    let scene = random_scene(50, 1, 3);
    let meta = dir.path().join("meta.json");
    write_sog_folder(&scene, &meta, &WriteOptions::default(), &mut |_| true).unwrap();
    let mut rng = SplitMix(2);
    let (mut read, mut refused) = (0, 0);
    for i in 0..2000 {
        let name = if i % 3 == 0 { "meta.json" } else { NAMES[rng.below(NAMES.len())] };
        let path = dir.path().join(name);
        let good = std::fs::read(&path).unwrap();
        let bad = damage(&good, &mut rng);
        std::fs::write(&path, &bad).unwrap();
        let due = || {
            let meta: Value = serde_json::from_slice(&std::fs::read(&meta).unwrap()).unwrap();
            meta["count"].as_u64().unwrap() as usize
        };
        match read_sog(&meta, &ReadOptions::default()) {
            Ok(loaded) => {
                assert_eq!(loaded.source_rows(), due(), "case {i}, {name}");
                read += 1;
            }
            Err(_) => refused += 1,
        }
        std::fs::write(&path, &good).unwrap();
    }
    assert!(read > 100 && refused > 500, "{read} read, {refused} refused");
    check_memory();
}

#[test]
fn damaged_streams() {
    let dir = tempfile::tempdir().unwrap();
    let scene = random_scene(50, 0, 3);
    let chunk = dir.path().join("a/meta.json");
    write_sog_folder(&scene, &chunk, &WriteOptions::default(), &mut |_| true).unwrap();
    let run = |offset: usize, count: usize| json!({"file": 0, "offset": offset, "count": count});
    let good = json!({"lodLevels": 2, "environment": null, "filenames": ["a/meta.json"], "tree":
        {"children": [{"lods": {"0": run(0, 20)}}, {"lods": {"0": run(20, 30), "1": run(20, 1)}}]}});
    let good = good.to_string();
    let path = dir.path().join("lod-meta.json");
    let mut rng = SplitMix(4);
    let mut read = 0;
    for i in 0..1000 {
        let bytes =
            if i == 0 { good.clone().into_bytes() } else { damage(good.as_bytes(), &mut rng) };
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(loaded) = read_sog(&path, &ReadOptions::default()) {
            assert!((1..=50).contains(&loaded.source_rows()), "case {i}");
            read += 1;
        }
    }
    assert!(read > 10, "{read}");
    let deep = format!(
        "{{\"lodLevels\":1,\"filenames\":[],\"tree\":{}{}}}",
        "{\"children\":[".repeat(5000),
        "]}".repeat(5000)
    );
    std::fs::write(&path, deep).unwrap();
    read_sog(&path, &ReadOptions::default()).unwrap_err();
    let empty = "{\"lodLevels\":1,\"filenames\":[],\"tree\":{}}";
    std::fs::write(&path, empty).unwrap();
    let error = read_sog(&path, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("no Gaussian"), "{error}");
    check_memory();
}
