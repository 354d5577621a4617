//! How large a scene is by what is in it: `lab yardsticks` compares `assets/embedded/yardsticks.json` with rooms that it was
//! not fitted to.

use scenesplat::embedded;
use scenesplat::yardsticks::Yardsticks;
use scenesplat_lab::reader::Reader;
use scenesplat_lab::yardsticks::{fitted, measured, rooms};
use std::path::Path;

/// Seeds of the rooms that they are fitted to, and of others.
const SEED: u64 = 6201;
const CHECKED: u64 = 6202;

/// Fits to made rooms. `weights`: SHA-256 of the network's.
pub fn write(reader: &Reader, weights: String, assets: &Path) -> anyhow::Result<()> {
    let texts = embedded::vocabulary()?.class_table();
    let found = fitted(reader, &texts, SEED, weights, |count| eprint!("\r{count} rooms"))?;
    let path = assets.join("yardsticks.json");
    std::fs::write(&path, serde_json::to_string_pretty(&found)? + "\n")?;
    println!("\nwrote {}: {} classes", path.display(), found.classes.len());
    Ok(())
}

/// How far off the units of other rooms are.
pub fn run() -> anyhow::Result<()> {
    let reader = &Reader::embedded()?;
    let texts = embedded::vocabulary()?.class_table();
    let known = Yardsticks::embedded()?;
    let (mut off, mut none) = (Vec::new(), 0);
    for scene in rooms(CHECKED) {
        for things in measured(reader, &texts, &scene?)? {
            match known.compare(&things) {
                Some(found) => off.push((found.factor.ln(), found.spread)),
                None => none += 1,
            }
        }
    }
    let mut errors: Vec<f64> = off.iter().map(|(e, _)| e.abs()).collect();
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors.get((share * errors.len() as f64) as usize).copied();
    println!("{} looks, {none} without two yardsticks", off.len());
    for share in [0.5, 0.7, 0.9, 0.95] {
        println!("{share}: off by less than {:.3} in ln", at(share).unwrap_or(f64::NAN));
    }
    // What is called by its own spread: how far yardsticks are off together besides.
    for own in [0.02, 0.03, 0.04, 0.05, 0.06] {
        let mean =
            off.iter().map(|(e, s)| e * e / (s * s + own * own)).sum::<f64>() / off.len() as f64;
        println!("with a spread of {own} of their own: {mean:.2} squared deviations");
    }
    Ok(())
}
