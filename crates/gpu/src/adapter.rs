//! Which graphics processors there are, and opening one.

use crate::error::{GpuError, Result};
use std::fmt;

/// Which graphics processor is meant.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub enum Choice {
    /// The one that the system prefers for computing: discrete before integrated before software.
    #[default]
    Best,
    /// Of this number in [`adapters`].
    Number(usize),
    /// Whose name contains this text, whatever the case.
    Named(String),
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Best => f.write_str("gpu"),
            Self::Number(number) => write!(f, "gpu:{number}"),
            Self::Named(name) => write!(f, "gpu:{name}"),
        }
    }
}

/// A graphics processor as the system lists it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterInfo {
    /// Its name.
    pub name: String,
    /// The interface: vulkan, metal or dx12.
    pub interface: String,
    /// Driver and version, as it says.
    pub driver: String,
    /// Whether it is a program on the CPU.
    pub software: bool,
    /// Whether it computes with 16-bit floating-point numbers.
    pub f16: bool,
    /// The largest array that a kernel can read, bytes.
    pub largest_array: u64,
}

impl fmt::Display for AdapterInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.name, self.interface)
    }
}

/// An adapter with its rank for computing: lower is better.
pub(crate) struct Found {
    pub adapter: wgpu::Adapter,
    pub info: AdapterInfo,
    rank: usize,
}

/// All graphics processors that the system lists, the best for computing first; an empty list without a driver.
pub fn adapters() -> Vec<AdapterInfo> {
    found().into_iter().map(|found| found.info).collect()
}

fn found() -> Vec<Found> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    // Validation layers belong to debugging of drivers.
    descriptor.flags = wgpu::InstanceFlags::empty();
    let instance = wgpu::Instance::new(descriptor);
    let list = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let mut found: Vec<Found> = list.into_iter().map(describe).collect();
    found.sort_by_key(|found| found.rank);
    found
}

fn describe(adapter: wgpu::Adapter) -> Found {
    let info = adapter.get_info();
    let limits = adapter.limits();
    let rank = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    let driver = [info.driver.as_str(), info.driver_info.as_str()].join(" ").trim().to_owned();
    let info = AdapterInfo {
        name: info.name,
        interface: info.backend.to_str().to_owned(),
        driver,
        software: info.device_type == wgpu::DeviceType::Cpu,
        f16: adapter.features().contains(wgpu::Features::SHADER_F16),
        largest_array: largest_array(&limits),
    };
    Found { adapter, info, rank }
}

/// The largest array that a kernel can read.
pub(crate) fn largest_array(limits: &wgpu::Limits) -> u64 {
    let allowed = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    // Kernels count values and bytes in 32 bits, and buffers have multiples of 16 bytes.
    allowed.min(u32::MAX.into()) & !15
}

/// The adapter that is meant.
pub(crate) fn find(choice: &Choice) -> Result<Found> {
    pick(found(), choice, |found| &found.info)
}

/// The one of a list, best first, that is meant.
fn pick<T>(mut list: Vec<T>, choice: &Choice, info: impl Fn(&T) -> &AdapterInfo) -> Result<T> {
    if list.is_empty() {
        let why = "the system lists none (a driver for Vulkan, Metal or Direct3D 12 is needed)";
        return Err(GpuError::NoAdapter(why.to_owned()));
    }
    let number = match choice {
        Choice::Best => Some(0),
        Choice::Number(number) => Some(*number),
        Choice::Named(name) => {
            let name = name.to_lowercase();
            list.iter().position(|found| info(found).name.to_lowercase().contains(&name))
        }
    };
    match number.filter(|number| *number < list.len()) {
        Some(number) => Ok(list.swap_remove(number)),
        None => {
            let asked = match choice {
                Choice::Named(name) => name.clone(),
                Choice::Number(number) => number.to_string(),
                Choice::Best => String::new(),
            };
            let there = list.iter().enumerate();
            let there: Vec<String> =
                there.map(|(number, found)| format!("{number}: {}", info(found))).collect();
            Err(GpuError::NotFound { asked, there: there.join(", ") })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str) -> AdapterInfo {
        AdapterInfo {
            name: name.to_owned(),
            interface: "vulkan".to_owned(),
            driver: String::new(),
            software: false,
            f16: true,
            largest_array: 1 << 27,
        }
    }

    #[test]
    fn an_adapter_is_found_by_number_or_by_a_part_of_its_name() {
        let list = || vec![named("NVIDIA H200"), named("llvmpipe (LLVM 15)")];
        let pick = |choice| pick(list(), &choice, |info| info).map(|info| info.name);
        assert_eq!(pick(Choice::Best).unwrap(), "NVIDIA H200");
        assert_eq!(pick(Choice::Number(1)).unwrap(), "llvmpipe (LLVM 15)");
        assert_eq!(pick(Choice::Named("LLVMPIPE".to_owned())).unwrap(), "llvmpipe (LLVM 15)");
        let error = pick(Choice::Number(2)).unwrap_err().to_string();
        assert_eq!(
            error,
            "no graphics processor \"2\"; there are: 0: NVIDIA H200 (vulkan), 1: llvmpipe (LLVM 15) (vulkan)"
        );
        assert!(
            pick(Choice::Named("radeon".to_owned())).unwrap_err().to_string().contains("radeon")
        );
        let none = super::pick(Vec::<AdapterInfo>::new(), &Choice::Best, |info| info);
        assert!(none.unwrap_err().to_string().contains("driver"));
    }
}
