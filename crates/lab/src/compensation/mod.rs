//! What an inference does about the effects of a capture, as an [`EffectPlan`] says: [`modules`] are what there is,
//! [`plan_of`] decides, [`Compensation`] says which Gaussians it means.
//!
//! ```
//! use scenesplat_lab::compensation::{Compensation, Consumer, plan_of};
//! use scenesplat::rooms::{SyntheticRoomSettings, generate};
//!
//! let room = generate(&SyntheticRoomSettings::with_count(500, 1))?.scene;
//! let labels = Consumer { network: true, labels: true };
//! let mut plan = plan_of(&room, 1.0, labels, &"floaters=on".parse()?)?;
//! let about = Compensation::of(&mut plan, &room);
//! assert!(about.kept(room.len()).len() + about.num_left_out() == room.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`EffectPlan`]: scenesplat_datasets::effects::plan::EffectPlan

mod panes;
mod regions;
mod sections;

pub use panes::{TWO_LAYERS, glass_decision, panes_of};
pub use sections::{render_section, tiles_section};

use scenesplat::inspect::find_floaters;
use scenesplat_datasets::effects::plan::{
    EffectChoices, EffectModule, PlanSection, decide, looked_for,
};
use scenesplat_datasets::effects::profile::profile_of;
use scenesplat_datasets::effects::{Effect, EffectError};
use scenesplat_scene::GaussianScene;
use std::time::Instant;

/// Who makes use of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Consumer {
    /// Whether a network reads the Gaussians; else features are there already.
    pub network: bool,
    /// Whether they get labels or are selected, so that some may get none.
    pub labels: bool,
}

/// Gaussians that are not read.
const FLOATERS: EffectModule = EffectModule {
    effect: Effect::Floaters,
    action: "Gaussians left out of the voxels, answered for by the nearest others",
    by_itself: false,
    worth: "it gains less than a point of f-mIoU (docs/effects.md)",
};

/// Gaussians whose labels are withheld.
const HOLES: EffectModule = EffectModule {
    effect: Effect::Holes,
    action: "Gaussians at the rims of gaps without a label",
    by_itself: false,
    worth: "it takes less than a fifth off the calibration error (docs/effects.md)",
};

/// What an inference can do. Which of it comes on by itself follows what it was measured to be worth.
pub fn modules(consumer: Consumer) -> Vec<EffectModule> {
    let mut modules = Vec::new();
    if consumer.labels {
        modules.push(HOLES);
    }
    if consumer.network {
        modules.push(FLOATERS);
    }
    modules
}

/// Looks for what a consumer could do something about, and decides.
///
/// # Errors
/// If something is asked for about an effect that nothing acts on.
pub fn plan_of(
    scene: &GaussianScene,
    metres_per_unit: f64,
    consumer: Consumer,
    choices: &EffectChoices,
) -> Result<PlanSection, EffectError> {
    let began = Instant::now();
    let modules = modules(consumer);
    let wanted = looked_for(&modules, choices);
    let profile = profile_of(scene, metres_per_unit, &wanted);
    let mut section = decide(&modules, choices, &profile, None)?;
    section.seconds = (!wanted.is_empty()).then(|| began.elapsed().as_secs_f64());
    Ok(section)
}

/// The Gaussians that a plan is about.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Compensation {
    kept: Option<Vec<usize>>,
    left_out: usize,
    withheld: Vec<bool>,
    /// Balls that nothing in gets a label.
    rims: Vec<[f32; 4]>,
}

impl Compensation {
    /// Finds them, and notes in the plan how many they are. Depends on the decisions and the scene alone.
    pub fn of(plan: &mut PlanSection, scene: &GaussianScene) -> Self {
        let mut found = Self::default();
        if let Some(floaters) = plan.acting(Effect::Floaters) {
            let seen = find_floaters(scene);
            floaters.changed = Some(seen.removed());
            found.left_out = seen.removed();
            found.kept = (seen.removed() > 0).then_some(seen.kept);
        }
        if let Some(holes) = plan.acting(Effect::Holes) {
            found.withheld = regions::inside(&holes.regions, &scene.coord);
            holes.changed = Some(found.num_withheld());
            found.rims.clone_from(&holes.regions);
        }
        found
    }

    /// Rows that the network reads, of so many, ascending.
    pub fn kept(&self, gaussians: usize) -> Vec<usize> {
        self.kept.clone().unwrap_or_else(|| (0..gaussians).collect())
    }

    /// How many it does not.
    pub fn num_left_out(&self) -> usize {
        self.left_out
    }

    /// Gaussians that get no label; empty where all may get one, else `[N]`.
    pub fn withheld(&self) -> &[bool] {
        &self.withheld
    }

    /// Which of other places, in units of the scene, get no label; empty where all may get one. `[M, 3]` to `[M]`
    pub fn withheld_at(&self, places: &[[f32; 3]]) -> Vec<bool> {
        regions::inside(&self.rims, places)
    }

    /// How many they are.
    pub fn num_withheld(&self) -> usize {
        self.withheld.iter().filter(|is| **is).count()
    }
}

#[cfg(test)]
mod tests;
