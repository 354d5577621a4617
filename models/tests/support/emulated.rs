//! Comparisons once more as on other devices, and on the device that `SCENESPLAT_TEST_DEVICE` names.

use crate::support_device::{DEVICE, device};
use candle_core::Device;
use scenesplat_device::emulator::{Emulator, is_there};
use scenesplat_models::{DeviceChoice, EmulatedDevice, is_emulated, on_emulated_device};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

/// Whether a comparison runs, or acts as if it ran, elsewhere than on the CPU.
#[allow(dead_code, reason = "not all need it")]
pub fn elsewhere() -> bool {
    is_emulated() || !device().is_cpu()
}

/// Runs a comparison with its tensors on the device that is named, if one is.
pub fn on_named_device(work: fn()) {
    static OPENED: OnceLock<Device> = OnceLock::new();
    let Ok(name) = std::env::var("SCENESPLAT_TEST_DEVICE") else {
        println!("not run: SCENESPLAT_TEST_DEVICE names no device");
        return;
    };
    let open = || name.parse::<DeviceChoice>().unwrap().open().unwrap().device;
    let device = OPENED.get_or_init(open).clone();
    assert!(!device.is_cpu(), "{name} is where all other tests run");
    DEVICE.set(device);
    work();
    DEVICE.set(Device::Cpu);
}

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
/// are composed on one without. Each runs on the device that is named, too.
macro_rules! on_devices {
    ($($test:ident = $work:expr, kernels $passes:expr $(, tensors $operations:expr)?;)*) => {$(
        mod $test {
            #[allow(unused_imports, reason = "not all need all")]
            use super::*;

            #[test]
            fn kernels() {
                $crate::support_emulated::with_kernels($work, &$passes);
            }

            #[test]
            fn device() {
                $crate::support_emulated::on_named_device($work);
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
