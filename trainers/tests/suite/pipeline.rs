//! A network from scenes to checkpoints: the same bits whatever the workers, threads and
//! interruptions, and finite numbers for as long as it runs.

use crate::support::{
    Watch, causes, dataset, fit, resume, rooms, state, stop_at, texts, trainer_by,
};
use scenesplat_datasets::transforms::{language_pretraining, validation};
use scenesplat_datasets::{
    DataError, Dataset, InputFeatures, LoaderSettings, Sample, SampleRng, SceneDataset,
    SceneLoader, Transform, build_transforms,
};
use scenesplat_kernels::Precision;
use scenesplat_losses::{
    AggregatedContrastive, CosineLoss, CrossEntropy, LovaszSoftmax, Objective,
};
use scenesplat_metrics::Measurement;
use scenesplat_models::{Compute, ModelConfig, ParamStore, PointTransformerV3Config};
use scenesplat_rooms::CLASSES;
use scenesplat_trainers::evaluators::{SegmentationEvaluator, ZeroShotEvaluator};
use scenesplat_trainers::tasks::{
    LanguagePretraining, SemanticSegmentation, TargetSource, TaskModule,
};
use scenesplat_trainers::{
    DataModule, Event, Flow, OneCycle, Progress, Trainer, TrainerConfig, TrainingModule,
};
use std::path::Path;
use std::sync::{Arc, Mutex};

const WIDTH: usize = 24;

fn network(precision: Precision) -> ModelConfig {
    ModelConfig::new(PointTransformerV3Config {
        enc_channels: vec![8, 16, 16],
        enc_num_head: vec![1, 2, 2],
        enc_patch_size: vec![64; 3],
        dec_channels: vec![16, 16],
        dec_num_head: vec![2, 2],
        dec_patch_size: vec![64; 2],
        drop_path: 0.2,
        compute: Compute { precision, ..Compute::default() },
        ..PointTransformerV3Config::tiny()
    })
    .with_projection(WIDTH)
}

fn training_data() -> Arc<dyn Dataset> {
    dataset(rooms(6, 900, 3), &language_pretraining(0.1), 1)
}

fn loader(data: Arc<dyn Dataset>, workers: usize) -> SceneLoader {
    let settings = LoaderSettings { workers, ..LoaderSettings::default() };
    SceneLoader::new(data, InputFeatures::default(), settings).unwrap()
}

fn language(precision: Precision, seed: u64) -> TaskModule {
    let params = ParamStore::trainable(seed);
    let model = network(precision).build(params.builder()).unwrap();
    let contrastive = AggregatedContrastive { min_points: 20, ..AggregatedContrastive::default() };
    let objective = Objective::new().with(1.0, CosineLoss::default()).with(0.02, contrastive);
    let targets = TargetSource::class_text(&texts(WIDTH)).unwrap();
    TaskModule::new(params, model, objective, LanguagePretraining { targets })
}

fn trainer(module: &TaskModule, config: TrainerConfig) -> Trainer {
    trainer_by(module, config, 0.003, 0.05, OneCycle::default())
}

fn config(dir: Option<&Path>) -> TrainerConfig {
    let mut config =
        TrainerConfig { seed: 9, epochs: 3, clip_norm: Some(1.0), ..TrainerConfig::default() };
    config.checkpoint.dir = dir.map(Path::to_owned);
    config
}

#[test]
fn neither_workers_threads_nor_interruptions_change_a_bit() {
    let data = training_data();
    let whole = |workers: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let module = language(Precision::F32, 1);
            fit(trainer(&module, config(None)), &module, loader(data.clone(), workers)).unwrap();
            state(module.params())
        })
    };
    let expected = whole(0, 2);
    assert_ne!(expected, state(language(Precision::F32, 1).params()), "it learned something");
    assert_eq!(expected, whole(1, 1));
    assert_eq!(expected, whole(3, 2));
    for (stop, workers) in [(1, 0), (5, 1), (7, 3)] {
        let dir = tempfile::tempdir().unwrap();
        let module = language(Precision::F32, 1);
        let settings = || TrainerConfig { log_every: 1, ..config(Some(dir.path())) };
        let first = trainer(&module, settings()).with_callback(stop_at(stop));
        let at = fit(first, &module, loader(data.clone(), workers)).unwrap();
        assert_eq!(at.step, stop);
        let module = language(Precision::F32, 2);
        let second = trainer(&module, settings());
        resume(second, dir.path(), &module, loader(data.clone(), workers));
        assert_eq!(expected, state(module.params()), "interrupted at {stop}, {workers} workers");
    }
}

#[test]
fn recomputed_blocks_train_alike() {
    let data = training_data();
    let run = |recompute| {
        let module = language(Precision::F32, 1);
        let settings = TrainerConfig { recompute, epochs: 1, ..config(None) };
        fit(trainer(&module, settings), &module, loader(data.clone(), 0)).unwrap();
        state(module.params())
    };
    for ((name, plain), (_, recomputed)) in run(false).iter().zip(&run(true)) {
        for (a, b) in plain.iter().zip(recomputed) {
            assert!((a - b).abs() <= 1e-6 * a.abs().max(1.0), "{name}: {a} {b}");
        }
    }
}

/// Spoils one value of one scene.
#[derive(Debug)]
struct Poison(&'static str);
impl Transform for Poison {
    fn apply(&self, sample: &mut Sample, _: &mut SampleRng) -> Result<(), DataError> {
        if sample.id == self.0 {
            sample.color[3][1] = f32::NAN;
        }
        Ok(())
    }
}

#[test]
fn a_poisoned_scene_is_named() {
    let mut steps = build_transforms(&validation(0.1)).unwrap();
    steps.push(Arc::new(Poison("room-000004")));
    let data = SceneDataset::new(Arc::new(rooms(6, 900, 3)), steps, 1, 1).unwrap();
    let module = language(Precision::F32, 1);
    let trainer = trainer(&module, config(None));
    let text = causes(&fit(trainer, &module, loader(Arc::new(data), 1)).unwrap_err());
    assert!(text.contains("room-000004"), "{text}");
}

/// Every logged value with its step.
type Record = Arc<Mutex<Vec<(u64, Measurement)>>>;

fn recorded(trainer: Trainer) -> (Trainer, Record) {
    let record = Record::default();
    let noted = Arc::clone(&record);
    let watch = Watch(move |event: &Event<'_>, at: Progress| {
        if let Event::Step { measurements } | Event::Eval { measurements, .. } = event {
            noted.lock().unwrap().extend(measurements.iter().map(|m| (at.step, m.clone())));
        }
        Flow::Continue
    });
    (trainer.with_callback(watch), record)
}

/// Trains for 40 epochs: the loss falls below a share of its first values, and the accuracy rises.
fn check_learning(
    module: &TaskModule,
    mut data: DataModule<'_, TaskModule>,
    name: &str,
    loss_falls: f64,
) {
    let settings = TrainerConfig { epochs: 40, eval_every: 20, log_every: 1, ..config(None) };
    let (mut trainer, record) = recorded(trainer(module, settings));
    trainer.fit(module, &mut data, Progress::default()).unwrap();
    let values = record.lock().unwrap();
    let series = |name: &str| -> Vec<f64> {
        values.iter().filter(|(_, m)| m.name == name).map(|(_, m)| m.value).collect()
    };
    let loss = series("train/loss");
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    let (first, last) = (mean(&loss[..10]), mean(&loss[loss.len() - 10..]));
    assert!(last < first * loss_falls, "{name}: loss {first} to {last}");
    let accuracy = series(&format!("{name}/allAcc"));
    assert!(accuracy[1] > accuracy[0] && accuracy[1] > 0.3, "{name}: {accuracy:?}");
}

#[test]
fn both_tasks_learn_their_rooms() {
    let (seen, input) = (dataset(rooms(6, 900, 3), &validation(0.1), 1), InputFeatures::default());
    let data = || DataModule::new(loader(training_data(), 1));
    let texts = texts(WIDTH);
    let zero_shot =
        ZeroShotEvaluator::new("zero_shot", seen.clone(), input.clone(), texts, vec![0, 1, 2]);
    let module = language(Precision::F32, 1);
    check_learning(&module, data().with_evaluator(zero_shot), "zero_shot", 0.8);
    let params = ParamStore::trainable(4);
    let shape = network(Precision::F32).with_classes(CLASSES.len());
    let model = shape.build(params.builder()).unwrap();
    let objective = Objective::new().with(1.0, CrossEntropy::default()).with(1.0, LovaszSoftmax);
    let module = TaskModule::new(params, model, objective, SemanticSegmentation);
    let segmentation = SegmentationEvaluator::new("segmentation", seen, input, Vec::new());
    check_learning(&module, data().with_evaluator(segmentation), "segmentation", 0.9);
}

/// Keeps a different, sometimes tiny, part of each scene.
#[derive(Debug)]
struct Uneven;
impl Transform for Uneven {
    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        use rand_chacha::rand_core::RngCore;
        let share = [1, 2, 17, 150, sample.len()][(rng.next_u32() % 5) as usize];
        let rows: Vec<u32> = (0..sample.len().min(share) as u32).collect();
        sample.select_rows(&rows);
        Ok(())
    }
}

/// Set `SCENESPLAT_STABILITY_STEPS=2000` for the long run; by default a short one.
#[test]
fn every_step_is_finite_and_none_is_left_out() {
    let steps: u64 =
        std::env::var("SCENESPLAT_STABILITY_STEPS").ok().and_then(|s| s.parse().ok()).unwrap_or(30);
    for precision in [Precision::F32, Precision::Bf16] {
        for uneven in [false, true] {
            for seed in 0..3 {
                let mut changes = build_transforms(&language_pretraining(0.1)).unwrap();
                if uneven {
                    changes.push(Arc::new(Uneven));
                }
                let rooms = Arc::new(rooms(6, 400, 3));
                let data = SceneDataset::new(rooms, changes, seed, 1).unwrap();
                let module = language(precision, seed);
                let settings =
                    TrainerConfig { seed, epochs: steps.div_ceil(3), log_every: 1, ..config(None) };
                let (trainer, record) = recorded(trainer(&module, settings));
                let at = fit(trainer, &module, loader(Arc::new(data), 0))
                    .unwrap_or_else(|e| panic!("{precision} uneven {uneven} seed {seed}: {e:?}"));
                let values = record.lock().unwrap();
                let losses: Vec<_> = values.iter().filter(|v| v.1.name == "train/loss").collect();
                assert_eq!((at.step, losses.len() as u64), (at.total_steps, at.total_steps));
                assert!(values.iter().all(|(_, m)| m.value.is_finite()));
                assert!(
                    state(module.params()).iter().all(|(_, v)| v.iter().all(|x| x.is_finite()))
                );
            }
        }
    }
}
