//! `doctor --training`

use super::Args;
use crate::bench::Stopped;
use crate::bench::process::Scratch;
use crate::error::refuse;
use crate::progress::{Progress, interrupted};
use crate::terminal::{print, write_text};
use anyhow::{Result, anyhow, bail};
use scenesplat_lab::doctor::{StabilitySettings, stability};

/// The grid of trainings; a report also when it is stopped.
pub(super) fn run(args: &Args, progress: &Progress) -> Result<()> {
    let scratch = Scratch::new()?;
    let mut settings = StabilitySettings::default();
    if let Some(steps) = args.steps {
        settings.steps = steps;
    }
    if let Some(count) = args.seeds {
        settings.seeds = (1..=count).collect();
    }
    if let Some(recipe) = args.recipe {
        settings.recipes = vec![recipe];
    }
    if settings.steps == 0 || settings.seeds.is_empty() {
        refuse!("--steps, --seeds: 1 or more is expected");
    }
    let report = stability(&settings, scratch.path(), &mut |name, share| {
        progress.advance(name, share);
        !interrupted()
    });
    progress.finish();
    let report = report.map_err(|failure| anyhow!("{}", failure.0))?;
    print(&report.to_string());
    if let Some(path) = &args.json {
        write_text(path, &(serde_json::to_string_pretty(&report)? + "\n"))?;
        progress.say(format!("wrote {}", path.display()));
    }
    if report.failed > 0 {
        bail!("{} trainings or checks failed", report.failed);
    }
    if report.stopped {
        return Err(Stopped.into());
    }
    Ok(())
}
