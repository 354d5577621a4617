//! The commands of the program. Exit codes: 0 done, 1 failed, 2 wrong use, 3 some of many scenes failed.

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
mod evaluate;
mod features;
mod inspect;
pub(crate) mod labelled;
mod lift_labels;
mod many;
mod merge;
mod objects;
mod optimise;
mod pareto;
mod prepare;
mod probe;
mod query;
mod reconstruct;
mod render;
mod segment;
mod simulate;
mod text;
mod train;
mod view;
mod weights;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;

/// Language features, labels and queries for scenes of 3D Gaussians, on a plain CPU.
#[derive(Debug, Parser)]
#[command(name = "scenesplat", version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
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
    /// Measures what accuracy costs in time: a grid of settings on labelled scenes.
    Pareto(pareto::Args),
    /// One setting, in this process: what `pareto` starts itself with.
    #[command(hide = true)]
    ParetoPoint(pareto::PointArgs),
}

/// The command line is right in form but asks for something that does not fit together.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct WrongUse(pub String);

/// Runs the program on the given arguments, the first of which is its name.
pub fn run(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let args: Vec<OsString> = args.into_iter().collect();
    let line = args.iter().skip(1).map(|a| a.to_string_lossy()).collect::<Vec<_>>().join(" ");
    let mut command = Cli::command();
    let matches = command.try_get_matches_from_mut(&args);
    let asked = matches.as_ref().ok().map(|matches| many::asked(matches));
    if let Some(Ok(Some(many))) = asked {
        return end(many.run(&command).and_then(|()| crate::terminal::check_output()));
    }
    let parsed = matches.and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed.map_err(|error| error.format(&mut command)) {
        Ok(cli) => cli,
        Err(e) => {
            // Help and version are no errors.
            let code = if e.use_stderr() { 2 } else { 0 };
            if code == 0 {
                crate::terminal::note(e.print());
                return end(crate::terminal::check_output());
            }
            let _ = e.print();
            return ExitCode::from(code);
        }
    };
    let done = match &cli.command {
        Command::Demo(args) => demo::run(args, &line),
        Command::Inspect(args) => inspect::run(args, &line),
        Command::Features(args) => features::run(args, &line),
        Command::Segment(args) => segment::run(args, &line),
        Command::Query(args) => query::run(args, &line),
        Command::Objects(args) => objects::run(args, &line),
        Command::View(args) => view::run(args, &line),
        Command::Text(args) => text::run(args),
        Command::CollectLabels(args) => collect_labels::run(args, &line),
        Command::LiftLabels(args) => lift_labels::run(args, &line),
        Command::Evaluate(args) => evaluate::run(args, &line),
        Command::Merge(args) => merge::run(args, &line),
        Command::Render(args) => render::run(args, &line),
        Command::Simulate(args) => simulate::run(args, &line),
        Command::Optimise(args) => optimise::run(args, &line),
        Command::Curate(args) => curate::run(args, &line),
        Command::Compare(args) => compare::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Train(args) => train::run(args),
        Command::Probe(args) => probe::run(args),
        Command::Reconstruct(args) => reconstruct::run(args, &line),
        Command::Codes(args) => codes::run(args, &line),
        Command::Prepare(args) => prepare::run(args, &line),
        Command::Chunk(args) => chunk::run(args),
        Command::Weights(args) => weights::run(args, &line),
        Command::Bench(args) => bench::run(args),
        Command::Doctor(args) => doctor::run(args),
        Command::Pareto(args) => pareto::run(args),
        Command::ParetoPoint(args) => pareto::run_point(args),
    };
    // An error of the command comes first; results that did not get out are one, too.
    end(done.and_then(|()| crate::terminal::check_output()))
}

fn end(done: anyhow::Result<()>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            crate::terminal::print_error(&e);
            let code = match () {
                () if e.downcast_ref::<WrongUse>().is_some() => 2,
                () if e.downcast_ref::<many::SomeFailed>().is_some() => 3,
                () => 1,
            };
            ExitCode::from(code)
        }
    }
}
