//! What a scene says about how it was captured: for each effect whether it is there, how strong it is, and by
//! what numbers.
//!
//! From the Gaussians alone, without pictures or cameras. At most 65 536 of them are looked at, evenly chosen,
//! around 8192 of which the nearest ones are looked up once, for all detectors. A pure function: the same
//! for any number of threads. Rows with a NaN, or that are nowhere, are not looked at; a scene of
//! fewer than 100 others, or all in one place, is not judged.
//!
//! # Source
//! Effects and strengths are those of the simulator ([`simulate`](super::simulate)); the measures are ours, but
//! for the photon transfer curve of `noise` (Janesick, *Photon Transfer*, 2007). Thresholds were fitted on
//! synthetic rooms, and tested on others: docs/effects.md says how well they do.

mod blur;
mod cells;
mod evidence;
mod floaters;
mod gaps;
mod glass;
mod holes;
pub mod isolation;
mod light;
mod noise;
mod planes;
mod surface;
mod table;
mod thresholds;

pub use cells::FAINT;
pub use evidence::{EffectEvidence, EffectProfile, Figure};

use super::Effect;
use planes::Shell;
use scenesplat_scene::GaussianScene;
use table::Table;

/// Fewer patches say nothing.
const FEWEST_PATCHES: usize = 50;

/// What a detector measured.
struct Measured {
    /// The number that decides.
    measure: Figure,
    /// Others that go with it.
    more: Vec<Figure>,
    /// The number that the severity is read from.
    strength: f64,
    /// Where it is, if that can be said: center and radius, in units of the scene.
    regions: Vec<[f32; 4]>,
}

/// What was measured, or why nothing could be.
type Outcome = Result<Measured, &'static str>;

/// Looks at a scene, one of whose units is so many meters long.
///
/// However large the scene, at most 8192 neighbor searches among 65 536 Gaussians, and one look at each row.
///
/// ```
/// use scenesplat_datasets::effects::profile::profile;
/// use scenesplat_datasets::effects::{Effect, simulate};
/// use scenesplat_rooms::{SyntheticRoomSettings, generate};
///
/// let room = generate(&SyntheticRoomSettings::with_count(16_000, 7))?.scene;
/// assert!(!profile(&room, 1.0).of(Effect::Surface).present);
/// let rough = simulate(&room, &"surface=3".parse()?, 1)?.scene;
/// let seen = profile(&rough, 1.0);
/// assert!(seen.of(Effect::Surface).present && seen.of(Effect::Surface).severity > 2.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn profile(scene: &GaussianScene, metres_per_unit: f64) -> EffectProfile {
    profile_of(scene, metres_per_unit, &Effect::ALL)
}

/// As [`profile`], but looks for some of the effects alone; of the others nothing is said. The fewer, the less it
/// costs, and without any the scene is not looked at.
pub fn profile_of(scene: &GaussianScene, metres_per_unit: f64, wanted: &[Effect]) -> EffectProfile {
    let table = match wanted {
        [] => None,
        _ => Table::of(scene, isolation::FEWEST_ROWS),
    };
    let has_shell = wanted.iter().any(|effect| {
        matches!(effect, Effect::Holes | Effect::Floaters | Effect::Glass | Effect::Light)
    });
    let shell = match &table {
        Some(table) if has_shell => Shell::of(table),
        _ => Shell::default(),
    };
    let measure = |effect| {
        if !wanted.contains(&effect) {
            return Err("not looked for");
        }
        let Some(table) = &table else {
            return Err("fewer than 100 Gaussians with usable values, or all in one place");
        };
        match effect {
            Effect::Holes => holes::measure(&shell, metres_per_unit),
            Effect::Floaters => floaters::measure(table, &shell),
            Effect::Surface => surface::measure(table, metres_per_unit),
            Effect::Blur => blur::measure(table, metres_per_unit),
            Effect::Glass => glass::measure(&shell),
            Effect::Light => light::measure(table, &shell),
            Effect::Noise => noise::measure(table),
        }
    };
    EffectProfile {
        gaussians: scene.len(),
        looked_at: table.as_ref().map_or(0, |table| table.rows.len()),
        effects: Effect::ALL.map(|e| EffectEvidence::new(e, measure(e))).into(),
    }
}
