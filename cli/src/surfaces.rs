//! `--surfaces`, `--min-probability` and `--refine`: labels agree on what is one smooth surface of one color, stay out where
//! the network is not sure, and objects correct them.

use crate::error::refuse;
use crate::flags::Inference;
use crate::frame::{Frame, frame};
use crate::session::Session;
use anyhow::Result;
use scenesplat::calibration::Calibration;
use scenesplat::labels::{Agreement, RefinedObjects};
use scenesplat::objects::RefineSettings;
use scenesplat::objects::surfaces::{SceneSurfaces, SurfaceSettings, scene_surfaces};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::GaussianScene;

/// What labels agree on, and how sure they have to be.
#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct SurfaceArgs {
    /// Whether labels agree on smooth surfaces of one color, before neighbors vote: each Gaussian takes the class for
    /// which its surfaces speak most, and pieces too small for their class take the label of a neighbor. auto is on
    /// where the classes are those of the built-in vocabulary, as they are for the network inside the program.
    #[arg(long, value_name = "WHAT", default_value = "auto")]
    pub surfaces: SurfaceChoice,
    /// Leaves Gaussians unlabeled whose best class is less probable than this, 0 to 1. Of a network whose
    /// probabilities are calibrated, such as the one inside the program, with the classes of the vocabulary, or of a classifier.
    #[arg(long, value_name = "P", value_parser = parse_probability)]
    pub min_probability: Option<f32>,
    /// What corrects labels before neighbors vote. objects: an object of the labels becomes a much larger one that it touches and
    /// could be as well, or what its Gaussians speak for most if it could not be what it is, and its Gaussians with it.
    /// Needs probabilities, as --min-probability does.
    #[arg(long, value_name = "WHAT", default_value = "off")]
    pub refine: RefineChoice,
}

impl Default for SurfaceArgs {
    fn default() -> Self {
        Self { surfaces: SurfaceChoice::Auto, min_probability: None, refine: RefineChoice::Off }
    }
}

/// What corrects labels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum RefineChoice {
    /// The objects that they make.
    Objects,
    /// Nothing.
    Off,
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

fn parse_probability(text: &str) -> Result<f32, String> {
    let value: f32 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if (0.0..=1.0).contains(&value) { Ok(value) } else { Err("expected 0 to 1".to_owned()) }
}

/// What the classes are.
#[derive(Debug, Clone, Copy)]
pub struct Asked<'a> {
    /// Their names.
    pub names: &'a [String],
    /// Whether they are those of the built-in vocabulary.
    pub is_vocabulary: bool,
    /// Whether a network looks for them, not features made before.
    pub is_network: bool,
    /// Whether features are their probabilities.
    pub is_classifier: bool,
}

/// What the labels of a scene agree on.
#[derive(Debug)]
pub struct Agreeing {
    surfaces: Option<SceneSurfaces>,
    temperature: Option<f32>,
    min_probability: Option<f32>,
    least_area: Vec<f64>,
    /// How the scene lies, if objects refine labels.
    refines: Option<Frame>,
}

impl Agreeing {
    /// The surfaces, if labels agree on any.
    pub fn surfaces(&self) -> Option<&SceneSurfaces> {
        self.surfaces.as_ref()
    }

    /// As the library takes it, for the scene that it was found for and the names of its classes.
    pub fn agreement<'a>(&'a self, scene: &'a GaussianScene, names: &'a [String]) -> Agreement<'a> {
        let objects = self.refines.map(|frame| {
            let Frame { upright, metres_per_unit, .. } = frame;
            let settings = RefineSettings::default();
            RefinedObjects { scene, names, upright, metres_per_unit, settings }
        });
        Agreement {
            surfaces: self.surfaces.as_ref(),
            temperature: self.temperature,
            min_probability: self.min_probability,
            least_area: &self.least_area,
            objects,
        }
    }
}

impl SurfaceArgs {
    /// The first flag that was given.
    pub fn given(self) -> Option<&'static str> {
        if self.surfaces != SurfaceChoice::Auto {
            return Some("--surfaces");
        }
        if self.refine != RefineChoice::Off {
            return Some("--refine");
        }
        self.min_probability.map(|_| "--min-probability")
    }

    /// Records by what probabilities labels are judged; refuses a least one where there are none.
    fn note_probabilities(
        self,
        session: &Session<'_>,
        temperature: Option<f32>,
        is_classifier: bool,
    ) -> Result<()> {
        let has_none = temperature.is_none() && !is_classifier;
        if has_none && self.refine != RefineChoice::Off {
            refuse!(
                "--refine: cosines of this network with these classes are not calibrated, as those of the network \
                 inside the program with its own are; leave it out"
            );
        }
        if let Some(least) = self.min_probability {
            if has_none {
                refuse!(
                    "--min-probability: cosines of this network with these classes are not calibrated, as those of the \
                            network inside the program with its own are; give a least cosine (--min-score)"
                );
            }
            let meaning = "what is less probable stays unknown";
            session.receipt.setting("min_probability", least, meaning);
        }
        if let Some(temperature) = temperature {
            let meaning = "cosines over it are the logits of probabilities";
            session.receipt.setting("temperature", temperature, meaning);
        }
        Ok(())
    }

    /// What the labels of a scene are to agree on.
    pub fn find(
        self,
        session: &Session<'_>,
        opened: &OpenedScene,
        inference: &Inference,
        asked: Asked<'_>,
    ) -> Result<Agreeing> {
        let Asked { names, is_vocabulary, is_network, is_classifier } = asked;
        let own = match is_vocabulary && is_network {
            true => Calibration::of(&inference.network.weights()?)?,
            false => None,
        };
        let temperature = own.as_ref().map(|own| own.temperature);
        // How large things are does not depend on who looks at them.
        let sizes = match own {
            None if is_vocabulary => Some(Calibration::embedded()?),
            own => own,
        };
        self.note_probabilities(session, temperature, is_classifier)?;
        let is_on = match self.surfaces {
            SurfaceChoice::Auto => is_vocabulary,
            SurfaceChoice::On => true,
            SurfaceChoice::Off => false,
        };
        let mut agreeing = Agreeing {
            surfaces: None,
            temperature,
            min_probability: self.min_probability,
            least_area: sizes.map(|sizes| sizes.least_area(names)).unwrap_or_default(),
            refines: None,
        };
        if self.refine == RefineChoice::Objects {
            agreeing.refines = Some(frame(session, opened, inference));
            session.receipt.setting(
                "refine",
                "objects",
                "labels and their objects correct each other",
            );
        }
        if !is_on {
            session.receipt.setting("surfaces", "off", "each Gaussian has a label of its own");
            return Ok(agreeing);
        }
        let _stage = session.receipt.stage("surfaces");
        let Frame { turn, metres_per_unit, .. } = frame(session, opened, inference);
        let settings = SurfaceSettings::default();
        let found = scene_surfaces(&opened.loaded.scene, &turn, metres_per_unit, &settings)?;
        let counts: Vec<String> = found.scales.iter().map(|of| of.count.to_string()).collect();
        let meaning = match agreeing.least_area.is_empty() {
            true => "smooth pieces of one color, small to large, on which labels agree",
            false => {
                "smooth pieces of one color, small to large, on which labels agree; then what is too small for its \
                 class takes the label of a neighbor"
            }
        };
        session.receipt.setting("surfaces", counts.join(" "), meaning);
        agreeing.surfaces = Some(found);
        Ok(agreeing)
    }
}
