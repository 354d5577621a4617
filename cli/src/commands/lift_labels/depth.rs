//! Whether only pixels of a Gaussian's own depth label it.

use super::args::{Args, DepthArg, RuleArg};
use super::pictures::Pictures;
use super::plan::LIFTING;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::rasterizer::Gaussians;
use scenesplat::rasterizer::lifting::{DepthEffect, DepthProbe, DepthTolerance};

impl Args {
    /// What depth has to agree with a Gaussian's, if any; with `auto`, by what some pictures show.
    pub(super) fn decide_depth(
        &self,
        session: &Session<'_>,
        (gaussians, antialiased): (&Gaussians, bool),
        pictures: &Pictures<'_>,
    ) -> Result<Option<DepthTolerance>> {
        let note = |text: &str, on: bool| {
            session.receipt.setting("depth", text, "pixels of another depth label nothing");
            let decision = self.about_depth(on, None);
            session.receipt.decided(gaussians.means.len(), LIFTING, decision);
        };
        match &self.lifting.depth {
            DepthArg::Off => {
                note("off", false);
                return Ok(None);
            }
            DepthArg::Auto if self.lifting.rule == RuleArg::CentrePixel => {
                note("auto: off", false);
                return Ok(None);
            }
            DepthArg::Auto => {}
            DepthArg::Render => {
                note("render", true);
                return Ok(Some(DepthTolerance::RENDERED));
            }
            DepthArg::Folder(folder) => {
                note(&folder.display().to_string(), true);
                return Ok(Some(DepthTolerance::default()));
            }
        }
        let effect = self.depth_effect(session, (gaussians, antialiased), pictures)?;
        let found = effect.misleading.map_or("unknown".to_owned(), |m| format!("{m:.3}"));
        let chosen = if effect.helps() { "render" } else { "off" };
        session.progress.say(format!(
            "labels at another depth mislead: {found} (0: as right as the others, 1: by lot) on {} \
             Gaussians, {:.1} % of the weight is at its depth; depth agreement: {chosen}",
            effect.gaussians,
            100.0 * effect.kept
        ));
        let why = "measured for --depth auto";
        session.receipt.setting("depth_misleading", found, why);
        session.receipt.setting("depth_gaussians", effect.gaussians, why);
        session.receipt.setting("depth_kept", format!("{:.3}", effect.kept), why);
        note(&format!("auto: {chosen}"), effect.helps());
        let decision = self.about_depth(effect.helps(), Some(&effect));
        session.receipt.decided(gaussians.means.len(), LIFTING, decision);
        Ok(effect.helps().then_some(DepthTolerance::RENDERED))
    }

    fn depth_effect(
        &self,
        session: &Session<'_>,
        (gaussians, antialiased): (&Gaussians, bool),
        pictures: &Pictures<'_>,
    ) -> Result<DepthEffect> {
        let _stage = session.receipt.stage("depth agreement");
        let all = pictures.len();
        let count = all.min(DepthProbe::PICTURES);
        let mut probe = None;
        for number in 0..count {
            session.check_stop()?;
            session.progress.advance("trying depth agreement", number as f64 / count as f64);
            let picture = pictures.read(number * all / count)?;
            let (dim, probe) = match &mut probe {
                Some((dim, probe)) => (*dim, probe),
                none => {
                    let dim = picture.segments.dim;
                    let new = DepthProbe::new(gaussians, dim, &self.settings(None, antialiased))?;
                    (dim, &mut none.insert((dim, new)).1)
                }
            };
            picture.check_dim(dim)?;
            probe.add(&picture.labelled()).with_context(|| format!("frame {}", picture.name))?;
        }
        session.progress.finish();
        Ok(probe.context("no camera has segments")?.1.effect()?)
    }
}
