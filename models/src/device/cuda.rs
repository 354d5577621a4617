//! Opening a CUDA device: libraries, driver, kernels of candle's own operations.

use super::{DeviceChoice, DeviceError, OpenDevice};
use candle_core::Device;
use candle_core::cuda_backend::{cudarc, kernels};
use cudarc::{cublas, curand, driver};
use rayon::prelude::*;
use scenesplat_device::KernelModule;
use scenesplat_device::nvrtc::{Architecture, Cache, compile};
use std::sync::{Mutex, PoisonError};

/// Where a library comes from.
const DRIVER: &str = "install NVIDIA's driver";
const TOOLKIT: &str = "install it with CUDA 12 or newer (it is in the Python packages of NVIDIA too) and name its folder in \
                       LD_LIBRARY_PATH";

/// Looks for the libraries that cudarc loads: it panics where one is missing.
fn libraries(device: &DeviceChoice) -> Result<(), DeviceError> {
    // SAFETY: opening a library runs its initialisers; those of these three have no demands.
    let found = unsafe {
        [
            ("libcuda (the driver)", DRIVER, driver::sys::is_culib_present()),
            ("libcublas (matrix products)", TOOLKIT, cublas::sys::is_culib_present()),
            (
                "libcurand (random numbers, which candle asks for)",
                TOOLKIT,
                curand::sys::is_culib_present(),
            ),
        ]
    };
    match found.into_iter().find(|(_, _, present)| !present) {
        Some((library, help, _)) => {
            Err(DeviceError::NoLibrary { device: device.clone(), library, help })
        }
        None => Ok(()),
    }
}

/// What the driver says of an error.
fn said(error: driver::DriverError) -> String {
    let name = error.error_name().map_or("unknown error".into(), |name| name.to_string_lossy());
    match error.error_string() {
        Ok(text) => format!("the driver says: {} ({name})", text.to_string_lossy()),
        Err(_) => format!("the driver says: {name}"),
    }
}

pub(super) fn open(device: &DeviceChoice, number: usize) -> Result<OpenDevice, DeviceError> {
    libraries(device)?;
    let unusable = |error| DeviceError::Unusable { device: device.clone(), problem: said(error) };
    let count = driver::CudaContext::device_count().map_err(unusable)?;
    if usize::try_from(count).map_or(true, |count| number >= count) {
        let problem = match count {
            0 => "the driver knows no device".to_owned(),
            1 => "the driver knows one device, cuda:0".to_owned(),
            n => format!("the driver knows {n} devices, cuda:0 to cuda:{}", n - 1),
        };
        return Err(DeviceError::Unusable { device: device.clone(), problem });
    }
    let context = driver::CudaContext::new(number).map_err(unusable)?;
    let capability = context.compute_capability().map_err(unusable)?;
    let name = context.name().map_err(unusable)?;
    provide(device, capability)?;
    // A stream of its own, not one for each thread: tensors are made in one and used in another.
    let opened = Device::new_cuda_with_stream(number);
    let opened = opened
        .map_err(|e| DeviceError::Unusable { device: device.clone(), problem: e.to_string() })?;
    Ok(OpenDevice::of_tensors(opened, name))
}

/// Makes candle's kernels ready for this capability, once in a process. Those of our own operations follow when they are
/// first used.
fn provide(device: &DeviceChoice, (major, minor): (i32, i32)) -> Result<(), DeviceError> {
    // Two threads that open devices would compile twice.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let architecture = Architecture { major: major.unsigned_abs(), minor: minor.unsigned_abs() };
    let cache = Cache::of_user();
    // Seconds each where they are not in the cache yet.
    kernels::TEXTS.par_iter().filter(|(id, _)| !kernels::is_provided(*id)).try_for_each(
        |(id, source)| {
            let module = KernelModule { name: id.name(), source, entries: &[] };
            let compiled = compile(&module, architecture, &cache);
            let compiled = compiled.map_err(|e| DeviceError::Kernels {
                device: device.clone(),
                problem: e.to_string(),
            })?;
            kernels::provide(*id, compiled.ptx);
            Ok(())
        },
    )
}
