//! What is done about the effects of a capture, and about whatever else a scene calls for: one object for all who
//! decide, with the evidence of each decision.
//!
//! A plan is made once from a profile, what a command can do ([`EffectModule`]) and the user's choices; it is
//! printed, and stored as JSON. Read back, it says the same again without a profile.

mod choices;
mod decide;
mod text;

pub use choices::{EffectChoice, EffectChoices};
pub use decide::{EffectModule, decide, looked_for};

use super::{Effect, EffectError};
use serde::{Deserialize, Serialize};

/// A decision that was made before stays until its measure is so far on the other side of the threshold, as a
/// share of it: evidence that trembles by a hundredth cannot flip it twice.
pub const HYSTERESIS: f64 = 0.05;

/// The section of a plan with the effects of the capture.
pub const EFFECTS: &str = "effects";

/// One decision, with its evidence.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectDecision {
    /// About what: an effect, or a part of rendering or lifting.
    pub effect: String,
    /// What the user said.
    pub choice: EffectChoice,
    /// Whether something is done about it.
    pub on: bool,
    /// How strong the effect is, 0 to 5; 0 where it is off, or was not measured.
    pub level: f64,
    /// The number that decided; `None` where nothing was measured.
    pub measure: Option<f64>,
    /// The value that it was compared with; `None` where there is none.
    pub threshold: Option<f64>,
    /// What is done where it is on; `None` where nothing here acts on it.
    pub action: Option<String>,
    /// Because of what, in words.
    pub why: String,
    /// Where: center and radius of balls, in units of the scene.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub regions: Vec<[f32; 4]>,
    /// Gaussians, or pictures, that it changed; `None` where that is not counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed: Option<usize>,
}

/// Decisions of one kind.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanSection {
    /// Which: [`EFFECTS`], `tiles`, `render`, `lifting`.
    pub name: String,
    /// Each with its evidence.
    pub decisions: Vec<EffectDecision>,
    /// What deciding took, seconds; `None` where nothing had to be measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

/// All that was decided about a scene.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectPlan {
    /// Gaussians of the scene that it was made of.
    pub gaussians: usize,
    /// The parts, each by who decides.
    pub sections: Vec<PlanSection>,
}

impl EffectPlan {
    /// A plan without any decision.
    pub fn new(gaussians: usize) -> Self {
        Self { gaussians, sections: Vec::new() }
    }

    /// Adds a part; one of the same name is replaced.
    pub fn put(&mut self, section: PlanSection) {
        match self.sections.iter_mut().find(|s| s.name == section.name) {
            Some(known) => *known = section,
            None => self.sections.push(section),
        }
    }

    /// Adds a decision to the part of that name; one about the same is replaced.
    pub fn add(&mut self, section: &str, decision: EffectDecision) {
        let at = self.sections.iter().position(|s| s.name == section).unwrap_or_else(|| {
            self.sections.push(PlanSection::new(section, Vec::new()));
            self.sections.len() - 1
        });
        let decisions = &mut self.sections[at].decisions;
        match decisions.iter_mut().find(|d| d.effect == decision.effect) {
            Some(known) => *known = decision,
            None => decisions.push(decision),
        }
    }

    /// The part of that name.
    pub fn section(&self, name: &str) -> Option<&PlanSection> {
        self.sections.iter().find(|s| s.name == name)
    }

    /// The decision about an effect of the capture; `None` in a plan that does not know it.
    pub fn of(&self, effect: Effect) -> Option<&EffectDecision> {
        self.section(EFFECTS)?.of(effect)
    }

    /// Whether something is done about an effect of the capture.
    pub fn is_on(&self, effect: Effect) -> bool {
        self.of(effect).is_some_and(|d| d.on)
    }

    /// The stored decisions about effects, to be followed again on a scene of so many Gaussians by someone who
    /// can do no more than `modules`.
    ///
    /// # Errors
    /// If the plan was made of another scene, has no such decisions, or asks for what nothing here does.
    pub fn replayed(
        &self,
        gaussians: usize,
        modules: &[EffectModule],
    ) -> Result<PlanSection, EffectError> {
        if self.gaussians != gaussians {
            return Err(EffectError::OtherScene { planned: self.gaussians, got: gaussians });
        }
        let Some(section) = self.section(EFFECTS) else { return Err(EffectError::NoDecisions) };
        for decision in &section.decisions {
            let effect = Effect::named(&decision.effect)?;
            let acts = modules.iter().any(|module| module.effect == effect);
            if decision.on && !acts {
                return Err(decide::nothing_acts(effect, modules));
            }
        }
        let mut section = section.clone();
        section.seconds = None;
        section.decisions.iter_mut().for_each(|d| d.changed = Some(0));
        Ok(section)
    }
}

impl PlanSection {
    /// A part with decisions that need no measuring.
    pub fn new(name: &str, decisions: Vec<EffectDecision>) -> Self {
        Self { name: name.to_owned(), decisions, seconds: None }
    }

    /// The decision about an effect.
    pub fn of(&self, effect: Effect) -> Option<&EffectDecision> {
        self.decisions.iter().find(|d| d.effect == effect.name())
    }

    /// The decision about an effect, if something is done about it, to note what it changed.
    pub fn acting(&mut self, effect: Effect) -> Option<&mut EffectDecision> {
        self.decisions.iter_mut().find(|d| d.on && d.effect == effect.name())
    }

    /// Whether something is done about an effect.
    pub fn is_on(&self, effect: Effect) -> bool {
        self.of(effect).is_some_and(|d| d.on)
    }
}
