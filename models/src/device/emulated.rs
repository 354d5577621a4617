//! Tensors of the CPU as those of another device, whose kernels run on an emulated grid: tests see which passes launch
//! kernels, and what layers do away from the CPU.

use super::launches::{self, Launches};
use crate::scoped::with_value;
use candle_core::{Error, Result, Shape};
use scenesplat_device::Launcher;
use scenesplat_device::emulator::{Buffer, Emulator, EmulatorError};
use scenesplat_kernels::fallbacks::Pass;
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Operations with their passes, and how often each ran.
type Counts = BTreeMap<(&'static str, Pass), usize>;

struct Emulated {
    emulator: Emulator,
    seen: Counts,
}

thread_local! {
    static EMULATED: RefCell<Option<Emulated>> = const { RefCell::new(None) };
}

/// Runs `work` as on a device, on this thread only: passes with kernels are launched, and weights are not packed. Gives the
/// passes that were launched, and how often.
pub fn on_emulated_device<R>(emulator: Emulator, work: impl FnOnce() -> R) -> (R, Counts) {
    let emulated = Emulated { emulator, seen: BTreeMap::new() };
    let (done, left) = with_value(&EMULATED, emulated, work);
    (done, left.map(|e| e.seen).unwrap_or_default())
}

/// Whether this thread acts as if on a device.
pub fn is_emulated() -> bool {
    EMULATED.with_borrow(Option::is_some)
}

/// The grid of this thread, if it acts as if on a device.
fn emulator() -> Option<Emulator> {
    EMULATED.with_borrow(|active| active.as_ref().map(|e| e.emulator))
}

/// Counts a pass, if this thread acts as if on a device.
fn note(pass: (&'static str, Pass)) {
    EMULATED.with_borrow_mut(|active| {
        if let Some(emulated) = active {
            *emulated.seen.entry(pass).or_default() += 1;
        }
    });
}

/// Values with their shape.
type Values = (Vec<f32>, Shape);

/// Launches a pass, if passes are launched on this thread and there is a kernel.
pub(crate) fn run(
    inputs: &[(&[f32], &[usize])],
    pass: &impl Launches,
) -> Result<Option<Vec<Values>>> {
    let Some(emulator) = emulator() else { return Ok(None) };
    let launch = || -> std::result::Result<_, EmulatorError> {
        let mut buffers: Vec<Buffer> = Vec::with_capacity(inputs.len());
        for (values, _) in inputs {
            buffers.push(emulator.upload_values(values)?);
        }
        let inputs: Vec<_> = buffers.iter().zip(inputs).map(|(b, (_, dims))| (b, *dims)).collect();
        let Some(made) = pass.launch(&emulator, &inputs)? else { return Ok(None) };
        let mut found = Vec::with_capacity(made.len());
        for (buffer, shape) in made {
            found.push((emulator.download_values(&buffer, shape.elem_count())?, shape));
        }
        Ok(Some(found))
    };
    let made = launch().map_err(Error::wrap)?;
    if made.is_some() {
        note(pass.name());
    }
    Ok(made)
}

/// Mean and biased variance of each channel, if passes are launched on this thread.
pub(crate) fn batch_statistics(x: &[f32], dims: &[usize]) -> Result<Option<(Vec<f64>, Vec<f64>)>> {
    let Some(emulator) = emulator() else { return Ok(None) };
    note(("batch_statistics", Pass::Forward));
    let x = emulator.upload_values(x).map_err(Error::wrap)?;
    launches::batch_statistics(&emulator, (&x, dims)).map(Some).map_err(Error::wrap)
}
