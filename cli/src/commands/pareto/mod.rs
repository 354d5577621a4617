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
use crate::error::WrongUse;
use crate::progress::{Progress, listen_for_interrupt};
use crate::terminal::print;
use anyhow::{Context, Result, anyhow, bail};
pub use args::Args;
use campaign::Campaign;
use explore::explore;
pub use point::{PointArgs, run_point};
use scenesplat::scene::{FolderLock, printable};
use scenesplat_lab::pareto::{
    Around, Grid, Record, Records, Summary, TrainingCurve, compare, write_report,
};
use std::time::Instant;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let began = Instant::now();
    let _ = listen_for_interrupt();
    if args.calibrate {
        return calibrate::calibrate(args);
    }
    let (grid, settings) =
        args.grid_or(|| Grid::default_grid().map_err(|e| WrongUse(e.to_string())))?;
    let neutral = neutral::rows(&grid.neutral)?;
    let runs = args.training.iter().chain(&grid.training);
    let training = runs.map(|run| Ok(TrainingCurve::read(run)?)).collect::<Result<_>>()?;
    // Before anything is measured, and before it is overwritten if it is the same file.
    let before = args.against.as_deref().map(Records::read).transpose()?;
    let progress = Progress::new(args.running.quiet);
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    let _lock = FolderLock::acquire(&args.out)?;
    let mut records = Records::open(&args.out.join("records.jsonl"))?;
    if records.repaired {
        progress
            .say("records.jsonl: the last line was cut by an interruption; it is measured again");
    }
    let scratch = Scratch::new()?;
    let sets = inputs::sets(&args.scenes(), scratch.path(), &progress)?;
    let repeats = usize::from(args.repeats);
    let campaign = Campaign::new(args, &grid, &sets, scratch.path(), &progress, repeats);
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
            "{} settings on {} sets of scenes: about {}, neighbors that rule some out not counted",
            settings.len(),
            sets.len(),
            scenesplat_lab::pareto::seconds_text(seconds)
        ));
    }
    let networks = grid.networks.iter();
    let mut around = Around {
        reference: grid.reference.to_string(),
        networks: networks.map(|(n, w)| (n.clone(), w.weights.display().to_string())).collect(),
        training,
        ..Around::default()
    };
    let mut done = explore(&campaign, &settings, &mut records, &mut around, began);
    if done.is_ok() && around.unmeasured.is_empty() {
        done = neutral::complete(&campaign, &neutral, &mut records, &args.out);
    }
    done.map_err(|error| what_is_kept(error, &records))?;
    report(args, &records, around, before.as_deref())
}

fn what_is_kept(error: anyhow::Error, records: &Records) -> anyhow::Error {
    match error.is::<Stopped>() {
        true => {
            let kept = records.all.len();
            anyhow!("stopped; {kept} records are kept: the same command goes on from there")
        }
        false => error,
    }
}

/// Prints and writes what was measured of the scenes that were asked for.
fn report(args: &Args, records: &Records, around: Around, before: Option<&[Record]>) -> Result<()> {
    // Of the scenes that were asked for; without any, of all that were measured before.
    let scenes = args.scenes();
    let asked = |r: &&Record| scenes.is_empty() || scenes.contains(&r.scenes);
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
    match (before, &args.against) {
        (Some(before), Some(path)) => tell::compared(&compare(&shown, before), path),
        _ => Ok(()),
    }
}
