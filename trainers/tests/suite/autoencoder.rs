//! An autoencoder of language features: it learns, compares each row with itself, and says what is kept.

use crate::support::{dataset, fit, in_step, rooms, trainer_by};
use scenesplat_datasets::transforms::validation;
use scenesplat_datasets::{SceneDataset, SceneLoader, TrainBatch};
use scenesplat_models::ParamStore;
use scenesplat_rooms::vocabulary::Vocabulary;
use scenesplat_trainers::tasks::autoencoder::{
    AutoencoderConfig, AutoencoderEvaluator, AutoencoderTask,
};
use scenesplat_trainers::{
    Evaluator, OneCycle, Progress, StepOutput, TrainerConfig, TrainingModule,
};
use std::sync::Arc;

const WIDTH: usize = 64;

fn data(seed: u64) -> Arc<SceneDataset> {
    let vocabulary = Arc::new(Vocabulary::new(WIDTH).unwrap());
    dataset(rooms(3, 1500, seed).with_vocabulary(vocabulary), &validation(0.2), 0)
}

fn loader() -> SceneLoader {
    crate::support::loader(data(1), 1, 0)
}

fn task() -> AutoencoderTask {
    let config = AutoencoderConfig { widths: vec![WIDTH, 32, 16], ..<_>::default() };
    AutoencoderTask::new(&config, ParamStore::trainable(1)).unwrap()
}

fn step(task: &AutoencoderTask, batch: &TrainBatch) -> candle_core::Result<StepOutput> {
    in_step(|cx| task.training_step(batch, cx))
}

fn measured(task: &AutoencoderTask) -> Vec<(String, f64)> {
    let table = Vocabulary::new(WIDTH).unwrap().class_table();
    let mut evaluator = AutoencoderEvaluator::new("unseen", data(7), Some(table));
    let found = evaluator.run(task, Progress::default()).unwrap();
    let names = Evaluator::<AutoencoderTask>::measurements(&evaluator);
    assert_eq!(found.iter().map(|m| m.name.clone()).collect::<Vec<_>>(), names);
    found.into_iter().map(|m| (m.name, m.value)).collect()
}

#[test]
fn it_learns_and_says_what_is_kept() {
    let task = task();
    let before = measured(&task);
    let config = TrainerConfig { epochs: 100, ..TrainerConfig::default() };
    fit(trainer_by(&task, config, 0.01, 0.0, OneCycle::default()), &task, loader()).unwrap();
    let after = measured(&task);
    for ((name, before), (_, after)) in before.iter().zip(&after) {
        let better = if name.starts_with("agreement") { after > before } else { after < before };
        assert!(better, "{name}: {before}, then {after}");
    }
    // Rows of unit length: the square distance is twice 1 − cosine.
    assert!((after[0].1 - 2.0 * after[1].1).abs() < 1e-3, "{after:?}");
    assert!(after[2].1 > 0.8, "{after:?}");
}

#[test]
fn each_row_is_compared_with_itself() {
    let (task, batch) = (task(), loader().batches(0, 0).next().unwrap().unwrap());
    let out = step(&task, &batch).unwrap();
    let term = |name: &str| out.terms.iter().find(|(n, _)| n == name).unwrap().1;
    // Along the right axis both say the same of rows of unit length; over the batch they would not.
    assert!((term("l2") - 2.0 * term("cosine")).abs() < 1e-4, "{:?}", out.terms);
    assert!(term("cosine") > 0.0 && term("cosine") <= 2.0);
}

#[test]
fn the_encoder_remembers_the_statistics_of_what_it_trains_on() {
    let (task, batch) = (task(), loader().batches(0, 0).next().unwrap().unwrap());
    let means = || -> Vec<f32> {
        let buffers = task.params().buffers();
        let means = buffers.iter().filter(|(name, _)| name.ends_with("running_mean"));
        means.flat_map(|(_, var)| var.flatten_all().unwrap().to_vec1::<f32>().unwrap()).collect()
    };
    assert!(!means().is_empty() && means().iter().all(|m| *m == 0.0));
    step(&task, &batch).unwrap();
    let moved = means().iter().filter(|m| **m != 0.0).count();
    assert!(moved > means().len() / 2, "{moved} of {}", means().len());
}

#[test]
fn hard_input() {
    let (task, batch) = (task(), loader().batches(0, 0).next().unwrap().unwrap());
    let none = TrainBatch { valid_feat: Some(vec![false; batch.len()]), ..batch.clone() };
    assert_eq!(step(&task, &none).unwrap().counted_rows, 0);
    let mut one = vec![false; batch.len()];
    let first = batch.valid_feat.as_ref().unwrap().iter().position(|v| *v).unwrap();
    one[first] = true;
    let one = TrainBatch { valid_feat: Some(one), ..batch.clone() };
    let out = step(&task, &one).unwrap();
    assert_eq!(out.counted_rows, 1);
    assert!(out.loss.to_scalar::<f32>().unwrap().is_finite());
    let missing = TrainBatch { lang_feat: None, ..batch.clone() };
    assert!(step(&task, &missing).err().unwrap().to_string().contains("lang_feat"));
    let config = AutoencoderConfig { widths: vec![768, 16], ..<_>::default() };
    let wide = AutoencoderTask::new(&config, ParamStore::trainable(1)).unwrap();
    assert!(step(&wide, &batch).err().unwrap().to_string().contains("widths"));
    for widths in [vec![], vec![64], vec![64, 0]] {
        let config = AutoencoderConfig { widths, ..<_>::default() };
        assert!(AutoencoderTask::new(&config, ParamStore::trainable(1)).is_err());
    }
    let config = AutoencoderConfig { l2: 0.0, cosine: 0.0, ..<_>::default() };
    assert!(AutoencoderTask::new(&config, ParamStore::trainable(1)).is_err());
}
