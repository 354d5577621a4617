//! What it is worth to do something about capture effects:
//! `cargo run --release -p scenesplat-lab --example effect_plans -- suite.json 24 2 20000 3` labels 24 damaged rooms of 20,000 Gaussians
//! (6 clean, 7 with one effect, 11 with two, at severity 3) with nothing done, as a plan decides by itself, with whatever
//! is found, and with everything; then each pair of effects on 2 rooms. A sixth argument such as `surface+blur` is the
//! one pair that is looked at.

use scenesplat::datasets::effects::Effect;
use scenesplat_lab::severity::{SuiteSettings, effect_suite};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let out = args.next().ok_or("which file for the figures?")?;
    let usual = SuiteSettings::default();
    let settings = SuiteSettings {
        scenes: args.next().map_or(Ok(usual.scenes), |n| n.parse())?,
        pair_rooms: args.next().map_or(Ok(usual.pair_rooms), |n| n.parse())?,
        gaussians: args.next().map_or(Ok(usual.gaussians), |n| n.parse())?,
        severity: args.next().map_or(Ok(usual.severity), |n| n.parse())?,
        pairs: match args.next() {
            None => Vec::new(),
            Some(names) => {
                let (a, b) = names.split_once('+').ok_or("two effects, as in surface+blur")?;
                vec![[Effect::named(a)?, Effect::named(b)?]]
            }
        },
        ..usual
    };
    let report = effect_suite(&settings, &mut |text, share| {
        eprintln!("{:3.0} %  {text}", 100.0 * share);
        true
    })?;
    println!("{report}");
    std::fs::write(out, serde_json::to_string_pretty(&report)?)?;
    Ok(())
}
