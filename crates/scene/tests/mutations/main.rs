//! Ten thousand damaged copies of every small file: no panic, no greed, no wrong count.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

#[path = "../common/mod.rs"]
mod common;
mod counting_allocator;
mod counts;
mod fixtures;
mod mutate;
mod parts;

use common::SplitMix;
use counting_allocator::{Counting, peak_of};
use scenesplat_scene::{ReadOptions, open_scene_bytes};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Mutex;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const ROUNDS: u64 = 10_000;

/// What decoders may need whatever the file holds: windows, tables, buffers of blocks. The fixtures of
/// our own are larger than this in memory.
const DECODER_BYTES: usize = 128 << 10;

/// The allocator counts for the whole program, so one test at a time.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

#[test]
fn damaged_parts_of_scenes_do_no_harm() {
    let _alone = ONE_AT_A_TIME.lock();
    for part in parts::all() {
        assert!((part.open)(&part.bytes).is_some(), "{} does not open", part.name);
        let (_, honest) = peak_of(|| (part.open)(&part.bytes));
        let mut opened = 0;
        for seed in 0..ROUNDS {
            let bytes = mutate::mutated(&part.bytes, &mut SplitMix(seed));
            let about = || format!("{}, seed {seed}", part.name);
            let run = || peak_of(|| (part.open)(&bytes));
            let (result, peak) = catch_unwind(AssertUnwindSafe(run))
                .unwrap_or_else(|_| panic!("{}: a panic reached the caller", about()));
            let grown = bytes.len().max(part.bytes.len()) as f64 / part.bytes.len() as f64;
            let limit = (4.0 * grown * honest as f64) as usize + DECODER_BYTES;
            assert!(peak <= limit, "{}: {peak} bytes of memory, {limit} are fair", about());
            opened += usize::from(result.is_some());
        }
        println!("{}: {ROUNDS} mutations, {opened} opened", part.name);
    }
}

#[test]
fn damaged_files_are_refused_or_read_with_the_right_count() {
    let _alone = ONE_AT_A_TIME.lock();
    for fixture in fixtures::all() {
        let path = Path::new(&fixture.name);
        let open = |bytes: &[u8]| open_scene_bytes(bytes, path, &ReadOptions::default());
        // Once without counting: the first call of a decoder fills its tables.
        let first = open(&fixture.bytes).unwrap_or_else(|e| panic!("{}: {e}", fixture.name));
        assert_eq!(first.kind.name(), fixture.kind, "{}", fixture.name);
        assert_eq!(counts::claimed(fixture.kind, &fixture.bytes), Some(first.source_rows()));
        let (_, honest) = peak_of(|| open(&fixture.bytes).map(drop));
        let (mut opened, mut largest) = (0, 0);
        for seed in 0..ROUNDS {
            let bytes = mutate::mutated(&fixture.bytes, &mut SplitMix(seed));
            let about = || format!("{}, seed {seed}", fixture.name);
            let run = || peak_of(|| open(&bytes));
            let (result, peak) = catch_unwind(AssertUnwindSafe(run))
                .unwrap_or_else(|_| panic!("{}: a panic reached the caller", about()));
            // Damage may make the file longer, and then it honestly holds more.
            let grown = bytes.len().max(fixture.bytes.len()) as f64 / fixture.bytes.len() as f64;
            let limit = (4.0 * grown * honest as f64) as usize + DECODER_BYTES;
            assert!(peak <= limit, "{}: {peak} bytes of memory, {limit} are fair", about());
            largest = largest.max(peak);
            let Ok(loaded) = result else { continue };
            opened += 1;
            loaded.scene.check_rows().unwrap_or_else(|e| panic!("{}: {e}", about()));
            let kept = loaded.scene.len() + loaded.report.dropped_rows;
            assert_eq!(kept, loaded.source_rows(), "{}", about());
            // Damage to the magic can turn a file into one of another format.
            if loaded.kind.name() == fixture.kind {
                let claimed = counts::claimed(fixture.kind, &bytes);
                assert_eq!(claimed, Some(loaded.source_rows()), "{}", about());
            }
        }
        println!(
            "{}: {ROUNDS} mutations, {opened} opened, {honest} bytes honestly, {largest} at most",
            fixture.name
        );
    }
}
