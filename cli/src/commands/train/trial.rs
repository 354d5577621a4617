//! `train --fast-dev-run` and `train --lr-find`

use super::{Args, ranks, watch};
use crate::error::refuse;
use crate::progress::listen_for_interrupt;
use crate::terminal::print;
use anyhow::Result;
use candle_core::Device;
use scenesplat::experiment::{ExperimentConfig, search_lr};
use scenesplat::trainers::LrFinderConfig;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;

/// Trains and evaluates a little.
pub(super) fn try_out(
    args: &Args,
    config: &ExperimentConfig,
    batches: NonZeroUsize,
    device: &Device,
) -> Result<()> {
    alone("--fast-dev-run", device)?;
    listen_for_interrupt()?;
    let stop = Arc::default();
    watch(Arc::clone(&stop));
    let batches = batches.get();
    let report = scenesplat::experiment::try_out(config, batches, device, args.console(), stop)?;
    report.remarks.iter().for_each(|remark| print(remark));
    let used = report.steps * report.accumulate;
    let evaluations = match report.evaluations.as_slice() {
        [] => "no evaluation".to_owned(),
        names => format!("{batches} scenes at most of {}", names.join(", ")),
    };
    print(&format!("--fast-dev-run: {used} batches in {} steps, {evaluations}", report.steps));
    print("nothing was written: leave the flag out to train");
    Ok(())
}

/// Looks for a learning rate.
pub(super) fn search(
    config: &ExperimentConfig,
    steps: u64,
    device: &Device,
    out: &Path,
) -> Result<()> {
    alone("--lr-find", device)?;
    let settings = LrFinderConfig { steps, ..LrFinderConfig::default() };
    let report = search_lr(config, &settings, device, out)?;
    report.remarks.iter().for_each(|remark| print(remark));
    let curve = &report.curve;
    if let Some(last) = curve.points.last().filter(|_| curve.diverged) {
        let taken = curve.points.len();
        print(&format!(
            "the loss grew at a rate of {:.2e}, after {taken} of {steps} steps",
            last.lr
        ));
    }
    match curve.suggestion {
        Some(rate) => print(&format!(
            "learning rate: {rate:.2e}, where the loss falls the most (the file has {:.2e}); \
             to use it: --set optimizer.lr={rate:.2e}",
            config.optimizer.lr
        )),
        None => {
            print("learning rate: none to suggest, for the loss does not fall; look at the curve");
        }
    }
    print(&format!("curve: {} and {}", report.picture.display(), report.table.display()));
    Ok(())
}

/// Refuses to be one of several processes.
fn alone(flag: &str, device: &Device) -> Result<()> {
    let size = ranks::start(device)?.size();
    if size > 1 {
        refuse!("{flag}: is for one process, and {size} were started; run it without the launcher");
    }
    Ok(())
}
