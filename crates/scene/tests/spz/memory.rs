//! How much memory files make the reader reserve.

use crate::common::random_scene;
use crate::hostile::{header, open, problem, replace_stream, small_files};
use crate::{gunzip, gzip, write};
use scenesplat_scene::formats::spz::write_spz;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{LoadedScene, SceneError, WriteOptions};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::io::Write;

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

/// A zstd frame of `first` and then zeros, `size` bytes together, which says so: four bytes for
/// each 128 KiB, the most that the format can do.
fn frame_of_zeros(first: &[u8], size: u64) -> Vec<u8> {
    let block = |out: &mut Vec<u8>, kind: u32, size: u64, last: bool| {
        let head = (size as u32) << 3 | kind << 1 | u32::from(last);
        out.extend_from_slice(&head.to_le_bytes()[..3]);
    };
    // Eight bytes of size, then a window of 128 KiB.
    let mut out = vec![0x28, 0xb5, 0x2f, 0xfd, 0xc0, 7 << 3];
    out.extend_from_slice(&size.to_le_bytes());
    if !first.is_empty() {
        block(&mut out, 0, first.len() as u64, false);
        out.extend_from_slice(first);
    }
    let mut left = size - first.len() as u64;
    while left > 0 {
        let run = left.min(128 << 10);
        left -= run;
        block(&mut out, 1, run, left == 0);
        out.push(0);
    }
    out
}

/// A file of version 4 in which every byte of every Gaussian is 0.
fn v4_of_zeros(rows: u32, degree: u8) -> Vec<u8> {
    let rest = 3 * ((u64::from(degree) + 1).pow(2) - 1);
    let widths: Vec<u64> = [9, 1, 3, 3, 4, rest].into_iter().filter(|&w| w > 0).collect();
    let mut out = header(4, rows, degree);
    out[15] = widths.len() as u8;
    out.extend_from_slice(&32u32.to_le_bytes());
    out.resize(32, 0);
    let sizes = widths.iter().map(|width| u64::from(rows) * width);
    let frames: Vec<Vec<u8>> = sizes.clone().map(|size| frame_of_zeros(&[], size)).collect();
    for (frame, size) in frames.iter().zip(sizes) {
        out.extend_from_slice(&(frame.len() as u64).to_le_bytes());
        out.extend_from_slice(&size.to_le_bytes());
    }
    [out, frames.concat()].concat()
}

#[test]
fn what_would_expand_beyond_belief_is_refused_whatever_it_is_wrapped_in() {
    let legacy = |rows: u32| {
        let head = header(3, rows, 3);
        frame_of_zeros(&head, 16 + 65 * u64::from(rows))
    };
    let mut zeros = header(3, 1 << 20, 3);
    zeros.resize(16 + (64 << 20), 0);
    let files = [
        ("v4", v4_of_zeros(2_000_000, 3), 2_000_000),
        ("v4", v4_of_zeros(20_000_000, 3), 20_000_000),
        ("zstd", legacy(2_000_000), 2_000_000),
        ("zstd", legacy(20_000_000), 20_000_000),
        ("gzip", gzip(&zeros), 1 << 20),
    ];
    for (name, bytes, rows) in files {
        let (result, peak) = peak_of(&bytes);
        let text = result.unwrap_err().to_string();
        let size = bytes.len();
        assert!(text.contains(&format!("claims {rows} Gaussians")), "{name} of {size}: {text}");
        assert!(peak < 1 << 20, "{name} of {size} bytes: {peak} bytes reserved");
    }
    // As many zeros as a small scene has are a scene.
    for bytes in [v4_of_zeros(100_000, 3), legacy(100_000)] {
        assert_eq!(open(&bytes).unwrap().scene.len(), 100_000, "{} bytes", bytes.len());
    }
}

#[test]
fn a_scene_of_equal_gaussians_opens_if_it_is_small_and_is_not_written_if_not() {
    let one = random_scene(1, 3, 3);
    let scene = one.select_rows(&vec![0; 100_000]).unwrap();
    for version in 2..=4 {
        let bytes = write(&scene, version);
        let back = open(&bytes).unwrap().scene;
        assert_eq!(back.len(), 100_000, "version {version} of {} bytes", bytes.len());
        assert!(back.coord.iter().all(|p| *p == back.coord[0]));
    }
    // Nothing is written that cannot be read again.
    let scene = one.select_rows(&vec![0; 600_000]).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.spz");
    let result = write_spz(&scene, &path, &WriteOptions::default(), &mut |_| true);
    let text = result.unwrap_err().to_string();
    assert!(text.contains("600000 Gaussians"), "{text}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn one_block_may_be_constant_without_saying_how_long_it_is() {
    let mut scene = random_scene(40_000, 3, 5);
    scene.sh_rest.fill(0.0);
    let file = write(&scene, 4);
    let mut to = zstd::stream::Encoder::new(Vec::new(), 3).unwrap();
    to.include_contentsize(false).unwrap();
    to.write_all(&vec![128; 40_000 * 45]).unwrap();
    let bytes = replace_stream(&file, 5, &to.finish().unwrap());
    assert_eq!(open(&bytes).unwrap().scene, open(&file).unwrap().scene);
}

#[test]
fn labels_of_one_gaussian_are_small() {
    let plain = write(&random_scene(1, 0, 3), 4);
    let payload = frame_of_zeros(&[], 50 << 20);
    let mut bytes = plain[..32].to_vec();
    bytes[14] |= 2;
    bytes[16..20].copy_from_slice(&(40 + payload.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&0x5353_0001u32.to_le_bytes());
    bytes.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&payload);
    bytes.extend_from_slice(&plain[32..]);
    let (result, peak) = peak_of(&bytes);
    let text = result.unwrap_err().to_string();
    assert!(text.contains("labels hold 52428800 bytes"), "{text}");
    assert!(peak < 1 << 20, "{peak}");
}

#[test]
fn memory_follows_what_a_stream_delivers() {
    // 9 MB of equal Gaussians in a KiB: within what any file may hold, but nothing to reserve memory
    // for at once.
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
    body.truncate(16 << 20);
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
