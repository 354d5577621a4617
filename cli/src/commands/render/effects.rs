//! The effects of a `render`: on the scene before, and on its pictures.

use super::cameras::{Shot, Shots};
use super::{Args, near};
use crate::session::Session;
use anyhow::Result;
use scenesplat::datasets::effects::pictures::{DrawnPicture, PictureReport, PictureSimulator};
use scenesplat::datasets::effects::{Effect, EffectSet, Pane, largest_wall, simulate_upright};
use scenesplat::scene::{GaussianScene, StatedUp, guess_up};
use scenesplat_lab::capture::ScenePictures;
use serde_json::json;

/// Takes the pictures, and remembers what was done to each.
pub(super) struct Effects {
    set: EffectSet,
    seed: u64,
    simulator: PictureSimulator,
    pane: Option<Pane>,
    taken: Vec<(String, usize, PictureReport)>,
}

impl Effects {
    /// Damages the scene as asked, and gets ready for its pictures.
    pub(super) fn on(
        session: &Session<'_>,
        args: &Args,
        (mut scene, stated_up): (GaussianScene, StatedUp),
        shots: &Shots,
    ) -> Result<(GaussianScene, Self)> {
        let (on_scene, on_pictures) = args.effect.split_for_pictures();
        if !args.effect.is_empty() {
            session.receipt.setting("effect", args.effect, "what the capture does");
            session.receipt.setting("seed", args.seed, "which of the possible damages");
        }
        // Nothing of this runs for what is absent.
        let glass = on_pictures.severity(Effect::Glass);
        if !on_scene.is_empty() {
            let _stage = session.receipt.stage("simulate");
            let found = simulate_upright(&scene, &on_scene, args.seed, args.up)?;
            for done in &found.done {
                let name = done.effect.name();
                session.progress.say(format!("{name}={}: {}", done.severity, done.text));
                session.receipt.setting(name, done.severity, &done.text);
            }
            scene = found.scene;
        }
        let mut pane = None;
        if glass > 0.0 {
            let _stage = session.receipt.stage("find glass");
            let up = args.up.unwrap_or_else(|| guess_up(&scene, stated_up).direction);
            let wall = largest_wall(&scene.coord, up);
            pane = wall.map(|wall| Pane::on(&wall, glass, args.seed));
        }
        let near = near(args, shots).into();
        let simulator = PictureSimulator::new(&on_pictures, args.seed, pane, near)?;
        let taken = Vec::new();
        Ok((scene, Self { set: on_pictures, seed: args.seed, simulator, pane, taken }))
    }

    pub(super) fn needs_depth(&self) -> bool {
        self.simulator.needs_depth()
    }

    /// Takes the next picture.
    pub(super) fn take(
        &mut self,
        pictures: &ScenePictures<'_>,
        shot: &Shot,
    ) -> Result<DrawnPicture> {
        let frame = shot.index as u64;
        let (picture, report) = self.simulator.take(pictures, frame, &shot.camera)?;
        self.taken.push((shot.name.clone(), shot.index, report));
        Ok(picture)
    }

    /// Says and notes each effect with its cost, and writes what became of each picture.
    pub(super) fn tell(&self, session: &Session<'_>) -> Result<()> {
        for (effect, severity) in self.set.present() {
            let text = self.text(effect);
            session.progress.say(format!("{}={severity}: {text}", effect.name()));
            session.receipt.setting(effect.name(), severity, &text);
        }
        if self.set.is_empty() {
            return Ok(());
        }
        let renders: usize = self.taken.iter().map(|(_, _, report)| report.renders).sum();
        let why = format!("renders for {} pictures; one each without effects", self.taken.len());
        session.receipt.setting("renders", renders, &why);
        let frame = |(name, frame, report): &(String, usize, PictureReport)| {
            json!({
                "picture": format!("{name}.png"),
                "frame": frame,
                "renders": report.renders,
                "blur_pixels": report.blur_pixels,
                "poses": report.poses,
                "glass_share": report.glass,
                "linear_gain": report.gain,
            })
        };
        let frames: Vec<_> = self.taken.iter().map(frame).collect();
        let text = json!({
            "effect": self.set.to_string(),
            "seed": self.seed,
            "renders": renders,
            "pictures": frames,
        });
        let text = serde_json::to_string_pretty(&text)? + "\n";
        session.write_text("effects.json", &text)?;
        Ok(())
    }

    /// What an effect did to the pictures, and what it cost.
    fn text(&self, effect: Effect) -> String {
        let reports = || self.taken.iter().map(|(_, _, report)| report);
        let count = self.taken.len().max(1) as f64;
        let most = |of: fn(&PictureReport) -> f64| reports().map(of).fold(0.0, f64::max);
        match effect {
            Effect::Blur => {
                let poses: usize = reports().map(|report| report.poses).sum();
                format!(
                    "motion of up to {:.1} pixels; {:.1} renders a picture, up to K = {:.0}",
                    most(|r| r.blur_pixels),
                    poses as f64 / count,
                    most(|r| r.poses as f64)
                )
            }
            Effect::Glass if self.pane.is_none() => {
                "no upright plane that could hold a pane: no glass, no cost".to_owned()
            }
            Effect::Glass => format!(
                "a pane in {} of {} pictures, one more render each; up to {:.0} % of a picture",
                reports().filter(|r| r.glass > 0.0).count(),
                self.taken.len(),
                100.0 * most(|r| r.glass)
            ),
            Effect::Light => {
                let least = reports().map(|r| r.gain[1]).fold(f64::INFINITY, f64::min);
                format!("exposure from {least:.2} to {:.2} times; no render", most(|r| r.gain[1]))
            }
            _ => "no render".to_owned(),
        }
    }
}
