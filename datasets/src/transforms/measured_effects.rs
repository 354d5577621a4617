//! [`MeasuredEffects`]

use super::capture_effects::{always, check_place, damage};
use crate::effects::profile::profile_of;
use crate::effects::{Effect, EffectSet};
use crate::error::{bad_setting, check_probability, require};
use crate::rng::{below, happens};
use crate::{DataError, DataSource, Sample, SampleRng, Transform};
use rand_chacha::rand_core::RngCore;
use serde::{Deserialize, Serialize};

/// With `probability`, does to the scene what was found in one of the training scenes, each as likely: effects come as
/// often, as strong and together with which others as they do there. Where nothing was found, nothing is done.
///
/// For the rest it is [`CaptureEffects`](super::CaptureEffects), before [`GridSample`](super::GridSample).
///
/// # Source
/// Our own; what is found is what [`profile`](crate::effects::profile::profile) says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredEffects {
    /// Which effects, and how severe at most, 0 to 5: `holes=5,blur=3`.
    pub most: EffectSet,
    /// What was found in each scene; a training looks for it in its own scenes if it is not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<Vec<EffectSet>>,
    /// How often it happens.
    #[serde(default = "always")]
    pub probability: f64,
}

impl MeasuredEffects {
    /// Looks for the effects in the scenes of a source, in their order; meters.
    ///
    /// # Errors
    /// If a scene cannot be read.
    pub fn look(&mut self, source: &dyn DataSource) -> Result<(), DataError> {
        let wanted: Vec<Effect> = self.most.present().map(|(effect, _)| effect).collect();
        let look = |id: &String| {
            let scene = source.load(id)?.scene;
            Ok(profile_of(&scene, 1.0, &wanted).severities())
        };
        self.found = Some(source.scene_ids().iter().map(look).collect::<Result<_, DataError>>()?);
        Ok(())
    }

    /// What was found in one of the scenes, no stronger than allowed.
    fn draw(&self, found: &[EffectSet], rng: &mut SampleRng) -> EffectSet {
        let scene = found[below(rng, found.len() as u32) as usize];
        Effect::ALL.into_iter().fold(EffectSet::default(), |set, effect| {
            let severity = scene.severity(effect).min(self.most.severity(effect));
            // The lesser of two severities is one.
            set.with(effect, severity).unwrap_or(set)
        })
    }
}

impl Transform for MeasuredEffects {
    fn check(&self) -> Result<(), DataError> {
        check_probability("measured_effects.probability", self.probability)?;
        let expected = "effects with a severity above 0, such as holes=5,blur=3";
        require(!self.most.is_empty(), "measured_effects.most", self.most, expected)?;
        let some = self.found.as_ref().is_none_or(|found| !found.is_empty());
        let expected = "what was found in one scene or more, such as [\"none\", \"holes=2\"]";
        require(some, "measured_effects.found", "[]", expected)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        check_place(sample, "measured_effects")?;
        let Some(found) = &self.found else {
            let expected = "what was found in the scenes (MeasuredEffects::look)";
            return Err(bad_setting("measured_effects.found", "nothing", expected));
        };
        if !happens(rng, self.probability) || sample.is_empty() {
            return Ok(());
        }
        let effects = self.draw(found, rng);
        let seed = rng.next_u64();
        if effects.is_empty() { Ok(()) } else { damage(sample, &effects, seed) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SourceScene;
    use crate::effects::profile::profile;
    use crate::effects::simulate;
    use crate::sample_rng;
    use crate::transforms::CaptureEffects;
    use crate::transforms::testing::{applied, room};
    use scenesplat_rooms::{SyntheticRoomSettings, generate};
    use scenesplat_scene::GaussianScene;

    fn step(most: &str, found: &[&str]) -> MeasuredEffects {
        let found = Some(found.iter().map(|text| text.parse().unwrap()).collect());
        MeasuredEffects { most: most.parse().unwrap(), found, probability: 1.0 }
    }

    /// By hand: a number that says whether, one that says which scene, one for the damage.
    #[test]
    fn it_damages_as_the_scene_that_was_drawn() {
        let found = ["none", "holes=4,noise=1", "floaters=2,surface=3"];
        let measured = step("holes=3,floaters=5,surface=1", &found);
        let sample = room(1200);
        let mut drawn = [0; 3];
        for seed in 0..60 {
            let mut rng = sample_rng(seed, 1, 2);
            let mut got = sample.clone();
            measured.apply(&mut got, &mut { rng.clone() }).unwrap();
            assert!(happens(&mut rng, 1.0));
            let which = below(&mut rng, 3) as usize;
            drawn[which] += 1;
            let expected = ["", "holes=3", "floaters=2,surface=1"][which];
            let mut want = sample.clone();
            if which > 0 {
                let effects: EffectSet = expected.parse().unwrap();
                damage(&mut want, &effects, rng.next_u64()).unwrap();
            }
            assert!(got == want, "seed {seed}");
        }
        // Each is as likely, within five standard deviations of 60 draws.
        assert!(drawn.iter().all(|n| (2..=38).contains(n)), "{drawn:?}");
        // A range of one severity draws other numbers, and does the same otherwise.
        let fixed = CaptureEffects { effects: "holes=3".parse().unwrap(), probability: 1.0 };
        let always = step("holes=3", &["holes=3"]);
        assert!(applied(&always, &sample, 1).len() < sample.len());
        assert!(applied(&fixed, &sample, 1).len() < sample.len());
    }

    /// Three scenes, the second of them damaged.
    struct Rooms(Vec<String>);

    fn scene(id: &str) -> GaussianScene {
        let number: u64 = id.parse().unwrap();
        let room = generate(&SyntheticRoomSettings::with_count(16_000, 1000 + number)).unwrap();
        match number {
            1 => simulate(&room.scene, &"surface=4,noise=3".parse().unwrap(), 1).unwrap().scene,
            _ => room.scene,
        }
    }

    impl DataSource for Rooms {
        fn scene_ids(&self) -> &[String] {
            &self.0
        }

        fn load(&self, id: &str) -> Result<SourceScene, DataError> {
            Ok(SourceScene { scene: scene(id), report: Default::default() })
        }
    }

    #[test]
    fn what_is_found_is_what_the_profiles_of_the_scenes_say() {
        let rooms = Rooms(["0", "1", "2"].map(str::to_owned).to_vec());
        let mut measured = MeasuredEffects { found: None, ..step("surface=5,noise=2", &[]) };
        let mut sample = room(100);
        let error = measured.apply(&mut sample, &mut sample_rng(0, 0, 0)).unwrap_err();
        assert!(error.to_string().contains("measured_effects.found"), "{error}");
        measured.look(&rooms).unwrap();
        let found = measured.found.clone().unwrap();
        assert_eq!(found.len(), 3);
        for (set, id) in found.iter().zip(&rooms.0) {
            let seen = profile(&scene(id), 1.0);
            for effect in Effect::ALL {
                let wanted = matches!(effect, Effect::Surface | Effect::Noise);
                let severity = if wanted { seen.of(effect).severity } else { 0.0 };
                assert_eq!(set.severity(effect), severity, "{id} {}", effect.name());
            }
        }
        assert!(found[1].severity(Effect::Surface) > 2.0 && found[1].severity(Effect::Noise) > 1.0);
        // As it is read back from a record: the same, bit for bit.
        let text = serde_json::to_string(&measured).unwrap();
        assert_eq!(serde_json::from_str::<MeasuredEffects>(&text).unwrap(), measured);
        let mut again = measured.clone();
        again.look(&rooms).unwrap();
        assert_eq!(again, measured);
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let refused = |step: &MeasuredEffects| step.check().unwrap_err().to_string();
        assert!(refused(&step("none", &["none"])).contains("measured_effects.most"));
        assert!(refused(&step("holes=1", &[])).contains("measured_effects.found"));
        let often = MeasuredEffects { probability: 2.0, ..step("holes=1", &["none"]) };
        assert!(refused(&often).contains("measured_effects.probability"));
        let read = |text: &str| serde_json::from_str::<MeasuredEffects>(text);
        assert!(read(r#"{"most": "holes=1..3"}"#).is_err() && read("{}").is_err());
        assert_eq!(read(r#"{"most": "holes=1"}"#).unwrap().found, None);
        let mut sampled = room(50);
        sampled.grid_coord = vec![[0; 3]; sampled.len()];
        let error = step("holes=1", &["none"]).apply(&mut sampled, &mut sample_rng(0, 0, 0));
        assert!(error.unwrap_err().to_string().contains("before grid_sample"));
    }
}
