//! From a profile and the user's choices to decisions.

use super::super::profile::{EffectEvidence, EffectProfile};
use super::super::{Effect, EffectError};
use super::{EFFECTS, EffectChoice, EffectChoices, EffectDecision, HYSTERESIS, PlanSection};

/// What somebody can do about an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EffectModule {
    /// Which effect.
    pub effect: Effect,
    /// What is done, in words.
    pub action: &'static str,
    /// Whether it comes on by itself where the effect is found.
    pub by_itself: bool,
    /// What it was measured to be worth, in words.
    pub worth: &'static str,
}

/// The effects that have to be looked for: those that a module acts on, unless the user or the module's worth has
/// said no already.
pub fn looked_for(modules: &[EffectModule], choices: &EffectChoices) -> Vec<Effect> {
    let needed = |module: &&EffectModule| match choices.of(module.effect) {
        EffectChoice::On => true,
        EffectChoice::Auto => module.by_itself,
        EffectChoice::Off => false,
    };
    modules.iter().filter(needed).map(|module| module.effect).collect()
}

/// Decides about every effect. `profile`: what was seen of those that are [`looked_for`]; `before`: the decisions that
/// were made of this scene earlier, if there are any; automatic ones stay within [`HYSTERESIS`] of their
/// thresholds.
///
/// # Errors
/// If the user wants something done about an effect that no module acts on.
pub fn decide(
    modules: &[EffectModule],
    choices: &EffectChoices,
    profile: &EffectProfile,
    before: Option<&PlanSection>,
) -> Result<PlanSection, EffectError> {
    let decision = |effect: Effect| -> Result<EffectDecision, EffectError> {
        let choice = choices.of(effect);
        let name = effect.name().to_owned();
        let module = modules.iter().find(|module| module.effect == effect);
        let Some(module) = module else {
            if choice == EffectChoice::On {
                return Err(nothing_acts(effect, modules));
            }
            let why = "nothing here acts on it".to_owned();
            let changed = Some(0);
            let none = EffectDecision::default();
            return Ok(EffectDecision { effect: name, choice, why, changed, ..none });
        };
        // What somebody asked for was no decision.
        let was = before.and_then(|section| section.of(effect));
        let was = was.filter(|d| d.choice == EffectChoice::Auto).map(|d| d.on);
        Ok(about(module, choice, profile.of(effect), was))
    };
    let decisions = Effect::ALL.into_iter().map(decision).collect::<Result<_, _>>()?;
    Ok(PlanSection::new(EFFECTS, decisions))
}

fn about(
    module: &EffectModule,
    choice: EffectChoice,
    evidence: &EffectEvidence,
    was: Option<bool>,
) -> EffectDecision {
    let measure = evidence.measure.as_ref().map(|m| m.value);
    let on = match choice {
        EffectChoice::On => true,
        EffectChoice::Off => false,
        EffectChoice::Auto => module.by_itself && is_found(evidence, was),
    };
    let why = match choice {
        EffectChoice::Auto if module.by_itself => evidence.text.clone(),
        EffectChoice::Auto => {
            format!("not by itself: {}; {}=on does it", module.worth, module.effect.name())
        }
        EffectChoice::On => format!("on by choice; {}", evidence.text),
        EffectChoice::Off => "off by choice".to_owned(),
    };
    EffectDecision {
        effect: module.effect.name().to_owned(),
        choice,
        on,
        level: if on { evidence.strength } else { 0.0 },
        measure,
        threshold: Some(evidence.threshold),
        action: Some(module.action.to_owned()),
        why,
        regions: if on { evidence.regions.clone() } else { Vec::new() },
        changed: Some(0),
    }
}

/// Whether the evidence says that the effect is there, if it was thought to be there or not before.
fn is_found(evidence: &EffectEvidence, was: Option<bool>) -> bool {
    let limit = match was {
        Some(true) => 1.0 - HYSTERESIS,
        Some(false) => 1.0 + HYSTERESIS,
        None => 1.0,
    };
    evidence.over_threshold().is_some_and(|over| over >= limit)
}

/// That a wish has no effect here.
pub(super) fn nothing_acts(effect: Effect, modules: &[EffectModule]) -> EffectError {
    let acted_on: Vec<&str> = modules.iter().map(|module| module.effect.name()).collect();
    let acted_on = if acted_on.is_empty() { "none".to_owned() } else { acted_on.join(", ") };
    EffectError::NothingActs { name: effect.name().to_owned(), acted_on }
}
