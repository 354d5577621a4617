//! `scenesplat train`

mod json_console;
mod ranks;
mod sweep;
mod trial;

use crate::error::{Saved, refuse};
use crate::flags::Running;
use crate::log;
use crate::progress::{interrupted, listen_for_interrupt};
use crate::terminal::{note_warning, print};
use crate::threads::set_threads;
use crate::version;
use anyhow::{Context, Result, anyhow};
use candle_core::Device;
use json_console::JsonConsole;
use scenesplat::datasets::Amount;
use scenesplat::experiment::{
    ExperimentConfig, ExperimentError, MakeConsole, RunOptions, RunReport, train_together,
};
use scenesplat::models::DeviceChoice;
use scenesplat::trainers::Collective;
use scenesplat::trainers::callbacks::Console;
use scenesplat::trainers::checkpoint::newest_checkpoint;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Trains a network as a file says; can be interrupted and resumed.
///
/// Ctrl-C saves and stops; `--resume` goes on, with the bits that an uninterrupted run has. Built with the feature mpi
/// and started by mpirun or srun, the ranks share the batches of each step (docs/training.md).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The experiment: data, network, losses, optimizer (see configs/). With --resume, the folder of a run will do.
    #[arg(value_name = "CONFIG.toml")]
    pub config: PathBuf,
    /// Changes a setting of the file: `optimizer.lr=1e-3`, `train.0.repeat=4`, `precision=bf16`; may be given several times.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub changes: Vec<String>,
    /// Trains once for each value of a setting: `optimizer.lr=[1e-3, 3e-4]`; may be given several times, then once for each
    /// combination. Each training has a folder of its own in that of the run, and sweep.csv compares them.
    #[arg(
        long, value_name = "KEY=[VALUES]",
        conflicts_with_all = ["resume", "fast_dev_run", "lr_find", "check"]
    )]
    pub sweep: Vec<String>,
    /// Folder of the run. [default: runs/ and the name of the file]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Goes on with the run in that folder.
    #[arg(long)]
    pub resume: bool,
    /// Starts anew or goes on, whichever applies.
    #[arg(long, conflicts_with = "resume")]
    pub resume_if_there: bool,
    /// Other seed of first values, order and augmentation than the file's.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
    /// Where the network is trained: cpu; cuda:0 (or another number), if the program was built for it (docs/devices.md);
    /// auto, which is cuda:0 if there is one, else cpu.
    #[arg(long, value_name = "DEVICE", default_value_t = DeviceChoice::Cpu)]
    pub device: DeviceChoice,
    /// Trains on N batches (1 if not said) and evaluates on N scenes of each evaluation, to see whether everything fits
    /// together; writes nothing.
    #[arg(
        long, value_name = "N", num_args = 0..=1, require_equals = true, default_missing_value = "1",
        conflicts_with_all = ["resume", "resume_if_there", "out", "check", "lr_find", "overfit", "limit_batches", "limit_evaluation"]
    )]
    pub fast_dev_run: Option<NonZeroUsize>,
    /// Trains on the first N batches again and again, and evaluates on their scenes: what can learn at all learns these
    /// by heart. The same as --set limits.overfit=N.
    #[arg(long, value_name = "N", conflicts_with = "limit_batches")]
    pub overfit: Option<NonZeroUsize>,
    /// Batches of each epoch: a number such as 10, or a share such as 0.1. The same as --set limits.train=N.
    #[arg(long, value_name = "N|SHARE")]
    pub limit_batches: Option<Amount>,
    /// Scenes of each evaluation, as --limit-batches. The same as --set limits.evaluate=N.
    #[arg(long, value_name = "N|SHARE")]
    pub limit_evaluation: Option<Amount>,
    /// Looks for a learning rate instead of training: N steps (100 if not said) with a rising rate. Writes lr_find.png
    /// and lr_find.csv into the folder, and changes nothing else.
    #[arg(
        long, value_name = "N", num_args = 0..=1, require_equals = true, default_missing_value = "100",
        value_parser = clap::value_parser!(u64).range(3..), conflicts_with_all = ["resume", "resume_if_there", "check"]
    )]
    pub lr_find: Option<u64>,
    /// Reads the experiment, prints it with everything that it extends, and trains nothing.
    #[arg(long)]
    pub check: bool,
}

impl Args {
    /// The changes of settings, those that have a flag of their own among them.
    fn all_changes(&self) -> Vec<String> {
        let limits = [
            ("overfit", self.overfit.map(|batches| batches.to_string())),
            ("train", self.limit_batches.map(|amount| amount.to_string())),
            ("evaluate", self.limit_evaluation.map(|amount| amount.to_string())),
        ];
        let limits = limits
            .into_iter()
            .filter_map(|(name, value)| Some(format!("limits.{name}={}", value?)));
        self.changes.iter().cloned().chain(limits).collect()
    }

    /// The flag that goes on with what is there.
    fn resuming(&self) -> &'static str {
        if self.sweep.is_empty() { "--resume" } else { "--resume-if-there" }
    }

    /// What shows the run.
    fn console(&self) -> Option<MakeConsole> {
        console(&self.running)
    }

    /// The file of the experiment, and the folder of the run.
    fn file_and_folder(&self) -> Result<(PathBuf, PathBuf)> {
        if self.config.is_dir() {
            let file = self.config.join("config.toml");
            if !(self.resume || self.resume_if_there || self.check) || self.out.is_some() {
                refuse!(
                    "{}: a folder is a run to go on with: give --resume and no --out, or a file",
                    self.config.display()
                );
            }
            return Ok((file, self.config.clone()));
        }
        let name = self.config.file_stem().unwrap_or_default();
        let out = self.out.clone().unwrap_or_else(|| PathBuf::from("runs").join(name));
        Ok((self.config.clone(), out))
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let (file, out) = args.file_and_folder()?;
    if !file.exists() {
        refuse!(
            "{}: there is no such file; give the TOML file of an experiment, such as those in configs/, or with --resume the \
             folder of a run",
            file.display()
        );
    }
    let mut config = ExperimentConfig::read_changed(&file, &args.all_changes())?;
    if let Some(seed) = args.seed {
        config.set_seed(seed);
    }
    if args.check {
        print(&toml::to_string_pretty(&config)?);
        return Ok(());
    }
    set_threads(args.running.threads)?;
    let device = args.device.open_for_training().context("--device")?;
    if let Some(why) = &device.fell_back {
        print(&format!("--device auto: training on the cpu: {why}"));
    } else if args.device != DeviceChoice::Cpu {
        print(&format!("device: {} ({})", args.device, device.name));
    }
    if let Some(batches) = args.fast_dev_run {
        return trial::try_out(args, &config, batches, &device.device);
    }
    if let Some(steps) = args.lr_find {
        return trial::search(&config, steps, &device.device, &out);
    }
    listen_for_interrupt()?;
    let stop = Arc::new(AtomicBool::new(false));
    watch(Arc::clone(&stop));
    let ranks = ranks::start(&device.device)?;
    let run = Start { args, device: device.device, stop, ranks };
    if !args.sweep.is_empty() {
        return sweep::run(&run, &file, &out);
    }
    let report = run.train(&config, out)?;
    if run.ranks.rank() == 0 {
        tell(&report, &config, args);
    }
    run.end(&report)
}

/// What trainings of one call have in common.
struct Start<'a> {
    args: &'a Args,
    device: Device,
    stop: Arc<AtomicBool>,
    ranks: Rc<dyn Collective>,
}

impl Start<'_> {
    /// Trains in a folder.
    fn train(&self, config: &ExperimentConfig, out: PathBuf) -> Result<RunReport> {
        let Self { args, device, stop, ranks } = self;
        let there = || newest_checkpoint(&out.join("checkpoints"));
        let resume = args.resume || (args.resume_if_there && there()?.is_some());
        if ranks.size() > 1 && ranks.rank() == 0 {
            let of = if config.trainer.sync_batch_norm { "all of them" } else { "its own batch" };
            let (size, carrier) = (ranks.size(), ranks.carrier());
            print(&format!(
                "{size} ranks share the batches of each step; a batch norm takes the statistics of {of}; gradients go by \
                 {carrier}"
            ));
        }
        let options = RunOptions {
            out,
            resume,
            console: args.console(),
            stop: Arc::clone(stop),
            device: device.clone(),
            commit: version::COMMIT.map(str::to_owned),
        };
        let done =
            train_together(config, &options, Rc::clone(ranks)).map_err(|error| match error {
                ExperimentError::HoldsRun { path } => anyhow!(
                    "{}: holds a run already; give {} to go on with it, or another --out",
                    path.display(),
                    args.resuming()
                ),
                other => other.into(),
            });
        ranks::all_end(&**ranks, done)
    }

    /// Whether a training was asked to stop before its end.
    fn end(&self, report: &RunReport) -> Result<()> {
        // Early stopping is an end like any other.
        let is_whole = report.progress.step >= report.progress.total_steps;
        if is_whole || !interrupted() { Ok(()) } else { Err(Saved.into()) }
    }
}

/// Prints what came of a training, the answer first.
fn tell(report: &RunReport, config: &ExperimentConfig, args: &Args) {
    let (at, outcome) = (report.progress, &report.outcome);
    let mut text = format!("{} of {} steps", at.step, at.total_steps);
    if let Some(loss) = outcome.loss {
        text += &format!(", loss {loss:.4}");
    }
    if let (Some(name), Some((value, step))) = (&config.trainer.checkpoint.best, outcome.best) {
        text += &format!(", best {name} {value:.4} at step {step}");
    }
    print(&text);
    let fallbacks = scenesplat::kernels::fallbacks::take();
    let fallbacks = fallbacks.iter().map(scenesplat::device::on_the_cpu);
    for warning in report.remarks.iter().cloned().chain(fallbacks) {
        note_warning(&warning);
        print(&warning);
    }
    print(&format!("weights: {}", report.model.display()));
    print(&format!("curves: {}, and curves.html beside it", report.curves.display()));
    if at.step < at.total_steps {
        let (step, of, flag) = (at.step, at.total_steps, args.resuming());
        print(&format!("stopped at step {step} of {of}: {flag} goes on"));
    }
}

/// What shows a training.
pub(super) fn console(running: &Running) -> Option<MakeConsole> {
    match (running.quiet, log::is_json()) {
        (true, _) => None,
        (false, true) => Some(|| Box::new(JsonConsole)),
        (false, false) => Some(|| Box::new(Console::new())),
    }
}

/// Sets `stop` when the user asks to stop.
pub(super) fn watch(stop: Arc<AtomicBool>) {
    std::thread::spawn(move || {
        while !interrupted() {
            std::thread::sleep(Duration::from_millis(50));
            if Arc::strong_count(&stop) == 1 {
                // The training is over.
                return;
            }
        }
        stop.store(true, Ordering::SeqCst);
    });
}
