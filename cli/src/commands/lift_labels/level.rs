//! Features and files of one granularity.

use super::plan::{Guard, LIFTING};
use super::{Args, write};
use crate::progress::interrupted;
use crate::session::Session;
use anyhow::Result;
use scenesplat::datasets::effects::plan::EffectDecision;
use scenesplat::outputs::{OpenedScene, write_scene_preview};
use scenesplat::rasterizer::lifting::{LiftError, Lifter};
use scenesplat::scene::guess_up;
use std::path::{Path, PathBuf};

impl Args {
    /// Makes the features of one level and writes all files.
    pub(super) fn write(
        &self,
        session: &Session<'_>,
        opened: &OpenedScene,
        lifter: &mut Lifter<'_>,
        number: usize,
        level: usize,
        guard: Guard,
    ) -> Result<()> {
        let folder = self.folder(session, level)?;
        let stage = session.receipt.stage("features");
        let mut writer = write::Writer::new(opened, &folder, lifter.tables())?;
        let rows = opened.loaded.scene.len().max(1);
        let mut guarded = 0;
        lifter.features(number, &self.finalise(&guard), |block| {
            if interrupted() {
                return Err(LiftError::Stopped);
            }
            session.progress.advance("features", block.first as f64 / rows as f64);
            guarded += block.guarded.iter().filter(|is| **is).count();
            writer.add(&block)
        })?;
        session.progress.finish();
        let decision = EffectDecision { changed: Some(guarded), ..guard.decision };
        session.receipt.decided(opened.loaded.scene.len(), LIFTING, decision);
        let written = writer.finish()?;
        drop(stage);
        for (path, bytes) in &written.files {
            session.wrote(path, *bytes);
        }
        session.receipt.add_rows_out(opened.loaded.source_rows());
        session.progress.say(format!(
            "level {level}: {} of {} Gaussians have a feature; mean confidence {:.3}, seen by {:.1} \
             pictures on average",
            written.valid,
            opened.loaded.scene.len(),
            written.mean_confidence,
            written.mean_views
        ));
        session.check_stop()?;
        self.picture(session, opened, &folder, &written.colors)
    }

    /// Where the files of a level go.
    pub(super) fn folder(&self, session: &Session<'_>, level: usize) -> Result<PathBuf> {
        match self.level.len() {
            1 => session.outputs.main_folder(),
            _ => session.outputs.inner_folder(&inner_folder(level)),
        }
    }

    /// The picture of a level's features. `colors`: of the Gaussians.
    pub(super) fn picture(
        &self,
        session: &Session<'_>,
        opened: &OpenedScene,
        folder: &Path,
        colors: &[[u8; 3]],
    ) -> Result<()> {
        let _stage = session.receipt.stage("picture");
        let name = self.input.name();
        let title = format!("{name}: lifted labels (principal components as colors)");
        let loaded = &opened.loaded;
        let (scene, stated) = (&loaded.scene, loaded.stated_up);
        let up = self.lifting.up.unwrap_or_else(|| guess_up(scene, stated).direction);
        let path = folder.join("preview.png");
        let settings = self.lifting.preview.settings(title, session.doubts(), up);
        let bytes = write_scene_preview(scene, colors, &[], &settings, &path)?;
        session.wrote(&path, bytes);
        Ok(())
    }
}

/// The folder of a level in the output folder, if there are several.
pub(super) fn inner_folder(level: usize) -> String {
    format!("level-{level}")
}
