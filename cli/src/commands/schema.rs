//! `scenesplat schema`

use crate::terminal::print;
use anyhow::Result;
use clap::ValueEnum;
use scenesplat_lab::pareto::Grid;

/// Prints a JSON schema of the files that `train` or `pareto` reads, for editors.
///
/// With the schema in a file, `#:schema train.schema.json` as the first line of an experiment makes editors complete its
/// settings and mark misspelt ones (docs/command_line.md).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Of which files: train (experiments) or grid (of pareto).
    #[arg(value_enum, value_name = "train|grid", hide_possible_values = true)]
    pub of: Files,
}

/// Files with a schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Files {
    /// Experiments, which `train` reads.
    Train,
    /// Grids of settings, which `pareto` reads.
    Grid,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let schema = match args.of {
        Files::Train => scenesplat::experiment::SCHEMA,
        Files::Grid => Grid::SCHEMA,
    };
    print(schema.trim_end());
    Ok(())
}
