//! What compensating for effects is worth: the same damaged rooms with nothing done, with what a plan decides by itself,
//! with whatever is found, and with everything; and whether two effects together are worse than both.
//!
//! ```no_run
//! use scenesplat_lab::severity::{SuiteSettings, effect_suite};
//!
//! let report = effect_suite(&SuiteSettings::default(), &mut |_, _| true)?;
//! println!("{report}");
//! # Ok::<(), scenesplat_lab::severity::SeverityError>(())
//! ```

mod report;
mod score;
#[cfg(test)]
mod tests;

pub use report::{Figures, PairRow, SceneRow, SuiteReport, Worth};

use super::measure::Bench;
use super::{CurveSettings, SeverityError};
use crate::compensation::{Consumer, modules};
use scenesplat_datasets::effects::plan::{EffectChoice, EffectChoices};
use scenesplat_datasets::effects::profile::profile_of;
use scenesplat_datasets::effects::{Effect, EffectSet, simulate};
use scenesplat_scene::GaussianScene;
use score::Score;
use std::collections::BTreeMap;

/// Which rooms, and how damaged.
#[derive(Debug, Clone, PartialEq)]
pub struct SuiteSettings {
    /// Scenes of the mixed suite; each is another room.
    pub scenes: usize,
    /// Rooms for each pair of effects; 0 for no pairs.
    pub pair_rooms: usize,
    /// Which pairs; empty for all.
    pub pairs: Vec<[Effect; 2]>,
    /// Gaussians of each room.
    pub gaussians: usize,
    /// How severe each effect is, above 0 and up to 5.
    pub severity: f64,
    /// Seed of the rooms; those that the network inside the program was trained on have others.
    pub room_seed: u64,
    /// Seed of the damage.
    pub seed: u64,
}

impl Default for SuiteSettings {
    fn default() -> Self {
        Self {
            scenes: 24,
            pair_rooms: 2,
            pairs: Vec::new(),
            gaussians: 20_000,
            severity: 3.0,
            room_seed: 4711,
            seed: 1,
        }
    }
}

/// What is done about effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Mode {
    /// Nothing.
    Off,
    /// What a plan decides by itself.
    Auto,
    /// Everything about what is found, whatever it is worth.
    Found,
    /// Everything, found or not.
    On,
}

impl Mode {
    const ALL: [Self; 4] = [Self::Off, Self::Auto, Self::Found, Self::On];

    fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Auto => "auto",
            Self::Found => "found",
            Self::On => "on",
        }
    }

    /// The choices that it comes to for a scene.
    fn choices(self, scene: &GaussianScene) -> EffectChoices {
        let acted_on: Vec<Effect> = modules(LABELS).iter().map(|m| m.effect).collect();
        let set = |choices: EffectChoices, effect: &Effect, choice| choices.with(*effect, choice);
        match self {
            Self::Auto => EffectChoices::default(),
            Self::Off => {
                acted_on.iter().fold(EffectChoices::default(), |c, e| set(c, e, EffectChoice::Off))
            }
            Self::On => {
                acted_on.iter().fold(EffectChoices::default(), |c, e| set(c, e, EffectChoice::On))
            }
            Self::Found => {
                let profile = profile_of(scene, 1.0, &acted_on);
                acted_on.iter().fold(EffectChoices::default(), |c, e| {
                    let there = profile.of(*e).present;
                    set(c, e, if there { EffectChoice::On } else { EffectChoice::Off })
                })
            }
        }
    }
}

/// Who labels scenes here.
const LABELS: Consumer = Consumer { network: true, labels: true };

/// Labels damaged rooms with the network inside the program, in each mode, and scores them.
///
/// `go_on` is told what is under way and the share that is done, and may end it.
///
/// # Errors
/// If a setting is out of its range, it was ended, or something cannot be computed.
pub fn effect_suite(
    settings: &SuiteSettings,
    go_on: &mut dyn FnMut(&str, f64) -> bool,
) -> Result<SuiteReport, SeverityError> {
    check(settings)?;
    let acted_on: Vec<Effect> = modules(LABELS).iter().map(|m| m.effect).collect();
    let damage = Damage::new(settings)?;
    let mixed = mixed(settings.scenes);
    let pairs = if settings.pairs.is_empty() { pairs() } else { settings.pairs.clone() };
    let total = mixed.len() * (Mode::ALL.len() + acted_on.len())
        + settings.pair_rooms * (1 + Effect::ALL.len() + pairs.len());
    let mut done = 0usize;
    let mut step = |text: &str| {
        let going = go_on(text, done as f64 / total as f64);
        done += 1;
        if going { Ok(()) } else { Err(SeverityError::Stopped) }
    };
    let bench = Bench::new()?;
    // The first run of a network finds its memory.
    bench.label(&damage.room(0)?)?;
    let mut pooled: BTreeMap<Mode, Score> = BTreeMap::new();
    let mut worth: Vec<[Score; 2]> = vec![Default::default(); acted_on.len()];
    let mut rows = Vec::new();
    for (number, effects) in mixed.iter().enumerate() {
        let scene = damage.done(number, effects)?;
        let mut row = SceneRow { effects: names(effects), modes: Vec::new() };
        for mode in Mode::ALL {
            step(&format!("scene {number}: {}, {}", row.effects, mode.name()))?;
            let score = Score::of(&bench, &scene, |scene| mode.choices(scene))?;
            row.modes.push(score.figures(mode.name(), &bench)?);
            pooled.entry(mode).or_default().add(&score);
            if mode == Mode::Off {
                for (i, _) in acted_on.iter().enumerate().filter(|(_, e)| effects.contains(e)) {
                    worth[i][0].add(&score);
                }
            }
        }
        for (i, effect) in acted_on.iter().enumerate().filter(|(_, e)| effects.contains(e)) {
            step(&format!("scene {number}: {} alone is on", effect.name()))?;
            let alone = |_: &GaussianScene| {
                Mode::Off.choices(&GaussianScene::default()).with(*effect, EffectChoice::On)
            };
            worth[i][1].add(&Score::of(&bench, &scene, alone)?);
        }
        rows.push(row);
    }
    let figures = |score: &Score, name: &str| score.figures(name, &bench);
    let modes =
        pooled.iter().map(|(mode, score)| figures(score, mode.name())).collect::<Result<_, _>>()?;
    let worth =
        acted_on.iter().zip(&worth).map(|(effect, [off, on])| -> Result<_, SeverityError> {
            Ok(Worth {
                effect: effect.name().to_owned(),
                off: figures(off, "off")?,
                on: figures(on, "on")?,
            })
        });
    let worth = worth.collect::<Result<_, _>>()?;
    let pairs = combined(settings, &bench, &damage, &pairs, &mut step)?;
    Ok(SuiteReport {
        scenes: settings.scenes,
        gaussians: settings.gaussians,
        severity: settings.severity,
        modes,
        worth,
        pairs,
        rows,
    })
}

/// Quality under each pair of effects beside that under both alone.
fn combined(
    settings: &SuiteSettings,
    bench: &Bench,
    damage: &Damage<'_>,
    pairs: &[[Effect; 2]],
    step: &mut dyn FnMut(&str) -> Result<(), SeverityError>,
) -> Result<Vec<PairRow>, SeverityError> {
    if settings.pair_rooms == 0 {
        return Ok(Vec::new());
    }
    let mut quality = |effects: &[Effect]| -> Result<f64, SeverityError> {
        let mut all = Score::default();
        for room in 0..settings.pair_rooms {
            step(&format!("room {room}: {}", names(effects)))?;
            let scene = damage.done(room, effects)?;
            all.add(&Score::of(bench, &scene, |scene| Mode::Off.choices(scene))?);
        }
        Ok(all.figures("off", bench)?.f_miou)
    };
    let clean = quality(&[])?;
    let wanted =
        Effect::ALL.into_iter().filter(|effect| pairs.iter().flatten().any(|e| e == effect));
    let alone: BTreeMap<Effect, f64> =
        wanted.map(|e| Ok((e, quality(&[e])?))).collect::<Result<_, SeverityError>>()?;
    let row = |pair: &[Effect; 2]| -> Result<PairRow, SeverityError> {
        Ok(PairRow {
            effects: names(pair),
            clean,
            alone: pair.map(|e| alone[&e]),
            together: quality(pair)?,
        })
    };
    pairs.iter().map(row).collect()
}

fn check(settings: &SuiteSettings) -> Result<(), SeverityError> {
    let wrong = |setting, expected| Err(SeverityError::Setting { setting, expected });
    if settings.scenes == 0 {
        return wrong("scenes", "1 or more");
    }
    if settings.gaussians < 1000 {
        return wrong("gaussians", "1000 or more of each room");
    }
    if !(settings.severity > 0.0 && settings.severity <= 5.0) {
        return wrong("severity", "above 0, up to 5");
    }
    Ok(())
}

/// Rooms and what is done to them.
struct Damage<'a> {
    settings: &'a SuiteSettings,
    rooms: CurveSettings,
}

impl<'a> Damage<'a> {
    fn new(settings: &'a SuiteSettings) -> Result<Self, SeverityError> {
        let SuiteSettings { gaussians, room_seed, seed, .. } = *settings;
        let rooms = CurveSettings { gaussians, room_seed, seed, ..CurveSettings::default() };
        Ok(Self { settings, rooms })
    }

    fn room(&self, number: usize) -> Result<GaussianScene, SeverityError> {
        super::room(&self.rooms, number)
    }

    fn done(&self, number: usize, effects: &[Effect]) -> Result<GaussianScene, SeverityError> {
        let mut set = EffectSet::default();
        for effect in effects {
            set = set.with(*effect, self.settings.severity)?;
        }
        let room = self.room(number)?;
        Ok(simulate(&room, &set, super::seed(&self.rooms, number))?.scene)
    }
}

fn pairs() -> Vec<[Effect; 2]> {
    let all = Effect::ALL;
    (0..all.len()).flat_map(|i| (i + 1..all.len()).map(move |j| [all[i], all[j]])).collect()
}

/// What each scene of a suite has: of 24, 6 have nothing, 7 one effect each, 11 two.
fn mixed(scenes: usize) -> Vec<Vec<Effect>> {
    let (single, pairs) = (Effect::ALL, pairs());
    let of = |i: usize| match i % 24 {
        i if i.is_multiple_of(4) => Vec::new(),
        i if i < 10 => vec![single[i - 1 - i / 4]],
        // Pairs that have holes or floaters first, which are what something acts on.
        i => {
            pairs[i - 10 - usize::from(i > 12) - usize::from(i > 16) - usize::from(i > 20)].to_vec()
        }
    };
    (0..scenes).map(of).collect()
}

fn names(effects: &[Effect]) -> String {
    let names: Vec<&str> = effects.iter().map(|e| e.name()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join("+") }
}
