//! A network learns from one scene's own labels, beside rooms that are made on the spot so that it forgets nothing.
//!
//! The scene is one of the training's data sets ([`write_scene`]): where it has a label that label is learned, elsewhere what
//! the network said before; some labels are held out ([`held_out`]). The training is an [experiment](crate::experiment) by the
//! recipe in `configs/adapt.toml` ([`experiment`]); of its weights and those before a mean is taken ([`write_blend`]). [`Exam`] says what the network knows before and after.

mod blend;
mod error;
mod figures;
mod labels;
mod recipe;
mod settings;
mod split;

pub use blend::write_blend;
pub use error::AdaptError;
pub use figures::{AgainstTruth, Exam, Figures, OfRooms, Progress, Right};
pub use labels::{LabelFiles, OwnLabels, class_of_names};
pub use recipe::experiment;
pub use settings::{AdaptSettings, Folders};
pub use split::held_out;

use crate::experiment::export::write_model;
use crate::experiment::furniture::ATTRIBUTION;
use crate::inference::SceneFeatures;
use crate::{Network, embedded};
use half::f16;
use scenesplat_rooms::Vocabulary;
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::{AtomicFile, GaussianScene, LanguageFeatures, TextTable};
use std::path::PathBuf;

/// The name of the scene in the training's data.
const SCENE: &str = "scene";

/// The texts of a network's classes, which have to be the built-in vocabulary.
///
/// # Errors
/// If the network has classes of its own, or a width that no vocabulary has.
pub fn class_texts(network: &Network) -> Result<TextTable, AdaptError> {
    if network.is_classifier() || network.config().is_none() {
        let problem = "the network names its classes by itself; an adaptation is for language features that are read with the \
                       built-in vocabulary, such as those of the network inside the program";
        return Err(AdaptError::Network(problem.to_owned()));
    }
    Ok(Vocabulary::new(network.model().out_channels())?.class_table())
}

/// Writes the scene as it is learned from: its labels but those held out, and where it has none the network's own `features`
/// as targets.
///
/// `scene`: upright, in meters, as the network reads it. `labels`: −1 for none. `[N]`
///
/// # Errors
/// If features cannot be read, or a file cannot be written.
pub fn write_scene(
    scene: &GaussianScene,
    (labels, held_out): (&[i32], &[bool]),
    features: &SceneFeatures,
    folders: &Folders,
) -> Result<(), AdaptError> {
    let values = features.gaussian_rows(0..features.len())?;
    let rows = LanguageFeatures {
        values: values.iter().map(|v| f16::from_f32(*v)).collect(),
        dim: features.width(),
    };
    let learned = |(label, is_out): (&i32, &bool)| if *is_out { -1 } else { *label };
    let scene = GaussianScene {
        segment: Some(labels.iter().zip(held_out).map(learned).collect()),
        segment_score: None,
        instance: None,
        lang_code: None,
        lang_feat: Some(rows),
        // What is held out has no target either: it would learn the answer from before.
        valid_feat_mask: Some(labels.iter().map(|label| *label < 0).collect()),
        labelled_points: None,
        extra: Vec::new(),
        ..scene.clone()
    };
    write_npy_folder(&scene, &folders.data().join(SCENE), true)?;
    Ok(())
}

/// Writes the weights inside the program to where a training starts from, and says where that is.
///
/// # Errors
/// If a file cannot be written.
pub fn write_start(folders: &Folders) -> Result<PathBuf, AdaptError> {
    let tensors = embedded::tensors()?.into_iter().collect();
    write_model(&tensors, &embedded::config()?, &folders.start())?;
    // Who made what it learned from is named wherever the weights go.
    let list = folders.start().join(ATTRIBUTION);
    AtomicFile::write(&list, embedded::attribution().as_bytes())?;
    Ok(folders.start())
}
