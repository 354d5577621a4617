//! Decisions about effects: what the user says, what the evidence says, and that they do not tremble.

use scenesplat_datasets::effects::Effect;
use scenesplat_datasets::effects::plan::{EffectChoice, EffectChoices, EffectPlan};
use scenesplat_datasets::effects::profile::{EffectProfile, profile};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use std::sync::OnceLock;

fn seen() -> EffectProfile {
    static SEEN: OnceLock<EffectProfile> = OnceLock::new();
    let room = || generate(&SyntheticRoomSettings::with_count(4000, 1003)).expect("a room").scene;
    SEEN.get_or_init(|| profile(&room(), 1.0)).clone()
}

/// The profile with a measure so far from its threshold.
fn with_floaters(times: f64) -> EffectProfile {
    let mut seen = seen();
    let floaters =
        seen.effects.iter_mut().find(|e| e.effect == Effect::Floaters).expect("each has one");
    floaters.measure.as_mut().expect("a room").value = times * floaters.threshold;
    seen
}

#[test]
fn choices_are_read_and_wrong_ones_named() {
    let choices: EffectChoices = "glass=off,floaters=on,blur=auto".parse().unwrap();
    assert_eq!(choices.of(Effect::Glass), EffectChoice::Off);
    assert_eq!(choices.of(Effect::Noise), EffectChoice::Auto);
    assert_eq!(choices.to_string(), "floaters=on,glass=off");
    assert_eq!(choices.to_string().parse(), Ok(choices));
    assert_eq!("auto".parse(), Ok(EffectChoices::default()));
    for (text, part) in [
        ("floaters", "floaters=auto"),
        ("floaters=2", "on, off or auto"),
        ("dust=on", "there are holes, floaters"),
        ("blur=on,blur=off", "given twice"),
    ] {
        let error = text.parse::<EffectChoices>().unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
    }
}

#[test]
fn the_user_has_the_last_word_and_a_stored_plan_says_the_same() {
    let choices = "floaters=on,light=off".parse().unwrap();
    let plan = EffectPlan::new(&with_floaters(0.1), &choices, None);
    assert!(plan.is_on(Effect::Floaters) && !plan.is_on(Effect::Light));
    assert!(plan.of(Effect::Floaters).unwrap().why.starts_with("on by choice"));
    let text = serde_json::to_string(&plan).unwrap();
    assert_eq!(serde_json::from_str::<EffectPlan>(&text).unwrap(), plan);
    assert!(plan.to_string().contains("floaters  on"));
}

#[test]
fn evidence_that_trembles_flips_a_decision_at_most_once() {
    for centre in [0.94, 0.96, 1.0, 1.04, 1.06] {
        let mut plan = EffectPlan::new(&with_floaters(centre), &EffectChoices::default(), None);
        let mut flips = 0;
        for i in 0..40 {
            let noise = [0.01, -0.01, 0.004, -0.007][i % 4];
            let seen = with_floaters(centre * (1.0 + noise));
            let next = EffectPlan::new(&seen, &EffectChoices::default(), Some(&plan));
            flips += usize::from(next.is_on(Effect::Floaters) != plan.is_on(Effect::Floaters));
            plan = next;
        }
        assert!(flips <= 1, "{centre}: {flips}");
    }
    // What really changes does flip.
    let on = EffectPlan::new(&with_floaters(1.2), &EffectChoices::default(), None);
    let off = EffectPlan::new(&with_floaters(0.8), &EffectChoices::default(), Some(&on));
    assert!(on.is_on(Effect::Floaters) && !off.is_on(Effect::Floaters));
}
