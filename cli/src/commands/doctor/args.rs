//! The flags of `doctor`, and the cases that they choose.

use crate::duration::{Seconds, parse_duration};
use crate::error::refuse;
use crate::flags::Running;
use anyhow::Result;
use scenesplat_lab::doctor::{Case, Level, StabilityRecipe, catalogue, nearest_names};
use std::path::PathBuf;

/// Runs hard cases on this machine: damaged files, numbers at the edge of their range, operators
/// against f64, short trainings, damaged rooms. Needs no files. Each case is made anew, the same
/// every time; docs/hard_cases.md lists them.
///
/// --soak, --round, --training, --curves and --report run something else instead of the cases.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("instead").conflicts_with_all(["full", "case", "level", "operators_to"]))]
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
    /// Random inputs for so long (10m, 1h): files, values, operators, scenes through the network. None may
    /// panic, nothing that is not finite may come out, memory has to stay flat.
    #[arg(long, value_name = "TIME", value_parser = parse_duration, group = "instead")]
    pub soak: Option<Seconds>,
    /// One round of --soak again, by the number that its report names; the seed as there.
    #[arg(long, value_name = "N", group = "instead")]
    pub round: Option<u64>,
    /// Which random inputs of --soak [default: 0], which damage of --curves [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Trains a small network in every form: {f32, bf16} × {even, uneven batches} × {plain, accumulated,
    /// recomputed} × seeds; compares their gradients, and poisons a batch. Then without labels, by two
    /// recipes: {f32, bf16} × {even, uneven batches} × seeds. Hours at the default length.
    #[arg(long, group = "instead")]
    pub training: bool,
    /// Optimizer steps of each of --training. [default: 2000]
    #[arg(long, value_name = "N", requires = "training")]
    pub steps: Option<u64>,
    /// Seeds of --training. [default: 3]
    #[arg(long, value_name = "N", requires = "training")]
    pub seeds: Option<u64>,
    /// What is learned in --training; all if not given.
    #[arg(long, value_name = "NAME", requires = "training", value_parser = recipe)]
    pub recipe: Option<StabilityRecipe>,
    /// Draws what labels of unseen rooms are worth against the severity of each capture effect:
    /// severity.json, .png and .svg in this folder.
    #[arg(long, value_name = "DIR", group = "instead")]
    pub curves: Option<PathBuf>,
    /// Rooms of --curves. [default: 4]
    #[arg(long, value_name = "N", requires = "curves")]
    pub rooms: Option<usize>,
    /// Gaussians of each room of --curves. [default: 20000]
    #[arg(long, value_name = "N", requires = "curves")]
    pub gaussians: Option<usize>,
    /// Prints what a report of a bug needs: version, build, processor, instruction set, memory, variables, and a check of
    /// two seconds. No paths, no names of users.
    #[arg(long, group = "instead")]
    pub report: bool,
    /// Folder for the files of --case; they get a folder of the case's name in it.
    #[arg(long, value_name = "DIR", default_value = "scenesplat-out")]
    pub out: PathBuf,
    /// Also writes everything as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
    /// The operators alone, as JSON into this file: what the command starts itself with.
    #[arg(long, hide = true, value_name = "FILE.json")]
    pub operators_to: Option<PathBuf>,
}

impl Args {
    /// Refuses a flag that would do nothing.
    pub(super) fn check(&self) -> Result<()> {
        let random = self.soak.is_some() || self.round.is_some() || self.curves.is_some();
        if self.seed.is_some() && !random {
            refuse!(
                "--seed belongs to --soak, --round and --curves: the cases are the same every time"
            );
        }
        if self.round.is_some() && self.json.is_some() {
            refuse!("--json: a --round has no report");
        }
        if self.report && self.json.is_some() {
            refuse!(
                "--json: --report is a text to paste; without it the cases are written as JSON"
            );
        }
        Ok(())
    }
}

fn recipe(text: &str) -> Result<StabilityRecipe, String> {
    let known = StabilityRecipe::ALL.into_iter().find(|recipe| recipe.name() == text);
    known.ok_or_else(|| {
        let names: Vec<&str> = StabilityRecipe::ALL.iter().map(|recipe| recipe.name()).collect();
        format!("{text:?}: one of {} is expected", names.join(", "))
    })
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
            refuse!("--case {name}: no such case; nearest: {near}");
        }
        return Ok(cases);
    }
    cases.retain(|case| args.full || case.quick);
    cases.retain(|case| args.level.is_none_or(|level| case.level == level));
    Ok(cases)
}
