//! The commands of the program. Exit codes: 0 done, 1 failed, 2 wrong use, 3 some of many scenes failed, 4 a
//! training stopped and saved.

mod bench;
mod chunk;
mod classes;
mod codes;
mod collect_labels;
mod compare;
mod convert;
mod curate;
mod demo;
mod doctor;
pub(crate) mod evaluate;
pub(crate) mod features;
pub(crate) mod inspect;
mod labelled;
mod lift_labels;
mod many;
mod meant;
mod merge;
mod objects;
mod optimise;
mod pareto;
mod phrase;
mod prepare;
mod probe;
pub(crate) mod query;
mod reconstruct;
mod render;
mod segment;
mod simulate;
mod text;
mod train;
mod view;
mod weights;

pub use labelled::{LabelArgs, Labelled, Labelling};

use crate::error::{Saved, WrongUse};
use crate::terminal;
use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;

/// Language features, labels and queries for scenes of 3D Gaussians, on a plain CPU.
#[derive(Debug, Parser)]
#[command(name = "scenesplat", version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Fails where there is a warning; no results are put in place then.
    #[arg(long, global = true)]
    warnings_as_errors: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Labels a furnished room with the network inside the program: needs no file.
    Demo(demo::Args),
    /// Looks at a scene: what is in it, what is wrong with it, what it will cost.
    Inspect(inspect::Args),
    /// Writes one feature row per Gaussian.
    Features(features::Args),
    /// Labels every Gaussian with a class.
    Segment(segment::Args),
    /// Finds the Gaussians of an object by its name.
    Query(query::Args),
    /// Lists, boxes and exports the objects of a scene.
    Objects(objects::Args),
    /// Writes one HTML file to look at a scene and query it, without a server.
    View(view::Args),
    /// Says what phrases mean to the network inside the program, and writes text embeddings of them.
    Text(text::Args),
    /// Makes language labels of Gaussians from posed pictures: segments, their features, lifting.
    CollectLabels(collect_labels::Args),
    /// Lifts labels of pictures onto the Gaussians.
    LiftLabels(lift_labels::Args),
    /// Measures labels against the truth that scenes carry.
    Evaluate(evaluate::Args),
    /// Joins the parts of a command over many scenes, if none is missing.
    Merge(merge::Args),
    /// Draws a scene as its cameras, or cameras around it, see it.
    Render(render::Args),
    /// Does to a scene what a bad capture would have done.
    Simulate(simulate::Args),
    /// Makes a scene from posed pictures.
    Optimise(Box<optimise::Args>),
    /// Says which frames and which scenes are worth keeping, and why.
    Curate(Box<curate::Args>),
    /// Measures how much pictures differ.
    Compare(compare::Args),
    /// Writes a scene in another format, whole or in part.
    Convert(convert::Args),
    /// Trains a network as a file says.
    Train(train::Args),
    /// Asks what a network has learned: a small classifier on its rows, beside an untrained network.
    Probe(probe::Args),
    /// Draws what self-supervised training makes of masked parts of a scene.
    Reconstruct(reconstruct::Args),
    /// Turns language features of scenes into codes of a trained autoencoder, or back.
    Codes(codes::Args),
    /// Makes what training reads of a benchmark's own files.
    Prepare(prepare::Args),
    /// Cuts scenes into overlapping squares for training.
    Chunk(chunk::Args),
    /// Says what is in a checkpoint and which network it fits.
    Weights(weights::Args),
    /// Measures the speed of this machine.
    Bench(bench::Args),
    /// Runs hard cases on this machine: damaged files, numbers at the edge, operators against f64.
    Doctor(doctor::Args),
    /// Measures what accuracy costs in time: a grid of settings on labeled scenes.
    Pareto(pareto::Args),
    /// One setting, in this process: what `pareto` starts itself with.
    #[command(hide = true)]
    ParetoPoint(pareto::PointArgs),
}

/// Runs the program on the given arguments, the first of which is its name. Gives the exit code.
pub fn run(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args: Vec<OsString> = args.into_iter().collect();
    let line = args.iter().skip(1).map(|a| a.to_string_lossy()).collect::<Vec<_>>().join(" ");
    let mut command = Cli::command();
    let matches = command.try_get_matches_from_mut(&args);
    let asked = matches.as_ref().ok().map(|matches| many::asked(matches));
    if let Some(Ok(Some(many))) = asked {
        return end(many.run(&command));
    }
    let parsed = matches.and_then(|matches| Cli::from_arg_matches(&matches));
    match parsed.map_err(|error| error.format(&mut command)) {
        Ok(cli) => {
            terminal::forget_warnings(cli.warnings_as_errors);
            end(cli.command.run(&line).and_then(|()| terminal::check_warnings()))
        }
        // Help and version are no errors.
        Err(e) if !e.use_stderr() => {
            terminal::print_usage(&e);
            end(Ok(()))
        }
        Err(e) => {
            terminal::print_usage(&e);
            if e.kind() == ErrorKind::UnknownArgument && args.get(1).is_some_and(|a| a == "train") {
                let tip = "tip: settings of the file are changed as in --set trainer.epochs=3";
                terminal::tell_line(tip);
            }
            2
        }
    }
}

impl Command {
    fn run(&self, line: &str) -> anyhow::Result<()> {
        match self {
            Self::Demo(args) => demo::run(args, line),
            Self::Inspect(args) => inspect::run(args, line),
            Self::Features(args) => features::run(args, line),
            Self::Segment(args) => segment::run(args, line),
            Self::Query(args) => query::run(args, line),
            Self::Objects(args) => objects::run(args, line),
            Self::View(args) => view::run(args, line),
            Self::Text(args) => text::run(args),
            Self::CollectLabels(args) => collect_labels::run(args, line),
            Self::LiftLabels(args) => lift_labels::run(args, line),
            Self::Evaluate(args) => evaluate::run(args, line),
            Self::Merge(args) => merge::run(args, line),
            Self::Render(args) => render::run(args, line),
            Self::Simulate(args) => simulate::run(args, line),
            Self::Optimise(args) => optimise::run(args, line),
            Self::Curate(args) => curate::run(args, line),
            Self::Compare(args) => compare::run(args),
            Self::Convert(args) => convert::run(args),
            Self::Train(args) => train::run(args),
            Self::Probe(args) => probe::run(args),
            Self::Reconstruct(args) => reconstruct::run(args, line),
            Self::Codes(args) => codes::run(args, line),
            Self::Prepare(args) => prepare::run(args, line),
            Self::Chunk(args) => chunk::run(args),
            Self::Weights(args) => weights::run(args, line),
            Self::Bench(args) => bench::run(args),
            Self::Doctor(args) => doctor::run(args),
            Self::Pareto(args) => pareto::run(args),
            Self::ParetoPoint(args) => pareto::run_point(args),
        }
    }
}

/// Prints the error of a command, or that its results did not get out, and gives the exit code.
fn end(done: anyhow::Result<()>) -> u8 {
    let Err(e) = done.and_then(|()| terminal::check_output()) else { return 0 };
    if e.downcast_ref::<Saved>().is_some() {
        return 4;
    }
    terminal::print_error(&e);
    match () {
        () if e.downcast_ref::<WrongUse>().is_some() => 2,
        () if e.downcast_ref::<many::SomeFailed>().is_some() => 3,
        () => 1,
    }
}
