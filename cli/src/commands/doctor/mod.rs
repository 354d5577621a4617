//! `scenesplat doctor`

mod args;
mod curves;
mod isas;
mod report;
mod soak;
mod stability;

use crate::bench::Stopped;
use crate::bench::process::Scratch;
use crate::error::WrongUse;
use crate::outputs::Outputs;
use crate::progress::{Progress, interrupted};
use crate::terminal::{print, write_text};
use anyhow::{Context, Result, bail};
pub use args::Args;
use args::chosen;
use isas::{operators_to, other_isas};
use scenesplat::scene::{FolderLock, printable};
use scenesplat_lab::doctor::{Case, Doctor, DoctorReport, Surroundings, Verdict};
use std::path::Path;
use std::time::Instant;

/// Panics of cases say nothing by themselves: they are a case's failure, with their text.
struct Silence;

impl Silence {
    fn new() -> Self {
        std::panic::set_hook(Box::new(|_| {}));
        Self
    }
}

impl Drop for Silence {
    fn drop(&mut self) {
        // Back to the default.
        drop(std::panic::take_hook());
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let began = Instant::now();
    args.check()?;
    let progress = Progress::start(&args.running)?;
    if args.report {
        return report::run(&progress);
    }
    if let Some(round) = args.round {
        return soak::again(args, round);
    }
    if args.soak.is_some() || args.training || args.curves.is_some() {
        Outputs::new(Path::new("")).claim_any("--json", args.json.as_ref())?;
    }
    if let Some(length) = args.soak {
        return soak::run(args, length, &progress);
    }
    if args.training {
        return stability::run(args, &progress);
    }
    if let Some(folder) = &args.curves {
        return curves::run(args, folder, &progress);
    }
    let cases = chosen(args)?;
    if let Some(path) = &args.operators_to {
        return operators_to(path, &cases);
    }
    Outputs::new(Path::new("")).claim_any("--json", args.json.as_ref())?;
    let scratch = Scratch::new()?;
    let kept = args.case.as_ref().map(|name| args.out.join(name));
    // Other runs stay out of the folder while it is written to.
    let _lock = kept.as_deref().map(|folder| lock(&args.out, folder)).transpose()?;
    let doctor = match &kept {
        Some(_) => Doctor::new(&args.out)?.keeping(),
        None => Doctor::new(scratch.path())?,
    };
    let verdicts = run_cases(&doctor, &cases, &progress)?;
    let others = if args.full { other_isas(args, scratch.path(), &progress)? } else { Vec::new() };
    progress.finish();
    let surroundings = Surroundings::detect(doctor.threads());
    let seconds = began.elapsed().as_secs_f64();
    let report = DoctorReport::new(surroundings, verdicts, others, seconds);
    print(&report.to_string());
    if let Some(path) = &args.json {
        write_text(path, &(serde_json::to_string_pretty(&report)? + "\n"))?;
        progress.say(format!("wrote {}", path.display()));
    }
    if let Some(folder) = kept.filter(|folder| folder.exists()) {
        print(&format!("kept what the case made: {}", printable(&folder.display().to_string())));
    }
    if report.failed > 0 {
        bail!("{} of {} cases failed", report.failed, report.cases);
    }
    Ok(())
}

/// Makes `out` and locks it for `folder` in it, which must not be there.
fn lock(out: &Path, folder: &Path) -> Result<FolderLock> {
    if folder.exists() {
        let text = format!("--out: {} is there already", folder.display());
        return Err(WrongUse(text + "; give another --out, or remove it").into());
    }
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    Ok(FolderLock::acquire(out)?)
}

fn run_cases(doctor: &Doctor, cases: &[Case], progress: &Progress) -> Result<Vec<Verdict>> {
    let _silence = Silence::new();
    let mut verdicts = Vec::with_capacity(cases.len());
    for (i, case) in cases.iter().enumerate() {
        if interrupted() {
            return Err(Stopped.into());
        }
        progress.advance(case.level.name(), i as f64 / cases.len() as f64);
        let verdict = doctor.run(case);
        if let Some(why) = &verdict.failure {
            progress.say(format!("FAILED {}: {why}", case.name));
        }
        verdicts.push(verdict);
    }
    Ok(verdicts)
}
