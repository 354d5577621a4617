//! Comparisons once more as on other devices, and on the device that `SCENESPLAT_TEST_DEVICE` names.

use candle_core::Device;
use scenesplat_device::emulator::{Emulator, is_there};
use scenesplat_kernels::fallbacks::Pass;
use scenesplat_models::{DeviceChoice, is_emulated, on_emulated_device};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::sync::OnceLock;

thread_local! {
    static DEVICE: RefCell<Device> = const { RefCell::new(Device::Cpu) };
}

/// Where a comparison puts its tensors and weights: on the CPU, unless one runs on the device that is named.
pub fn here() -> Device {
    DEVICE.with_borrow(Device::clone)
}

/// Whether a comparison runs, or acts as if it ran, elsewhere than on the CPU.
pub fn elsewhere() -> bool {
    is_emulated() || !here().is_cpu()
}

/// Runs a comparison with its tensors on the device that is named, if one is.
pub fn device(work: fn(), _: &str) {
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

/// Runs a comparison as on CUDA, with the threads of each block in order and in a shuffled order. The kernels of these
/// operations, and of no others, must be launched: forward and backward, of those that end with `>` forward alone.
pub fn kernels(work: fn(), operations: &str) {
    if !is_there() {
        return;
    }
    let mut expected = BTreeSet::new();
    for operation in operations.split_whitespace() {
        let name = operation.trim_end_matches('>');
        expected.insert((name, Pass::Forward));
        if !operation.contains('>') {
            expected.insert((name, Pass::Backward));
        }
    }
    for seed in [0, 0x5eed] {
        let ((), launched) = on_emulated_device(Emulator::new(seed), work);
        println!("launched: {launched:?}");
        assert_eq!(launched.into_keys().collect::<BTreeSet<_>>(), expected);
    }
}

/// Names tests, the comparisons that they run, their operations, and on which devices: `kernels` (emulated, with our
/// kernels), `device` (the one that is named).
macro_rules! on_devices {
    ($($test:ident = $work:expr, $operations:expr, [$($device:ident)*];)*) => {$(
        mod $test {
            #[allow(unused_imports, reason = "not all need all")]
            use super::*;

            $(#[test]
            fn $device() {
                $crate::support::devices::$device($work, $operations);
            })*
        }
    )*};
}
pub(crate) use on_devices;
