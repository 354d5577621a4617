//! `doctor --curves`

use super::Args;
use crate::bench::Stopped;
use crate::error::refuse;
use crate::progress::{Progress, interrupted};
use crate::terminal::{print, write_text};
use anyhow::{Context, Result};
use scenesplat::scene::FolderLock;
use scenesplat_lab::severity::{CurveSettings, SeverityError, severity_curves};
use std::path::Path;

/// Curves of quality against severity, as numbers and as a picture.
pub(super) fn run(args: &Args, folder: &Path, progress: &Progress) -> Result<()> {
    let mut settings = CurveSettings::default();
    if let Some(rooms) = args.rooms {
        settings.rooms = rooms;
    }
    if let Some(gaussians) = args.gaussians {
        settings.gaussians = gaussians;
    }
    if let Some(seed) = args.seed {
        settings.seed = seed;
    }
    // Other runs stay out of the folder, and it is known to be one, before the work.
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let _lock = FolderLock::acquire(folder)?;
    let found = severity_curves(&settings, &mut |name, share| {
        progress.advance(name, share);
        !interrupted()
    });
    progress.finish();
    let report = match found {
        Ok(report) => report,
        Err(SeverityError::Stopped) => return Err(Stopped.into()),
        Err(SeverityError::Setting { setting, expected }) => {
            refuse!("--{setting}: {expected} is expected");
        }
        Err(error) => return Err(error.into()),
    };
    print(&report.to_string());
    for (path, _) in report.write(folder)? {
        progress.say(format!("wrote {}", path.display()));
    }
    if let Some(path) = &args.json {
        write_text(path, &(serde_json::to_string_pretty(&report)? + "\n"))?;
        progress.say(format!("wrote {}", path.display()));
    }
    Ok(())
}
