//! SPZ files that lie, are cut off, or were damaged: an error, never a panic, never much memory.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

mod common;

use common::{SplitMix, random_scene, shared};
use scenesplat_scene::formats::spz::{is_spz, read_spz, write_spz};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{GaussianScene, LoadedScene, Policy, ReadOptions, SceneError, WriteOptions};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::io::{Read, Write};
use std::path::Path;

/// Counts what a thread asks for, so that a test can say how much a file made the reader reserve.
struct Counting;

thread_local! {
    static NOW: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

fn count(change: isize) {
    // At the end of a thread its counters may be gone already; then nobody asks for them.
    let _ = NOW.try_with(|now| {
        now.set(now.get() + change);
        let _ = PEAK.try_with(|peak| peak.set(peak.get().max(now.get())));
    });
}

// SAFETY: every call is handed on to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller keeps the contract of `alloc`, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: `at` came from `System` through `alloc` above, with this layout.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// Reads with all work in this thread, and gives the most memory that was reserved at a time.
fn peak_of(bytes: &[u8]) -> (Result<LoadedScene, SceneError>, usize) {
    thread_local! {
        static HERE: rayon::ThreadPool =
            rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    }
    HERE.with(|pool| {
        pool.install(|| {
            let before = NOW.get();
            PEAK.set(before);
            let result = open(bytes);
            (result, (PEAK.get() - before) as usize)
        })
    })
}

fn open(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    read_spz(bytes, Path::new("a.spz"), &ReadOptions::default())
}

fn problem(bytes: &[u8]) -> String {
    let text = open(bytes).unwrap_err().to_string();
    assert!(text.starts_with("a.spz: "), "{text}");
    text
}

fn write(scene: &GaussianScene, spz_version: u8) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.spz");
    let options = WriteOptions { spz_version, ..WriteOptions::default() };
    write_spz(scene, &path, &options, &mut |_| true).unwrap();
    std::fs::read(path).unwrap()
}

fn gzip(body: &[u8]) -> Vec<u8> {
    let mut to = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    to.write_all(body).unwrap();
    to.finish().unwrap()
}

fn gunzip(file: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    flate2::read::GzDecoder::new(file).read_to_end(&mut body).unwrap();
    body
}

/// The header of a file of version 1 to 3.
fn header(version: u32, rows: u32, degree: u8) -> Vec<u8> {
    let mut out = b"NGSP".to_vec();
    out.extend_from_slice(&version.to_le_bytes());
    out.extend_from_slice(&rows.to_le_bytes());
    out.extend_from_slice(&[degree, 12, 0, 0]);
    out
}

/// A small file of every kind, with labels.
fn small_files() -> Vec<(&'static str, Vec<u8>)> {
    let mut scene = random_scene(40, 1, 3);
    scene.segment = Some((0..40).collect());
    let (v2, v3, v4) = (write(&scene, 2), write(&scene, 3), write(&scene, 4));
    let body = gunzip(&v3);
    let wrapped = zstd::encode_all(&body[..], 5).unwrap();
    vec![("v2", v2), ("v3", v3), ("v4", v4), ("wrapped", wrapped), ("raw", body)]
}

#[test]
fn a_file_that_is_cut_anywhere_is_refused() {
    for (name, bytes) in small_files() {
        assert_eq!(open(&bytes).unwrap().scene.len(), 40, "{name}");
        for cut in 0..bytes.len() {
            let result = open(&bytes[..cut]);
            // A raw file that ends where a record of labels would begin has just none.
            let without_labels = name == "raw" && cut == 16 + 40 * 29;
            assert_eq!(result.is_ok(), without_labels, "{name} cut to {cut} of {}", bytes.len());
        }
    }
}

#[test]
fn bytes_that_follow_are_reported_and_refused_by_the_strict_policy() {
    let strict = ReadOptions { policy: Policy::Strict, ..ReadOptions::default() };
    let mut scene = random_scene(40, 1, 3);
    for labelled in [false, true] {
        for version in 2..=4 {
            let mut bytes = write(&scene, version);
            let whole = open(&bytes).unwrap();
            assert_eq!(whole.report.count(Rule::FileTrailing), 0);
            bytes.extend_from_slice(b"more");
            let loaded = open(&bytes).unwrap();
            assert_eq!(loaded.scene, whole.scene);
            let finding = loaded.report.finding(Rule::FileTrailing).unwrap();
            assert_eq!((finding.first_element, finding.example.as_str()), (40, "4 bytes"));
            assert!(read_spz(&bytes, Path::new("a.spz"), &strict).is_err());
        }
        scene.segment = Some(vec![1; 40]);
    }
    // Within the stream, where nothing says that records follow.
    scene.segment = None;
    let mut body = gunzip(&write(&scene, 3));
    body.push(0);
    for bytes in [gzip(&body), zstd::encode_all(&body[..], 3).unwrap(), body] {
        assert_eq!(open(&bytes).unwrap().report.count(Rule::FileTrailing), 1);
        assert!(read_spz(&bytes, Path::new("a.spz"), &strict).is_err());
    }
}

#[test]
fn other_versions_and_degrees_are_named() {
    for (bytes, what) in [
        (header(0, 1, 0), "version 0"),
        (header(5, 1, 0), "version 5"),
        (header(3, 1, 5), "degree 5"),
        (header(3, 1, 255), "degree 255"),
        (gzip(&header(4, 1, 0)), "version 4 within a stream"),
        (gzip(b"some other file that was compressed"), "not with NGSP"),
        (zstd::encode_all(&b"some other file"[..], 3).unwrap(), "ends within its header"),
        (gzip(&[0; 1 << 20]), "not with NGSP"),
        (gzip(b""), "ends within its header"),
        (b"NGSP".to_vec(), "ends within its header"),
        (b"plyplyplyplyplyplyply".to_vec(), "not with NGSP"),
    ] {
        let text = problem(&bytes);
        assert!(text.contains(what), "{text}");
    }
    let mut bits = header(2, 1, 0);
    bits[13] = 32;
    assert!(problem(&bits).contains("32 fractional bits"));
    // No Gaussian at all is an error of its own.
    for bytes in [header(3, 0, 0), gzip(&header(2, 0, 3))] {
        assert!(problem(&bytes).contains(Rule::FileEmpty.about().bad_value));
    }
    assert!(is_spz(b"NGSP") && is_spz(&[0x1f, 0x8b, 8]) && is_spz(&[0x28, 0xb5, 0x2f, 0xfd]));
    assert!(!is_spz(b"ply\n") && !is_spz(b"") && !is_spz(b"NGS") && !is_spz(b"PK\x03\x04"));
}

#[test]
fn large_counts_reserve_little() {
    // Of 200 bytes a reader may make a scene of some KiB; a step of 128 KiB is decompressed at a
    // time, as bytes and as numbers, and the decompressors have their windows.
    const FIXED: usize = 1 << 20;
    for rows in [41, 1000, 1 << 20, u32::MAX] {
        for (name, bytes) in small_files() {
            let set = |at: usize, body: &[u8]| {
                let mut body = body.to_vec();
                body[at..at + 4].copy_from_slice(&rows.to_le_bytes());
                body
            };
            let bytes = match name {
                "v2" | "v3" => gzip(&set(8, &gunzip(&bytes))),
                "wrapped" => {
                    zstd::encode_all(&set(8, &zstd::decode_all(&bytes[..]).unwrap())[..], 3)
                        .unwrap()
                }
                "raw" => set(8, &bytes),
                // All sizes in the table of contents agree with the count.
                _ => {
                    let mut bytes = set(8, &bytes);
                    let toc = u32::from_le_bytes(bytes[16..20].try_into().unwrap()) as usize;
                    for (i, row_bytes) in [9, 1, 3, 3, 4, 9].into_iter().enumerate() {
                        let size = u64::from(rows) * row_bytes;
                        bytes[toc + 16 * i + 8..][..8].copy_from_slice(&size.to_le_bytes());
                    }
                    bytes
                }
            };
            let (result, peak) = peak_of(&bytes);
            assert!(result.is_err(), "{name} {rows}");
            assert!(peak < FIXED, "{name}, {rows} rows: {peak} bytes reserved");
        }
    }
}

#[test]
fn memory_follows_what_a_stream_delivers() {
    // A million equal Gaussians are a few KiB: honest, but nothing to reserve memory for at once.
    let scene = random_scene(1, 1, 3).select_rows(&vec![0; 300_000]).unwrap();
    let array_bytes = 300_000 * (3 + 3 + 4 + 1 + 3 + 9) * 4;
    for version in 2..=4 {
        let bytes = write(&scene, version);
        let (result, peak) = peak_of(&bytes);
        assert_eq!(result.unwrap().scene.len(), 300_000, "version {version}");
        // An array that grows is moved: for a moment a quarter of it is there twice.
        assert!(peak < array_bytes * 5 / 4 + (1 << 20), "version {version}: {peak}");
        // The same claim without the data.
        let (result, peak) = peak_of(&bytes[..bytes.len() / 2]);
        assert!(result.is_err());
        assert!(peak < array_bytes, "version {version}: {peak}");
    }
}

#[test]
fn bombs_are_not_decompressed() {
    // Megabytes of zeros behind one honest Gaussian: not one of them is wanted.
    let mut body = header(3, 1, 0);
    body.resize(16 + 20, 0);
    let one = body.len();
    body.resize(64 << 20, 0);
    for bytes in [gzip(&body), zstd::encode_all(&body[..], 1).unwrap()] {
        assert!(bytes.len() < 100_000);
        let (result, peak) = peak_of(&bytes);
        let loaded = result.unwrap();
        assert_eq!((loaded.scene.len(), loaded.report.count(Rule::FileTrailing)), (1, 1));
        assert!(peak < 1 << 20, "{peak}");
    }
    // Zeros are a scene like any other if there are enough of them for the count, and not if not.
    let rows = (body.len() - 16) / 20;
    body[8..12].copy_from_slice(&(rows as u32 + 1).to_le_bytes());
    assert!(problem(&gzip(&body)).contains(&format!("of {} Gaussians", rows + 1)));
    assert_eq!(one, 36);

    // A stream of version 4 that holds more than its size, with and without saying so.
    let scene = random_scene(40, 1, 3);
    let file = write(&scene, 4);
    for says in [true, false] {
        let zeros = vec![0; 1 << 20];
        let mut to = zstd::stream::Encoder::new(Vec::new(), 3).unwrap();
        to.include_contentsize(says).unwrap();
        if says {
            to.set_pledged_src_size(Some(zeros.len() as u64)).unwrap();
        }
        to.write_all(&zeros).unwrap();
        let bytes = replace_stream(&file, 1, &to.finish().unwrap());
        let text = problem(&bytes);
        let due = if says { "alphas hold 1048576 bytes instead of 40" } else { "go on after 40" };
        assert!(text.contains(due), "{text}");
    }
}

/// A file of version 4 with another stream `i`; the size in the table is left as it is.
fn replace_stream(file: &[u8], i: usize, stream: &[u8]) -> Vec<u8> {
    let number = |at: usize| u64::from_le_bytes(file[at..at + 8].try_into().unwrap()) as usize;
    let toc = u32::from_le_bytes(file[16..20].try_into().unwrap()) as usize;
    let start =
        toc + 16 * usize::from(file[15]) + (0..i).map(|i| number(toc + 16 * i)).sum::<usize>();
    let end = start + number(toc + 16 * i);
    let mut out = [&file[..start], stream, &file[end..]].concat();
    out[toc + 16 * i..][..8].copy_from_slice(&(stream.len() as u64).to_le_bytes());
    out
}

#[test]
fn a_table_of_contents_that_lies_is_refused() {
    let file = write(&random_scene(40, 1, 3), 4);
    let with = |at: usize, value: &[u8]| {
        let mut bytes = file.clone();
        bytes[at..at + value.len()].copy_from_slice(value);
        problem(&bytes)
    };
    for toc in [0u32, 31, file.len() as u32 + 1, u32::MAX] {
        assert!(with(16, &toc.to_le_bytes()).contains("table of contents at byte"));
    }
    assert!(with(16, &(file.len() as u32 - 5).to_le_bytes()).contains("ends within its table"));
    assert!(with(15, &[0]).contains("none of them for its positions"));
    assert!(with(15, &[255]).contains("table of contents"));
    assert!(with(12, &[0]).contains("more than its header calls for"));
    assert!(with(12, &[2]).contains("40 Gaussians take 960"));
    for i in 0..6 {
        let entry = 32 + 16 * i;
        for size in [1u64, 41 * 9, u64::MAX] {
            let text = with(entry + 8, &size.to_le_bytes());
            assert!(text.contains(&format!("take {size} bytes")), "{text}");
        }
        for size in [file.len() as u64, u64::MAX] {
            let text = with(entry, &size.to_le_bytes());
            assert!(text.contains(&format!("a stream {i} of {size} bytes")), "{text}");
        }
        // A byte less here is a byte more there: neither stream is whole.
        let size = u64::from_le_bytes(file[entry..entry + 8].try_into().unwrap());
        let text = with(entry, &(size - 1).to_le_bytes());
        let due = ["decompressed", "zstd", "end after"];
        assert!(due.iter().any(|due| text.contains(due)), "{text}");
        let text = problem(&replace_stream(&file, i, b"no zstd at all"));
        assert!(text.contains("are no zstd stream"), "{text}");
    }
}

#[test]
fn labels_that_lie_are_refused() {
    const LABELS: [u8; 4] = 0x5353_0001u32.to_le_bytes();
    let plain = write(&random_scene(40, 1, 3), 4);
    let with = |payload: &[u8], size: u32| {
        let mut out = plain[..32].to_vec();
        out[14] |= 2;
        out[16..20].copy_from_slice(&(40 + payload.len() as u32).to_le_bytes());
        out.extend_from_slice(&LABELS);
        out.extend_from_slice(&size.to_le_bytes());
        out.extend_from_slice(payload);
        out.extend_from_slice(&plain[32..]);
        problem(&out)
    };
    let frame = |bytes: &[u8]| zstd::bulk::compress(bytes, 3).unwrap();
    let text = with(b"nothing", 7);
    assert!(text.contains("labels are no zstd stream"), "{text}");
    let text = with(&frame(b"nothing"), frame(b"nothing").len() as u32);
    assert!(text.contains("block of labels"), "{text}");
    assert!(with(b"nothing", 8).contains("7 of 8 bytes of an extension record"));
    assert!(with(b"", u32::MAX).contains("labels of 4294967295 bytes"));
    // 40 rows do not take 100 MiB, said or not.
    let huge = frame(&vec![0; 100 << 20]);
    let text = with(&huge, huge.len() as u32);
    assert!(text.contains("labels hold 104857600 bytes"), "{text}");
    // Those of another scene.
    let mut other = random_scene(41, 0, 1);
    other.segment = Some(vec![0; 41]);
    let other = write(&other, 4);
    let toc = u32::from_le_bytes(other[16..20].try_into().unwrap()) as usize;
    let text = with(&other[40..toc], (toc - 40) as u32);
    assert!(text.contains("41 Gaussians, not 40"), "{text}");
}

/// Opens damaged copies of a file: the right number of rows, or an error, never anything else.
fn mutate(name: &str, bytes: &[u8], rows: usize, times: usize) {
    let mut rng = SplitMix(rows as u64 ^ bytes.len() as u64);
    for i in 0..times {
        let mut copy = bytes.to_vec();
        for _ in 0..=rng.below(3) {
            // Half of them in the header, where most can go wrong.
            let at =
                if i % 2 == 0 { rng.below(copy.len().min(160)) } else { rng.below(copy.len()) };
            match rng.below(4) {
                0 => copy[at] = rng.next() as u8,
                1 => copy[at] ^= 1 << rng.below(8),
                2 => copy[at] = [0, 255][rng.below(2)],
                _ => copy.truncate(at + 1),
            }
        }
        if let Ok(loaded) = open(&copy) {
            let claimed = match &copy[..] {
                [b'N', b'G', b'S', b'P', ..] => {
                    u32::from_le_bytes(copy[8..12].try_into().unwrap()) as usize
                }
                _ => rows,
            };
            assert_eq!(loaded.source_rows(), claimed, "{name}, mutation {i}");
            let dropped = loaded.report.dropped_rows;
            assert_eq!(loaded.scene.len() + dropped, claimed, "{name}, mutation {i}");
            loaded.scene.check_rows().unwrap();
        }
    }
}

#[test]
fn damaged_files_give_errors_or_as_many_rows_as_they_say() {
    for (name, bytes) in small_files() {
        mutate(name, &bytes, 40, 2000);
        // Damage within the stream, behind its checksum.
        if name == "raw" {
            let mut rng = SplitMix(1);
            for i in 0..2000 {
                let mut body = bytes.clone();
                let at = if i % 2 == 0 { rng.below(16) } else { rng.below(body.len()) };
                body[at] ^= 1 << rng.below(8);
                let claimed = u32::from_le_bytes(body[8..12].try_into().unwrap()) as usize;
                for bytes in [gzip(&body), zstd::bulk::compress(&body, 1).unwrap()] {
                    if let Ok(loaded) = open(&bytes) {
                        assert_eq!(loaded.source_rows(), claimed);
                    }
                }
            }
        }
    }
    for name in ["minimal-raw", "minimal-v2", "minimal-v3", "minimal-v4"] {
        let Some(path) = shared(&format!("real/fixtures/{name}.spz")) else { continue };
        mutate(name, &std::fs::read(path).unwrap(), 4, 2000);
    }
    // Large enough for several threads and for streams of many blocks.
    for version in 2..=4 {
        let name = format!("real/parity/playbot_lod4.v{version}.spz");
        let Some(path) = shared(&name) else { continue };
        mutate(&name, &std::fs::read(path).unwrap(), 8406, 60);
    }
}
