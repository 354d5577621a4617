//! What a program says about devices.

use scenesplat_kernels::fallbacks::{Fallback, Pass};

/// A line on what was computed on the CPU for a device: which pass of which operation, and how often.
pub fn on_the_cpu(fallback: &Fallback) -> String {
    let pass = match fallback.pass {
        Pass::Forward => "forward",
        Pass::Backward => "backward",
    };
    format!(
        "on the cpu, as the device has no kernel for it: {} {pass}, {} times",
        fallback.operation, fallback.times
    )
}
