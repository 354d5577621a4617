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
        Ok(serde_json::from_str(include_str!("../../../../assets/pareto/embedded.json"))?)
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
mod tests {
    use super::super::cost::tests::runs;
    use super::*;

    fn calibration() -> Calibration {
        let settings = [("voxel=0.06,k=25", 0.7), ("voxel=0.24,k=1", 0.6)];
        let settings = settings.map(|(s, f_miou)| Calibrated { setting: s.to_owned(), f_miou });
        Calibration {
            version: "0.1.0".to_owned(),
            machine: Machine::default(),
            fingerprint: "m".to_owned(),
            weights_hash: "w".to_owned(),
            f32_flop_s: 1e11,
            reference: "voxel=0.06,k=25".to_owned(),
            scenes: "synthetic:6:1022".to_owned(),
            width: 96,
            classes: 41,
            settings: settings.to_vec(),
            model: CostModel::fit(&runs()),
        }
    }

    fn size(setting: &str) -> Size {
        let fine = setting.ends_with("25");
        let (cell, k) = if fine { (3, 25) } else { (40, 1) };
        Size { gaussians: 120_000, voxels: 120_000 / cell, classes: 41, width: 96, k }
    }

    /// By hand: the fine setting takes 1.3 s, the coarse one 0.2 s.
    fn choose(ask: Ask, slower: f64) -> Result<Choice, BudgetError> {
        calibration().choose("segment", &ask, &mut size, slower, 0.0)
    }

    #[test]
    fn the_best_that_fits_is_chosen() {
        let within = |seconds| Ask { seconds: Some(seconds), ..Ask::default() };
        assert_eq!(choose(within(3.0), 1.0).unwrap().setting, "voxel=0.06,k=25");
        let coarse = choose(within(0.5), 1.0).unwrap();
        assert_eq!(coarse.setting, "voxel=0.24,k=1");
        assert!(coarse.seconds < 0.5 && (coarse.share - 6.0 / 7.0).abs() < 1e-9, "{coarse:?}");
        // A machine four times as slow.
        assert_eq!(choose(within(3.0), 4.0).unwrap().setting, "voxel=0.24,k=1");
        let error = choose(within(0.01), 1.0).unwrap_err().to_string();
        assert!(error.contains("the cheapest, voxel=0.24,k=1, takes about"), "{error}");
    }

    #[test]
    fn quality_and_memory_are_kept_too() {
        let good = Ask { min_quality: Some(0.95), ..Ask::default() };
        assert_eq!(choose(good, 1.0).unwrap().setting, "voxel=0.06,k=25");
        let any = Ask { min_quality: Some(0.5), ..Ask::default() };
        assert_eq!(choose(any, 1.0).unwrap().setting, "voxel=0.24,k=1");
        let both = Ask { seconds: Some(0.5), ..good };
        let error = choose(both, 1.0).unwrap_err().to_string();
        assert!(error.contains("voxel=0.06") && error.contains("good enough"), "{error}");
        let error = choose(Ask { min_quality: Some(1.01), ..Ask::default() }, 1.0).unwrap_err();
        assert!(matches!(error, BudgetError::Quality { .. }), "{error}");
        // 50 MB and 12 MB of Gaussians; 40 or 3 MB of voxels.
        let memory = |mb: u64| Ask {
            seconds: Some(9.0),
            max_memory: Some(mb * 1_000_000),
            ..Ask::default()
        };
        assert_eq!(choose(memory(80), 1.0).unwrap().setting, "voxel=0.24,k=1");
        assert_eq!(choose(memory(200), 1.0).unwrap().setting, "voxel=0.06,k=25");
        assert!(matches!(choose(memory(10), 1.0).unwrap_err(), BudgetError::Memory { .. }));
    }

    #[test]
    fn the_reserve_is_for_what_is_still_to_do() {
        // 1.24 s of work after 1.5 s that have passed: 1.5 + 1.1 · 1.24 = 2.86 s, not 1.1 · 2.74 = 3.01.
        let after = |seconds| {
            let ask = Ask { seconds: Some(seconds), ..Ask::default() };
            let choice = calibration().choose("segment", &ask, &mut size, 1.0, 1.5).unwrap();
            (choice.setting, choice.seconds)
        };
        let (setting, seconds) = after(2.95);
        assert_eq!(setting, "voxel=0.06,k=25");
        assert!((seconds - 2.74).abs() < 0.01, "{seconds}");
        assert_eq!(after(2.8).0, "voxel=0.24,k=1");
    }

    #[test]
    fn a_front_returns_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("front.json");
        std::fs::write(&path, serde_json::to_string(&calibration()).unwrap()).unwrap();
        let back = Calibration::read(&path).unwrap();
        assert_eq!(back.settings, calibration().settings);
        std::fs::write(&path, "{}").unwrap();
        assert!(Calibration::read(&path).unwrap_err().to_string().contains("front.json"));
        let shipped = Calibration::shipped().unwrap();
        assert_eq!(shipped.weights_hash, scenesplat::embedded::sha256());
        assert!(shipped.settings.len() >= 4);
    }

    #[test]
    fn a_slow_machine_makes_only_what_is_still_to_do_longer() {
        // 1.24 s of work after 1.5 s that have passed, four times as slow: 1.5 + 4 · 1.24 = 6.46 s.
        let ask = Ask { seconds: Some(100.0), ..Ask::default() };
        let choice = calibration().choose("segment", &ask, &mut size, 4.0, 1.5).unwrap();
        assert_eq!(choice.setting, "voxel=0.06,k=25");
        assert!((choice.seconds - 6.46).abs() < 0.05, "{}", choice.seconds);
    }

    #[test]
    fn the_margin_is_the_larger_of_error_and_reserve() {
        // 1.24 s of work with half more in reserve are 1.86 s; with a fifth more they would be 1.49 s.
        for (error, reserve) in [(0.5, 0.2), (0.2, 0.5)] {
            let mut calibration = calibration();
            (calibration.model.error, calibration.model.reserve) = (error, reserve);
            let within = |seconds| {
                let ask = Ask { seconds: Some(seconds), ..Ask::default() };
                calibration.choose("segment", &ask, &mut size, 1.0, 0.0).unwrap().setting
            };
            assert_eq!(within(1.95), "voxel=0.06,k=25", "{error} {reserve}");
            assert_eq!(within(1.7), "voxel=0.24,k=1", "{error} {reserve}");
        }
    }
}
