//! How long a grid will take, before it is measured.

use super::campaign::{Beside, Campaign, Labels};
use super::inputs::Set;
use crate::error::WrongUse;
use anyhow::Result;
use scenesplat::Setting;
use scenesplat::setting::Passes;
use scenesplat_lab::pareto::{Kind, Records, seconds_text};
use std::path::Path;
use std::time::Instant;

/// Work of a setting against that of the reference, roughly: voxels of a surface grow with the inverse
/// square of their size, and passes and copies add up. Other parts are taken to change nothing.
fn work(setting: &Setting, reference: &Setting) -> f64 {
    let voxels = match (setting.voxel, reference.voxel) {
        (Some(own), Some(their)) => (their / own).powi(2),
        _ => 1.0,
    };
    // All passes of the original are eight at most on most surfaces.
    let passes = |s: &Setting| match s.passes {
        None => 1.0,
        Some(Passes::Count(n)) => n as f64,
        Some(Passes::All) => 8.0,
    };
    let copies = |s: &Setting| s.tta.unwrap_or(1) as f64;
    let runs = |s: &Setting| passes(s) * copies(s);
    // Reading, voting and writing do not become less.
    (voxels * runs(setting) / runs(reference)).max(0.25)
}

/// Seconds of a network on a set of scenes, by one run on the first of them.
#[derive(Debug, Clone, Copy)]
struct Price {
    /// A process before its first scene.
    start: f64,
    /// All scenes once, as they are timed.
    timed: f64,
    /// All scenes once more, scored.
    scored: f64,
}

impl Price {
    /// Of a setting that is `work` times as much: a warm-up, the repeats, and the run that is scored.
    fn of(&self, work: f64, repeats: usize) -> f64 {
        let scoring = (self.scored - self.timed).max(0.0);
        self.start + scoring + work * self.timed * (repeats as f64 + 2.0)
    }
}

/// Seconds that the settings and neutral rows will take that are not in the records. One run of each
/// network tells, on the first scene of each set.
pub fn estimate(
    campaign: &Campaign<'_>,
    settings: &[Setting],
    records: &Records,
    neutral: &[(String, Beside)],
) -> Result<f64> {
    let reference = &campaign.grid.reference;
    let mut total = 0.0;
    for set in campaign.sets {
        let mut prices: Vec<(Option<String>, Price)> = Vec::new();
        let mut price = |net: &Option<String>| -> Result<Price> {
            if let Some((_, known)) = prices.iter().find(|(name, _)| name == net) {
                return Ok(*known);
            }
            let found = probe(campaign, set, &Setting { net: net.clone(), ..reference.clone() })?;
            prices.push((net.clone(), found));
            Ok(found)
        };
        for setting in settings {
            if records.find(Kind::Setting, &setting.to_string(), None, &set.name).is_none() {
                total += price(&setting.net)?.of(work(setting, reference), campaign.repeats);
            }
        }
        for (row, beside) in neutral {
            let name = reference.to_string();
            if records.find(Kind::Neutral, &name, Some(row), &set.name).is_none() {
                // One thread takes as many times longer, at most, as there are threads.
                let here = campaign.machine.threads as f64;
                let slower = beside.threads.map_or(1.0, |threads| (here / threads as f64).max(1.0));
                total += price(&reference.net)?.of(slower, super::neutral::REPEATS);
            }
        }
    }
    Ok(total)
}

/// What a setting costs on a set, from its first scene and the sizes of the files.
fn probe(campaign: &Campaign<'_>, set: &Set, setting: &Setting) -> Result<Price> {
    let first = Set { scenes: set.scenes.iter().take(1).cloned().collect(), ..set.clone() };
    let nowhere = Labels { folder: None, keep: false };
    let began = Instant::now();
    let record = campaign.measure(setting, &first, 1, &Beside::default(), nowhere)?.setting;
    let wall = began.elapsed().as_secs_f64();
    let bytes = |set: &Set| -> u64 {
        let size = |path: &Path| std::fs::metadata(path).map_or(0, |file| file.len());
        set.scenes.iter().map(|scene| size(&scene.path)).sum()
    };
    let share = bytes(set) as f64 / bytes(&first).max(1) as f64;
    let (start, once) = (record.load_seconds + 0.2, record.seconds_p50);
    let scored = (wall - start - 2.0 * once).max(once);
    Ok(Price { start, timed: once * share, scored: scored * share })
}

/// Refuses what would take too long.
pub fn check(seconds: f64, settings: usize, limit: f64) -> Result<()> {
    if seconds <= limit {
        return Ok(());
    }
    Err(WrongUse(format!(
        "the grid has {settings} settings, which would take about {} here; the limit is {}. Give a \
         smaller --grid, fewer --scenes or --repeats, or a larger --limit",
        seconds_text(seconds),
        seconds_text(limit)
    ))
    .into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finer_voxels_and_more_passes_are_more_work() {
        let of = |text: &str| work(&text.parse().unwrap(), &"voxel=0.04,passes=1".parse().unwrap());
        assert_eq!(of("voxel=0.04"), 1.0);
        assert_eq!(of("voxel=0.02,passes=2"), 8.0);
        assert_eq!((of("tta=4"), of("passes=2,tta=4")), (4.0, 8.0));
        assert_eq!(of("voxel=1"), 0.25);
        // Two timed passes, a warm-up, and one that is scored: 10 s of them are no network.
        let price = Price { start: 1.0, timed: 3.0, scored: 13.0 };
        assert_eq!(price.of(2.0, 2), 1.0 + 10.0 + 4.0 * 6.0);
        assert!(check(10.0, 3, 20.0).is_ok());
        let error = check(50_000.0, 10_000, 600.0).unwrap_err().to_string();
        assert!(error.contains("10000 settings") && error.contains("13.9 h"), "{error}");
    }
}
