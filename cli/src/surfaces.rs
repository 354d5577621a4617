//! `--surfaces`: labels agree on what is one smooth surface of one color.

use crate::commands::labelled::{Frame, frame};
use crate::flags::Inference;
use crate::session::Session;
use anyhow::Result;
use scenesplat::objects::surfaces::{SurfaceSettings, Surfaces, scene_surfaces};
use scenesplat::outputs::OpenedScene;

/// Whether surfaces have one label each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::Args)]
pub struct SurfaceArgs {
    /// Whether labels agree on smooth surfaces of one color, before neighbours vote: each Gaussian takes the label of
    /// most of the surfaces that it is on. auto is on where the classes are those of the built-in vocabulary, as they
    /// are for the network inside the program.
    #[arg(long, value_name = "WHAT", default_value = "auto")]
    pub surfaces: SurfaceChoice,
}

/// What is done about surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum SurfaceChoice {
    /// On where the classes are those of the built-in vocabulary, else off.
    Auto,
    /// Labels agree on them.
    On,
    /// Labels stay.
    Off,
}

impl SurfaceArgs {
    /// The surfaces of a scene, if labels are to agree on them, else none; `is_vocabulary`: whether the
    /// classes are those of the built-in vocabulary.
    pub fn find(
        self,
        session: &Session<'_>,
        opened: &OpenedScene,
        inference: &Inference,
        is_vocabulary: bool,
    ) -> Result<Vec<Surfaces>> {
        let is_on = match self.surfaces {
            SurfaceChoice::Auto => is_vocabulary,
            SurfaceChoice::On => true,
            SurfaceChoice::Off => false,
        };
        if !is_on {
            session.receipt.setting("surfaces", "off", "each Gaussian has a label of its own");
            return Ok(Vec::new());
        }
        let _stage = session.receipt.stage("surfaces");
        let Frame { upright, metres_per_unit, .. } = frame(opened, inference);
        let settings = SurfaceSettings::default();
        let found = scene_surfaces(&opened.loaded.scene, &upright, metres_per_unit, &settings)?;
        let counts: Vec<String> = found.iter().map(|of| of.count.to_string()).collect();
        let meaning = "smooth pieces of one color, small to large, on which labels agree";
        session.receipt.setting("surfaces", counts.join(" "), meaning);
        Ok(found)
    }
}
