//! What each effect of a capture costs the labels of the network inside the program, by severity.

use crate::Arguments;
use anyhow::Result;
use scenesplat::effect_costs::EffectCosts;
use scenesplat::embedded;
use scenesplat_lab::severity::{CurveSettings, severity_curves};
use std::path::Path;

pub fn run(mut args: Arguments) -> Result<()> {
    let settings = CurveSettings {
        rooms: args.or(12)?,
        gaussians: args.or(40_000)?,
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
        weights: embedded::sha256(),
        rooms: report.rooms,
        gaussians: report.gaussians,
        severities: settings.severities,
        f_miou,
    };
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/embedded/effect_costs.json");
    std::fs::write(&path, serde_json::to_string_pretty(&costs)? + "\n")?;
    println!("wrote {}", path.display());
    Ok(())
}
