//! Comparisons once more as on other devices.

use scenesplat_device::emulator::{Emulator, is_there};
use scenesplat_models::{EmulatedDevice, on_emulated_device};
use std::collections::{BTreeMap, BTreeSet};

/// Runs a comparison as on CUDA, with the threads of each block in order and in a shuffled order; these passes, and no
/// others, have to be launched.
pub fn with_kernels(work: fn(), passes: &[&str]) {
    if !is_there() {
        return;
    }
    for seed in [0, 0x5eed] {
        let device = EmulatedDevice::Kernels(Emulator::new(seed));
        let ((), launched) = on_emulated_device(device, work);
        println!("launched: {launched:?}");
        compare(&launched, passes);
    }
}

/// Runs a comparison as on Metal; these operations, and no others, have to be composed of candle's.
pub fn with_tensors(work: fn(), operations: &[&str]) {
    let ((), composed) = on_emulated_device(EmulatedDevice::Tensors, work);
    println!("composed: {composed:?}");
    compare(&composed, operations);
}

fn compare(seen: &BTreeMap<&'static str, usize>, expected: &[&str]) {
    let seen: BTreeSet<&str> = seen.keys().copied().collect();
    let expected: BTreeSet<&str> = expected.iter().flat_map(|s| s.split_whitespace()).collect();
    assert_eq!(seen, expected);
}

/// Names tests, the comparisons that they run, the passes that these launch on a device with kernels, and the operations that
/// are composed on one without.
macro_rules! on_devices {
    ($($test:ident = $work:expr, kernels $passes:expr $(, tensors $operations:expr)?;)*) => {$(
        mod $test {
            #[allow(unused_imports, reason = "not all need all")]
            use super::*;

            #[test]
            fn kernels() {
                $crate::support_emulated::with_kernels($work, &$passes);
            }
            $(
                #[test]
                fn tensors() {
                    $crate::support_emulated::with_tensors($work, &$operations);
                }
            )?
        }
    )*};
}
pub(crate) use on_devices;
