//! Sorting.

use crate::clouds::{LENGTHS, numbers};
use crate::support::gpu;
use scenesplat_gpu::ops::radix_sort::{Keys, argsort, sort};
use scenesplat_kernels::serialization;

#[test]
fn rows_are_in_the_order_that_the_cpu_gives_at_every_length() {
    let Some(gpu) = gpu() else { return };
    for len in LENGTHS {
        let keys = numbers(len, 1 << 63, len as u64);
        let mut commands = gpu.commands();
        let device = Keys::upload(&gpu, &keys).unwrap();
        assert_eq!((device.len(), device.is_empty()), (len, len == 0));
        let rows = argsort(&mut commands, &device, 63).unwrap();
        assert_eq!(commands.read(&rows).unwrap(), serialization::argsort(&keys), "{len}");
        assert_eq!(device.read(&mut commands).unwrap(), keys, "the keys stay");
    }
}

#[test]
fn every_number_of_bits_sorts_and_equal_keys_stay_as_they_are() {
    let Some(gpu) = gpu() else { return };
    for bits in [0, 1, 3, 7, 8, 9, 24, 30, 31, 32, 33, 39, 40, 41, 60, 63, 64] {
        // Few different keys, spread over all bits, so that most are there many times.
        let spread = |v: u64| match bits {
            0 => 0,
            _ => v.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - bits),
        };
        let keys: Vec<u64> = numbers(5000, 97, bits.into()).into_iter().map(spread).collect();
        let mut commands = gpu.commands();
        let device = Keys::upload(&gpu, &keys).unwrap();
        let sorted = sort(&mut commands, &device, None, bits).unwrap();
        let want = serialization::argsort(&keys);
        assert_eq!(commands.read(&sorted.rows).unwrap(), want, "{bits}");
        let in_order: Vec<u64> = want.iter().map(|row| keys[*row as usize]).collect();
        assert_eq!(sorted.keys.read(&mut commands).unwrap(), in_order, "{bits}");
    }
}

#[test]
pub fn rows_given_go_along_and_the_result_is_the_same_twice() {
    let Some(gpu) = gpu() else { return };
    let keys = numbers(20_000, 1 << 40, 3);
    let rows: Vec<u32> = (0..20_000).map(|i| i * 7 % 20_000 + 5).collect();
    let (device, list) = (Keys::upload(&gpu, &keys).unwrap(), gpu.upload("rows", &rows).unwrap());
    let want: Vec<u32> =
        serialization::argsort(&keys).iter().map(|place| rows[*place as usize]).collect();
    for _ in 0..2 {
        let mut commands = gpu.commands();
        let sorted = sort(&mut commands, &device, Some(&list), 40).unwrap();
        assert_eq!(commands.read(&sorted.rows).unwrap(), want);
    }
    // No bits: nothing moves.
    let mut commands = gpu.commands();
    let sorted = sort(&mut commands, &device, Some(&list), 0).unwrap();
    assert_eq!(commands.read(&sorted.rows).unwrap(), rows);
}

#[test]
fn keys_all_alike_and_keys_in_falling_order() {
    let Some(gpu) = gpu() else { return };
    for keys in [vec![(1 << 63) - 1; 3000], (0..3000).rev().map(|i| i << 33 | 5).collect()] {
        let mut commands = gpu.commands();
        let device = Keys::upload(&gpu, &keys).unwrap();
        let rows = argsort(&mut commands, &device, 64).unwrap();
        assert_eq!(commands.read(&rows).unwrap(), serialization::argsort(&keys));
    }
}

#[test]
fn few_bits_are_few_passes_and_bad_sizes_are_errors() {
    let Some(gpu) = gpu() else { return };
    let device = Keys::upload(&gpu, &numbers(300, 200, 1)).unwrap();
    let dispatches = |bits| {
        let mut commands = gpu.commands();
        argsort(&mut commands, &device, bits).unwrap();
        commands.dispatches()
    };
    // Counting, one sum, moving.
    assert_eq!([dispatches(8), dispatches(9), dispatches(63)], [3, 6, 24]);
    let mut commands = gpu.commands();
    assert!(argsort(&mut commands, &device, 65).is_err());
    let high = gpu.upload("keys", &[0u32; 299]).unwrap();
    let uneven = Keys { high: high.clone(), ..device.clone() };
    assert!(argsort(&mut commands, &uneven, 40).is_err());
    assert!(sort(&mut commands, &device, Some(&high), 8).is_err());
}
