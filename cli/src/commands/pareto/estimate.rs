//! How long a grid will take, before it is measured.

use super::campaign::{Beside, Campaign, Labels};
use super::inputs::Set;
use crate::commands::WrongUse;
use anyhow::Result;
use scenesplat::Setting;
use scenesplat::pareto::{Kind, Record, Records, seconds_text};
use scenesplat::setting::Passes;

/// Work of a setting against that of the reference, roughly: voxels of a surface grow with the inverse
/// square of their size, and passes add up. Other parts are taken to change nothing.
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
    // Reading, voting and writing do not become less.
    (voxels * passes(setting) / passes(reference)).max(0.25)
}

/// Seconds that the settings will take that are not in the records, from one run of the reference on
/// the first scene of each set.
pub fn estimate(
    campaign: &Campaign<'_>,
    settings: &[Setting],
    records: &Records,
    neutral: usize,
) -> Result<f64> {
    let mut total = 0.0;
    let passes = campaign.repeats as f64 + 2.0;
    for set in campaign.sets {
        let [whole, load] = cost(campaign, set, records)?;
        let scenes = set.scenes.len() as f64;
        for setting in settings {
            if records.find(Kind::Setting, &setting.to_string(), None, &set.name).is_none() {
                total += load + work(setting, &campaign.grid.reference) * whole * scenes * passes;
            }
        }
        total += neutral as f64 * (load + whole * scenes * 3.0);
    }
    Ok(total)
}

/// Seconds of a scene with the reference, and of a process around it.
fn cost(campaign: &Campaign<'_>, set: &Set, records: &Records) -> Result<[f64; 2]> {
    let reference = &campaign.grid.reference;
    let of = |r: &Record| [r.seconds_p50, r.load_seconds + 0.2];
    if let Some(record) = records.find(Kind::Setting, &reference.to_string(), None, &set.name) {
        return Ok(of(record));
    }
    let first = Set { scenes: set.scenes.iter().take(1).cloned().collect(), ..set.clone() };
    let nowhere = Labels { folder: None, keep: false };
    let [record, ..] = campaign.measure(reference, &first, 1, &Beside::default(), nowhere)?;
    Ok(of(&record))
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
        assert_eq!(of("voxel=1"), 0.25);
        assert!(check(10.0, 3, 20.0).is_ok());
        let error = check(50_000.0, 10_000, 600.0).unwrap_err().to_string();
        assert!(error.contains("10000 settings") && error.contains("13.9 h"), "{error}");
    }
}
