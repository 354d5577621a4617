//! Which setting to take where time, quality or memory is given: from a front that was measured.

use super::ParetoError;
use super::chart::seconds_text;
use super::cost::{CostModel, Size};
use scenesplat::machine::Machine;
use scenesplat::memory::Bytes;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A setting with what it is worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibrated {
    /// The setting in canonical form.
    pub setting: String,
    /// Its f-mIoU on the scenes of the calibration.
    pub f_miou: f64,
}

/// A front with the cost model of the machine that it was measured on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Version of the program.
    pub version: String,
    /// The machine.
    pub machine: Machine,
    /// [`Machine::fingerprint`].
    pub fingerprint: String,
    /// SHA-256 of the weights.
    pub weights_hash: String,
    /// Multiply–adds, two operations each, that all threads did in a second.
    pub f32_flop_s: f64,
    /// What quality is a share of.
    pub reference: String,
    /// The scenes that quality was measured on.
    pub scenes: String,
    /// Numbers of a feature.
    pub width: usize,
    /// Classes that competed.
    pub classes: usize,
    /// The settings to choose from.
    pub settings: Vec<Calibrated>,
    /// What they cost.
    pub model: CostModel,
}

/// What is asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Ask {
    /// Seconds that the whole command may take.
    pub seconds: Option<f64>,
    /// Least share of the reference's quality.
    pub min_quality: Option<f64>,
    /// Bytes that the process may take.
    pub max_memory: Option<u64>,
}

/// What was chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The setting.
    pub setting: String,
    /// Seconds that the whole command is expected to take.
    pub seconds: f64,
    /// Its f-mIoU on the scenes of the calibration.
    pub f_miou: f64,
    /// That as a share of the reference's.
    pub share: f64,
    /// Why it, in words.
    pub why: String,
}

/// Why there is nothing to choose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BudgetError {
    /// No setting keeps the budget.
    #[error(
        "no setting takes {} or less here; the cheapest{of_quality}, {setting}, takes about {}",
        seconds_text(*asked), seconds_text(*needed)
    )]
    Time {
        /// Seconds asked for.
        asked: f64,
        /// The cheapest setting.
        setting: String,
        /// Its price, seconds.
        needed: f64,
        /// Which of the settings were considered.
        of_quality: String,
    },
    /// No setting is as good.
    #[error("no setting keeps {:.1} % of the reference's quality; the best, {setting}, keeps {:.1} %", 100.0 * asked, 100.0 * best)]
    Quality {
        /// Share asked for.
        asked: f64,
        /// The best setting.
        setting: String,
        /// Its share.
        best: f64,
    },
    /// No setting fits into memory.
    #[error("no setting fits into {asked} here; {setting} needs least, about {needed}")]
    Memory {
        /// Bytes asked for.
        asked: Bytes,
        /// The setting that needs least.
        setting: String,
        /// What it needs.
        needed: Bytes,
    },
    /// The front holds nothing that can be used.
    #[error("the stored front has no setting for this command; make it again")]
    Nothing,
}

/// A setting that may be chosen.
#[derive(Clone, Copy)]
struct Candidate<'a> {
    calibrated: &'a Calibrated,
    seconds: f64,
    share: f64,
    peak: f64,
}

impl Candidate<'_> {
    fn setting(&self) -> String {
        self.calibrated.setting.clone()
    }
}

impl Calibration {
    /// Reads a stored one.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn read(path: &Path) -> Result<Self, ParetoError> {
        let text = std::fs::read_to_string(path)
            .map_err(ParetoError::io(path, "cannot read the front"))?;
        serde_json::from_str(&text).map_err(|error| ParetoError::Record {
            path: path.to_owned(),
            line: error.line(),
            text: error.to_string(),
        })
    }

    /// The front that comes with the program, of the network inside it.
    ///
    /// # Errors
    /// If the program was built with a broken file.
    pub fn shipped() -> Result<Self, ParetoError> {
        Ok(serde_json::from_str(scenesplat::shipped::PARETO_FRONT)?)
    }

    /// The best setting that keeps what is asked for: of those that fit, the one of the highest
    /// quality, the cheapest of equals; where no time is given, the cheapest.
    ///
    /// `size_of`: how large the work is with a setting. `slower`: how much longer this machine takes
    /// than that of the front. `spent`: seconds that have passed. Times are taken longer than the model
    /// says: by its own error or by what the slowest of twenty runs took more, at least a tenth.
    ///
    /// # Errors
    /// If nothing fits; the message has the cheapest setting and its price.
    pub fn choose(
        &self,
        command: &str,
        ask: &Ask,
        size_of: &mut dyn FnMut(&str) -> Size,
        slower: f64,
        spent: f64,
    ) -> Result<Choice, BudgetError> {
        let mut all = self.candidates(command, size_of, slower, spent);
        let count = all.len();
        let lightest = all.iter().min_by(|a, b| a.peak.total_cmp(&b.peak)).copied();
        let lightest = lightest.ok_or(BudgetError::Nothing)?;
        if let Some(limit) = ask.max_memory {
            all.retain(|o| o.peak <= limit as f64);
            if all.is_empty() {
                let (asked, needed) = (Bytes(limit), Bytes(lightest.peak as u64));
                return Err(BudgetError::Memory { asked, setting: lightest.setting(), needed });
            }
        }
        if let Some(asked) = ask.min_quality {
            let best = all.iter().max_by(|a, b| a.share.total_cmp(&b.share)).copied();
            all.retain(|o| o.share >= asked);
            if let (true, Some(best)) = (all.is_empty(), best) {
                let (setting, best) = (best.setting(), best.share);
                return Err(BudgetError::Quality { asked, setting, best });
            }
        }
        if let Some(asked) = ask.seconds {
            let margin = 1.0 + self.model.error.max(self.model.reserve).clamp(0.1, 0.6);
            let needed = |o: &Candidate<'_>| spent + (o.seconds - spent) * margin;
            let cheapest = all.iter().min_by(|a, b| a.seconds.total_cmp(&b.seconds)).copied();
            all.retain(|o| needed(o) <= asked);
            if let (true, Some(cheapest)) = (all.is_empty(), cheapest) {
                let (setting, needed) = (cheapest.setting(), needed(&cheapest));
                let of_quality =
                    ask.min_quality.map_or(String::new(), |_| " that is good enough".to_owned());
                return Err(BudgetError::Time { asked, setting, needed, of_quality });
            }
        }
        let cheaper = |a: &&Candidate<'_>, b: &&Candidate<'_>| b.seconds.total_cmp(&a.seconds);
        let better = |a: &&Candidate<'_>, b: &&Candidate<'_>| {
            a.calibrated.f_miou.total_cmp(&b.calibrated.f_miou)
        };
        let chosen = match ask.seconds {
            Some(_) => all.iter().max_by(|a, b| better(a, b).then(cheaper(a, b))),
            None => all.iter().max_by(|a, b| cheaper(a, b).then(better(a, b))),
        };
        let chosen = chosen.ok_or(BudgetError::Nothing)?;
        let what = if ask.seconds.is_some() { "the best" } else { "the cheapest" };
        let why = format!("{what} of {} settings that fit, of {count} measured", all.len());
        Ok(Choice {
            setting: chosen.setting(),
            seconds: chosen.seconds,
            f_miou: chosen.calibrated.f_miou,
            share: chosen.share,
            why,
        })
    }

    /// The settings whose cost is known.
    fn candidates(
        &self,
        command: &str,
        size_of: &mut dyn FnMut(&str) -> Size,
        slower: f64,
        spent: f64,
    ) -> Vec<Candidate<'_>> {
        let best = self.settings.iter().find(|c| c.setting == self.reference);
        let reference = best.map_or(f64::NAN, |c| c.f_miou);
        let candidates = self.settings.iter().filter_map(|calibrated| {
            let Calibrated { setting, f_miou } = calibrated;
            let size = size_of(setting);
            let seconds = spent + slower * self.model.seconds(command, setting, &size)?;
            let peak = self.model.peak_bytes(setting, &size)?;
            Some(Candidate { calibrated, seconds, share: f_miou / reference, peak })
        });
        candidates.collect()
    }
}

#[cfg(test)]
mod tests;
