//! What a network has learned, asked by probes: small classifiers on its rows, while it stays as it is.
//!
//! [`probe`] reads a network's rows of some scenes, all scales of its encoder at every voxel, trains a
//! classifier on some of them and scores it on others; beside it the same for the same network with
//! values that nobody trained, and for what the network reads. A network that is worth something beats
//! both: the first says that training taught it, the second that it did more than hand its inputs on.
//!
//! Rows are computed once, by weights that are packed for inference and have no gradient, so nothing can
//! move them. Channels are brought to mean 0 and variance 1 over the rows that are learned from.

#[cfg(test)]
mod by_hand;
mod classifier;
mod decoder;
mod error;
mod object_set;
mod rows;
mod scenes;

pub use classifier::{Fit, ProbeKind, ProbeSettings};
pub use error::ProbeError;
pub use object_set::{ObjectSet, read_file};
pub use rows::{LabelRegime, ProbeScene, RowSource};
pub use scenes::ProbeScenes;

use crate::network::{Network, NetworkConfig, WeightOptions, Weights, network_of};
use classifier::Classifier;
use decoder::EncoderValues;
use rows::{Learned, Objects, choose, objects};
use scenesplat_metrics::{ConfusionMatrix, Metric, TesterReport};
use scenesplat_models::ParamStore;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// What a probe found about one kind of rows.
#[derive(Debug, Clone, Serialize)]
pub struct ProbeResult {
    /// Width of the rows.
    pub width: usize,
    /// Mean IoU over the classes that occur, 0..=1.
    pub miou: Option<f64>,
    /// Mean accuracy over the classes that occur, 0..=1.
    pub macc: Option<f64>,
    /// Share of the labeled Gaussians that are right, 0..=1.
    pub all_acc: Option<f64>,
    /// IoU of each class, 0..=1; `None` for one that does not occur.
    pub class_iou: Vec<Option<f64>>,
    /// Loss of the last steps.
    pub loss: f64,
    /// Seconds for rows, training and scoring.
    pub seconds: f64,
    /// The same for objects: the mean row of each instance, if scenes have instances.
    pub objects: Option<ObjectResult>,
}

/// What a probe on objects found.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ObjectResult {
    /// Objects that were learned from.
    pub train_objects: usize,
    /// Objects that were scored.
    pub test_objects: usize,
    /// Share that is right, 0..=1.
    pub accuracy: Option<f64>,
    /// Mean over classes of the share that is right, 0..=1.
    pub mean_accuracy: Option<f64>,
}

/// What [`probe`] gives.
#[derive(Debug, Clone, Serialize)]
pub struct ProbeReport {
    /// How the probe was trained.
    #[serde(flatten)]
    pub settings: ProbeSettings,
    /// Number of classes.
    pub classes: usize,
    /// Names of the scenes that were learned from.
    pub train_scenes: Vec<String>,
    /// Names of the scenes that were scored.
    pub test_scenes: Vec<String>,
    /// Labeled voxels there were to learn from.
    pub labelled_rows: usize,
    /// Labeled voxels that were learned from.
    pub learned_rows: usize,
    /// The network.
    pub backbone: ProbeResult,
    /// The same architecture with values that nobody trained.
    pub random: ProbeResult,
    /// What the network reads, and the height above the ground.
    pub raw_inputs: ProbeResult,
}

/// Probes the network of a model folder, or of weights that are known by their shapes. `say` gets each step in words; returning `false` cancels.
///
/// # Errors
/// If they are no model whose network gives its scales, or scenes cannot be read or hold no labels.
pub fn probe(
    model: &Path,
    scenes: &ProbeScenes,
    settings: &ProbeSettings,
    say: &mut dyn FnMut(&str) -> bool,
) -> Result<ProbeReport, ProbeError> {
    settings.check()?;
    let config = network_of(&Weights::File(model.to_owned()), None, &WeightOptions::default())?;
    let network =
        Network::load(config.clone(), &Weights::File(model.to_owned()), WeightOptions::default())?;
    let random = random_network(&config, settings.seed)?;
    let sources = [
        ("backbone", RowSource::Network(network.model()), Some(EncoderValues::File(model))),
        ("random", RowSource::Network(random.as_ref()), Some(EncoderValues::Random)),
        ("raw_inputs", RowSource::Inputs, None),
    ];
    let (train, test) = scenes.split()?;
    let mut report = None;
    for (name, source, values) in sources {
        let mut tell = |text: String| if say(&text) { Ok(()) } else { Err(ProbeError::Stopped) };
        tell(format!("{name}: rows of {} scenes", train.len() + test.len()))?;
        let began = Instant::now();
        let read = |data: &dyn scenesplat_datasets::Dataset| rows::read(data, &config, source);
        let (train_rows, test_rows) = (read(train.as_ref())?, read(test.as_ref())?);
        let classes = classes_of(train_rows.iter().chain(&test_rows))?;
        let learned = choose(&train_rows, settings.labels, settings.seed)?;
        tell(format!("{name}: {} rows are learned from", learned.labels.len()))?;
        let (answer, of_training) = match values.filter(|_| settings.kind == ProbeKind::Decoder) {
            Some(values) => {
                let decoder = decoder::train(&config, values, &train_rows, classes, settings)?;
                let answer = score(|scene| decoder.classes(scene), &test_rows, classes)?;
                (answer, (decoder.width, decoder.loss))
            }
            None => {
                let classifier = Classifier::train(&learned, classes, settings)?;
                let answer = score(|scene| classifier.classes(&scene.rows), &test_rows, classes)?;
                (answer, (classifier.width(), classifier.loss))
            }
        };
        let objects =
            settings.objects.then(|| object_result(&train_rows, &test_rows, classes, settings));
        let objects = objects.transpose()?.flatten();
        let result = result(&answer.tester_report(), of_training, began, objects);
        let report = report.get_or_insert_with(|| {
            first_report(settings, classes, (&train_rows, &test_rows), &learned, &result)
        });
        match name {
            "random" => report.random = result,
            "raw_inputs" => report.raw_inputs = result,
            _ => {}
        }
    }
    report.ok_or(ProbeError::NoLabels)
}

/// A report with the same result for all sources.
fn first_report(
    settings: &ProbeSettings,
    classes: usize,
    (train, test): (&[ProbeScene], &[ProbeScene]),
    learned: &Learned,
    result: &ProbeResult,
) -> ProbeReport {
    let names = |scenes: &[ProbeScene]| scenes.iter().map(|s| s.id.clone()).collect();
    ProbeReport {
        settings: settings.clone(),
        classes,
        train_scenes: names(train),
        test_scenes: names(test),
        labelled_rows: train.iter().map(ProbeScene::num_labelled).sum(),
        learned_rows: learned.labels.len(),
        backbone: result.clone(),
        random: result.clone(),
        raw_inputs: result.clone(),
    }
}

/// The architecture with first values, as training would begin with them.
fn random_network(
    config: &NetworkConfig,
    seed: u64,
) -> Result<Box<dyn scenesplat_models::Backbone>, ProbeError> {
    let store = ParamStore::trainable(seed);
    Ok(config.model.build(store.builder())?)
}

/// One more than the largest label.
fn classes_of<'a>(scenes: impl Iterator<Item = &'a ProbeScene>) -> Result<usize, ProbeError> {
    let largest = scenes.filter_map(|scene| scene.largest_label()).max();
    largest.map(|label| label as usize + 1).ok_or(ProbeError::NoLabels)
}

/// Every labeled Gaussian takes the class of its voxel.
fn score(
    classes_of: impl Fn(&ProbeScene) -> Result<Vec<i32>, ProbeError>,
    scenes: &[ProbeScene],
    classes: usize,
) -> Result<ConfusionMatrix, ProbeError> {
    let mut confusion = ConfusionMatrix::new(classes)?;
    for scene in scenes {
        let of_rows = classes_of(scene)?;
        let of_gaussians: Vec<i32> =
            scene.voxel_of.iter().map(|&row| of_rows[row as usize]).collect();
        confusion.update((&of_gaussians, &scene.truth))?;
    }
    Ok(confusion)
}

fn object_result(
    train: &[ProbeScene],
    test: &[ProbeScene],
    classes: usize,
    settings: &ProbeSettings,
) -> Result<Option<ObjectResult>, ProbeError> {
    let (Some(train), Some(test)) = (objects(train)?, objects(test)?) else { return Ok(None) };
    let classifier = Classifier::train(&train.learned(), classes, settings)?;
    let mut confusion = ConfusionMatrix::new(classes)?;
    let Objects { rows, labels } = &test;
    confusion.update((&classifier.classes(rows)?, labels))?;
    let report = confusion.tester_report();
    Ok(Some(ObjectResult {
        train_objects: train.labels.len(),
        test_objects: test.labels.len(),
        accuracy: report.all_accuracy,
        mean_accuracy: report.mean_accuracy,
    }))
}

fn result(
    report: &TesterReport,
    (width, loss): (usize, f64),
    began: Instant,
    objects: Option<ObjectResult>,
) -> ProbeResult {
    ProbeResult {
        width,
        miou: report.mean_iou,
        macc: report.mean_accuracy,
        all_acc: report.all_accuracy,
        class_iou: report.classes.iter().map(|c| c.iou).collect(),
        loss,
        seconds: began.elapsed().as_secs_f64(),
        objects,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Tensor};

    /// Voxels of one channel, each of which is a Gaussian and an object.
    fn scene(rows: &[f32], labels: &[i32]) -> ProbeScene {
        let n = rows.len();
        ProbeScene {
            id: "s".to_owned(),
            rows: Tensor::from_vec(rows.to_vec(), (n, 1), &Device::Cpu).unwrap(),
            labels: labels.to_vec(),
            instances: Some((0..n as i32).collect()),
            voxel_of: (0..n as u32).collect(),
            truth: labels.to_vec(),
            batch: scenesplat_datasets::TrainBatch::default(),
        }
    }

    #[test]
    fn every_gaussian_is_scored_by_its_own_label() {
        // Three Gaussians in the voxel of class 0, the last of which is a 1; one in the voxel of class 1.
        let scene = ProbeScene {
            voxel_of: vec![0, 0, 0, 1],
            truth: vec![0, 0, 1, 1],
            ..scene(&[0.0, 0.0], &[0, 1])
        };
        let confusion = score(|_| Ok(vec![0, 1]), &[scene], 2).unwrap();
        // By true and by found class: of two 0 both are right, of two 1 one is taken for a 0.
        assert_eq!(confusion.counts(), [2, 0, 1, 1]);
    }

    #[test]
    fn objects_that_are_scored_are_not_learned_from() {
        // Low rows are 0 and high ones 1; in the scene that is scored it is the other way round.
        let train = [scene(&[0.0, 0.5, 9.5, 10.0], &[0, 0, 1, 1])];
        let test = [scene(&[1.0, 9.0], &[1, 0])];
        let settings = ProbeSettings { steps: 100, lr: 0.1, ..ProbeSettings::default() };
        let found = object_result(&train, &test, 2, &settings).unwrap().unwrap();
        assert_eq!((found.train_objects, found.test_objects), (4, 2));
        // So what was learned is wrong about both.
        assert_eq!(found.accuracy, Some(0.0));
    }

    #[test]
    fn mean_accuracy_is_over_classes_and_accuracy_over_gaussians() {
        let mut confusion = ConfusionMatrix::new(2).unwrap();
        // Of three 0 all are right, and one 1 is taken for a 0.
        confusion.update((&[0, 0, 0, 0][..], &[0, 0, 0, 1][..])).unwrap();
        let found = result(&confusion.tester_report(), (7, 0.5), Instant::now(), None);
        let is_near = |got: Option<f64>, due: f64| got.is_some_and(|v| (v - due).abs() < 1e-6);
        // Of the classes 3 / 3 and 0 / 1, of all 3 / 4; IoUs are 3 / 4 and 0 / 1.
        assert!(is_near(found.macc, 0.5), "{found:?}");
        assert!(is_near(found.all_acc, 0.75), "{found:?}");
        assert!(is_near(found.miou, 0.375), "{found:?}");
        assert_eq!((found.width, found.loss), (7, 0.5));
    }
}
