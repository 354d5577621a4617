//! Where comparisons compute: on the CPU, unless one runs on the device that is named.

use candle_core::Device;
use std::cell::RefCell;

thread_local! {
    #[allow(dead_code, reason = "not all need it")]
    pub static DEVICE: RefCell<Device> = const { RefCell::new(Device::Cpu) };
}

/// Where a comparison puts its tensors and weights.
pub fn device() -> Device {
    DEVICE.with_borrow(Device::clone)
}
