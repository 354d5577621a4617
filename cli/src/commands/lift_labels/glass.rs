//! Whether labels are lifted in two layers, where pictures look through glass.

use super::args::Args;
use super::plan::LIFTING;
use crate::error::{WrongUse, refuse};
use crate::receipt::ReceiptReport;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::datasets::effects::plan::{EffectDecision, EffectPlan};
use scenesplat::datasets::effects::{Effect, EffectError};
use scenesplat::rasterizer::lifting::{Lifter, Panes};
use scenesplat::scene::GaussianScene;
use scenesplat::scene::input_file::open_regular_file;
use scenesplat_lab::compensation::{glass_decision, panes_of};
use std::io::Read;

/// What was decided about glass.
pub struct Glass {
    decision: EffectDecision,
    /// `None` where labels are lifted in one layer.
    pub(super) panes: Option<Panes>,
}

fn wrong(error: &EffectError) -> anyhow::Error {
    WrongUse(format!("--effect: {error}")).into()
}

impl Args {
    /// Refuses a wish that nothing could fulfil.
    pub(super) fn check_effects(&self) -> Result<()> {
        glass_decision(&GaussianScene::default(), &self.effect, None).map_err(|e| wrong(&e))?;
        Ok(())
    }

    /// The plan of the earlier run, if one was named.
    pub(super) fn plan_before(&self, session: &Session<'_>) -> Result<Option<EffectPlan>> {
        let Some(path) = &self.effect_before else { return Ok(None) };
        session.outputs.reads(path)?;
        let named = || format!("--effect-before {}", path.display());
        let mut text = String::new();
        open_regular_file(path)?.read_to_string(&mut text).with_context(named)?;
        let plan = ReceiptReport::plan_in(&text)
            .map_err(|error| WrongUse(format!("{}: no receipt with a plan: {error}", named())))?;
        let section = plan.section(LIFTING);
        if section.and_then(|section| section.of(Effect::Glass)).is_none() {
            refuse!("{}: it decides nothing about glass", named());
        }
        session.receipt.fingerprint("effects before", path)?;
        Ok(Some(plan))
    }

    /// Looks for glass, unless that is off by choice.
    pub(super) fn decide_glass(
        &self,
        session: &Session<'_>,
        scene: &GaussianScene,
        before: Option<&EffectPlan>,
    ) -> Result<Glass> {
        let _stage = session.receipt.stage("glass");
        let before = before.and_then(|plan| plan.section(LIFTING));
        let decision = glass_decision(scene, &self.effect, before).map_err(|e| wrong(&e))?;
        let panes = (decision.on).then(|| panes_of(scene, &decision.regions));
        let panes = panes.filter(|panes| !panes.balls.is_empty());
        if decision.on && panes.is_none() {
            let text =
                format!("no pane was found, labels are lifted in one layer: {}", decision.why);
            session.warn(text);
        }
        Ok(Glass { decision, panes })
    }

    /// Notes what came of it.
    pub(super) fn note_glass(&self, session: &Session<'_>, lifter: &Lifter<'_>, glass: Glass) {
        let Glass { mut decision, panes } = glass;
        decision.changed = Some(lifter.num_through_panes());
        if let Some(panes) = panes {
            let count = |rows: &[bool]| rows.iter().filter(|is| **is).count();
            session.progress.say(format!(
                "{} panes of {} Gaussians in {} pictures: labels of panes and of what is behind them are kept \
                 apart; {} Gaussians behind them may be mirror images and are less sure",
                panes.balls.len(),
                count(&panes.is_sheet),
                lifter.num_through_panes(),
                count(&panes.is_doubtful)
            ));
        }
        let gaussians = lifter.num_gaussians();
        session.receipt.decided(gaussians, LIFTING, decision);
    }
}
