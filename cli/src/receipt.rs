//! What a command did and what it cost: times by stage, memory, rows, bytes, the settings that
//! changed the result, repairs, fingerprints of weights and inputs, and the machine.
//!
//! A [`Receipt`] records while the command runs; [`Receipt::finish`] gives a [`ReceiptReport`],
//! which prints as a table and is written as JSON.

use crate::defaults::{self, Taken};
use scenesplat::alignment::AlignmentReport;
use scenesplat::datasets::effects::plan::{EffectDecision, EffectPlan, PlanSection};
use scenesplat::effect_costs::FoundEffect;
pub use scenesplat::machine::Machine;
use scenesplat::machine::peak_memory_bytes;
use scenesplat::scene::SceneError;
use scenesplat::scene::input_file::open_regular_file;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::cell::RefCell;
use std::fmt;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Why a receipt could not be made or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReceiptError {
    /// A file could not be read or written.
    #[error("{}: {action}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        #[source]
        source: std::io::Error,
    },
    /// It is no file that can be read.
    #[error(transparent)]
    Input(#[from] SceneError),
    /// The report could not be put into JSON.
    #[error("the receipt cannot be written as JSON")]
    Json(#[from] serde_json::Error),
}

/// Characters of the widest value to whose width the other values of a receipt are padded.
const WIDEST_COLUMN: usize = 24;

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

/// A finished receipt. Field names are stable.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ReceiptReport {
    /// The command, as typed or named.
    pub command: String,
    /// Wall time, seconds.
    pub wall_seconds: f64,
    /// Times. The stages without `/` in their names add up to the wall time; `a/b` is a part of `a`.
    pub stages: Vec<StageTime>,
    /// Largest resident memory of the process, bytes; `None` where the system does not tell.
    pub peak_memory_bytes: Option<u64>,
    /// Rows (Gaussians) read.
    pub rows_in: u64,
    /// Rows (Gaussians) written.
    pub rows_out: u64,
    /// Bytes of the files written.
    pub bytes_written: u64,
    /// Settings that changed the result.
    pub settings: Vec<SettingUsed>,
    /// Flags that a file of defaults gave, and which file.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub defaults: Vec<SettingUsed>,
    /// Warnings and repairs, in the order in which they came up.
    pub warnings: Vec<String>,
    /// Weights and inputs.
    pub files: Vec<FileFingerprint>,
    /// The files that were written, the receipt aside.
    #[serde(default)]
    pub written: Vec<WrittenFile>,
    /// Where it ran.
    pub machine: Machine,
    /// What was expected of a setting that was chosen by a budget, and what became of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<BudgetReport>,
    /// What was decided about the scene, with evidence, to be followed again by `--effect-plan`; of the last scene
    /// where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effect_plan: Option<EffectPlan>,
    /// Effects of the capture that a labeled scene shows, with what they cost and what to do about them; of the last
    /// scene where there are several.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<FoundEffect>,
    /// How the network, or what measures the scene, reads it; of the last scene where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alignment: Option<AlignmentReport>,
}

/// The budget in a receipt.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct BudgetReport {
    /// Seconds asked for; none if quality alone was.
    pub asked_s: Option<f64>,
    /// Seconds that the command was expected to take.
    pub expected_s: f64,
    /// Seconds that it took, choosing included.
    pub spent_s: f64,
    /// The setting that was chosen.
    pub setting: String,
}

/// Time spent in one stage.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StageTime {
    /// Name; nested stages carry the names around them: `network/attention`.
    pub name: String,
    /// Seconds, all runs together.
    pub seconds: f64,
    /// Share of the wall time, 0..=1.
    pub share: f64,
    /// How often the stage ran.
    pub runs: u64,
}

/// A setting that changed the result.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettingUsed {
    /// Name, as in the command line or file.
    pub name: String,
    /// Its value.
    pub value: String,
    /// Where the value came from or what it does.
    pub why: String,
}

/// A file that was written.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WrittenFile {
    /// Where: from the output folder on, if it is in there.
    pub path: String,
    /// Size, bytes.
    pub bytes: u64,
}

/// What a file or folder contained.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileFingerprint {
    /// What the file was for: `weights`, `input`, …
    pub role: String,
    /// Where it was.
    pub path: String,
    /// Size, bytes; of all files of a folder.
    pub bytes: u64,
    /// SHA-256 in hexadecimal. Of a folder: of the sorted lines `<relative path>\0<sha256>\n`.
    pub sha256: String,
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

impl ReceiptReport {
    /// The plan of a receipt, or of a file that is one, in JSON.
    ///
    /// # Errors
    /// If the text is neither.
    pub fn plan_in(text: &str) -> Result<EffectPlan, serde_json::Error> {
        #[derive(Deserialize)]
        struct WithPlan {
            effect_plan: EffectPlan,
        }
        let value: serde_json::Value = serde_json::from_str(text)?;
        match value.get("sections") {
            Some(_) => serde_json::from_value(value),
            None => Ok(serde_json::from_value::<WithPlan>(value)?.effect_plan),
        }
    }

    /// The report as JSON.
    ///
    /// # Errors
    /// If a number is not finite.
    pub fn to_json(&self) -> Result<String, ReceiptError> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Time of a stage, seconds; 0 if it did not run.
    #[cfg(test)]
    pub fn seconds(&self, stage: &str) -> f64 {
        self.stages.iter().find(|s| s.name == stage).map_or(0.0, |s| s.seconds)
    }
}

impl fmt::Display for ReceiptReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.command)?;
        let label = |stage: &StageTime| {
            let depth = stage.name.matches('/').count();
            let last = stage.name.rsplit('/').next().unwrap_or_default();
            let runs = if stage.runs > 1 { format!(" ×{}", stage.runs) } else { String::new() };
            format!("{}{last}{runs}", "  ".repeat(depth))
        };
        let labels: Vec<String> = self.stages.iter().map(label).collect();
        let width = labels.iter().map(|l| l.chars().count()).max().unwrap_or(0).max(5);
        for (stage, label) in self.stages.iter().zip(&labels) {
            let (seconds, percent) = (stage.seconds, 100.0 * stage.share);
            writeln!(f, "  {label:width$}  {seconds:>9.3} s  {percent:>5.1} %")?;
        }
        writeln!(f, "  {:width$}  {:>9.3} s", "total", self.wall_seconds)?;
        let peak = self.peak_memory_bytes.map_or_else(|| "not known".to_owned(), bytes_text);
        writeln!(f, "  peak memory {peak}")?;
        writeln!(
            f,
            "  rows in {}, out {}; written {}",
            thousands(self.rows_in),
            thousands(self.rows_out),
            bytes_text(self.bytes_written)
        )?;
        let name_width = self.settings.iter().map(|s| s.name.chars().count()).max().unwrap_or(0);
        // A long value, such as a plan, stands for itself: the others are not padded to its length.
        let widths = self.settings.iter().map(|s| s.value.chars().count());
        let value_width = widths.filter(|&width| width <= WIDEST_COLUMN).max().unwrap_or(0);
        for SettingUsed { name, value, why } in &self.settings {
            writeln!(f, "  set {name:name_width$} = {value:value_width$}  {why}")?;
        }
        for SettingUsed { name, value, why } in &self.defaults {
            writeln!(f, "  {name} {value} by {why}")?;
        }
        for file in &self.files {
            let hash = file.sha256.get(..16).unwrap_or(&file.sha256);
            writeln!(
                f,
                "  {} {}: {}, sha256 {hash}…",
                file.role,
                file.path,
                bytes_text(file.bytes)
            )?;
        }
        match self.warnings.len() {
            0 => {}
            1 => writeln!(f, "  a warning, told above")?,
            count => writeln!(f, "  {count} warnings, told above")?,
        }
        if let Some(BudgetReport { asked_s, expected_s, spent_s, setting }) = &self.budget {
            let asked = asked_s.map_or("no time".to_owned(), |s| format!("{s:.3} s"));
            writeln!(
                f,
                "  budget: {asked} asked for, {expected_s:.3} s expected, {spent_s:.3} s spent: \
                 {setting}"
            )?;
        }
        writeln!(f, "  {}", self.machine)
    }
}

/// SHA-256 in hexadecimal and size of a file, or of all files of a folder.
///
/// Files are read in pieces, so size does not matter.
///
/// # Errors
/// If something cannot be read.
pub fn sha256_of(path: &Path) -> Result<(String, u64), ReceiptError> {
    let mut hasher = Sha256::new();
    let mut bytes = 0;
    if path.is_dir() {
        let mut files = Vec::new();
        collect_files(path, &mut files)?;
        let mut lines = Vec::with_capacity(files.len());
        for file in files {
            let (hash, size) = sha256_of(&file)?;
            let relative = file.strip_prefix(path).unwrap_or(&file);
            // One spelling on all systems.
            let parts: Vec<_> = relative.iter().map(|p| p.to_string_lossy()).collect();
            lines.push(format!("{}\0{hash}\n", parts.join("/")));
            bytes += size;
        }
        lines.sort_unstable();
        for line in lines {
            hasher.update(line.as_bytes());
        }
    } else {
        let io = |source| ReceiptError::Io {
            path: path.to_owned(),
            action: "cannot read the file for its fingerprint",
            source,
        };
        // A pipe would be waited for.
        let mut file = open_regular_file(path)?;
        let mut piece = vec![0; 1 << 20];
        loop {
            match file.read(&mut piece) {
                Ok(0) => break,
                Ok(read) => {
                    hasher.update(&piece[..read]);
                    bytes += read as u64;
                }
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(io(error)),
            }
        }
    }
    let hash = hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok((hash, bytes))
}

fn collect_files(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), ReceiptError> {
    let io = |source| ReceiptError::Io {
        path: folder.to_owned(),
        action: "cannot list the folder for its fingerprint",
        source,
    };
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let entry = entry.map_err(io)?;
        // Links are not followed into folders: they may lead round in a circle.
        if entry.file_type().map_err(io)?.is_dir() {
            collect_files(&entry.path(), files)?;
        } else if entry.path().is_file() {
            files.push(entry.path());
        }
    }
    Ok(())
}

fn bytes_text(bytes: u64) -> String {
    let bytes_f = bytes as f64;
    match bytes {
        0..10_000 => format!("{bytes} B"),
        10_000..10_000_000 => format!("{:.1} kB", bytes_f / 1e3),
        10_000_000..10_000_000_000 => format!("{:.1} MB", bytes_f / 1e6),
        _ => format!("{:.1} GB", bytes_f / 1e9),
    }
}

fn thousands(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sleep(ms: u64) {
        std::thread::sleep(Duration::from_millis(ms));
    }

    #[test]
    fn stages_add_up_to_the_wall_time() {
        let receipt = Receipt::new("test");
        receipt.time("read", || sleep(5));
        for _ in 0..2 {
            let _network = receipt.stage("network");
            receipt.time("conv", || sleep(4));
            receipt.time("attention", || sleep(2));
        }
        sleep(3);
        let report = receipt.finish();
        let names: Vec<&str> = report.stages.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["read", "network", "network/conv", "network/attention", "other"]);
        let outer: f64 =
            report.stages.iter().filter(|s| !s.name.contains('/')).map(|s| s.seconds).sum();
        assert!((outer - report.wall_seconds).abs() < 1e-6, "{outer} {}", report.wall_seconds);
        let shares: f64 =
            report.stages.iter().filter(|s| !s.name.contains('/')).map(|s| s.share).sum();
        assert!((shares - 1.0).abs() < 1e-6);
        let parts = report.seconds("network/conv") + report.seconds("network/attention");
        assert!(parts <= report.seconds("network") && parts >= 0.012);
        assert!(report.seconds(OTHER_STAGE) >= 0.003);
        assert_eq!(report.stages[2].runs, 2);
    }

    #[test]
    fn guards_may_end_in_any_order() {
        let receipt = Receipt::new("test");
        let outer = receipt.stage("outer");
        let inner = receipt.stage("inner");
        drop(outer);
        drop(inner);
        let _running = receipt.stage("still running");
        let report = receipt.finish();
        assert_eq!(report.stages.len(), 4);
        assert!(report.stages.iter().all(|s| s.runs == 1));
    }

    #[test]
    fn json_returns_unchanged_and_is_renamed_into_place() {
        let receipt = Receipt::new("encode room.ply");
        receipt.add_rows_in(1_234_567);
        receipt.add_rows_out(5);
        receipt.add_bytes_written(10);
        receipt.setting("grid_size", 0.02, "default");
        receipt.setting("grid_size", 0.05, "command line");
        receipt.warning("3 zero quaternions became the identity");
        receipt.computation("f32", "avx512");
        receipt.threads(2);
        let report = receipt.finish();
        let text = report.to_json().unwrap();
        let back: ReceiptReport = serde_json::from_str(&text).unwrap();
        assert_eq!(back.settings, report.settings);
        assert_eq!(back.settings.len(), 1);
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        let mut names: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
        names.sort_unstable();
        assert_eq!(
            names,
            [
                "bytes_written",
                "command",
                "files",
                "machine",
                "peak_memory_bytes",
                "rows_in",
                "rows_out",
                "settings",
                "stages",
                "wall_seconds",
                "warnings",
                "written"
            ]
        );
        let table = report.to_string();
        for part in ["1 234 567", "grid_size = 0.05", "a warning", "avx512, f32", "total"] {
            assert!(table.contains(part), "{part} in\n{table}");
        }
    }

    #[test]
    fn a_long_value_does_not_widen_the_lines_of_others() {
        let receipt = Receipt::new("render room.ply");
        receipt.setting("plan", "p".repeat(480), "what is computed");
        receipt.setting("preset", "gsplat-1.6", "constants");
        receipt.setting("depth_scale", 1000, "steps");
        let table = receipt.finish().to_string();
        assert!(table.contains("= gsplat-1.6  constants"), "{table}");
        assert!(table.contains("= 1000        steps"), "{table}");
        assert!(!table.contains(&" ".repeat(30)), "{table}");
    }

    #[test]
    fn fingerprints_of_files_and_folders() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("b.npy"), b"abc").unwrap();
        std::fs::create_dir(folder.path().join("sub")).unwrap();
        std::fs::write(folder.path().join("sub/a.npy"), b"").unwrap();
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_of(&folder.path().join("b.npy")).unwrap(), (abc.to_owned(), 3));
        let (before, bytes) = sha256_of(folder.path()).unwrap();
        assert_eq!(bytes, 3);
        std::fs::rename(folder.path().join("b.npy"), folder.path().join("c.npy")).unwrap();
        assert_ne!(sha256_of(folder.path()).unwrap().0, before);
        let receipt = Receipt::new("test");
        assert!(receipt.fingerprint("input", &folder.path().join("none")).is_err());
        receipt
            .time("read", || receipt.fingerprint("weights", &folder.path().join("c.npy")))
            .unwrap();
        let report = receipt.finish();
        assert_eq!(report.files[0].sha256, abc);
        // The one that failed was begun outside of any stage.
        let runs = |name| report.stages.iter().find(|s| s.name == name).map(|s| s.runs);
        assert_eq!((runs("fingerprint"), runs("read/fingerprint")), (Some(1), Some(1)));
    }

    #[test]
    fn texts() {
        assert_eq!(
            [0, 999, 1000, 1_234_567].map(thousands),
            ["0", "999", "1 000", "1 234 567"].map(str::to_owned)
        );
        assert_eq!(bytes_text(12_345_678), "12.3 MB");
        if cfg!(target_os = "linux") {
            assert!(peak_memory_bytes().unwrap() > 1_000_000);
        }
    }
}
