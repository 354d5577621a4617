//! The flags of `doctor`, and the cases that they choose.

use crate::commands::WrongUse;
use anyhow::Result;
use scenesplat::doctor::{Case, Level, catalogue, nearest_names};
use std::path::PathBuf;

/// Runs hard cases on this machine: damaged files, numbers at the edge of their range, operators
/// against f64, short trainings, damaged rooms. Needs no files. Each case is made anew, the same
/// every time; docs/hard_cases.md lists them.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// All cases, and the operators on each instruction set of the machine.
    #[arg(long)]
    pub full: bool,
    /// Only this case; what it made is kept in --out.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["full", "level"])]
    pub case: Option<String>,
    /// Only cases of this level: inputs, operators, training or scenes.
    #[arg(long, value_name = "NAME", value_parser = parse_level)]
    pub level: Option<Level>,
    /// Folder for the files of --case; they get a folder of the case's name in it.
    #[arg(long, value_name = "DIR", default_value = "scenesplat-out")]
    pub out: PathBuf,
    /// Also writes everything as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Threads; all cores by default. Results are compared with those of one thread.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Shows no progress.
    #[arg(long)]
    pub quiet: bool,
    /// The operators alone, as JSON into this file: what the command starts itself with.
    #[arg(long, hide = true, value_name = "FILE.json")]
    pub operators_to: Option<PathBuf>,
}

fn parse_level(text: &str) -> Result<Level, String> {
    let known = Level::ALL.into_iter().find(|level| level.name() == text);
    known.ok_or_else(|| format!("{text:?}: inputs, operators, training or scenes"))
}

/// The cases that the command line asks for.
pub(super) fn chosen(args: &Args) -> Result<Vec<Case>> {
    let mut cases = catalogue();
    if let Some(name) = &args.case {
        cases.retain(|case| case.name == *name);
        if cases.is_empty() {
            let near = nearest_names(name).join(", ");
            return Err(WrongUse(format!("--case {name}: no such case; nearest: {near}")).into());
        }
        return Ok(cases);
    }
    cases.retain(|case| args.full || case.quick);
    cases.retain(|case| args.level.is_none_or(|level| case.level == level));
    Ok(cases)
}
