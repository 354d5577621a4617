//! `scenesplat pareto`

mod args;
mod campaign;
mod duration;
mod estimate;
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
pub use point::{PointArgs, run_point};
use scenesplat::Setting;
use scenesplat::pareto::{
    Around, Candidate, Grid, Kind, Records, RuledOut, Summary, TrainingCurve, Tried, order, points,
    ruled_out, write_report,
};
use scenesplat::scene::{FolderLock, printable};
use std::cell::{Cell, RefCell};
use std::time::Instant;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let began = Instant::now();
    let grid = match &args.grid {
        Some(path) => Grid::read(path),
        None => Grid::default_grid(),
    };
    let grid = grid.map_err(|e| WrongUse(e.to_string()))?;
    let settings = grid.settings().map_err(|e| WrongUse(e.to_string()))?;
    let neutral = neutral::rows(&grid.neutral)?;
    let runs = args.training.iter().chain(&grid.training);
    let training: Vec<TrainingCurve> =
        runs.map(|run| TrainingCurve::read(run)).collect::<Result<_, _>>()?;
    let _ = listen_for_interrupt();
    let progress = Progress::new(args.quiet);
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    let _lock = FolderLock::acquire(&args.out)?;
    let mut records = Records::open(&args.out.join("records.jsonl"))?;
    if records.mended {
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
        progress: &progress,
        asked: Cell::new(0),
        weights: RefCell::default(),
    };
    let hashes: Vec<_> = sets.iter().map(|s| (s.name.clone(), s.hash.clone())).collect();
    records.check_own(&campaign.machine.fingerprint(), &campaign.machine, &hashes)?;
    campaign.check_weights(&records, &settings)?;
    for setting in &settings {
        campaign.weights_hash(setting)?;
    }
    let seconds = estimate::estimate(&campaign, &settings, &records, neutral.len())?;
    estimate::check(seconds, settings.len(), args.limit.0)?;
    progress.say(format!(
        "{} settings on {} sets of scenes: about {} at most",
        settings.len(),
        sets.len(),
        scenesplat::pareto::seconds_text(seconds)
    ));
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
    let done = measure_all(&campaign, &settings, &mut records, &mut around, began).and_then(|()| {
        match around.unmeasured.is_empty() {
            true => neutral::complete(&campaign, &neutral, &mut records, &args.out),
            false => Ok(()),
        }
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
    let summary = Summary::of(&records.all, around)?;
    tell::tell(&summary);
    for (path, _) in write_report(&summary, &records.all, &args.out)? {
        print(&format!("wrote {}", printable(&path)));
    }
    if !summary.unmeasured.is_empty() {
        bail!(
            "--limit: time was over before {} settings were measured; the same command goes on from there",
            summary.unmeasured.len()
        );
    }
    match summary.neutral.iter().find(|row| !row.holds) {
        Some(row) => bail!("{} changed the labels on {}, and must not", row.neutral, row.scenes),
        None => Ok(()),
    }
}

/// Measures the settings that have to be measured, the reference first.
fn measure_all(
    campaign: &Campaign<'_>,
    settings: &[Setting],
    records: &mut Records,
    around: &mut Around,
    began: Instant,
) -> Result<()> {
    let (grid, args) = (campaign.grid, campaign.args);
    let sets: Vec<String> = campaign.sets.iter().map(|s| s.name.clone()).collect();
    let candidates = order(settings, &grid.axes);
    for (i, candidate) in candidates.iter().enumerate() {
        let setting: Setting = candidate.text.parse()?;
        let measured = sets
            .iter()
            .all(|set| records.find(Kind::Setting, &candidate.text, None, set).is_some());
        if !measured && i > 0 {
            if let Some(by) = skipped(grid, candidate, records, &sets) {
                campaign.progress.say(format!("  {} is ruled out by {}", by.setting, by.by));
                around.skipped.push(by);
                continue;
            }
            if began.elapsed().as_secs_f64() > args.limit.0 {
                around.unmeasured.push(candidate.text.clone());
                continue;
            }
        }
        campaign.progress.say(format!("{}/{}", i + 1, candidates.len()));
        campaign.complete(&setting, records, &args.out)?;
    }
    Ok(())
}

/// Why a candidate need not be measured, by what was measured so far.
fn skipped(
    grid: &Grid,
    candidate: &Candidate,
    records: &Records,
    sets: &[String],
) -> Option<RuledOut> {
    if !grid.skip {
        return None;
    }
    let tried = points(&records.all, Kind::Setting, sets).into_iter().filter_map(|point| {
        let setting: Setting = point.setting.parse().ok()?;
        Some(Tried {
            candidate: Candidate::new(&setting),
            cost: point.seconds_p50,
            worth: point.f_miou?,
        })
    });
    ruled_out(candidate, &tried.collect::<Vec<_>>(), &grid.axes)
}
