//! What each effect of a capture costs the labels of the network inside the program, by severity.

use anyhow::Result;
use scenesplat::Weights;
use scenesplat::effect_costs::EffectCosts;
use scenesplat_lab::severity::{CurveSettings, severity_curves};
use std::path::Path;

/// Measures the network in `assets`, whose SHA-256 is `hash`.
pub fn write(assets: &Path, hash: String) -> Result<()> {
    let settings = CurveSettings {
        rooms: 8,
        gaussians: 30_000,
        weights: Weights::File(assets.to_path_buf()),
        ..CurveSettings::default()
    };
    let report = severity_curves(&settings, &mut |step, share| {
        eprint!("\r{:3.0} % {step:<20}", 100.0 * share);
        true
    })?;
    println!("{report}");
    let f_miou = report
        .curves
        .iter()
        .map(|curve| (curve.effect.clone(), curve.points.iter().map(|p| p.f_miou).collect()))
        .collect();
    let costs = EffectCosts {
        weights: hash,
        rooms: report.rooms,
        gaussians: report.gaussians,
        severities: settings.severities,
        f_miou,
    };
    let path = assets.join("effect_costs.json");
    std::fs::write(&path, serde_json::to_string_pretty(&costs)? + "\n")?;
    println!("wrote {}", path.display());
    Ok(())
}
