//! Whether a gain is learned for each picture: the decision of `optimise` about drifting light.

use super::Args;
use super::args::ExposureArg;
use super::frames::Frames;
use crate::session::Session;
use scenesplat::datasets::effects::Effect;
use scenesplat::datasets::effects::plan::{EffectChoice, EffectDecision};
use scenesplat::optimisation::{ExposureDrift, exposure_drift, fused_points};

/// The section of the plan.
const OPTIMISATION: &str = "optimisation";
/// Points that the pictures are compared at.
const POINTS: usize = 4000;

impl Args {
    /// Looks at the pictures, unless the user has decided, and notes what was found.
    pub(super) fn decide_exposure(&self, session: &Session<'_>, frames: &Frames) -> bool {
        let choice = match self.exposure {
            ExposureArg::Auto => EffectChoice::Auto,
            ExposureArg::On => EffectChoice::On,
            ExposureArg::Off => EffectChoice::Off,
        };
        let drift = (choice == EffectChoice::Auto).then(|| {
            let _stage = session.receipt.stage("exposure");
            exposure_drift(&frames.train, &fused_points(&frames.train, POINTS).0)
        });
        let decision = decision(choice, drift);
        session.progress.say(format!("exposure: {}", decision.why));
        session.receipt.setting("exposure", decision.on, &decision.why);
        let on = decision.on;
        session.receipt.decided(0, OPTIMISATION, decision);
        on
    }
}

/// What is done and why. `drift`: `None` where nobody looked, `Some(None)` where pictures cannot tell.
fn decision(choice: EffectChoice, drift: Option<Option<ExposureDrift>>) -> EffectDecision {
    let drift = drift.flatten().filter(|_| choice == EffectChoice::Auto);
    let on = choice == EffectChoice::On || drift.as_ref().is_some_and(ExposureDrift::is_present);
    let why = match (choice, &drift) {
        (EffectChoice::Off, _) => "off by choice".to_owned(),
        (EffectChoice::On, _) => {
            "a gain and an offset of each picture are learned, by choice".to_owned()
        }
        (EffectChoice::Auto, None) => {
            "taken for constant: that needs six pictures with depth that show the same \
            places; --exposure on learns it"
                .to_owned()
        }
        (EffectChoice::Auto, Some(d)) => format!(
            "pictures differ by ±{:.0} % in exposure and ±{:.1} % in red against blue: {}",
            100.0 * d.exposure.exp_m1(),
            100.0 * d.balance.exp_m1(),
            if on { "a gain and an offset of each are learned" } else { "taken for constant" }
        ),
    };
    EffectDecision {
        effect: Effect::Light.name().to_owned(),
        choice,
        on,
        level: drift.as_ref().filter(|_| on).map_or(0.0, |d| d.severity().min(5.0)),
        measure: drift.as_ref().map(ExposureDrift::severity),
        threshold: drift.is_some().then_some(ExposureDrift::THRESHOLD),
        action: Some("a gain and an offset per channel of each picture".to_owned()),
        why,
        ..EffectDecision::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_decides() {
        let drift = |exposure| ExposureDrift { log_gains: Vec::new(), exposure, balance: 0.0 };
        let auto = |found| decision(EffectChoice::Auto, Some(found));
        assert!(auto(Some(drift(0.2))).on);
        assert!(!auto(Some(drift(0.02))).on);
        assert!(!auto(None).on);
        assert_eq!(auto(Some(drift(0.2))).measure, Some(2.0));
        assert!(decision(EffectChoice::On, None).on);
        assert!(!decision(EffectChoice::Off, None).on);
        assert!(auto(None).why.contains("--exposure on"));
    }
}
