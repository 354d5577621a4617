//! `scenesplat pareto`

mod args;
mod calibrate;
mod campaign;
mod estimate;
mod explore;
mod inputs;
mod neutral;
mod point;
mod request;
mod tell;

use crate::bench::Stopped;
use crate::bench::process::Scratch;
use crate::commands::WrongUse;
use crate::progress::{Progress, listen_for_interrupt};
use crate::terminal::print;
use anyhow::{Context, Result, anyhow, bail};
pub use args::Args;
use campaign::{Campaign, this_machine};
use explore::explore;
pub use point::{PointArgs, run_point};
use scenesplat::scene::{FolderLock, printable};
use scenesplat_lab::pareto::{
    Around, Grid, Record, Records, Summary, TrainingCurve, compare, write_report,
};
use std::cell::{Cell, RefCell};
use std::time::Instant;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let began = Instant::now();
    let _ = listen_for_interrupt();
    if args.calibrate {
        return calibrate::calibrate(args);
    }
    let grid = match &args.grid {
        Some(path) => Grid::read(path),
        None => Grid::default_grid(),
    };
    let grid = grid.map_err(|e| WrongUse(e.to_string()))?;
    let settings = grid.settings().map_err(|e| WrongUse(e.to_string()))?;
    let neutral = neutral::rows(&grid.neutral)?;
    let runs = args.training.iter().chain(&grid.training);
    let mut training = Vec::new();
    for run in runs {
        training.push(TrainingCurve::read(run)?);
    }
    // Before anything is measured, and before it is overwritten if it is the same file.
    let before = args.against.as_deref().map(Records::read).transpose()?;
    let progress = Progress::new(args.quiet);
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    let _lock = FolderLock::acquire(&args.out)?;
    let mut records = Records::open(&args.out.join("records.jsonl"))?;
    if records.repaired {
        progress
            .say("records.jsonl: the last line was cut by an interruption; it is measured again");
    }
    let scratch = Scratch::new()?;
    let sets = inputs::sets(&args.scenes, scratch.path(), &progress)?;
    let campaign = Campaign {
        args,
        grid: &grid,
        sets: &sets,
        scratch: scratch.path(),
        machine: this_machine(args.threads),
        repeats: usize::from(args.repeats),
        progress: &progress,
        asked: Cell::new(0),
        weights: RefCell::default(),
    };
    let hashes: Vec<_> = sets.iter().map(|s| (s.name.clone(), s.hash.clone())).collect();
    let (machine, conditions) = (&campaign.machine, campaign.conditions()?);
    records.check_own(&machine.fingerprint(), machine, &conditions, &hashes)?;
    campaign.check_weights(&records, &settings)?;
    for setting in &settings {
        campaign.weights_hash(setting)?;
    }
    let seconds = estimate::estimate(&campaign, &settings, &records, &neutral)?;
    estimate::check(seconds, settings.len(), args.limit.0)?;
    if !sets.is_empty() {
        progress.say(format!(
            "{} settings on {} sets of scenes: about {}, neighbours that rule some out not counted",
            settings.len(),
            sets.len(),
            scenesplat_lab::pareto::seconds_text(seconds)
        ));
    }
    let mut around = Around {
        reference: grid.reference.to_string(),
        networks: grid
            .networks
            .iter()
            .map(|(n, w)| (n.clone(), w.weights.display().to_string()))
            .collect(),
        training,
        ..Around::default()
    };
    let done =
        explore(&campaign, &settings, &mut records, &mut around, began).and_then(|()| match around
            .unmeasured
            .is_empty()
        {
            true => neutral::complete(&campaign, &neutral, &mut records, &args.out),
            false => Ok(()),
        });
    if let Err(error) = done {
        let kept = records.all.len();
        return Err(match error.is::<Stopped>() {
            true => {
                anyhow!("stopped; {kept} records are kept: the same command goes on from there")
            }
            false => error,
        });
    }
    // Of the scenes that were asked for; without any, of all that were measured before.
    let asked = |r: &&Record| args.scenes.is_empty() || args.scenes.contains(&r.scenes);
    let shown: Vec<Record> = records.all.iter().filter(asked).cloned().collect();
    let summary = Summary::of(&shown, around)?;
    tell::tell(&summary);
    for (path, _) in write_report(&summary, &shown, &args.out)? {
        print(&format!("wrote {}", printable(&path)));
    }
    if !summary.unmeasured.is_empty() {
        bail!(
            "--limit: time was over before {} settings were measured; the same command goes on from there",
            summary.unmeasured.len()
        );
    }
    if let Some(row) = summary.neutral.iter().find(|row| !row.holds) {
        bail!("{} changed the labels on {}, and must not", row.neutral, row.scenes);
    }
    match (&before, &args.against) {
        (Some(before), Some(path)) => tell::compared(&compare(&shown, before), path),
        _ => Ok(()),
    }
}
