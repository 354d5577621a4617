//! Commands over many scenes: `features`, `segment`, `evaluate`, `lift-labels` and `collect-labels` with several scenes, a
//! manifest, or a part of them. Each scene is the same command on that scene alone, in a process of its own
//! and with a folder of its own in `--out`.

mod child;
mod list;
mod names;
mod record;
mod words;
mod work;

use crate::error::WrongUse;
use crate::terminal::print;
use anyhow::Result;
use clap::{ArgAction, ArgMatches, FromArgMatches};
pub use list::{Entry, MANIFEST, Manifest};
pub use record::{RECORDS, Record, Status, inspect_outputs, read_record};
use scenesplat::datasets::Shard;
use std::borrow::Cow;
use std::path::PathBuf;
use std::str::FromStr;

/// Which of many scenes.
#[derive(Debug, Clone, clap::Args)]
pub struct Many {
    /// Many scenes: a folder of them, or a file with one a line, or a JSON list such as
    /// ["a.ply", {"scene": "b.ply", "cameras": "b.json"}] with flags for some. Each gets a folder in --out.
    #[arg(long, value_name = "FILE|DIR", help_heading = "Many scenes")]
    pub manifest: Option<PathBuf>,
    /// Does part i of n (0/4, 1/4, …) of the scenes, sorted by path. auto, the default for several scenes:
    /// as the variables of a SLURM array say, or RANK and WORLD_SIZE, or all of them. Scenes that are done
    /// are left alone; `scenesplat merge` joins the parts.
    #[arg(long, value_name = "i/n|auto", help_heading = "Many scenes")]
    pub shard: Option<ShardArg>,
    /// Does scenes again that are done, also by other settings.
    #[arg(long, help_heading = "Many scenes")]
    pub again: bool,
}

/// A scene, or many.
#[derive(Debug, Clone, clap::Args)]
pub struct OneOrMany {
    /// The scene, in any format; several get a folder in --out each.
    #[arg(num_args = 1.., action = ArgAction::Append, required = false, required_unless_present = "manifest")]
    pub scene: PathBuf,
    /// Which of many scenes.
    #[command(flatten)]
    pub many: Many,
}

impl OneOrMany {
    /// The name of the scene's file.
    pub fn name(&self) -> Cow<'_, str> {
        self.scene.file_name().unwrap_or_default().to_string_lossy()
    }
}

/// A part, or the one that the scheduler says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShardArg {
    /// By the variables of a scheduler.
    Auto,
    /// This one.
    Part(Shard),
}

impl FromStr for ShardArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            _ => text
                .parse()
                .map(Self::Part)
                .map_err(|error: scenesplat::datasets::ShardError| error.to_string()),
        }
    }
}

/// Some scenes of a part could not be done.
#[derive(Debug, thiserror::Error)]
#[error(
    "{failed} of {all} scenes failed; the others are done (the reasons are in {RECORDS} of --out)"
)]
pub struct SomeFailed {
    failed: usize,
    all: usize,
}

/// The commands that take many scenes, the name of their scenes, and whether several of them without a
/// flag of [`Many`] are the command's own business.
const COMMANDS: [(&str, &str, bool); 5] = [
    ("features", "scene", false),
    ("segment", "scene", false),
    ("lift-labels", "scene", false),
    ("collect-labels", "scene", false),
    ("evaluate", "scenes", true),
];

/// A command line that asks for many scenes.
#[derive(Debug)]
pub struct Asked<'a> {
    /// The command.
    command: &'static str,
    /// Name of its argument with the scenes.
    positional: &'static str,
    flags: &'a ArgMatches,
    many: Many,
}

/// What of this kind a command line asks for.
///
/// # Errors
/// If the flags do not fit together.
pub fn asked(matches: &ArgMatches) -> Result<Option<Asked<'_>>, clap::Error> {
    let Some((name, flags)) = matches.subcommand() else { return Ok(None) };
    let Some(&(command, positional, own)) = COMMANDS.iter().find(|row| row.0 == name) else {
        return Ok(None);
    };
    let many = Many::from_arg_matches(flags)?;
    let several = !own && flags.get_raw(positional).is_some_and(|values| values.len() > 1);
    let is_asked = several || many.manifest.is_some() || many.shard.is_some() || many.again;
    Ok(is_asked.then_some(Asked { command, positional, flags, many }))
}

impl Asked<'_> {
    /// Which part of the scenes, and who says so.
    fn shard(&self) -> Result<(Shard, String)> {
        if let Some(ShardArg::Part(shard)) = self.many.shard {
            return Ok((shard, format!("--shard {shard}")));
        }
        let of_scheduler = Shard::from_environment(|name| std::env::var(name).ok());
        let found = of_scheduler.map_err(|error| WrongUse(error.to_string()))?;
        Ok(found.map_or_else(
            || (Shard::default(), "all scenes".to_owned()),
            |(shard, name)| (shard, format!("part {shard} by {name}")),
        ))
    }

    /// Runs the command on each scene of the part.
    ///
    /// # Errors
    /// If the scenes or flags cannot be understood, scenes were done by other settings, or some fail
    /// ([`SomeFailed`]).
    pub fn run(&self, command: &clap::Command) -> Result<()> {
        let (shard, why) = self.shard()?;
        let words = words::Words::of(command, self)?;
        let manifest = list::gather(self, &words)?;
        let tally = work::run(self, &words, manifest, shard, &why)?;
        print(&tally.to_string());
        match tally.failed.len() {
            0 => Ok(()),
            failed => Err(SomeFailed { failed, all: tally.all }.into()),
        }
    }
}
