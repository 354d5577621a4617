//! What most commands begin with: the output folder, the scene, the network.
//!
//! In the order of a run: [`Session::start`] here, scenes and the source of features in `open.rs`, the network in
//! `network.rs`, its run in `encode.rs`, results and the receipt in `write.rs`.

mod alignment;
mod encode;
mod network;
mod open;
mod recognition;
mod write;

use crate::budget::Chosen;
use crate::flags::{Inference, NetworkArgs, Shared};
use crate::outputs::Outputs;
use crate::progress::{Progress, interrupted};
use crate::receipt::Receipt;
use crate::terminal::print;
use anyhow::{Context, Result};
pub use open::FeatureSource;
use scenesplat::Network;
use scenesplat::alignment::Alignment;
use scenesplat::inference::EncodeError;
use scenesplat::kernels::simd::Isa;
use scenesplat::network::{NetworkChoice, Weights};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::frame_files::{FoundFiles, FrameFiles};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a caller in this process holds, so that it need not be read.
struct Held {
    /// Scenes that have not been asked for yet.
    scenes: RefCell<Vec<OpenedScene>>,
    /// The network that the flags name.
    network: Option<Arc<Network>>,
}

/// A running command.
pub struct Session<'a> {
    /// Shared flags.
    pub shared: &'a Shared,
    /// What is recorded.
    pub receipt: Receipt,
    /// What is shown.
    pub progress: Progress,
    /// What is read and written.
    pub outputs: Outputs,
    written: RefCell<Vec<(PathBuf, u64)>>,
    /// What makes the results doubtful; files say it, too.
    doubts: RefCell<Vec<String>>,
    /// The scene, where a budget had to look at it before.
    input: RefCell<Option<(OpenedScene, Option<String>)>>,
    /// What the caller holds, where the command is a function of another program.
    held: Option<Held>,
    /// How the scene of this file lies, and whether its walls were looked at: one answer for network, boxes and
    /// pictures.
    aligned: RefCell<Option<(PathBuf, bool, Alignment)>>,
}

impl<'a> Session<'a> {
    /// Sets up threads, the output folder, Ctrl-C and the receipt.
    pub fn start(shared: &'a Shared, command: &str) -> Result<Self> {
        let progress = Progress::start(&shared.running)?;
        let receipt = Receipt::new(format!("scenesplat {command}"));
        receipt.computation("f32", Isa::current().name());
        receipt.threads(rayon::current_num_threads());
        let outputs = Outputs::new(&shared.out);
        outputs.claim_any("--receipt", shared.receipt.as_ref())?;
        let (written, doubts, input, aligned) = Default::default();
        let held = None;
        Ok(Self { shared, receipt, progress, outputs, written, doubts, input, held, aligned })
    }

    /// Takes scenes, which go by their paths, and a network that the caller holds, for those that the flags name.
    pub fn hold(&mut self, scenes: Vec<OpenedScene>, network: Option<Arc<Network>>) {
        self.held = Some(Held { scenes: RefCell::new(scenes), network });
    }

    /// As [`start`](Self::start) for a command with a network, whose files are inputs.
    pub fn start_with(shared: &'a Shared, network: &NetworkArgs, command: &str) -> Result<Self> {
        let session = Self::start(shared, command)?;
        if let Some(Weights::File(path)) = &network.weights {
            session.outputs.reads(path)?;
        }
        if let Some(NetworkChoice::File(path)) = &network.config {
            session.outputs.reads(path)?;
        }
        Ok(session)
    }

    /// As [`start`](Self::start) for a command that runs a network by a setting, which `chosen` says if a budget chose
    /// it.
    pub fn start_network(
        shared: &'a Shared,
        inference: &Inference,
        chosen: Option<Chosen>,
        command: &str,
    ) -> Result<Self> {
        let session = Self::start_with(shared, &inference.network, command)?;
        session.note_setting(inference);
        session.note_budget(chosen);
        Ok(session)
    }

    /// Records the setting, in its canonical form.
    fn note_setting(&self, inference: &Inference) {
        if !inference.effective.is_empty() {
            let why = "the parts that --setting and flags name (docs/settings.md)";
            self.receipt.setting("setting", &inference.effective, why);
        }
    }

    /// Reports and records the setting that a budget chose, and keeps the scene that it was chosen for.
    fn note_budget(&self, chosen: Option<Chosen>) {
        let Some(chosen) = chosen else { return };
        for remark in &chosen.remarks {
            self.warn(remark);
        }
        self.receipt.budget(chosen.report, chosen.began);
        *self.input.borrow_mut() = Some(chosen.input);
    }

    /// Prints a warning on standard error, also if quiet, and records it; each once.
    pub fn warn(&self, text: impl Into<String>) {
        let text = text.into();
        if self.progress.warn(&text) {
            self.receipt.warning(text);
        }
    }

    /// The files of some kind that belong to cameras, in the folder that a flag names; says how many were found.
    ///
    /// # Errors
    /// If the folder cannot be read, two files fit one camera, or none has one.
    pub fn files_of_cameras(
        &self,
        (flag, folder): (&str, &Path),
        (what, endings): (&str, &[&str]),
        cameras: &[&str],
    ) -> Result<Vec<Option<PathBuf>>> {
        let files = FrameFiles::open(folder, endings).context(flag.to_owned())?;
        let found = files.find(cameras)?;
        anyhow::ensure!(
            found.num_found() > 0,
            "{flag} {}: holds the {what} of none of the {} cameras ({:?}, …)",
            folder.display(),
            cameras.len(),
            cameras.first().unwrap_or(&"")
        );
        self.tell_found(what, &found);
        Ok(found.files.iter().map(|file| file.map(|file| files.path(file))).collect())
    }

    /// Says how many cameras have a file of some kind and how many have none; if any, that is a warning.
    pub fn tell_found(&self, what: &str, found: &FoundFiles) {
        let text = found.text(what);
        self.receipt.setting(&format!("found/{what}"), found.num_found(), &text);
        if found.missing.is_empty() {
            self.progress.say(text);
        } else {
            self.warn(text);
        }
    }

    /// As [`doubt`](Self::doubt), between asterisks.
    pub fn warn_loudly(&self, text: impl Into<String>) {
        let text = text.into();
        self.note_doubt(&text);
        if self.progress.warn(&format!("*** {text} ***")) {
            self.receipt.warning(text);
        }
    }

    /// Prints a part of the answer, unless quiet: for commands whose files are what they are run for.
    pub fn tell(&self, text: impl AsRef<str>) {
        if !self.shared.running.quiet {
            print(text.as_ref());
        }
    }

    /// As [`warn`](Self::warn), of what makes the results doubtful: the files tell those who did not see the terminal.
    pub fn doubt(&self, text: impl Into<String>) {
        let text = text.into();
        self.note_doubt(&text);
        self.warn(text);
    }

    /// What makes the results doubtful, as far as it was warned of.
    pub fn doubts(&self) -> Vec<String> {
        self.doubts.borrow().clone()
    }

    fn note_doubt(&self, text: &str) {
        let mut doubts = self.doubts.borrow_mut();
        if !doubts.iter().any(|known| known == text) {
            doubts.push(text.to_owned());
        }
    }

    /// Stops here if the user asked to.
    pub fn check_stop(&self) -> Result<()> {
        if interrupted() { Err(EncodeError::Stopped.into()) } else { Ok(()) }
    }
}
