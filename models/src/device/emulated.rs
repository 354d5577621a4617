//! Tensors of the CPU as those of another device: so tests see what passes launch, what is composed of candle's operations
//! where there are no kernels, and what layers do away from the CPU.

use crate::ops::launches::{self, Launches};
use crate::scoped::with_value;
use candle_core::{Error, Result, Shape};
use scenesplat_device::Launcher;
use scenesplat_device::emulator::{Buffer, Emulator, EmulatorError};
use std::cell::RefCell;
use std::collections::BTreeMap;

/// The device that the CPU stands in for.
#[derive(Debug, Clone, Copy)]
pub enum EmulatedDevice {
    /// One with our kernels, as CUDA; they run on an emulated grid.
    Kernels(Emulator),
    /// One with candle's operations alone, as Metal; those are the CPU's.
    Tensors,
}

struct Emulated {
    device: EmulatedDevice,
    seen: BTreeMap<&'static str, usize>,
}

thread_local! {
    static EMULATED: RefCell<Option<Emulated>> = const { RefCell::new(None) };
}

/// Runs `work` as on a device: passes for which there are kernels are launched, or operations are composed of candle's;
/// weights are not packed, and what is candle's operation on any device is that here. Only on this thread. Gives the
/// passes that were launched too, or the operations that were composed, by name, and how often.
pub fn on_emulated_device<R>(
    device: EmulatedDevice,
    work: impl FnOnce() -> R,
) -> (R, BTreeMap<&'static str, usize>) {
    let emulated = Emulated { device, seen: BTreeMap::new() };
    let (done, left) = with_value(&EMULATED, emulated, work);
    (done, left.map(|e| e.seen).unwrap_or_default())
}

/// Whether this thread acts as if on a device.
pub fn is_emulated() -> bool {
    EMULATED.with_borrow(Option::is_some)
}

/// The grid, having noted a pass; `None` where there are no kernels.
fn begin(pass: &'static str) -> Option<Emulator> {
    EMULATED.with_borrow_mut(|active| match active.as_mut()? {
        Emulated { device: EmulatedDevice::Kernels(emulator), seen } => {
            *seen.entry(pass).or_default() += 1;
            Some(*emulator)
        }
        Emulated { device: EmulatedDevice::Tensors, .. } => None,
    })
}

/// Whether an operation is composed of candle's, which is noted.
pub(crate) fn composes(operation: &'static str) -> bool {
    EMULATED.with_borrow_mut(|active| match active {
        Some(Emulated { device: EmulatedDevice::Tensors, seen }) => {
            *seen.entry(operation).or_default() += 1;
            true
        }
        _ => false,
    })
}

/// Name of a type without its module and its parameters.
fn short(name: &'static str) -> &'static str {
    let name = name.split(['<', '>']).next().unwrap_or(name);
    name.rsplit("::").next().unwrap_or(name)
}

/// An array that a pass makes.
pub(crate) type Made = (Vec<f32>, Shape);

/// Launches a pass, if passes are launched on this thread.
pub(crate) fn run<const N: usize, P: Launches<N>>(
    inputs: [(&[f32], &[usize]); N],
    pass: &P,
) -> Result<Option<Vec<Made>>> {
    let Some(emulator) = begin(short(std::any::type_name::<P>())) else { return Ok(None) };
    let launch = || -> std::result::Result<Vec<Made>, EmulatorError> {
        let mut buffers: Vec<Buffer> = Vec::with_capacity(N);
        for (values, _) in inputs {
            buffers.push(emulator.upload_values(values)?);
        }
        let of = |i: usize| (&buffers[i], inputs[i].1);
        let made = pass.launch(&emulator, std::array::from_fn(of))?;
        let values = |(buffer, shape): (Buffer, Shape)| {
            Ok((emulator.download_values(&buffer, shape.elem_count())?, shape))
        };
        made.into_iter().map(values).collect()
    };
    launch().map(Some).map_err(Error::wrap)
}

/// Mean and biased variance of each channel, if passes are launched on this thread.
pub(crate) fn batch_statistics(x: &[f32], dims: &[usize]) -> Result<Option<(Vec<f64>, Vec<f64>)>> {
    let Some(emulator) = begin("batch_statistics") else { return Ok(None) };
    let launch = || -> std::result::Result<_, EmulatorError> {
        launches::batch_statistics(&emulator, (&emulator.upload_values(x)?, dims))
    };
    launch().map(Some).map_err(Error::wrap)
}
