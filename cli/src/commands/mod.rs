//! The commands of the program. Exit codes: 0 done, 1 failed, 2 wrong use, 3 some of many scenes failed, 4 a
//! training stopped and saved.

mod adapt;
mod answer;
mod app;
mod bench;
mod chunk;
mod classes;
mod codes;
mod collect_labels;
mod compare;
mod completions;
mod convert;
mod curate;
mod demo;
mod doctor;
pub(crate) mod evaluate;
pub(crate) mod features;
pub(crate) mod inspect;
mod labelled;
mod lift_labels;
mod man;
mod many;
mod meant;
mod merge;
pub(crate) mod objects;
mod optimise;
mod overview;
mod pareto;
mod phrase;
mod prepare;
mod probe;
pub(crate) mod query;
mod reconstruct;
mod render;
mod room;
mod schema;
mod segment;
mod serve;
mod simulate;
mod text;
mod train;
mod view;
mod weights;

pub use labelled::{LabelArgs, Labelled, Labelling};

use crate::defaults::{self, Defaults};
use crate::error::{Saved, WrongUse};
use crate::log::{self, Level, LogFormat};
use crate::{terminal, version};
use anyhow::Result;
use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;
use std::path::Path;

/// Language features, labels and queries for scenes of 3D Gaussians, on a plain CPU.
#[derive(Debug, Parser)]
#[command(name = "scenesplat", version, long_version = version::long(), about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Fails where there is a warning; no results are put in place then.
    #[arg(long, global = true)]
    warnings_as_errors: bool,
    /// Also prints what was done step by step, and the receipt: stages, settings, files.
    #[arg(short, long, global = true)]
    verbose: bool,
    /// Form of messages and progress on standard error: text, or json, one object a line.
    #[arg(
        long,
        global = true,
        value_enum,
        value_name = "text|json",
        default_value_t,
        hide_possible_values = true
    )]
    log_format: LogFormat,
    /// Takes no values of flags from a file (scenesplat.toml; docs/command_line.md).
    #[arg(long, global = true)]
    no_config: bool,
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
    /// From the frames of a room to labels, objects and a page: one command.
    Room(room::Args),
    /// Finds the Gaussians of an object by its name.
    Query(query::Args),
    /// Lists, boxes and exports the objects of a scene.
    Objects(objects::Args),
    /// Writes one HTML file to look at a scene and query it, without a server.
    View(view::Args),
    /// Writes one HTML file that labels scenes in a browser, by itself and offline.
    App(app::Args),
    /// Answers questions about a scene to a program that speaks the Model Context Protocol.
    Serve(Box<serve::Args>),
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
    /// Teaches a network the labels of one scene, beside synthetic rooms.
    Adapt(Box<adapt::Args>),
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
    /// Prints a JSON schema of the files that `train` or `pareto` reads, for editors.
    Schema(schema::Args),
    /// Measures the speed of this machine.
    Bench(bench::Args),
    /// Runs hard cases on this machine: damaged files, numbers at the edge, operators against f64.
    Doctor(doctor::Args),
    /// Measures what accuracy costs in time: a grid of settings on labeled scenes.
    Pareto(pareto::Args),
    /// Prints a script by which a shell completes commands and flags.
    Completions(completions::Args),
    /// Writes man pages: one of the program, and one of each command.
    Man(man::Args),
    /// One setting, in this process: what `pareto` starts itself with.
    #[command(hide = true)]
    ParetoPoint(pareto::PointArgs),
}

/// The program's command line, with groups and examples in its help.
fn program() -> clap::Command {
    overview::dressed(Cli::command())
}

/// Runs the program on the given arguments, the first of which is its name, with the file of defaults, if there is one.
/// Gives the exit code.
pub fn run(args: impl IntoIterator<Item = OsString>, file: Option<&Path>) -> u8 {
    let args: Vec<OsString> = args.into_iter().collect();
    let line = args.iter().skip(1).map(|a| a.to_string_lossy()).collect::<Vec<_>>().join(" ");
    log::set_format(log::format_in(&args));
    let mut command = program();
    let args = match with_defaults(&mut command, args, file) {
        Ok(args) => args,
        Err(error) => return end(Err(error)),
    };
    let matches = command.try_get_matches_from_mut(&args);
    if let Ok(matches) = &matches {
        begin(matches);
        if log::is_verbose() && is_quiet(matches) {
            return end(Err(WrongUse("--quiet and --verbose: give one of them".to_owned()).into()));
        }
    }
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
            tell_tips(&e, &args);
            2
        }
    }
}

/// The arguments, and the flags of the file that they do not give.
fn with_defaults(
    command: &mut clap::Command,
    args: Vec<OsString>,
    file: Option<&Path>,
) -> Result<Vec<OsString>> {
    defaults::note(None);
    let of_shell = |word: &OsString| ["completions", "man", "help"].iter().any(|name| word == name);
    let is_off = args.iter().any(|word| word == "--no-config") || args.get(1).is_some_and(of_shell);
    let Some(file) = file.filter(|_| !is_off) else { return Ok(args) };
    command.build();
    let defaults = Defaults::read(file)?;
    let (args, taken) = defaults.complete(command, &args)?;
    defaults::note(Some((defaults.path().to_owned(), taken)));
    Ok(args)
}

/// Says what a file gave, in the form that the command line or that file asks for.
fn begin(matches: &clap::ArgMatches) {
    log::set_verbose(matches.get_flag("verbose"));
    log::set_format(matches.get_one("log_format").copied().unwrap_or_default());
    if let Some((file, taken)) = defaults::taken() {
        let words: Vec<String> = taken.iter().map(defaults::Taken::word).collect();
        let text = format!("{}: {} (--no-config ignores it)", file.display(), words.join(" "));
        terminal::say(Level::Info, &text);
    }
}

/// Whether the command, which may know no such flag, was asked to be quiet.
fn is_quiet(matches: &clap::ArgMatches) -> bool {
    let asked = matches.subcommand().and_then(|(_, of)| of.try_get_one::<bool>("quiet").ok()?);
    asked.copied().unwrap_or(false)
}

/// Says what may help after a command line that cannot be understood.
fn tell_tips(error: &clap::Error, args: &[OsString]) {
    let is_train = args.get(1).is_some_and(|a| a == "train");
    if error.kind() == ErrorKind::UnknownArgument && is_train {
        let tip = "tip: settings of the file are changed as in --set trainer.epochs=3";
        terminal::say(Level::Info, tip);
    }
    if let Some((file, taken)) = defaults::taken() {
        let words: Vec<String> = taken.iter().map(defaults::Taken::word).collect();
        let file = file.display();
        let tip = format!("tip: {file} gave {}; --no-config ignores it", words.join(" "));
        terminal::say(Level::Info, &tip);
    }
}

impl Command {
    fn run(&self, line: &str) -> anyhow::Result<()> {
        match self {
            Self::Demo(args) => demo::run(args, line),
            Self::Inspect(args) => inspect::run(args, line),
            Self::Features(args) => features::run(args, line),
            Self::Segment(args) => segment::run(args, line),
            Self::Room(args) => room::run(args, line),
            Self::Query(args) => query::run(args, line),
            Self::Objects(args) => objects::run(args, line),
            Self::View(args) => view::run(args, line),
            Self::App(args) => app::run(args, line),
            Self::Serve(args) => serve::run(args, line),
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
            Self::Adapt(args) => adapt::run(args, line),
            Self::Probe(args) => probe::run(args),
            Self::Reconstruct(args) => reconstruct::run(args, line),
            Self::Codes(args) => codes::run(args, line),
            Self::Prepare(args) => prepare::run(args, line),
            Self::Chunk(args) => chunk::run(args),
            Self::Weights(args) => weights::run(args, line),
            Self::Schema(args) => schema::run(args),
            Self::Bench(args) => bench::run(args),
            Self::Doctor(args) => doctor::run(args),
            Self::Pareto(args) => pareto::run(args),
            Self::Completions(args) => completions::run(args, program()),
            Self::Man(args) => man::run(args, program()),
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
