//! What captures do to scenes, on demand: parts that nobody saw, floaters, rough surfaces, motion blur,
//! glass, drifting light, noise. And to [`pictures`] of scenes.
//!
//! An effect that is absent costs nothing and changes nothing: the empty set gives the scene as it was,
//! bit for bit. Random numbers belong to (seed, effect, Gaussian or part), so one effect never
//! changes what another draws, and the number of threads changes nothing. Lengths are in meters.
//!
//! # Source
//! The causes of failure that SceneSplat (ICCV 2025) names in its supplement; strengths by severity are
//! our own, in [`strength`].

mod geometry;
mod glass;
mod light;
pub mod pane;
pub mod pictures;
pub mod plan;
pub mod profile;
mod ranges;
mod rooms;
mod set;
pub mod strength;

pub use pane::{Pane, Wall, largest_wall};
pub use ranges::EffectRanges;
pub use rooms::{RoomDamage, RoomEffect, simulate_in_room};
pub use set::{Effect, EffectError, EffectSet, MOST_SEVERE};

use crate::rng::SampleRng;
use scenesplat_kernels::random::purpose_rng;
use scenesplat_scene::{GaussianScene, SceneError, Up};

/// Purposes of random numbers from here on are those of effects.
const FIRST_PURPOSE: u8 = 64;

/// A scene after its effects.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// The scene: what is left of it, then what was added. Added Gaussians have no label (−1) and no
    /// valid language feature.
    pub scene: GaussianScene,
    /// Row of the original scene of each Gaussian; `None` for those that were added.
    pub source: Vec<Option<usize>>,
    /// What each effect did.
    pub done: Vec<EffectDone>,
}

impl Simulated {
    /// A scene before any effect.
    fn of(scene: &GaussianScene) -> Self {
        let source = (0..scene.len()).map(Some).collect();
        Self { scene: scene.clone(), source, done: Vec::new() }
    }

    /// What the random numbers of each Gaussian belong to: its row in the original scene, or its number
    /// among those that were added, so that no effect depends on what another removed.
    fn keys(&self) -> Vec<u64> {
        let mut added = (1 << 48)..;
        let mut key = |source: &Option<usize>| match source {
            Some(row) => *row as u64,
            None => added.next().unwrap_or(u64::MAX),
        };
        self.source.iter().map(&mut key).collect()
    }
}

/// What an effect did.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectDone {
    /// Which effect.
    pub effect: Effect,
    /// How strong, above 0 and up to 5.
    pub severity: f64,
    /// Gaussians that it removed, added or changed.
    pub changed: usize,
    /// That in words.
    pub text: String,
}

/// The random numbers of a part of an effect.
fn rng(seed: u64, effect: Effect, index: u64) -> SampleRng {
    purpose_rng(FIRST_PURPOSE + effect as u8, seed, 0, index)
}

/// The random numbers of a part of an effect on the picture with that number.
fn frame_rng(seed: u64, effect: Effect, frame: u64, part: u64) -> SampleRng {
    // Epoch 0 is the scene's.
    purpose_rng(FIRST_PURPOSE + effect as u8, seed, frame.wrapping_add(1), part)
}

/// Applies effects to a scene, in the order of [`Effect::ALL`].
///
/// Labeled points, which are no Gaussians, stay as they are. Values that are not finite stay, too.
/// Higher spherical harmonics keep their directions; `light` and `noise` scale them with the color.
///
/// `glass` takes for up what the scene suggests ([`guess_up`](scenesplat_scene::guess_up)).
///
/// # Errors
/// If the scene's arrays do not match.
pub fn simulate(
    scene: &GaussianScene,
    effects: &EffectSet,
    seed: u64,
) -> Result<Simulated, SceneError> {
    simulate_upright(scene, effects, seed, None)
}

/// As [`simulate`], where it may be known which way is up.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_upright(
    scene: &GaussianScene,
    effects: &EffectSet,
    seed: u64,
    up: Option<Up>,
) -> Result<Simulated, SceneError> {
    scene.check_rows()?;
    let mut out = Simulated::of(scene);
    for (effect, severity) in effects.present() {
        let (changed, text) = apply(&mut out, effect, severity, seed, up, None)?;
        out.done.push(EffectDone { effect, severity, changed, text });
    }
    Ok(out)
}

/// Applies one effect: how many Gaussians it changed, and that in words. `panes`: where there is glass, if
/// that is known.
fn apply(
    out: &mut Simulated,
    effect: Effect,
    severity: f64,
    seed: u64,
    up: Option<Up>,
    panes: Option<&[Pane]>,
) -> Result<(usize, String), SceneError> {
    Ok(match effect {
        Effect::Holes => geometry::holes(out, severity, seed)?,
        Effect::Floaters => geometry::floaters(out, severity, seed)?,
        Effect::Surface => geometry::surface(out, severity, seed),
        Effect::Blur => geometry::blur(out, severity, seed),
        Effect::Glass => match panes {
            None => glass::glass(out, severity, seed, up)?,
            Some(panes) => glass::on_panes(out, panes, seed)?,
        },
        Effect::Light => light::light(&mut out.scene, severity, seed),
        Effect::Noise => light::noise(out, severity, seed),
    })
}

#[cfg(test)]
mod tests;
