//! Running sums, and lists.

use crate::clouds::{LENGTHS, numbers};
use crate::support::gpu;
use scenesplat_gpu::ops::lists::{compose, count_up, invert};
use scenesplat_gpu::ops::scan::running_sums;

/// Running sums and the sum of all, by one addition after the other.
fn sums(values: &[u32]) -> (Vec<u32>, u32) {
    let mut sum = 0u32;
    let before = values.iter().map(|value| {
        let before = sum;
        sum = sum.wrapping_add(*value);
        before
    });
    (before.collect(), sum)
}

#[test]
pub fn sums_are_those_of_the_values_before_at_every_length() {
    let Some(gpu) = gpu() else { return };
    for len in LENGTHS {
        let values: Vec<u32> = numbers(len, 1000, len as u64).iter().map(|v| *v as u32).collect();
        let mut commands = gpu.commands();
        let list = gpu.upload("values", &values).unwrap();
        let got = running_sums(&mut commands, &list).unwrap();
        let (before, total) = sums(&values);
        assert_eq!(commands.read(&got.before).unwrap(), before, "{len}");
        assert_eq!(commands.read(&got.total).unwrap(), [total], "{len}");
        assert_eq!(commands.read(&list).unwrap(), values, "the values stay");
    }
}

#[test]
fn three_levels_of_sums_wrap_around_and_are_the_same_twice() {
    let Some(gpu) = gpu() else { return };
    // 2048² values fill two levels.
    let len = 2048 * 2048 + 3;
    let values: Vec<u32> = (0..len as u32).map(|i| i.wrapping_mul(2_654_435_761)).collect();
    let list = gpu.upload("values", &values).unwrap();
    let (before, total) = sums(&values);
    for _ in 0..2 {
        let mut commands = gpu.commands();
        let got = running_sums(&mut commands, &list).unwrap();
        assert!(commands.read(&got.before).unwrap() == before);
        assert_eq!(commands.read(&got.total).unwrap(), [total]);
    }
}

#[test]
pub fn lists_are_counted_inverted_and_composed() {
    let Some(gpu) = gpu() else { return };
    for len in [0, 1, 2, 255, 256, 257, 65_537] {
        let mut commands = gpu.commands();
        let counted = count_up(&mut commands, len).unwrap();
        assert_eq!(commands.read(&counted).unwrap(), (0..len as u32).collect::<Vec<_>>());
        let list: Vec<u32> = (0..len).map(|i| (i * 7919 % len.max(1)) as u32).collect();
        let device = gpu.upload("a list", &list).unwrap();
        let inverse = invert(&mut commands, &device).unwrap();
        let there_and_back = compose(&mut commands, &inverse, &device).unwrap();
        assert_eq!(commands.read(&there_and_back).unwrap(), (0..len as u32).collect::<Vec<_>>());
        let values: Vec<u32> = numbers(len, 1 << 32, 5).iter().map(|v| *v as u32).collect();
        let picked = gpu.upload("values", &values).unwrap();
        let picked = compose(&mut commands, &picked, &device).unwrap();
        let want: Vec<u32> = list.iter().map(|i| values[*i as usize]).collect();
        assert_eq!(commands.read(&picked).unwrap(), want);
    }
}
