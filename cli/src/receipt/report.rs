//! A finished receipt: what it holds, as a table and as JSON.

use super::error::ReceiptError;
use scenesplat::alignment::AlignmentReport;
use scenesplat::datasets::effects::plan::EffectPlan;
use scenesplat::effect_costs::FoundEffect;
use scenesplat::machine::Machine;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Characters of the widest value to whose width the other values of a receipt are padded.
const WIDEST_COLUMN: usize = 24;

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

    /// Time and memory, in a few words.
    pub fn cost(&self) -> String {
        let peak = self.peak_memory_bytes.map(|bytes| format!(", {} of memory", bytes_text(bytes)));
        format!("{:.1} s{}", self.wall_seconds, peak.unwrap_or_default())
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

pub(super) fn bytes_text(bytes: u64) -> String {
    let bytes_f = bytes as f64;
    match bytes {
        0..10_000 => format!("{bytes} B"),
        10_000..10_000_000 => format!("{:.1} kB", bytes_f / 1e3),
        10_000_000..10_000_000_000 => format!("{:.1} MB", bytes_f / 1e6),
        _ => format!("{:.1} GB", bytes_f / 1e9),
    }
}

/// A number with spaces between thousands.
pub fn thousands(value: u64) -> String {
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
