//! `train --sweep`

use super::{Args, Start, tell};
use crate::error::{WrongUse, refuse};
use crate::progress::interrupted;
use crate::terminal::{note_warning, print};
use anyhow::{Context, Result, bail};
use scenesplat::experiment::sweep::{RunOutcome, SweepAxis, best_of, combinations, folder_name};
use scenesplat::experiment::{ExperimentConfig, ExperimentError, RunReport};
use scenesplat::scene::AtomicFile;
use std::fmt::Write;
use std::path::{Path, PathBuf};

const TABLE: &str = "sweep.csv";

/// A training of the sweep.
struct Planned {
    changes: Vec<String>,
    config: ExperimentConfig,
    folder: PathBuf,
}

/// Trains once for each combination of values. One that fails is noted, and the others go on.
pub(super) fn run(start: &Start<'_>, file: &Path, out: &Path) -> Result<()> {
    if start.ranks.size() > 1 {
        refuse!("--sweep: is for one process, and {} were started", start.ranks.size());
    }
    let planned = plan(start.args, file, out)?;
    let of = planned.len();
    let mut reports = Vec::new();
    let mut failed = Vec::new();
    for (number, one) in (1..).zip(&planned) {
        print(&format!("training {number} of {of}: {}", one.changes.join(" ")));
        match start.train(&one.config, one.folder.clone()) {
            Ok(report) => {
                tell(&report, &one.config, start.args);
                let ended = start.end(&report);
                reports.push(Some(report));
                write_table(&planned, &reports, out)?;
                ended?;
            }
            // Before its first step.
            Err(error) if interrupted() => return Err(error),
            Err(error) => {
                let text = format!("training {number} of {of} failed: {error:#}");
                note_warning(&text);
                print(&text);
                reports.push(None);
                failed.push(number);
                write_table(&planned, &reports, out)?;
            }
        }
    }
    compare(&planned, &reports);
    print(&format!("table: {}", out.join(TABLE).display()));
    if !failed.is_empty() {
        bail!("--sweep: {} of {of} trainings failed: {failed:?}", failed.len());
    }
    Ok(())
}

/// Every training, read and checked before the first begins.
fn plan(args: &Args, file: &Path, out: &Path) -> Result<Vec<Planned>> {
    let wrong = |error: ExperimentError| WrongUse(format!("--sweep {error}"));
    let axes = args.sweep.iter().map(|text| SweepAxis::parse(text).map_err(wrong));
    let axes: Vec<SweepAxis> = axes.collect::<Result<_, _>>()?;
    let of_seed = axes.iter().any(|axis| axis.key.ends_with("seed"));
    if let Some(seed) = args.seed.filter(|_| of_seed) {
        refuse!("--seed {seed}: sets all seeds, and --sweep one of them; leave out one of the two");
    }
    let is_set = |change: &&String| {
        let key = change.split('=').next().unwrap_or_default().trim();
        axes.iter().any(|axis| axis.key == key)
    };
    if let Some(change) = args.all_changes().iter().find(is_set) {
        refuse!("--set {change}: --sweep sets it as well; leave out one of the two");
    }
    let mut planned = Vec::new();
    for (number, changes) in (1..).zip(combinations(&axes).map_err(wrong)?) {
        let all = [args.all_changes(), changes.clone()].concat();
        let mut config = ExperimentConfig::read_changed(file, &all)?;
        if let Some(seed) = args.seed {
            config.set_seed(seed);
        }
        let folder = out.join(folder_name(number, &changes));
        planned.push(Planned { changes, config, folder });
    }
    Ok(planned)
}

/// The trainings so far, a row each.
fn write_table(planned: &[Planned], reports: &[Option<RunReport>], out: &Path) -> Result<()> {
    let mut text = String::from("training,folder,settings,steps,loss,measurement,best,best_step\n");
    for (number, (one, report)) in (1..).zip(planned.iter().zip(reports)) {
        let cell = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
        let name = one.folder.file_name().unwrap_or_default().to_string_lossy();
        let measurement = one.config.trainer.checkpoint.best.as_ref();
        let measurement = measurement.map(ToString::to_string).unwrap_or_default();
        let values = match report {
            None => format!("failed,,{},,", cell(&measurement)),
            Some(RunReport { progress, outcome: RunOutcome { loss, best }, .. }) => {
                let steps = progress.step;
                let loss = loss.map(|loss| loss.to_string()).unwrap_or_default();
                let best = best.map_or(",".to_owned(), |(value, step)| format!("{value},{step}"));
                format!("{steps},{loss},{},{best}", cell(&measurement))
            }
        };
        let settings = cell(&one.changes.join(" "));
        writeln!(text, "{number},{},{settings},{values}", cell(&name))?;
    }
    let path = out.join(TABLE);
    AtomicFile::write(&path, text.as_bytes()).with_context(|| path.display().to_string())?;
    Ok(())
}

/// Prints a line for each training, the best one marked.
fn compare(planned: &[Planned], reports: &[Option<RunReport>]) {
    let Some(selection) = planned.first().map(|one| &one.config.trainer.checkpoint) else { return };
    let outcomes: Vec<Option<&RunOutcome>> =
        reports.iter().map(|report| report.as_ref().map(|report| &report.outcome)).collect();
    let best = best_of(selection, &outcomes);
    let name = selection.best.as_ref().map_or("loss".to_owned(), ToString::to_string);
    for (i, (one, outcome)) in planned.iter().zip(&outcomes).enumerate() {
        let value = match outcome {
            None => "failed".to_owned(),
            Some(RunOutcome { best: Some((value, step)), .. }) => {
                format!("{name} {value:.4} at step {step}")
            }
            Some(RunOutcome { loss: Some(loss), .. }) => format!("loss {loss:.4}"),
            Some(_) => "nothing was logged".to_owned(),
        };
        let mark = if best == Some(i) { "*" } else { " " };
        print(&format!("{mark} {:3}  {value:30}  {}", i + 1, one.changes.join(" ")));
    }
}
