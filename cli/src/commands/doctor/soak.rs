//! `doctor --soak` and `doctor --round`.

use super::{Args, Silence};
use crate::bench::Stopped;
use crate::bench::process::Scratch;
use crate::duration::Seconds;
use crate::progress::{Progress, interrupted};
use crate::terminal::{print, write_text};
use anyhow::{Result, bail};
use scenesplat_lab::doctor::{SoakSettings, soak, soak_round};
use std::time::Duration;

/// Random inputs for so long; a report also when it is stopped.
pub(super) fn run(args: &Args, length: Seconds, progress: &Progress) -> Result<()> {
    let scratch = Scratch::new()?;
    let settings = SoakSettings {
        duration: Duration::try_from_secs_f64(length.0)?,
        seed: args.seed.unwrap_or_default(),
    };
    let mut told = 0;
    let report = {
        let _silence = Silence::new();
        soak(settings, scratch.path(), &mut |share, round, problems| {
            if problems > told {
                told = problems;
                progress.say(format!("WRONG: {problems} of {round} rounds"));
            }
            progress.advance("soak", share);
            !interrupted()
        })?
    };
    progress.finish();
    print(&report.to_string());
    if let Some(path) = &args.json {
        write_text(path, &(serde_json::to_string_pretty(&report)? + "\n"))?;
        progress.say(format!("wrote {}", path.display()));
    }
    if !report.passed {
        let wrong: u64 = report.kinds.iter().map(|kind| kind.problems).sum();
        if wrong == 0 {
            bail!("memory grew, see above; all {} rounds went well", report.rounds);
        }
        bail!("{wrong} of {} rounds went wrong", report.rounds);
    }
    if report.stopped {
        return Err(Stopped.into());
    }
    Ok(())
}

/// One round again.
pub(super) fn again(args: &Args, round: u64) -> Result<()> {
    let scratch = Scratch::new()?;
    let seed = args.seed.unwrap_or_default();
    match soak_round(seed, round, scratch.path()) {
        Ok(kind) => print(&format!("round {round} of seed {seed} ({kind}): passed")),
        Err(failure) => bail!("{}", failure.0),
    }
    Ok(())
}
