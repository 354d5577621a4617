//! What is missing in a folder.

use crate::commands::many::{Entry, Record, Status, inspect_outputs};
use anyhow::{Result, bail};
use std::path::Path;

/// Scenes that are told one by one.
const TOLD: usize = 20;

/// Scenes without results, and why.
#[derive(Debug)]
pub struct Gaps {
    scenes: usize,
    found: Vec<String>,
}

impl Gaps {
    /// None as yet, of so many scenes.
    pub fn of(scenes: usize) -> Self {
        Self { scenes, found: Vec::new() }
    }

    /// The record of a scene, if its results are there.
    pub fn check(
        &mut self,
        folder: &Path,
        entry: &Entry,
        record: Option<Record>,
        verify: bool,
    ) -> Option<Record> {
        let name = &entry.name;
        let Some(record) = record else {
            self.found.push(format!("{name}: not done"));
            return None;
        };
        let problem = match record.status {
            Status::Failed => {
                Some(format!("failed: {}", record.reason.as_deref().unwrap_or("unknown")))
            }
            Status::Done if record.scene != entry.scene => {
                Some(format!("done of {}, not of {}", record.scene, entry.scene))
            }
            Status::Done => inspect_outputs(folder, &record, verify),
        };
        match problem {
            Some(problem) => {
                self.found.push(format!("{name}: {problem}"));
                None
            }
            None => Some(record),
        }
    }

    /// Looks whether all were done by the same settings; those that a manifest gives a scene may differ.
    pub fn check_jobs(&mut self, records: &[Record]) {
        let Some(first) = records.first() else { return };
        for record in records {
            if record.job.version != first.job.version || record.job.command != first.job.command {
                let of = |r: &Record| format!("{} {}", r.job.command, r.job.version);
                self.found.push(format!(
                    "{}: done by {}, {} by {}",
                    record.name,
                    of(record),
                    first.name,
                    of(first)
                ));
            }
        }
    }

    /// # Errors
    /// If anything is missing; names the scenes.
    pub fn refuse(&self) -> Result<()> {
        if self.found.is_empty() {
            return Ok(());
        }
        let mut text = format!("{} of {} scenes are missing:", self.found.len(), self.scenes);
        for gap in self.found.iter().take(TOLD) {
            text += &format!("\n  {gap}");
        }
        if self.found.len() > TOLD {
            text += &format!("\n  … and {} more", self.found.len() - TOLD);
        }
        bail!("{text}\nrun the same command again: what is done is left alone")
    }
}
