//! Decisions about effects: what the user says, what the evidence says, and that they do not tremble.

use scenesplat_datasets::effects::plan::{
    EFFECTS, EffectChoice, EffectChoices, EffectModule, EffectPlan, PlanSection, decide, looked_for,
};
use scenesplat_datasets::effects::profile::{EffectProfile, profile, profile_of};
use scenesplat_datasets::effects::{Effect, simulate};
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
    floaters.strength = 2.0;
    seen
}

const FLOATERS: EffectModule = EffectModule {
    effect: Effect::Floaters,
    action: "left out",
    by_itself: true,
    worth: "a point",
};
const LIGHT: EffectModule =
    EffectModule { effect: Effect::Light, action: "evened", by_itself: false, worth: "nothing" };

fn decided(seen: &EffectProfile, choices: &str, before: Option<&PlanSection>) -> PlanSection {
    let choices = choices.parse().expect("choices");
    decide(&[FLOATERS, LIGHT], &choices, seen, before).expect("both are acted on")
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
    let section = decided(&with_floaters(0.1), "floaters=on,light=off", None);
    assert!(section.is_on(Effect::Floaters) && !section.is_on(Effect::Light));
    assert!(section.of(Effect::Floaters).unwrap().why.starts_with("on by choice"));
    let mut plan = EffectPlan::new(4000);
    plan.put(section.clone());
    let text = serde_json::to_string(&plan).unwrap();
    let back: EffectPlan = serde_json::from_str(&text).unwrap();
    assert_eq!(back, plan);
    assert_eq!(back.replayed(4000, &[FLOATERS]).unwrap(), section);
    for (gaussians, modules, part) in [
        (4001, &[FLOATERS][..], "4000 Gaussians, this one has 4001"),
        (4000, &[LIGHT], "floaters=on: nothing here acts on floaters; acted on here: light"),
        (4000, &[], "acted on here: none"),
    ] {
        let error = plan.replayed(gaussians, modules).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    let empty = EffectPlan { sections: Vec::new(), ..plan };
    assert!(empty.replayed(4000, &[FLOATERS]).unwrap_err().to_string().contains("nothing"));
    let said = section.to_string();
    assert!(said.contains("floaters         on"), "{said}");
    assert!(said.ends_with("nothing here acts on holes, surface, blur, glass, noise"), "{said}");
}

#[test]
fn a_module_that_is_not_worth_it_waits_to_be_asked_and_nobody_looks_for_its_effect() {
    let mut seen = with_floaters(3.0);
    let light = seen.effects.iter_mut().find(|e| e.effect == Effect::Light).unwrap();
    light.measure.as_mut().unwrap().value = 3.0 * light.threshold;
    light.strength = 4.0;
    let section = decided(&seen, "auto", None);
    assert!(section.is_on(Effect::Floaters) && !section.is_on(Effect::Light));
    assert!(section.of(Effect::Light).unwrap().why.contains("nothing; light=on does it"));
    assert_eq!(section.of(Effect::Blur).unwrap().why, "nothing here acts on it");
    assert!(decided(&seen, "light=on", None).is_on(Effect::Light));
    let modules = [FLOATERS, LIGHT];
    let looked = |choices: &str| looked_for(&modules, &choices.parse().unwrap());
    assert_eq!(looked("auto"), [Effect::Floaters]);
    assert_eq!(looked("light=on"), [Effect::Floaters, Effect::Light]);
    assert_eq!(looked("floaters=off"), []);
    let error = decide(&modules, &"glass=on".parse().unwrap(), &seen, None).unwrap_err();
    assert_eq!(
        error.to_string(),
        "glass=on: nothing here acts on glass; acted on here: floaters, light"
    );
}

#[test]
fn what_is_not_looked_for_costs_nothing_and_changes_nothing_else() {
    let room = generate(&SyntheticRoomSettings::with_count(16_000, 1004)).unwrap().scene;
    let room = simulate(&room, &"holes=4".parse().unwrap(), 3).unwrap().scene;
    let all = profile(&room, 1.0);
    let one = profile_of(&room, 1.0, &[Effect::Holes]);
    assert_eq!(one.of(Effect::Holes), all.of(Effect::Holes));
    assert!(one.of(Effect::Noise).text.contains("not looked for"));
    assert!(!one.of(Effect::Noise).present && one.of(Effect::Noise).measure.is_none());
    assert_eq!(profile_of(&room, 1.0, &[]).looked_at, 0);
    // Where the gaps are: nothing stands in the middle of one, and something at its rim.
    let holes = all.of(Effect::Holes);
    assert!(holes.present && !holes.regions.is_empty());
    for [x, y, z, radius] in &holes.regions {
        let apart =
            |p: &[f32; 3]| ((p[0] - x).powi(2) + (p[1] - y).powi(2) + (p[2] - z).powi(2)).sqrt();
        let nearest = room.coord.iter().map(apart).fold(f32::MAX, f32::min);
        assert!(nearest > 0.02 && *radius > 0.15, "{nearest} {radius}");
    }
    // In another unit the same places.
    let mut small = room;
    small.coord.iter_mut().for_each(|p| *p = p.map(|v| 4.0 * v));
    small.log_scale.iter_mut().for_each(|s| *s = s.map(|v| v + 4f32.ln()));
    let scaled = profile_of(&small, 0.25, &[Effect::Holes]);
    let [a, b] = [&holes.regions, &scaled.of(Effect::Holes).regions].map(|r| r.len());
    assert!(a.abs_diff(b) <= 1 + a / 20, "{a} {b}");
    let ratio = scaled.of(Effect::Holes).regions[0][3] / holes.regions[0][3];
    assert!((ratio - 4.0).abs() < 0.2, "{ratio}");
}

#[test]
fn evidence_that_trembles_flips_a_decision_at_most_once() {
    for centre in [0.94, 0.96, 1.0, 1.04, 1.06] {
        let mut plan = decided(&with_floaters(centre), "auto", None);
        let mut flips = 0;
        for i in 0..40 {
            let noise = [0.01, -0.01, 0.004, -0.007][i % 4];
            let next = decided(&with_floaters(centre * (1.0 + noise)), "auto", Some(&plan));
            flips += usize::from(next.is_on(Effect::Floaters) != plan.is_on(Effect::Floaters));
            plan = next;
        }
        assert!(flips <= 1, "{centre}: {flips}");
    }
    // What really changes does flip.
    let on = decided(&with_floaters(1.2), "auto", None);
    let off = decided(&with_floaters(0.8), "auto", Some(&on));
    assert!(on.is_on(Effect::Floaters) && !off.is_on(Effect::Floaters));
    assert_eq!(on.name, EFFECTS);
}
