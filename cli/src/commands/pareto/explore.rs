//! Which settings are measured, and which are not.

use super::campaign::Campaign;
use anyhow::Result;
use scenesplat::Setting;
use scenesplat_lab::pareto::{
    Around, Candidate, Grid, Kind, Records, RuledOut, Tried, order, points, ruled_out,
};
use std::time::Instant;

/// Measures the settings that have to be measured, the reference first.
pub fn explore(
    campaign: &Campaign<'_>,
    settings: &[Setting],
    records: &mut Records,
    around: &mut Around,
    began: Instant,
) -> Result<()> {
    let (grid, args) = (campaign.grid, campaign.args);
    if campaign.sets.is_empty() {
        // Training curves alone.
        return Ok(());
    }
    let sets: Vec<String> = campaign.sets.iter().map(|s| s.name.clone()).collect();
    let candidates = order(settings, &grid.axes);
    for (i, candidate) in candidates.iter().enumerate() {
        let setting: Setting = candidate.text.parse()?;
        let measured = sets
            .iter()
            .all(|set| records.find(Kind::Setting, &candidate.text, None, set).is_some());
        if !measured && i > 0 {
            if let Some(by) = skipped(grid, candidate, records, &sets) {
                campaign.progress.say(format!("  {} is ruled out by {}", by.setting, by.by));
                around.skipped.push(by);
                continue;
            }
            if began.elapsed().as_secs_f64() > args.limit.0 {
                around.unmeasured.push(candidate.text.clone());
                continue;
            }
        }
        campaign.progress.say(format!("{}/{}", i + 1, candidates.len()));
        campaign.complete(&setting, records, &args.out)?;
    }
    Ok(())
}

/// Why a candidate need not be measured, by what was measured so far.
fn skipped(
    grid: &Grid,
    candidate: &Candidate,
    records: &Records,
    sets: &[String],
) -> Option<RuledOut> {
    if !grid.skip {
        return None;
    }
    let tried = points(&records.all, Kind::Setting, sets).into_iter().filter_map(|point| {
        let setting: Setting = point.setting.parse().ok()?;
        Some(Tried {
            candidate: Candidate::new(&setting),
            cost: point.seconds_p50,
            worth: point.f_miou?,
        })
    });
    ruled_out(candidate, &tried.collect::<Vec<_>>(), &grid.axes)
}
