//! Reproduces the figures of the documentation, and makes the files of the network inside the program:
//!
//!     cargo run --release -p scenesplat-lab --example lab -- NAME ARGUMENTS
//!
//! | name | arguments, with what is taken where they are left out |
//! |---|---|
//! | `effect-thresholds` | folder, first seed, rooms, effects (all) |
//! | `embedded-assets` | folders of models, whose mean is taken: makes all of `assets/embedded`; `SCENESPLAT_FURNITURE` |
//! | `half-labels` | folder, a scene (a file, or `synthetic:SEED:ROOM`, `scanned:` or `furnished:`), seed (0) |
//! | `objects-of-rooms` | rooms (20), seed (2026) |
//! | `picture-effects` | first room (200), rooms (8) |
//! | `poses` | poses of each scene, `own` or `any` unit, scenes (files, `synthetic:SEED` or `furnished:SEED`) |
//! | `recognition` | scenes: `+FILE` for a room, `-FILE` for what is none, `@N` for N parts of it |
//! | `refined-objects` | rooms (20), seed (777), then a scene with labels and instances, names of its labels, their map |
//! | `room-edits` | rooms, seed, folder of a model (embedded), part of the names of lines (all) |
//! | `self-supervised-terms` | experiment, steps (5), sums of terms (all) |
//! | `yardsticks` | none |

mod effect_costs;
mod effect_thresholds;
mod embedded_assets;
mod half_labels;
mod objects_of_rooms;
mod picture_effects;
mod poses;
mod recognition;
mod refined_objects;
mod room_edits;
mod self_supervised_terms;
mod yardsticks;

use anyhow::{Context, Result, bail};
use std::error::Error;
use std::str::FromStr;

/// The words behind the name of a measurement.
pub struct Arguments(std::iter::Skip<std::env::Args>);

impl Arguments {
    /// The next word.
    pub fn word(&mut self) -> Option<String> {
        self.0.next()
    }

    /// The next word as a value; `question`: what is wrong without it.
    pub fn needed<T: FromStr<Err: Error + Send + Sync + 'static>>(
        &mut self,
        question: &'static str,
    ) -> Result<T> {
        self.word().context(question)?.parse().context(question)
    }

    /// The next word as a value, or the usual one.
    pub fn or<T: FromStr<Err: Error + Send + Sync + 'static>>(&mut self, usual: T) -> Result<T> {
        Ok(self.word().map(|word| word.parse()).transpose()?.unwrap_or(usual))
    }
}

fn main() -> Result<()> {
    let mut args = Arguments(std::env::args().skip(1));
    let name = args.word().context("which measurement? See the head of this program.")?;
    match name.as_str() {
        "effect-thresholds" => effect_thresholds::run(args),
        "embedded-assets" => embedded_assets::run(args),
        "half-labels" => half_labels::run(args),
        "objects-of-rooms" => objects_of_rooms::run(args),
        "picture-effects" => picture_effects::run(args),
        "poses" => poses::run(args),
        "recognition" => recognition::run(args),
        "refined-objects" => refined_objects::run(args),
        "room-edits" => room_edits::run(args),
        "self-supervised-terms" => self_supervised_terms::run(args),
        "yardsticks" => yardsticks::run(),
        _ => bail!("there is no measurement {name:?}"),
    }
}
