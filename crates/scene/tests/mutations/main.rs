//! Damaged copies of every small file, and files that claim much: no panic, little memory, no wrong
//! count. A program of its own because its allocator counts what the whole process holds.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

#[path = "../common/mod.rs"]
mod common;
mod counting_allocator;
mod counts;
mod fixtures;
mod mutate;
mod parts;
mod sog;
mod spz;

use common::SplitMix;
use counting_allocator::{Counting, peak_of};
use fixtures::Fixture;
use scenesplat_scene::{LoadedScene, ReadOptions, open_scene_bytes};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Mutex;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Damaged copies of each file; `.ci/optional fuzz` makes more.
const ROUNDS: u64 = 200;

/// What decoders may need whatever the file holds: windows, tables, buffers of blocks. The fixtures of
/// our own are larger than this in memory.
const DECODER_BYTES: usize = 128 << 10;

/// The allocator counts for the whole program, so one test at a time.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Opens damaged copies of `bytes`, checks that each needs a fair amount of memory and gives `check` those
/// that opened. The first call of a decoder fills its tables, so it is not counted.
fn damage<T>(
    name: &str,
    bytes: &[u8],
    open: impl Fn(&[u8]) -> Option<T>,
    check: impl Fn(&[u8], T, &str),
) {
    assert!(open(bytes).is_some(), "{name} does not open");
    let (_, honest) = peak_of(|| open(bytes));
    let (mut opened, mut largest) = (0, 0);
    for seed in 0..ROUNDS {
        let damaged = mutate::mutated(bytes, &mut SplitMix(seed));
        let about = format!("{name}, seed {seed}");
        let run = || peak_of(|| open(&damaged));
        let (result, peak) = catch_unwind(AssertUnwindSafe(run))
            .unwrap_or_else(|_| panic!("{about}: a panic reached the caller"));
        // Damage may make the file longer, and then it honestly holds more.
        let grown = damaged.len().max(bytes.len()) as f64 / bytes.len() as f64;
        let limit = (4.0 * grown * honest as f64) as usize + DECODER_BYTES;
        assert!(peak <= limit, "{about}: {peak} bytes of memory, {limit} are fair");
        largest = largest.max(peak);
        if let Some(result) = result {
            opened += 1;
            check(&damaged, result, &about);
        }
    }
    println!("{name}: {opened} of {ROUNDS} opened, {honest} bytes honestly, {largest} at most");
}

#[test]
fn damaged_parts_of_scenes_do_no_harm() {
    let _alone = ONE_AT_A_TIME.lock();
    let folder = tempfile::tempdir().unwrap();
    for part in parts::all(folder.path()) {
        damage(&part.name, &part.bytes, &part.open, |_, _, _| {});
    }
}

#[test]
fn damaged_files_are_refused_or_read_with_the_right_count() {
    let _alone = ONE_AT_A_TIME.lock();
    for Fixture { name, kind, bytes } in fixtures::all() {
        let path = Path::new(&name);
        let open = |bytes: &[u8]| open_scene_bytes(bytes, path, &ReadOptions::default());
        let first = open(&bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(first.kind.name(), kind, "{name}");
        assert_eq!(counts::claimed(kind, &bytes), Some(first.source_rows()), "{name}");
        damage(
            &name,
            &bytes,
            |bytes| open(bytes).ok(),
            |bytes, loaded: LoadedScene, about| {
                loaded.scene.check_rows().unwrap_or_else(|e| panic!("{about}: {e}"));
                let kept = loaded.scene.len() + loaded.report.dropped_rows;
                assert_eq!(kept, loaded.source_rows(), "{about}");
                // Damage to the magic can turn a file into one of another format.
                if loaded.kind.name() == kind {
                    assert_eq!(counts::claimed(kind, bytes), Some(loaded.source_rows()), "{about}");
                }
            },
        );
    }
}
