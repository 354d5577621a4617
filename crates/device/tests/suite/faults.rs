//! The emulation notices what it is there for.

use crate::emulator::{Emulator, EmulatorError};
use scenesplat_device::ops::rows;
use scenesplat_device::{Items, KernelEntry, KernelModule, Launcher};

crate::support::on_grid! {
    missing_barriers_show_in_results
    threads_that_do_not_meet_are_told
    accesses_beside_arrays_are_told
    shared_memory_and_blocks_promise_nothing
    wrong_numbers_of_arguments_are_told
}

const ENTRIES: [KernelEntry; 9] = [
    faulty("reverse"),
    faulty("reverse_without_barrier"),
    faulty("half_at_the_barrier"),
    faulty("two_barriers"),
    faulty("lane_left_behind"),
    faulty("beyond_the_end"),
    faulty("beyond_the_tile"),
    faulty("left_from_before"),
    faulty("last_block_wins"),
];

/// Kernels with one fault each.
pub static FAULTS: KernelModule = KernelModule {
    name: "faults",
    source: concat!(include_str!("../../cuda/grid.h"), include_str!("faults.cu")),
    entries: &ENTRIES,
};

const fn faulty(name: &'static str) -> KernelEntry {
    KernelEntry::new("faults", name, 64, Items::PerThread)
}

/// What a kernel makes of 128 numbers, in two blocks.
fn run(name: &str, seed: u64) -> Result<Vec<u32>, EmulatorError> {
    let l = Emulator::with_modules(seed, std::slice::from_ref(&FAULTS));
    let kernel = FAULTS.entries.iter().find(|k| k.name == name).unwrap();
    let x = l.upload_values(&(0..128u32).collect::<Vec<_>>())?;
    let mut out = l.alloc_values::<u32>(128)?;
    l.run(kernel, 128, &[&x], &mut [&mut out], &[])?;
    l.download_values(&out, 128)
}

fn message(name: &str) -> String {
    run(name, 0).unwrap_err().to_string()
}

fn missing_barriers_show_in_results() {
    let want: Vec<u32> = (0..64).rev().chain((64..128).rev()).collect();
    for seed in 0..5 {
        assert_eq!(run("reverse", seed).unwrap(), want);
        assert_ne!(run("reverse_without_barrier", seed).unwrap(), want);
    }
    assert_ne!(
        run("reverse_without_barrier", 1).unwrap(),
        run("reverse_without_barrier", 2).unwrap()
    );
}

fn threads_that_do_not_meet_are_told() {
    let text = message("half_at_the_barrier");
    assert!(text.contains("is reached by 32 of 64 threads"), "{text}");
    let text = message("two_barriers");
    assert!(text.contains("waits at line"), "{text}");
    let text = message("lane_left_behind");
    assert!(text.contains("lanes wait for others of their warp"), "{text}");
    // The machine is as good as new afterwards.
    assert!(run("reverse", 0).is_ok());
}

fn accesses_beside_arrays_are_told() {
    let text = message("beyond_the_end");
    assert!(
        text.contains("block 1, thread 63") && text.contains("element 128 of an array of 128"),
        "{text}"
    );
    let text = message("beyond_the_tile");
    assert!(text.contains("thread 63") && text.contains("element 64 of an array of 64"), "{text}");
    let l = Emulator::new(0);
    let x = l.upload_values(&[1.0f32, 2.0, 3.0]).unwrap();
    let order = l.upload_values(&[0u32, 3, 1]).unwrap();
    let mut out = l.alloc_values::<f32>(3).unwrap();
    let error = rows::gather_rows(&l, &x, rows::Width::Four, 1, &order, 3, &mut out).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("gather_rows_4") && text.contains("element 3 of an array of 3"),
        "{text}"
    );
}

fn shared_memory_and_blocks_promise_nothing() {
    let left = run("left_from_before", 0).unwrap();
    assert!(left[..64].iter().copied().eq(0..64) && left[64..].iter().all(|&v| v == u32::MAX));
    let results: std::collections::BTreeSet<Vec<u32>> =
        (0..6).map(|seed| run("last_block_wins", seed).unwrap()).collect();
    assert_eq!(results.len(), 2, "blocks always run in one order");
}

fn wrong_numbers_of_arguments_are_told() {
    let l = Emulator::with_modules(0, std::slice::from_ref(&FAULTS));
    let x = l.upload_values(&[0u32; 64]).unwrap();
    let error = l.run(&ENTRIES[0], 64, &[&x], &mut [], &[]).unwrap_err().to_string();
    assert!(error.contains("takes 2 arguments, got 1"), "{error}");
}
