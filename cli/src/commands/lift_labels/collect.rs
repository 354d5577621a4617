//! The weights of all pictures, and whether they contradict each other.

use super::args::{Args, RobustArg};
use super::glass::Glass;
use super::pictures::Pictures;
use super::plan::Guard;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::memory::Bytes;
use scenesplat::rasterizer::Gaussians;
use scenesplat::rasterizer::lifting::{LiftSettings, Lifter, Robust};

impl Args {
    /// Collects the weights of all pictures, each counting as much as it says.
    pub(super) fn lift<'a>(
        &self,
        session: &Session<'_>,
        gaussians: &'a Gaussians,
        pictures: &Pictures<'_>,
        picture_weights: &[f32],
        settings: &LiftSettings,
        glass: &Glass,
    ) -> Result<Lifter<'a>> {
        let _stage = session.receipt.stage("lift");
        let mut lifter: Option<Lifter<'a>> = None;
        let (mut without_feature, mut weight, mut labelled) = (0, 0.0, 0.0);
        for number in 0..pictures.len() {
            session.check_stop()?;
            session.progress.advance("lifting", number as f64 / pictures.len() as f64);
            let picture = pictures.read(number)?;
            let lifter = match &mut lifter {
                Some(lifter) => lifter,
                none => {
                    let (levels, dim) = (self.level.len(), picture.segments.dim);
                    let new = Lifter::new(gaussians, levels, dim, settings.clone())?;
                    none.insert(match &glass.panes {
                        Some(panes) => new.with_panes(panes.clone())?,
                        None => new,
                    })
                }
            };
            picture.check_dim(lifter.tables().dim())?;
            let report = lifter
                .add_weighted(&picture.labelled(), picture_weights[number])
                .with_context(|| format!("frame {}", picture.name))?;
            without_feature += report.without_feature;
            weight += report.weight;
            labelled += report.labelled.first().copied().unwrap_or(0.0);
        }
        session.progress.finish();
        let lifter = lifter.context("no camera has segments")?;
        anyhow::ensure!(
            !lifter.tables().is_empty(),
            "{}: no picture has a segment with a feature",
            self.segments.display()
        );
        if without_feature > 0 {
            let text =
                format!("{without_feature} segments have a feature of zeros: they label nothing");
            session.warn(text);
        }
        session.progress.say(format!(
            "{} segments, {} weights ({} on disk), {:.1} % of the weight is in segments",
            lifter.tables().len(),
            lifter.num_weights(),
            Bytes(lifter.bytes_on_disk()),
            100.0 * labelled / f64::max(weight, 1e-9)
        ));
        Ok(lifter)
    }

    /// Whether to guard against wrong labels, and where, by what was measured.
    pub(super) fn decide(
        &self,
        session: &Session<'_>,
        lifter: &mut Lifter<'_>,
        number: usize,
        level: usize,
    ) -> Result<Guard> {
        let _stage = session.receipt.stage("disagreement");
        let rule = match self.lifting.robust {
            RobustArg::Auto => Robust::default(),
            RobustArg::On => Robust::On,
            RobustArg::Off => Robust::Off,
        };
        let measured = lifter.disagreement(number)?;
        let robust = rule.decide(measured.value());
        let figure = measured.value().map_or("unknown".to_owned(), |v| format!("{v:.3}"));
        session.progress.say(format!(
            "level {level}: disagreement between pictures {figure} on {} Gaussians; {}",
            measured.gaussians(),
            match (robust, self.lifting.robust) {
                (false, _) => "taking the weighted mean",
                (true, RobustArg::Auto) => "guarding where they contradict each other",
                (true, _) => "guarding everywhere",
            }
        ));
        let why = "variance of a Gaussian's labels over pictures, of that of all labels";
        session.receipt.setting(&format!("disagreement[{level}]"), figure, why);
        session.receipt.setting(
            &format!("robust[{level}]"),
            robust,
            "by --robust and the measurement",
        );
        // Who asks for it gets it everywhere.
        let above = match (robust, self.lifting.robust) {
            (true, RobustArg::Auto) => measured.conflict().map(|limit| limit as f32),
            _ => None,
        };
        Ok(Guard { decision: self.about_labels(level, robust, &measured), above })
    }
}
