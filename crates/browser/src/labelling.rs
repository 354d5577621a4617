//! From a scene to labels and objects, as `segment --instances` and `view` do it without flags.

use crate::EngineError;
use crate::remarks::{of_alignment, of_strangeness};
use scenesplat::alignment::judge::Judge;
use scenesplat::calibration::Calibration;
use scenesplat::datasets::effects::profile::profile;
use scenesplat::effect_costs::{EffectCosts, found_effects};
use scenesplat::labels::{Agreement, Classes, Labels, VOTE_K, label_agreeing_with_vote};
use scenesplat::metrics::ZeroShotOptions;
use scenesplat::objects::surfaces::{SceneSurfaces, SurfaceSettings, scene_surfaces};
use scenesplat::objects::{Catalogue, ObjectInput, ObjectSettings, find_objects};
use scenesplat::recognition::{FEWEST, KNOWN, Recognition};
use scenesplat::scene::{GaussianScene, LoadedScene, TextTable, squareness};
use scenesplat::{Alignment, AlignmentSettings, Network, SceneEncoder, SceneFeatures, embedded};

/// A part of the work, in the order in which they come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The file.
    Read,
    /// Which way is up, how large a unit is.
    Alignment,
    /// The network.
    Network,
    /// Smooth pieces of one color.
    Surfaces,
    /// Classes, agreement on surfaces, votes.
    Labels,
    /// Whether the network knows what it sees.
    Recognition,
    /// Objects with their boxes.
    Objects,
    /// What the page shows.
    Page,
    /// A file to save.
    Write,
}

/// Is told how far a stage has come, 0..=1.
pub type Tell<'a> = &'a mut dyn FnMut(Stage, f64);

/// A scene with labels and objects.
pub struct Labelled {
    /// Class of each Gaussian, −1 = none. `[N]`
    pub labels: Vec<i32>,
    /// How sure it is: the cosine with its class. `[N]`
    pub scores: Vec<f32>,
    /// The classes.
    pub text: TextTable,
    /// What the network says of each Gaussian.
    pub features: SceneFeatures,
    /// The objects.
    pub catalogue: Catalogue,
    /// How the scene lies.
    pub alignment: Alignment,
    /// What makes labels doubtful.
    pub warnings: Vec<String>,
    /// What else a reader may want to know.
    pub remarks: Vec<String>,
}

/// Labels a scene.
pub(crate) fn label(
    network: &Network,
    loaded: &LoadedScene,
    tell: Tell<'_>,
) -> Result<Labelled, EngineError> {
    let scene = &loaded.scene;
    let encoder = SceneEncoder::new(network);
    let alignment = aligned(&encoder, loaded, tell)?;
    tell(Stage::Network, 0.0);
    let features = encoder.encode_aligned(scene, alignment.clone(), &mut |at| {
        tell(Stage::Network, at.done);
        Ok(())
    })?;
    let text = embedded::vocabulary()?.class_table();
    tell(Stage::Surfaces, 0.0);
    let (turn, metres) = (alignment.rotation(), alignment.scale);
    let surfaces = scene_surfaces(scene, &turn, metres, &SurfaceSettings::default())?;
    tell(Stage::Labels, 0.0);
    let mut found = labels(scene, &features, &text, &surfaces)?;
    tell(Stage::Recognition, 0.0);
    let [mut warnings, mut remarks] = of_alignment(&alignment);
    warnings.extend(withhold_strange(scene, &alignment, &features, &surfaces, &mut found)?);
    let costs = EffectCosts::embedded()?;
    let effects = found_effects(&profile(scene, metres), Some(&costs));
    remarks.extend(effects.iter().map(|effect| format!("Effect of the capture: {effect}.")));
    tell(Stage::Objects, 0.0);
    let catalogue = objects(scene, &features, &text, &alignment, &found)?;
    let Labels { labels, scores, .. } = found;
    Ok(Labelled { labels, scores, text, features, catalogue, alignment, warnings, remarks })
}

/// How the scene lies; where its shape leaves that open, the network decides.
fn aligned(
    encoder: &SceneEncoder<'_>,
    loaded: &LoadedScene,
    tell: Tell<'_>,
) -> Result<Alignment, EngineError> {
    tell(Stage::Alignment, 0.0);
    let settings = AlignmentSettings { stated_up: loaded.stated_up, ..encoder.alignment };
    let found = Alignment::of(&loaded.scene, &settings);
    if !(found.is_open() || found.is_size_open()) {
        return Ok(found);
    }
    let mut tell_judge = |at: scenesplat::inference::EncodeProgress| {
        tell(Stage::Alignment, at.done);
        Ok(())
    };
    Ok(Judge::embedded()?.decide(encoder, &loaded.scene, &settings, found, &mut tell_judge)?)
}

fn labels(
    scene: &GaussianScene,
    features: &SceneFeatures,
    text: &TextTable,
    surfaces: &SceneSurfaces,
) -> Result<Labels, EngineError> {
    let calibration = Calibration::embedded()?;
    let least_area = calibration.least_area(&text.names);
    let agreement = Agreement {
        surfaces: Some(surfaces),
        temperature: Some(calibration.temperature),
        min_probability: None,
        least_area: &least_area,
        objects: None,
    };
    let options = ZeroShotOptions::default();
    let classes = Classes::Texts(text);
    Ok(label_agreeing_with_vote(features, classes, &options, &agreement, &scene.coord, VOTE_K)?)
}

/// Takes the labels of what the network does not know; says so where it is worth saying.
fn withhold_strange(
    scene: &GaussianScene,
    alignment: &Alignment,
    features: &SceneFeatures,
    surfaces: &SceneSurfaces,
    found: &mut Labels,
) -> Result<Option<String>, EngineError> {
    if scene.len() < FEWEST {
        return Ok(Some(format!(
            "Whether the network knows such a scene is not judged: it has fewer than {FEWEST} Gaussians."
        )));
    }
    let square = squareness(scene, &alignment.rotation());
    let recognized = Recognition::embedded()?.of(features, Some(surfaces.largest()), square)?;
    let Some(recognized) = recognized else { return Ok(None) };
    let strange = recognized.strange(KNOWN);
    found.withhold(&strange);
    let count = strange.iter().filter(|is| **is).count();
    Ok(of_strangeness(count as f64 / strange.len() as f64))
}

fn objects(
    scene: &GaussianScene,
    features: &SceneFeatures,
    text: &TextTable,
    alignment: &Alignment,
    found: &Labels,
) -> Result<Catalogue, EngineError> {
    let add = |row: usize, sum: &mut [f32]| {
        // Features of a browser are in memory, and can be read.
        if let Ok(values) = features.gaussian_rows(row..row + 1) {
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        }
    };
    let instances = scene.instance.as_deref().filter(|ids| ids.iter().any(|id| *id >= 0));
    let input = ObjectInput {
        scene,
        labels: &found.labels,
        scores: Some(&found.scores),
        instances,
        features: Some((features.width(), &add as _)),
        names: &text.names,
        upright: alignment.upright(),
        metres_per_unit: alignment.scale,
        floor: None,
    };
    Ok(find_objects(&input, &ObjectSettings::default())?)
}
