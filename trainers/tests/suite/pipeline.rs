//! A network from scenes to checkpoints: the same bits whatever the workers, threads and
//! interruptions, and finite numbers for as long as it runs.

use scenesplat_datasets::transforms::{language_pretraining, validation};
use scenesplat_datasets::{
    DataError, Dataset, InputFeatures, LoaderSettings, Sample, SampleRng, SceneDataset,
    SceneLoader, SyntheticRooms, Transform, build_transforms,
};
use scenesplat_kernels::Precision;
use scenesplat_losses::{
    AggregatedContrastive, CosineLoss, CrossEntropy, LovaszSoftmax, Objective,
};
use scenesplat_metrics::Measurement;
use scenesplat_models::{Compute, ModelConfig, ParamStore, PointTransformerV3Config};
use scenesplat_rooms::{CLASSES, SyntheticRoomSettings};
use scenesplat_scene::TextTable;
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::evaluators::{SegmentationEvaluator, ZeroShotEvaluator};
use scenesplat_trainers::tasks::{
    LanguagePretraining, SemanticSegmentation, TargetSource, TaskModule,
};
use scenesplat_trainers::{
    AdamW, AdamWConfig, Callback, Evaluator, Event, Flow, OneCycle, Progress, TrainError, Trainer,
    TrainerConfig, TrainingModule, group_by_keyword,
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

/// Directions of the classes: nothing but apart from each other.
fn texts() -> TextTable {
    let values = (0..CLASSES.len() * WIDTH).map(|i| ((i * i) as f32 * 0.7).sin()).collect();
    let names = CLASSES.iter().map(|c| c.name.to_owned()).collect();
    TextTable::from_rows(names, values, WIDTH).unwrap()
}

fn rooms(gaussians: usize) -> Arc<SyntheticRooms> {
    let settings = SyntheticRoomSettings {
        num_gaussians: Some(gaussians),
        ..SyntheticRoomSettings::default()
    };
    Arc::new(SyntheticRooms::new(6, settings, 3).unwrap())
}

fn training_data(gaussians: usize) -> Arc<dyn Dataset> {
    let steps = build_transforms(&language_pretraining(0.1)).unwrap();
    Arc::new(SceneDataset::new(rooms(gaussians), steps, 1, 1).unwrap())
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
    let targets = TargetSource::class_text(&texts()).unwrap();
    TaskModule::new(params, model, objective, LanguagePretraining { targets })
}

fn trainer<M: TrainingModule>(module: &M, config: TrainerConfig) -> Trainer {
    let groups = group_by_keyword(&module.params().parameters(), 0.003, 0.05, &[]);
    let optimizer = AdamW::new(groups, AdamWConfig::default()).unwrap();
    Trainer::new(config, Box::new(optimizer), Box::new(OneCycle::default())).unwrap()
}

fn config(dir: Option<&Path>) -> TrainerConfig {
    let mut config =
        TrainerConfig { seed: 9, epochs: 3, clip_norm: Some(1.0), ..TrainerConfig::default() };
    config.checkpoint.dir = dir.map(Path::to_owned);
    config
}

/// Everything that training changes.
fn state<M: TrainingModule>(module: &M) -> Vec<(String, Vec<f32>)> {
    let (parameters, buffers) = (module.params().parameters(), module.params().buffers());
    let values = |v: &candle_core::Var| {
        v.to_dtype(candle_core::DType::F32).unwrap().flatten_all().unwrap().to_vec1().unwrap()
    };
    parameters.iter().chain(&buffers).map(|(n, v)| (n.clone(), values(v))).collect()
}

struct StopAt(u64);
impl Callback for StopAt {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let stop = matches!(event, Event::Step { .. }) && at.step >= self.0;
        Ok(if stop { Flow::Stop } else { Flow::Continue })
    }
}

#[test]
fn neither_workers_threads_nor_interruptions_change_a_bit() {
    let data = training_data(900);
    let whole = |workers: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let module = language(Precision::F32, 1);
            trainer(&module, config(None))
                .fit(&module, &mut loader(data.clone(), workers), &mut [], Progress::default())
                .unwrap();
            state(&module)
        })
    };
    let expected = whole(0, 2);
    assert_ne!(expected, state(&language(Precision::F32, 1)), "it learned something");
    assert_eq!(expected, whole(1, 1));
    assert_eq!(expected, whole(3, 2));
    for (stop, workers) in [(1, 0), (5, 1), (7, 3)] {
        let dir = tempfile::tempdir().unwrap();
        let module = language(Precision::F32, 1);
        let settings = || TrainerConfig { log_every: 1, ..config(Some(dir.path())) };
        let mut first = trainer(&module, settings()).with_callback(StopAt(stop));
        let mut batches = loader(data.clone(), workers);
        let at = first.fit(&module, &mut batches, &mut [], Progress::default()).unwrap();
        assert_eq!(at.step, stop);
        let module = language(Precision::F32, 2);
        let mut second = trainer(&module, settings());
        let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
        let start = second.load_checkpoint(&newest, &module).unwrap();
        second.fit(&module, &mut loader(data.clone(), workers), &mut [], start).unwrap();
        assert_eq!(expected, state(&module), "interrupted at {stop}, {workers} workers");
    }
}

#[test]
fn recomputed_blocks_train_alike() {
    let data = training_data(900);
    let run = |recompute| {
        let module = language(Precision::F32, 1);
        let settings = TrainerConfig { recompute, epochs: 1, ..config(None) };
        trainer(&module, settings)
            .fit(&module, &mut loader(data.clone(), 0), &mut [], Progress::default())
            .unwrap();
        state(&module)
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
    let data = Arc::new(SceneDataset::new(rooms(900), steps, 1, 1).unwrap());
    let module = language(Precision::F32, 1);
    let error = trainer(&module, config(None))
        .fit(&module, &mut loader(data, 1), &mut [], Progress::default())
        .unwrap_err();
    let mut text = error.to_string();
    let mut source = std::error::Error::source(&error);
    while let Some(cause) = source {
        text.push_str(&format!(": {cause}"));
        source = cause.source();
    }
    assert!(text.contains("room-000004"), "{text}");
}

/// Records every logged value.
#[derive(Clone, Default)]
struct Record(Arc<Mutex<Vec<(u64, Measurement)>>>);
impl Callback for Record {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        if let Event::Step { measurements } | Event::Eval { measurements, .. } = event {
            self.0.lock().unwrap().extend(measurements.iter().map(|m| (at.step, m.clone())));
        }
        Ok(Flow::Continue)
    }
}

#[test]
fn both_tasks_learn_their_rooms() {
    let labels = build_transforms(&validation(0.1)).unwrap();
    let seen: Arc<dyn Dataset> = Arc::new(SceneDataset::new(rooms(900), labels, 1, 1).unwrap());
    let settings = TrainerConfig { epochs: 40, eval_every: 20, log_every: 1, ..config(None) };
    let check = |record: &Record, name: &str, loss_falls: f64| {
        let values = record.0.lock().unwrap();
        let series = |name: &str| -> Vec<f64> {
            values.iter().filter(|(_, m)| m.name == name).map(|(_, m)| m.value).collect()
        };
        let loss = series("train/loss");
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let (first, last) = (mean(&loss[..10]), mean(&loss[loss.len() - 10..]));
        assert!(last < first * loss_falls, "{name}: loss {first} to {last}");
        let accuracy = series(&format!("{name}/allAcc"));
        assert!(accuracy[1] > accuracy[0] && accuracy[1] > 0.3, "{name}: {accuracy:?}");
    };
    {
        let (module, record) = (language(Precision::F32, 1), Record::default());
        let input = InputFeatures::default();
        let evaluator =
            ZeroShotEvaluator::new("zero_shot", seen.clone(), input, texts(), vec![0, 1, 2]);
        let mut evaluators: Vec<Box<dyn Evaluator<TaskModule>>> = vec![Box::new(evaluator)];
        trainer(&module, settings.clone())
            .with_callback(record.clone())
            .fit(&module, &mut loader(training_data(900), 1), &mut evaluators, Progress::default())
            .unwrap();
        check(&record, "zero_shot", 0.8);
    }
    let params = ParamStore::trainable(4);
    let shape = network(Precision::F32).with_classes(CLASSES.len());
    let model = shape.build(params.builder()).unwrap();
    let objective = Objective::new().with(1.0, CrossEntropy::default()).with(1.0, LovaszSoftmax);
    let (module, record) =
        (TaskModule::new(params, model, objective, SemanticSegmentation), Record::default());
    let evaluator =
        SegmentationEvaluator::new("segmentation", seen, InputFeatures::default(), Vec::new());
    let mut evaluators: Vec<Box<dyn Evaluator<TaskModule>>> = vec![Box::new(evaluator)];
    trainer(&module, settings)
        .with_callback(record.clone())
        .fit(&module, &mut loader(training_data(900), 1), &mut evaluators, Progress::default())
        .unwrap();
    check(&record, "segmentation", 0.9);
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
                let data = SceneDataset::new(rooms(400), changes, seed, 1).unwrap();
                let (module, record) = (language(precision, seed), Record::default());
                let settings =
                    TrainerConfig { seed, epochs: steps.div_ceil(3), log_every: 1, ..config(None) };
                let at = trainer(&module, settings)
                    .with_callback(record.clone())
                    .fit(&module, &mut loader(Arc::new(data), 0), &mut [], Progress::default())
                    .unwrap_or_else(|e| panic!("{precision} uneven {uneven} seed {seed}: {e:?}"));
                let values = record.0.lock().unwrap();
                let losses: Vec<_> = values.iter().filter(|v| v.1.name == "train/loss").collect();
                assert_eq!((at.step, losses.len() as u64), (at.total_steps, at.total_steps));
                assert!(values.iter().all(|(_, m)| m.value.is_finite()));
                assert!(state(&module).iter().all(|(_, v)| v.iter().all(|x| x.is_finite())));
            }
        }
    }
}
