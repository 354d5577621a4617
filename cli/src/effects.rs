//! `--effect` and `--effect-plan`: what a command with a network does about the effects of a capture.

use crate::error::WrongUse;
use crate::flags::Inference;
use crate::receipt::ReceiptReport;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::datasets::effects::EffectError;
use scenesplat::datasets::effects::plan::{EffectChoices, EffectPlan, looked_for};
use scenesplat::datasets::effects::profile::profile;
use scenesplat::effect_costs::{EffectCosts, FoundEffect, found_effects};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::GaussianScene;
use scenesplat::scene::input_file::open_regular_file;
use scenesplat_lab::compensation::{Compensation, Consumer, modules, plan_of};
use std::io::Read;
use std::path::PathBuf;

/// What to do about the effects of a capture.
#[derive(Debug, Clone, clap::Args)]
pub struct EffectArgs {
    /// What is done about effects of the capture (docs/effects.md): NAME=auto as the scene's own evidence says, if it
    /// was measured to be worth it; on; off. segment, query and evaluate can withhold labels at the rims of holes; all can
    /// leave floaters out of the voxels. A name that nothing acts on can only be auto or off.
    #[arg(long, value_name = "NAME=auto|on|off,…", default_value = "auto")]
    pub effect: EffectChoices,
    /// Follows the plan of an earlier run, from its receipt.json, instead of looking at the scene: the
    /// same result, bit for bit.
    #[arg(long, value_name = "FILE.json", conflicts_with = "effect")]
    pub effect_plan: Option<PathBuf>,
}

/// What is asked for, before the scene is known.
pub struct Wish {
    choices: EffectChoices,
    stored: Option<EffectPlan>,
}

impl EffectArgs {
    /// Reads a stored plan, and refuses what nothing could act on; `labels`: whether some may be withheld.
    pub fn wish(&self, session: &Session<'_>, network: bool, labels: bool) -> Result<Wish> {
        let consumer = Consumer { network, labels };
        let nothing = GaussianScene::default();
        plan_of(&nothing, 1.0, consumer, &self.effect).map_err(|e| wrong(&e))?;
        let Some(path) = &self.effect_plan else {
            return Ok(Wish { choices: self.effect, stored: None });
        };
        session.outputs.reads(path)?;
        let mut text = String::new();
        let named = || format!("--effect-plan {}", path.display());
        open_regular_file(path)?.read_to_string(&mut text).with_context(named)?;
        let plan = ReceiptReport::plan_in(&text)
            .map_err(|error| WrongUse(format!("{}: no receipt with a plan: {error}", named())))?;
        session.receipt.fingerprint("effect plan", path)?;
        Ok(Wish { choices: self.effect, stored: Some(plan) })
    }
}

fn wrong(error: &EffectError) -> anyhow::Error {
    WrongUse(format!("--effect: {error}")).into()
}

impl Session<'_> {
    /// Decides what is done about the effects of a scene, says and notes it.
    pub fn compensation(
        &self,
        wish: &Wish,
        opened: &OpenedScene,
        inference: &Inference,
        consumer: Consumer,
    ) -> Result<Compensation> {
        let _stage = self.receipt.stage("effects");
        let scene = &opened.loaded.scene;
        let mut section = match &wish.stored {
            Some(plan) => plan
                .replayed(scene.len(), &modules(consumer))
                .map_err(|error| WrongUse(format!("--effect-plan: {error}")))?,
            None => {
                let is_idle = looked_for(&modules(consumer), &wish.choices).is_empty();
                let metres = if is_idle { 1.0 } else { self.alignment(opened, inference).scale };
                plan_of(scene, metres, consumer, &wish.choices).map_err(|e| wrong(&e))?
            }
        };
        let about = Compensation::of(&mut section, scene);
        self.progress.detail(section.to_string());
        self.receipt.plan(scene.len(), section);
        Ok(about)
    }

    /// Says which effects of the capture a labeled scene shows, what each costs, and what to do about it; labels do not
    /// depend on it. `is_own`: by the network inside the program, whose costs are known.
    pub fn note_effects(
        &self,
        opened: &OpenedScene,
        inference: &Inference,
        is_own: bool,
    ) -> Result<Vec<FoundEffect>> {
        let metres = self.alignment(opened, inference).scale;
        let _stage = self.receipt.stage("effects");
        let costs = is_own.then(EffectCosts::embedded).transpose()?;
        let found = found_effects(&profile(&opened.loaded.scene, metres), costs.as_ref());
        for effect in &found {
            self.progress.say(format!("effect of the capture: {effect}"));
        }
        self.receipt.effects(&found);
        Ok(found)
    }

    /// Says how much was withheld; nothing where nothing was.
    pub fn note_withheld(&self, count: usize, what: &str) {
        if count > 0 {
            let text = format!("{count} {what} withheld at the rims of holes");
            self.progress.say(&text);
            self.receipt.setting("withheld_at_holes", count, &text);
        }
    }
}
