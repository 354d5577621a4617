//! The scenes of a part, one after the other.

use super::Asked;
use super::child::{self, Ended};
use super::list::{Entry, Manifest};
use super::record::{Fingerprints, Job, RECORDS, Record, Status, inspect_outputs, read_record};
use super::words::{Flags, Words};
use crate::error::refuse;
use crate::progress::{Progress, interrupted, listen_for_interrupt};
use anyhow::{Context, Result};
use scenesplat::datasets::Shard;
use scenesplat::inference::EncodeError;
use scenesplat::scene::FolderLock;
use scenesplat::scene::atomic_file::WriteError;
use std::ffi::OsString;
use std::fmt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How often one looks whether another process is done with a scene.
const WAIT: Duration = Duration::from_millis(200);

/// What became of the scenes of a part.
#[derive(Debug, Default)]
pub struct Tally {
    /// Which part.
    what: String,
    /// Scenes of the part.
    pub all: usize,
    done: usize,
    was_done: usize,
    /// Names and reasons.
    pub failed: Vec<(String, String)>,
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} scenes, {} done now, {} done before, {} failed",
            self.what,
            self.all,
            self.done,
            self.was_done,
            self.failed.len()
        )?;
        self.failed.iter().try_for_each(|(name, reason)| write!(f, "\n  {name}: {reason}"))
    }
}

/// What became of one.
enum Became {
    Done,
    WasDone,
    Failed(String),
    /// Another process is at it.
    Busy,
}

struct Work<'a> {
    asked: &'a Asked<'a>,
    words: &'a Words,
    out: PathBuf,
    quiet: bool,
    progress: Progress,
    known: Fingerprints,
}

/// Does them.
///
/// # Errors
/// If one was done by other settings, a record cannot be read or written, or the user stops.
pub fn run(
    asked: &Asked<'_>,
    words: &Words,
    manifest: Manifest,
    shard: Shard,
    why: &str,
) -> Result<Tally> {
    let _ = listen_for_interrupt();
    let out = asked.flags.get_one::<PathBuf>("out").cloned().context("--out is missing")?;
    let quiet = asked.flags.get_flag("quiet");
    let work = Work {
        asked,
        words,
        quiet,
        progress: Progress::new(quiet),
        known: Fingerprints::default(),
        out,
    };
    std::fs::create_dir_all(work.out.join(RECORDS))
        .with_context(|| format!("{}: cannot make the folder", work.out.join(RECORDS).display()))?;
    manifest.agree(&work.out)?;
    let count = manifest.scenes.len();
    let mine = manifest.scenes.into_iter().enumerate().filter(|(place, _)| shard.holds(*place));
    let mine: Vec<Entry> = mine.map(|(_, entry)| entry).collect();
    work.progress.say(format!("{why}: {} of {count} scenes", mine.len()));
    let mut tally = Tally { what: why.to_owned(), all: mine.len(), ..Tally::default() };
    let began = Instant::now();
    let mut later = Vec::new();
    for (place, entry) in mine.iter().enumerate() {
        let left = match tally.done {
            0 => String::new(),
            done => {
                let each = began.elapsed().as_secs_f64() / done as f64;
                format!(", at most {:.0} s left", each * (mine.len() - place) as f64)
            }
        };
        work.progress.say(format!("[{}/{}] {}{left}", place + 1, mine.len(), entry.name));
        match work.one(entry)? {
            Became::Busy => {
                work.progress.say(format!("{}: another process is at it", entry.name));
                later.push(entry);
            }
            became => tally.add(entry, became),
        }
    }
    for entry in later {
        work.progress.say(format!("{}: waiting for the process that is at it", entry.name));
        let became = loop {
            match work.one(entry)? {
                Became::Busy => std::thread::sleep(WAIT),
                became => break became,
            }
        };
        tally.add(entry, became);
    }
    Ok(tally)
}

impl Tally {
    fn add(&mut self, entry: &Entry, became: Became) {
        match became {
            Became::Done => self.done += 1,
            Became::WasDone => self.was_done += 1,
            Became::Failed(reason) => self.failed.push((entry.name.clone(), reason)),
            Became::Busy => {}
        }
    }
}

impl Work<'_> {
    fn one(&self, entry: &Entry) -> Result<Became> {
        if interrupted() {
            return Err(EncodeError::Stopped.into());
        }
        let folder = self.out.join(RECORDS).join(&entry.name);
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
        let _lock = match FolderLock::acquire(&folder) {
            Err(WriteError::Busy { .. }) => return Ok(Became::Busy),
            lock => lock?,
        };
        // The rest of a run that was killed, or the same scene in a run of its own.
        let folder = self.out.join(&entry.name);
        if folder.exists() && matches!(FolderLock::acquire(&folder), Err(WriteError::Busy { .. })) {
            return Ok(Became::Busy);
        }
        let began = Instant::now();
        let flags = self.words.for_scene(&entry.name, &entry.scene, &entry.flags);
        let job = match Job::of(self.asked.command, &entry.scene, &flags, &self.known) {
            Ok(job) => job,
            Err(error) => {
                let job = Job {
                    command: self.asked.command.to_owned(),
                    version: env!("CARGO_PKG_VERSION").to_owned(),
                    settings: Default::default(),
                    inputs: Vec::new(),
                };
                return self.fail(entry, job, format!("{error:#}"), began);
            }
        };
        if !self.asked.many.again && self.is_done(entry, &job)? {
            return Ok(Became::WasDone);
        }
        match child::run(&self.line(entry, &flags))? {
            Ended::Stopped => Err(EncodeError::Stopped.into()),
            Ended::Failed(reason) => self.fail(entry, job, reason, began),
            Ended::Well => {
                match Record::done(&self.out, &entry.name, &entry.scene, job.clone()) {
                    Ok(record) => record.write(&self.out)?,
                    Err(error) => return self.fail(entry, job, format!("{error:#}"), began),
                }
                Ok(Became::Done)
            }
        }
    }

    /// Whether its results are there, of the same scene and settings.
    fn is_done(&self, entry: &Entry, job: &Job) -> Result<bool> {
        let record = read_record(&self.out, &entry.name)?;
        let Some(record) = record.filter(|record| record.status == Status::Done) else {
            return Ok(false);
        };
        if let Some(difference) = job.differs(&record.job) {
            refuse!(
                "{} in {} was done with {difference}; --again does it by these settings, another --out keeps both",
                entry.name,
                self.out.display()
            );
        }
        let changed = if record.job.inputs == job.inputs {
            inspect_outputs(&self.out, &record, false)
        } else {
            Some(format!("{} has changed since", entry.scene))
        };
        if let Some(reason) = changed {
            self.progress.say(format!("{}: {reason}; it is done again", entry.name));
            return Ok(false);
        }
        self.progress.say(format!("{}: done before", entry.name));
        Ok(true)
    }

    fn fail(&self, entry: &Entry, job: Job, reason: String, began: Instant) -> Result<Became> {
        self.progress.say(format!("{}: FAILED: {reason}", entry.name));
        let seconds = began.elapsed().as_secs_f64();
        let record = Record::failed(&entry.name, &entry.scene, job, reason.clone(), seconds);
        record.write(&self.out)?;
        Ok(Became::Failed(reason))
    }

    fn line(&self, entry: &Entry, flags: &Flags) -> Vec<OsString> {
        let mut out = OsString::from("--out=");
        out.push(self.out.join(&entry.name));
        let mut line = vec![OsString::from(self.asked.command), out];
        line.extend(flags.words());
        if self.quiet && !line.iter().any(|word| word == "--quiet") {
            line.push("--quiet".into());
        }
        // A scene may begin with a dash.
        line.extend(["--".into(), OsString::from(&entry.scene)]);
        line
    }
}
