//! Rows of scenes with their labels.

use super::ProbeError;
use crate::network::NetworkConfig;
use candle_core::{Device, Tensor};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use scenesplat_datasets::{
    Dataset, InputChannel, InputFeatures, Sample, TrainBatch, collate_samples,
};
use scenesplat_models::{Backbone, Forward, LevelOptions};
use scenesplat_trainers::tasks::point_cloud;
use serde::Serialize;
use std::collections::BTreeMap;

/// Whose rows are probed.
#[derive(Clone, Copy)]
pub enum RowSource<'a> {
    /// All scales of a network's encoder at every voxel.
    Network(&'a dyn Backbone),
    /// What the network reads, and the height above the ground.
    Inputs,
}

/// How many labels a probe may learn from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelRegime {
    /// All.
    All,
    /// This share of the labeled voxels of each scene, at least one; in 0..=1.
    Share(f64),
    /// So many voxels of each scene.
    PerScene(usize),
}

/// Rows of a scene.
#[derive(Debug, Clone)]
pub struct ProbeScene {
    /// Its name.
    pub id: String,
    /// One row a voxel. `[M, C]`
    pub rows: Tensor,
    /// Class of each voxel: that of the Gaussian that stands for it, -1 for none. `[M]`
    pub labels: Vec<i32>,
    /// Instance of each voxel, -1 for none. `[M]`
    pub instances: Option<Vec<i32>>,
    /// Voxel of each Gaussian. `[N]`
    pub voxel_of: Vec<u32>,
    /// Class of each Gaussian. `[N]`
    pub truth: Vec<i32>,
    /// What the rows were made of.
    pub batch: TrainBatch,
}

impl ProbeScene {
    pub(super) fn num_labelled(&self) -> usize {
        self.labels.iter().filter(|l| **l >= 0).count()
    }

    pub(super) fn largest_label(&self) -> Option<i32> {
        self.labels.iter().chain(&self.truth).copied().filter(|l| *l >= 0).max()
    }
}

/// Rows that a probe learns from.
pub(super) struct Learned {
    /// `[R, C]`
    pub rows: Tensor,
    /// `[R]`, none below 0
    pub labels: Vec<i32>,
}

/// Mean rows of instances.
pub(super) struct Objects {
    /// `[O, C]`
    pub rows: Tensor,
    /// Class of most of the voxels of each. `[O]`
    pub labels: Vec<i32>,
}

impl Objects {
    pub fn learned(&self) -> Learned {
        Learned { rows: self.rows.clone(), labels: self.labels.clone() }
    }
}

/// Reads all scenes; those without any Gaussian are left out.
pub(super) fn read(
    data: &dyn Dataset,
    config: &NetworkConfig,
    source: RowSource<'_>,
) -> Result<Vec<ProbeScene>, ProbeError> {
    let mut scenes = Vec::with_capacity(data.len());
    for index in 0..data.len() {
        let sample = data.get(0, index)?;
        if !sample.is_empty() {
            scenes.push(scene(sample, config, source)?);
        }
    }
    Ok(scenes)
}

fn scene(
    mut sample: Sample,
    config: &NetworkConfig,
    source: RowSource<'_>,
) -> Result<ProbeScene, ProbeError> {
    let id = sample.id.clone();
    let m = sample.len();
    let labels = sample.segment.clone().unwrap_or_else(|| vec![-1; m]);
    let instances = sample.instance.clone();
    let full = sample.full.take();
    let (voxel_of, truth) = match full {
        Some(full) => {
            let truth = full.segment.unwrap_or_else(|| vec![-1; full.voxel.len()]);
            (full.voxel, truth)
        }
        None => ((0..m as u32).collect(), labels.clone()),
    };
    let input = match source {
        RowSource::Network(_) => config.input.clone(),
        RowSource::Inputs => with_height(&config.input),
    };
    let batch = collate_samples(vec![sample], &input)?;
    let rows = match source {
        RowSource::Inputs => Tensor::from_slice(&batch.feat, (m, batch.channels), &Device::Cpu)?,
        RowSource::Network(network) => {
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            let options = LevelOptions { mask: None, decoder: false };
            let points = point_cloud(&batch)?;
            let mut cx = Forward::eval(&mut rng);
            network.forward_levels(&points, options, &mut cx)?.up_cast(0)?.detach()
        }
    };
    check_finite(&id, &rows)?;
    Ok(ProbeScene { id, rows, labels, instances, voxel_of, truth, batch })
}

fn with_height(input: &InputFeatures) -> InputFeatures {
    let mut input = input.clone();
    if !input.channels.contains(&InputChannel::Height) {
        input.channels.push(InputChannel::Height);
    }
    input
}

fn check_finite(id: &str, rows: &Tensor) -> Result<(), ProbeError> {
    let width = rows.dim(1)?.max(1);
    let values = rows.flatten_all()?.to_vec1::<f32>()?;
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(at) => Err(ProbeError::NotFinite {
            id: id.to_owned(),
            row: at / width,
            channel: at % width,
            value: values[at],
        }),
    }
}

/// The labeled rows that a probe may learn from, by (seed, scene).
pub(super) fn choose(
    scenes: &[ProbeScene],
    regime: LabelRegime,
    seed: u64,
) -> Result<Learned, ProbeError> {
    let (mut rows, mut labels) = (Vec::new(), Vec::new());
    for (stream, scene) in (0..).zip(scenes) {
        let labelled = chosen_rows(scene, regime, seed, stream);
        if labelled.is_empty() {
            continue;
        }
        labels.extend(labelled.iter().map(|&row| scene.labels[row as usize]));
        rows.push(scene.rows.index_select(&Tensor::new(labelled, &Device::Cpu)?, 0)?);
    }
    if labels.is_empty() {
        return Err(ProbeError::NoLabels);
    }
    Ok(Learned { rows: Tensor::cat(&rows, 0)?, labels })
}

/// Rows of one scene that may be learned from, ascending.
pub(super) fn chosen_rows(
    scene: &ProbeScene,
    regime: LabelRegime,
    seed: u64,
    stream: u64,
) -> Vec<u32> {
    let mut labelled: Vec<u32> =
        (0_u32..).zip(&scene.labels).filter(|(_, l)| **l >= 0).map(|(row, _)| row).collect();
    let count = match regime {
        LabelRegime::All => labelled.len(),
        LabelRegime::Share(share) => {
            ((labelled.len() as f64 * share).round() as usize).max(1).min(labelled.len())
        }
        LabelRegime::PerScene(count) => count.min(labelled.len()),
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    // The first of a random order, all of them where all are wanted.
    for i in 0..count {
        let left = (labelled.len() - i) as u64;
        let j = i + ((u128::from(rng.next_u64()) * u128::from(left)) >> 64) as usize;
        labelled.swap(i, j);
    }
    labelled.truncate(count);
    labelled.sort_unstable();
    labelled
}

/// Sum of the rows of an instance, their number, and how many have each class.
type InstanceSum = (Vec<f64>, usize, BTreeMap<i32, usize>);

/// The mean row of each instance, in the order of scenes and numbers; `None` if no scene has instances
/// with a class.
pub(super) fn objects(scenes: &[ProbeScene]) -> Result<Option<Objects>, ProbeError> {
    let (mut means, mut labels, mut width) = (Vec::new(), Vec::new(), 0);
    for scene in scenes {
        let Some(instances) = &scene.instances else { continue };
        width = scene.rows.dim(1)?;
        let values = scene.rows.flatten_all()?.to_vec1::<f32>()?;
        let mut sums: BTreeMap<i32, InstanceSum> = BTreeMap::new();
        for (row, (&instance, &label)) in instances.iter().zip(&scene.labels).enumerate() {
            if instance < 0 || label < 0 {
                continue;
            }
            let (sum, count, votes) =
                sums.entry(instance).or_insert_with(|| (vec![0.0; width], 0, BTreeMap::new()));
            let row = &values[row * width..][..width];
            sum.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(*v));
            *count += 1;
            *votes.entry(label).or_default() += 1;
        }
        for (sum, count, votes) in sums.into_values() {
            means.extend(sum.iter().map(|v| (v / count as f64) as f32));
            // Of equally many votes the smaller class.
            let best = votes.iter().max_by_key(|(label, n)| (**n, -**label));
            labels.push(best.map_or(-1, |(label, _)| *label));
        }
    }
    if labels.is_empty() {
        return Ok(None);
    }
    let rows = Tensor::from_vec(means, (labels.len(), width), &Device::Cpu)?;
    Ok(Some(Objects { rows, labels }))
}

#[cfg(test)]
mod by_hand;

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn scene_of(labels: &[i32], instances: &[i32]) -> ProbeScene {
        let values: Vec<f32> = (0..labels.len() * 2).map(|v| v as f32).collect();
        ProbeScene {
            id: "s".to_owned(),
            rows: Tensor::from_vec(values, (labels.len(), 2), &Device::Cpu).unwrap(),
            labels: labels.to_vec(),
            instances: Some(instances.to_vec()),
            voxel_of: (0..labels.len() as u32).collect(),
            truth: labels.to_vec(),
            batch: TrainBatch::default(),
        }
    }

    #[test]
    fn regimes_take_what_they_say_and_the_same_each_time() {
        let labels: Vec<i32> = (0..200).map(|i| i % 5 - 1).collect();
        let scenes = [scene_of(&labels, &labels), scene_of(&labels[..7], &labels[..7])];
        let count = |regime| choose(&scenes, regime, 3).unwrap().labels.len();
        assert_eq!(count(LabelRegime::All), 160 + 5);
        assert_eq!(count(LabelRegime::Share(0.1)), 16 + 1);
        assert_eq!(count(LabelRegime::Share(0.0)), 2);
        assert_eq!(count(LabelRegime::PerScene(20)), 20 + 5);
        let rows = |seed| {
            choose(&scenes, LabelRegime::PerScene(20), seed).unwrap().rows.to_vec2::<f32>().unwrap()
        };
        assert_eq!(rows(1), rows(1));
        assert_ne!(rows(1), rows(2));
        let learned = choose(&scenes, LabelRegime::Share(0.2), 1).unwrap();
        for (row, label) in learned.rows.to_vec2::<f32>().unwrap().iter().zip(&learned.labels) {
            assert_eq!(labels[row[0] as usize / 2], *label);
        }
        let none = [scene_of(&[-1, -1], &[0, 0])];
        assert!(matches!(choose(&none, LabelRegime::All, 0), Err(ProbeError::NoLabels)));
    }

    #[test]
    fn objects_are_means_of_their_voxels() {
        let scene = scene_of(&[2, 2, 1, -1, 0], &[7, 7, 7, 7, -1]);
        let found = objects(&[scene]).unwrap().unwrap();
        assert_eq!(found.labels, [2]);
        // Rows (0, 1), (2, 3), (4, 5): the fourth has no class, the fifth no instance.
        assert_eq!(found.rows.to_vec2::<f32>().unwrap(), [[2.0, 3.0]]);
        assert!(objects(&[scene_of(&[-1], &[0])]).unwrap().is_none());
    }

    #[test]
    fn the_first_instance_and_the_first_class_have_number_0() {
        let scene = scene_of(&[0, 0, 1], &[0, 0, 1]);
        let found = objects(&[scene]).unwrap().unwrap();
        assert_eq!(found.labels, [0, 1]);
    }

    #[test]
    fn there_are_as_many_classes_as_the_largest_label_of_any_scene_says() {
        let scenes =
            [scene_of(&[1, 0], &[0, 0]), scene_of(&[3, -1], &[0, 0]), scene_of(&[0], &[0])];
        assert_eq!(super::super::classes_of(scenes.iter()).unwrap(), 4);
        let none = [scene_of(&[-1], &[0])];
        assert!(matches!(super::super::classes_of(none.iter()), Err(ProbeError::NoLabels)));
    }

    #[test]
    fn the_height_above_the_ground_is_there_once() {
        use InputChannel::{Color, Height, Opacity};
        let channels = |channels: &[InputChannel]| {
            let channels = channels.to_vec();
            with_height(&InputFeatures { channels, ..InputFeatures::default() }).channels
        };
        // Last where a network does not read it, else where it is.
        assert_eq!(channels(&[Color, Opacity]), [Color, Opacity, Height]);
        assert_eq!(channels(&[Height, Color]), [Height, Color]);
    }

    #[test]
    fn a_value_that_is_not_finite_is_named_by_row_and_channel() {
        let rows = Tensor::new(&[[0.0f32; 3], [0.0, 0.0, f32::NAN]], &Device::Cpu).unwrap();
        let error = check_finite("a", &rows).unwrap_err().to_string();
        assert_eq!(error, "scene a: channel 2 of row 1 is NaN");
    }
}
