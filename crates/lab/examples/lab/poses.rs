//! Whether labels depend on how a scene lies: `lab poses COUNT own|any SCENES...`, scenes as files or as
//! `synthetic:SEED`, `furnished:SEED` (models held out of `SCENESPLAT_FURNITURE`).

use crate::Arguments;
use anyhow::{Context, bail};
use scenesplat::input::open_input;
use scenesplat::rooms::{FurnitureSplit, SyntheticRoomSettings, generate};
use scenesplat::scene::{GaussianScene, ReadOptions, StatedUp};
use scenesplat_lab::poses::{Labeller, PoseResult, poses};
use std::env;

/// Names the catalogue of furniture.
const FURNITURE: &str = "SCENESPLAT_FURNITURE";

/// Share of the labels that a pose without a warning keeps at least.
const LEAST_SAME: f64 = 0.95;

pub fn run(mut args: Arguments) -> anyhow::Result<()> {
    let count: u64 = args.needed("how many poses of each scene?")?;
    let any_unit = match args.word().as_deref() {
        Some("own") => false,
        Some("any") => true,
        _ => bail!("in their own unit, or in any unit?"),
    };
    let labeller = Labeller::embedded()?;
    println!(
        "{:<40} {:>6} {:>6} {:>6} {:>6} {:>7} {:>5} {:>5}",
        "scene", "median", "worst", "tilt", "worst", "unit", "warn", "bad"
    );
    while let Some(name) = args.word() {
        let (scene, stated_up) = open(&name)?;
        let results =
            poses(&labeller, &scene, stated_up, (47, count), any_unit, |r| eprintln!("{r:?}"))?;
        report(&name, &results);
    }
    Ok(())
}

fn open(name: &str) -> anyhow::Result<(GaussianScene, StatedUp)> {
    let usual = SyntheticRoomSettings::default();
    let settings = match name.split_once(':') {
        Some(("synthetic", seed)) => {
            SyntheticRoomSettings { seed: seed.parse().context("synthetic:SEED")?, ..usual }
        }
        Some(("furnished", seed)) => SyntheticRoomSettings {
            seed: seed.parse().context("furnished:SEED")?,
            furniture: Some(env::var_os(FURNITURE).context(FURNITURE)?.into()),
            furniture_split: FurnitureSplit::HeldOut,
            ..usual
        },
        _ => {
            let (opened, _) = open_input(name.as_ref(), &ReadOptions::default())?;
            return Ok((opened.loaded.scene, opened.loaded.stated_up));
        }
    };
    Ok((generate(&settings)?.scene, StatedUp::UPRIGHT))
}

fn report(name: &str, results: &[PoseResult]) {
    let sorted = |of: fn(&PoseResult) -> f64| {
        let mut values: Vec<f64> = results.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let (same, tilt) = (sorted(|r| r.same), sorted(|r| r.tilt));
    let unit = sorted(|r| (r.unit.ln().abs()).exp() - 1.0);
    let middle = results.len() / 2;
    let warned = results.iter().filter(|r| r.is_warned).count();
    let bad = results.iter().filter(|r| !r.is_warned && r.same < LEAST_SAME).count();
    let at = |values: &[f64], i: usize| values.get(i).copied().unwrap_or(f64::NAN);
    println!(
        "{name:<40} {:>6.3} {:>6.3} {:>6.3} {:>6.2} {:>7.3} {warned:>5} {bad:>5}",
        at(&same, middle),
        at(&same, 0),
        at(&tilt, middle),
        at(&tilt, results.len().saturating_sub(1)),
        at(&unit, middle),
    );
}
