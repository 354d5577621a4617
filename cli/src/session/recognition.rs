//! What of a scene the network inside the program knows.

use super::Session;
use crate::flags::Inference;
use crate::frame::frame;
use anyhow::Result;
use scenesplat::SceneFeatures;
use scenesplat::objects::surfaces::Surfaces;
use scenesplat::outputs::OpenedScene;
use scenesplat::recognition::{FEWEST, KNOWN, Recognition, Recognized};
use scenesplat::scene::squareness;

impl Session<'_> {
    /// How probable it is that each Gaussian is part of a room as the network inside the program, whose features
    /// these are, knows them; `None` if the features cannot tell, or there are
    /// too few Gaussians. Without surfaces the scene is judged as one.
    pub fn recognize(
        &self,
        opened: &OpenedScene,
        inference: &Inference,
        features: &SceneFeatures,
        surfaces: Option<&Surfaces>,
    ) -> Result<Option<Recognized>> {
        if opened.loaded.scene.len() < FEWEST {
            let why = format!(
                "whether the network knows such a scene is not judged: it has fewer than {FEWEST} Gaussians"
            );
            self.receipt.setting("known", "not judged", &why);
            self.progress.detail(why);
            return Ok(None);
        }
        let turn = frame(self, opened, inference).turn;
        let _stage = self.receipt.stage("recognition");
        let scene = &opened.loaded.scene;
        let square = squareness(scene, &turn);
        let Some(found) = Recognition::embedded()?.of(features, surfaces, square)? else {
            let why = "codes, or features without direction, do not tell what of a scene is known";
            self.receipt.setting("known", "not judged", why);
            return Ok(None);
        };
        let why = format!(
            "share of the Gaussians that are part of a room with a probability of {KNOWN} and more; by features \
             (score {:.2}) and {:.0} % of the surface square",
            found.score,
            100.0 * found.squareness
        );
        self.receipt.setting("known", format!("{:.3}", found.share(KNOWN)), &why);
        Ok(Some(found))
    }

    /// Warns that a scene, or part of it, looks like nothing that the network was trained on, with the consequence.
    pub fn warn_strange(&self, unknown: f64, consequence: &str) {
        let what = match unknown {
            share if share > 0.995 => "this looks".to_owned(),
            share => format!("{:.0} % of this look", 100.0 * share),
        };
        self.doubt(format!(
            "{what} like nothing that the network inside the program was trained on: {consequence}"
        ));
    }
}
