//! What a command did and what it cost: times by stage, memory, rows, bytes, the settings that
//! changed the result, repairs, fingerprints of weights and inputs, and the machine.
//!
//! A [`Receipt`] records while the command runs; [`Receipt::finish`] gives a [`ReceiptReport`],
//! which prints as a table and is written as JSON.

mod error;
mod fingerprint;
mod report;

pub use error::ReceiptError;
pub use fingerprint::sha256_of;
pub use report::{
    BudgetReport, FileFingerprint, ReceiptReport, SettingUsed, StageTime, WrittenFile, thousands,
};

use crate::defaults::{self, Taken};
use scenesplat::alignment::AlignmentReport;
use scenesplat::datasets::effects::plan::{EffectDecision, EffectPlan, PlanSection};
use scenesplat::effect_costs::FoundEffect;
pub use scenesplat::machine::Machine;
use scenesplat::machine::peak_memory_bytes;
use std::cell::RefCell;
use std::fmt;
use std::path::Path;
use std::time::{Duration, Instant};

/// The name of the stage that holds the time outside all others.
pub const OTHER_STAGE: &str = "other";

/// Records a running command. Belongs to the thread that runs the command.
#[derive(Debug)]
pub struct Receipt {
    start: Instant,
    clock: RefCell<Clock>,
    report: RefCell<ReceiptReport>,
    budget: RefCell<Option<(BudgetReport, Instant)>>,
}

#[derive(Debug, Default)]
struct Clock {
    /// Stages in the order in which they first began.
    stages: Vec<(String, Duration, u64)>,
    /// Indices of the running stages, outermost first, and when they began.
    running: Vec<(usize, Instant)>,
}

/// Ends its stage when dropped.
#[derive(Debug)]
#[must_use = "the stage ends when this is dropped"]
pub struct StageGuard<'a> {
    receipt: &'a Receipt,
    depth: usize,
}

/// The flags that a file gave to the command of this thread.
fn of_file() -> Vec<SettingUsed> {
    let Some((file, taken)) = defaults::taken() else { return Vec::new() };
    let why = file.display().to_string();
    let used = |Taken { flag, value }: Taken| SettingUsed {
        name: format!("--{flag}"),
        value: value.unwrap_or_else(|| "true".to_owned()),
        why: why.clone(),
    };
    taken.into_iter().map(used).collect()
}

impl Receipt {
    /// Starts the clock.
    pub fn new(command: impl Into<String>) -> Self {
        let report = ReceiptReport {
            command: command.into(),
            machine: Machine::detect(),
            defaults: of_file(),
            ..ReceiptReport::default()
        };
        Self {
            start: Instant::now(),
            clock: RefCell::default(),
            report: RefCell::new(report),
            budget: RefCell::default(),
        }
    }

    /// Begins a stage; it ends when the guard is dropped. A stage begun meanwhile is a part of it.
    /// Stages of the same name, inside the same stages, are added up.
    pub fn stage(&self, name: &str) -> StageGuard<'_> {
        let mut clock = self.clock.borrow_mut();
        let full_name = match clock.running.last() {
            Some(&(outer, _)) => format!("{}/{name}", clock.stages[outer].0),
            None => name.to_owned(),
        };
        let index = clock.stages.iter().position(|s| s.0 == full_name).unwrap_or_else(|| {
            clock.stages.push((full_name, Duration::ZERO, 0));
            clock.stages.len() - 1
        });
        let depth = clock.running.len();
        clock.running.push((index, Instant::now()));
        StageGuard { receipt: self, depth }
    }

    /// Runs `work` as a stage.
    #[cfg(test)]
    pub fn time<T>(&self, name: &str, work: impl FnOnce() -> T) -> T {
        let _stage = self.stage(name);
        work()
    }

    /// Adds to the rows read.
    pub fn add_rows_in(&self, rows: usize) {
        self.report.borrow_mut().rows_in += rows as u64;
    }

    /// Adds to the rows written.
    pub fn add_rows_out(&self, rows: usize) {
        self.report.borrow_mut().rows_out += rows as u64;
    }

    /// Adds to the bytes written.
    pub fn add_bytes_written(&self, bytes: u64) {
        self.report.borrow_mut().bytes_written += bytes;
    }

    /// Notes a setting that changed the result; a second note of the same name replaces the first.
    pub fn setting(&self, name: &str, value: impl fmt::Display, why: &str) {
        let used =
            SettingUsed { name: name.to_owned(), value: value.to_string(), why: why.to_owned() };
        let settings = &mut self.report.borrow_mut().settings;
        match settings.iter_mut().find(|s| s.name == name) {
            Some(known) => *known = used,
            None => settings.push(used),
        }
    }

    /// The value of a setting that was noted.
    pub fn setting_of(&self, name: &str) -> Option<String> {
        let report = self.report.borrow();
        report.settings.iter().find(|s| s.name == name).map(|s| s.value.clone())
    }

    /// Notes a warning or a repair.
    pub fn warning(&self, text: impl Into<String>) {
        self.report.borrow_mut().warnings.push(text.into());
    }

    /// Notes how the scene is read.
    pub fn alignment(&self, report: AlignmentReport) {
        self.report.borrow_mut().alignment = Some(report);
    }

    /// Notes the files that were written.
    pub fn written(&self, files: Vec<WrittenFile>) {
        self.report.borrow_mut().written = files;
    }

    /// Notes the number type of the computation and the instruction set of the kernels.
    pub fn computation(&self, dtype: &str, simd: &str) {
        let machine = &mut self.report.borrow_mut().machine;
        machine.dtype = dtype.to_owned();
        machine.simd = simd.to_owned();
    }

    /// Notes the number of threads that work; before, it is the size of the current thread pool.
    pub fn threads(&self, threads: usize) {
        self.report.borrow_mut().machine.threads = threads;
    }

    /// Notes a file whose hash is known already.
    pub fn fingerprint_known(&self, role: &str, path: &Path, bytes: u64, sha256: &str) {
        self.report.borrow_mut().files.push(FileFingerprint {
            role: role.to_owned(),
            path: path.display().to_string(),
            bytes,
            sha256: sha256.to_owned(),
        });
    }

    /// Notes what a file or folder contains. Its time is a stage of its own: reading a file a second
    /// time is what a receipt costs.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn fingerprint(&self, role: &str, path: &Path) -> Result<(), ReceiptError> {
        let _stage = self.stage("fingerprint");
        let (sha256, bytes) = sha256_of(path)?;
        let path = path.display().to_string();
        let file = FileFingerprint { role: role.to_owned(), path, bytes, sha256 };
        self.report.borrow_mut().files.push(file);
        Ok(())
    }

    /// The hash of the last file of a role that was noted.
    pub fn sha256_of_role(&self, role: &str) -> Option<String> {
        let report = self.report.borrow();
        report.files.iter().rev().find(|file| file.role == role).map(|file| file.sha256.clone())
    }

    /// Notes what was decided about a scene of so many Gaussians.
    pub fn plan(&self, gaussians: usize, section: PlanSection) {
        self.with_plan(gaussians, |plan| plan.put(section));
    }

    /// Notes one more decision about a scene of so many Gaussians.
    pub fn decided(&self, gaussians: usize, section: &str, decision: EffectDecision) {
        self.with_plan(gaussians, |plan| plan.add(section, decision));
    }

    fn with_plan(&self, gaussians: usize, change: impl FnOnce(&mut EffectPlan)) {
        let mut report = self.report.borrow_mut();
        let plan = report.effect_plan.get_or_insert_with(EffectPlan::default);
        plan.gaussians = gaussians;
        change(plan);
    }

    /// Notes the effects that a scene shows.
    pub fn effects(&self, found: &[FoundEffect]) {
        self.report.borrow_mut().effects = found.to_vec();
    }

    /// A part of the plan as text; empty where there is none.
    pub fn plan_text(&self, section: &str) -> String {
        let report = self.report.borrow();
        let found = report.effect_plan.as_ref().and_then(|plan| plan.section(section));
        found.map_or_else(String::new, ToString::to_string)
    }

    /// Notes a setting that was chosen by a budget; `began`: since when time is spent.
    pub fn budget(&self, report: BudgetReport, began: Instant) {
        *self.budget.borrow_mut() = Some((report, began));
    }

    /// Stops the clock. Stages still running end now.
    pub fn finish(&self) -> ReceiptReport {
        self.end_stages(0);
        let wall = self.start.elapsed();
        let clock = self.clock.borrow();
        let mut report = self.report.borrow().clone();
        let staged: Duration =
            clock.stages.iter().filter(|s| !s.0.contains('/')).map(|s| s.1).sum();
        let mut stages = clock.stages.clone();
        stages.push((OTHER_STAGE.to_owned(), wall.saturating_sub(staged), 1));
        let total = wall.as_secs_f64();
        report.wall_seconds = total;
        report.stages = stages
            .into_iter()
            .map(|(name, time, runs)| {
                let seconds = time.as_secs_f64();
                let share = if total > 0.0 { seconds / total } else { 0.0 };
                StageTime { name, seconds, share, runs }
            })
            .collect();
        report.peak_memory_bytes = peak_memory_bytes();
        report.budget = self.budget.borrow().clone().map(|(budget, began)| {
            let spent_s = began.elapsed().as_secs_f64();
            BudgetReport { spent_s, ..budget }
        });
        report
    }

    /// Ends the running stages from `depth` on, the innermost first.
    fn end_stages(&self, depth: usize) {
        let now = Instant::now();
        let mut clock = self.clock.borrow_mut();
        while clock.running.len() > depth {
            if let Some((index, began)) = clock.running.pop() {
                clock.stages[index].1 += now - began;
                clock.stages[index].2 += 1;
            }
        }
    }
}

impl Drop for StageGuard<'_> {
    fn drop(&mut self) {
        self.receipt.end_stages(self.depth);
    }
}

#[cfg(test)]
mod tests;
