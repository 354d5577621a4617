//! `--surfaces`: labels agree on what is one smooth surface of one color.

use crate::commands::labelled::frame;
use crate::flags::Inference;
use crate::session::Session;
use anyhow::Result;
use scenesplat::labels::scene_surfaces;
use scenesplat::objects::surfaces::{SurfaceSettings, Surfaces};
use scenesplat::outputs::OpenedScene;

/// Whether surfaces have one label each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::Args)]
pub struct SurfaceArgs {
    /// Whether labels agree on smooth surfaces of one color, before neighbours vote: each Gaussian takes the label of
    /// most of the surfaces that it is on.
    #[arg(long, value_name = "WHAT", default_value = "off")]
    pub surfaces: SurfaceChoice,
}

/// What is done about surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum SurfaceChoice {
    /// Labels agree on them.
    On,
    /// Labels stay.
    Off,
}

impl SurfaceArgs {
    /// The surfaces of a scene, if labels are to agree on them, else none.
    pub fn find(
        self,
        session: &Session<'_>,
        opened: &OpenedScene,
        inference: &Inference,
    ) -> Result<Vec<Surfaces>> {
        if self.surfaces == SurfaceChoice::Off {
            session.receipt.setting("surfaces", "off", "each Gaussian has a label of its own");
            return Ok(Vec::new());
        }
        let _stage = session.receipt.stage("surfaces");
        let metres = frame(opened, inference).metres_per_unit;
        let found = scene_surfaces(&opened.loaded.scene, metres, &SurfaceSettings::default())?;
        let counts: Vec<String> = found.iter().map(|of| of.count.to_string()).collect();
        let meaning = "smooth pieces of one color, small to large, on which labels agree";
        session.receipt.setting("surfaces", counts.join(" "), meaning);
        Ok(found)
    }
}
