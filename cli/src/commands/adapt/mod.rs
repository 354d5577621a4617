//! `scenesplat adapt`

mod args;
mod lesson;
mod report;
mod state;

use super::train;
use crate::error::{Saved, refuse};
use crate::progress::{Progress, interrupted};
use crate::receipt::sha256_of;
use crate::session::Session;
use crate::terminal::print;
use crate::version;
use anyhow::{Context, Result};
pub use args::Args;
use candle_core::Device;
use lesson::Lesson;
use scenesplat::adaptation::{self, Figures, Folders};
use scenesplat::calibration::Calibration;
use scenesplat::experiment::furniture::ATTRIBUTION;
use scenesplat::experiment::{RunOptions, RunReport};
use scenesplat::inference::{EncodeError, EncodeProgress};
use scenesplat::network::{WeightOptions, Weights, network_of};
use scenesplat::trainers::checkpoint::newest_checkpoint;
use scenesplat::{Network, NetworkConfig};
use std::path::Path;
use std::sync::Arc;

/// What is left in the output folder, which is a model folder.
const MODEL: [&str; 2] = ["model.safetensors", "config.json"];
const CALIBRATION: &str = "calibration.json";
const FIGURES: &str = "adaptation.json";

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    match &args.weights {
        Weights::File(path) => session.outputs.reads(path)?,
        Weights::Seeded(_) => {
            refuse!("--weights seeded:N has nothing to keep; give a trained network, or embedded")
        }
        Weights::Embedded => {}
    }
    let names = [args.label_names.as_deref(), args.class_map.as_deref()];
    session.outputs.reads_any(names.into_iter().chain([Some(args.labels.as_path())]))?;
    session.outputs.open_folder(&[MODEL[0], MODEL[1], CALIBRATION, FIGURES, ATTRIBUTION])?;
    let config = network_of(&args.weights, None, &WeightOptions::default())?;
    let network = load(&config, &args.weights)?;
    report::note_weights(&session, &network, args);
    let texts = adaptation::class_texts(&network)?;
    let lesson = Lesson::read(args, &session, &network, texts)?;
    let folders = Folders::new(&args.shared.out);
    state::begin(args, &session, &folders)?;

    let before = {
        let _stage = session.receipt.stage("before");
        let calibration = Calibration::of(&args.weights)?;
        lesson.write(&network, &folders, &mut shown(&session.progress))?;
        session.progress.finish();
        figures(&lesson, &network, calibration.as_ref(), &session.progress)?
    };
    report::warn_of_strangers(&session, &before);
    let start = match &args.weights {
        Weights::File(path) => std::path::absolute(path).unwrap_or_else(|_| path.clone()),
        _ => adaptation::write_start(&folders)?,
    };
    let trained = {
        let _stage = session.receipt.stage("train");
        train_network(args, &config, &start, &folders)?
    };
    let at = trained.progress;
    if at.step < at.total_steps {
        print(&format!(
            "stopped at step {} of {}: the same command goes on",
            at.step, at.total_steps
        ));
        return Err(Saved.into());
    }
    let adapted =
        after(args, &session, &lesson, (&config, &before), (&start, &trained.model), &folders);
    if adapted.is_err() && interrupted() {
        print("stopped after the training: the same command goes on");
        return Err(Saved.into());
    }
    adapted?;
    session.finish()
}

/// The network of the weights before and those trained, what it knows, and its files.
fn after(
    args: &Args,
    session: &Session<'_>,
    lesson: &Lesson,
    (config, before): (&NetworkConfig, &Figures),
    (start, trained): (&Path, &Path),
    folders: &Folders,
) -> Result<()> {
    let _stage = session.receipt.stage("after");
    adaptation::write_blend(config, start, trained, args.share, folders)?;
    let model = folders.model();
    let adapted = load(config, &Weights::File(model.clone()))?;
    let weights = sha256_of(&model.join(MODEL[0]))?.0;
    let calibration = lesson.exam().calibrate(&adapted, weights, &mut shown(&session.progress))?;
    session.progress.finish();
    let after = figures(lesson, &adapted, Some(&calibration), &session.progress)?;
    drop(_stage);
    for name in MODEL {
        session.write(name, |path| std::fs::copy(model.join(name), path).map(drop))?;
    }
    let makers = trained.join(ATTRIBUTION);
    if makers.is_file() {
        session.write(ATTRIBUTION, |path| std::fs::copy(&makers, path).map(drop))?;
    }
    session.write_text(CALIBRATION, &serde_json::to_string_pretty(&calibration)?)?;
    report::write(session, args, lesson, [before, &after])?;
    report::tell(args, lesson, [before, &after], &calibration);
    Ok(())
}

/// Flags by which other commands read the scene as the network of this folder learned it.
pub fn flags(folder: &Path) -> Result<Vec<String>> {
    let path = folder.join(FIGURES);
    let place = || path.display().to_string();
    let text = std::fs::read(&path).with_context(place)?;
    let found: serde_json::Value = serde_json::from_slice(&text).with_context(place)?;
    let words = found["flags"].as_str().unwrap_or_default().split_whitespace();
    Ok(words.map(str::to_owned).collect())
}

fn load(config: &NetworkConfig, weights: &Weights) -> Result<Network> {
    Ok(Network::load(config.clone(), weights, WeightOptions::default())?)
}

fn figures(
    lesson: &Lesson,
    network: &Network,
    calibration: Option<&Calibration>,
    progress: &Progress,
) -> Result<Figures> {
    let found = lesson.exam().figures(network, calibration, &mut shown(progress));
    progress.finish();
    Ok(found?)
}

/// Shows how far networks are; stops where the user asks to.
fn shown(progress: &Progress) -> impl FnMut(&str, EncodeProgress) -> Result<(), EncodeError> + '_ {
    |what, at| {
        if interrupted() {
            return Err(EncodeError::Stopped);
        }
        progress.advance(&format!("network, {what}"), at.done);
        Ok(())
    }
}

/// Trains, or goes on with the training in the folder.
fn train_network(
    args: &Args,
    network: &NetworkConfig,
    start: &Path,
    folders: &Folders,
) -> Result<RunReport> {
    let config = adaptation::experiment(network, start.to_owned(), folders, &args.settings())?;
    let stop = Arc::default();
    train::watch(Arc::clone(&stop));
    let options = RunOptions {
        resume: newest_checkpoint(&folders.run().join("checkpoints"))?.is_some(),
        out: folders.run(),
        console: train::console(&args.shared.running),
        stop,
        device: Device::Cpu,
        commit: version::COMMIT.map(str::to_owned),
    };
    Ok(scenesplat::experiment::train(&config, &options)?)
}
