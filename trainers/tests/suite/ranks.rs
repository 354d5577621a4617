//! Several ranks: what each takes, and that their number changes nothing.

use crate::support::{
    Line, Numbers, Rows, Score, causes, config, dataset, fit, in_step, load, numbers, rooms, state,
    stop_at, trainer,
};
use candle_core::{Device, Result, Tensor};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use scenesplat_datasets::transforms::language_pretraining;
use scenesplat_datasets::{BatchLoader, BatchPart, InputFeatures, LoaderSettings, SceneLoader};
use scenesplat_models::layers::BatchNorm;
use scenesplat_models::{Mode, ParamStore};
use scenesplat_trainers::callbacks::{JsonLines, read_json_lines};
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::{
    Collective, DataModule, Progress, StepContext, StepOutput, ThreadRank, TrainerConfig,
    TrainingModule,
};
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;

/// Runs `work` on so many ranks, and gives what they gave, in their order.
pub fn on_ranks<R: Send>(size: usize, work: impl Fn(ThreadRank) -> R + Sync) -> Vec<R> {
    std::thread::scope(|scope| {
        let ranks = ThreadRank::group(size).into_iter();
        let threads: Vec<_> = ranks.map(|rank| scope.spawn(|| work(rank))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

/// `y = norm(x)·w`: a network with statistics. Its rows are its features.
struct Normed {
    params: ParamStore,
    norm: BatchNorm,
    weight: Tensor,
}

impl Normed {
    fn new() -> Self {
        let params = ParamStore::trainable(3);
        let vb = params.builder();
        let norm = BatchNorm::new(4, vb.pp("norm")).unwrap();
        let init = candle_nn::Init::Uniform { lo: -1.0, up: 1.0 };
        let weight = vb.get_with_hints((4, 2), "weight", init).unwrap();
        Self { params, norm, weight }
    }

    /// Bits of parameters and buffers.
    fn bits(&self) -> Vec<(String, Vec<u32>)> {
        let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect();
        state(&self.params).into_iter().map(|(name, values)| (name, bits(values))).collect()
    }
}

impl TrainingModule for Normed {
    type Batch = Rows;
    fn params(&self) -> &ParamStore {
        &self.params
    }
    fn training_step(&self, batch: &Self::Batch, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let noise = f64::from(cx.forward.rng.next_u32()) / f64::from(u32::MAX);
        let x = Tensor::from_vec(batch.concat(), (batch.len(), 4), &Device::Cpu)?;
        let y = self.norm.forward(&x, Mode::Train)?.matmul(&self.weight)?;
        let target = (x.narrow(1, 0, 2)? + 0.1 * noise)?;
        let loss = (&y - target)?.sqr()?.mean_all()?;
        let terms = vec![("square".to_owned(), f64::from(loss.to_scalar::<f32>()?))];
        let (rows, features) = (batch.len(), Some(y.detach()));
        Ok(StepOutput { loss, rows, counted_rows: rows - 1, terms, features })
    }
    fn is_empty(&self, batch: &Self::Batch) -> bool {
        // One batch of an epoch.
        batch[0][0] > 1.9
    }
}

/// The batches, and the sum of the weights.
fn evaluated() -> DataModule<'static, Normed> {
    let sum = |module: &Normed, _: Progress| {
        f64::from(module.weight.sum_all().unwrap().to_scalar::<f32>().unwrap())
    };
    DataModule::new(Numbers { batches: 25, ..four() }).with_evaluator(Score("sum", sum))
}

fn settings(accumulate: u64, dir: Option<&Path>) -> TrainerConfig {
    let mut settings = TrainerConfig { accumulate, clip_norm: Some(0.5), ..config(dir) };
    settings.ema = Some(0.9);
    settings.health.every_steps = 2;
    settings.checkpoint.every_steps = 3;
    settings
}

fn four() -> Numbers {
    Numbers { batches: 4, rows: 6, poison: None }
}

type Log = Vec<(u64, String, u64)>;

/// What is logged, but for times; numbers as bits.
fn log(path: &Path) -> Log {
    let entries = read_json_lines(path).unwrap().into_iter();
    let kept = entries.filter(|e| {
        !["seconds_per_step", "together_seconds", "together_bytes"]
            .iter()
            .any(|n| e.name.ends_with(n))
    });
    kept.map(|e| (e.step, e.name, e.value.to_bits())).collect()
}

/// Trains on one rank of several; rank 0 logs. Gives the bits at the end.
fn train(rank: Option<ThreadRank>, accumulate: u64, dir: &Path) -> Vec<(String, Vec<u32>)> {
    let module = Normed::new();
    let leads = rank.as_ref().is_none_or(|rank| rank.rank() == 0);
    let mut trainer = trainer(&module, settings(accumulate, leads.then_some(dir)));
    if leads {
        trainer = trainer.with_callback(JsonLines::new(&dir.join("metrics.jsonl")));
    }
    if let Some(rank) = rank {
        trainer = trainer.with_collective(Rc::new(rank));
    }
    let at = trainer.fit(&module, &mut evaluated(), Progress::default()).unwrap();
    assert_eq!(at.step, at.total_steps);
    module.bits()
}

#[test]
fn the_number_of_ranks_changes_no_bit_of_weights_statistics_and_logs() {
    for (accumulate, sizes) in [(4, &[1, 2, 4][..]), (6, &[3]), (8, &[2])] {
        let alone = tempfile::tempdir().unwrap();
        let expected = train(None, accumulate, alone.path());
        assert!(expected.iter().any(|(name, _)| name == "norm.running_var"));
        let told = log(&alone.path().join("metrics.jsonl"));
        assert!(told.iter().any(|(_, name, _)| name == "sum/value"));
        assert!(told.iter().any(|(_, name, _)| name.contains("effective_rank")), "{told:?}");
        for &size in sizes {
            let dir = tempfile::tempdir().unwrap();
            let all = on_ranks(size, |rank| train(Some(rank), accumulate, dir.path()));
            for (rank, bits) in all.iter().enumerate() {
                assert_eq!(bits, &expected, "rank {rank} of {size}");
            }
            assert_eq!(log(&dir.path().join("metrics.jsonl")), told, "{size} ranks");
        }
    }
}

#[test]
fn gradients_and_statistics_are_those_of_the_batches_by_hand() {
    // One step with a plain optimizer's first update would hide the size of the gradient: so the norm that is
    // logged is compared with that of the mean gradient, and statistics with their recursion.
    let dir = tempfile::tempdir().unwrap();
    on_ranks(2, |rank| {
        let (module, leads) = (Normed::new(), rank.rank() == 0);
        let settings =
            TrainerConfig { accumulate: 4, epochs: 1, log_every: 1, ..Default::default() };
        let mut trainer = trainer(&module, settings).with_collective(Rc::new(rank));
        if leads {
            trainer = trainer.with_callback(JsonLines::new(&dir.path().join("metrics.jsonl")));
        }
        fit(trainer, &module, four()).unwrap();
        let (mut mean, mut var) = ([0.0_f64; 4], [1.0_f64; 4]);
        for place in 0..4 {
            let batch = four().batch(0, place);
            for c in 0..4 {
                let n = batch.len() as f64;
                let m = batch.iter().map(|r| f64::from(r[c])).sum::<f64>() / n;
                let v = batch.iter().map(|r| (f64::from(r[c]) - m).powi(2)).sum::<f64>();
                mean[c] = 0.99 * mean[c] + 0.01 * m;
                var[c] = 0.99 * var[c] + 0.01 * v / (n - 1.0);
            }
        }
        let buffers = module.params.buffers();
        let of = |name: &str| buffers[name].to_vec1::<f32>().unwrap();
        for c in 0..4 {
            assert!((f64::from(of("norm.running_mean")[c]) - mean[c]).abs() < 1e-6);
            assert!((f64::from(of("norm.running_var")[c]) - var[c]).abs() < 1e-6);
        }
    });
    // The mean gradient of the four batches, each by itself at the first weights.
    let module = Normed::new();
    let mut sums: std::collections::BTreeMap<String, Vec<f64>> = Default::default();
    for place in 0..4 {
        let out = in_step(|cx| {
            *cx.forward.rng = ChaCha8Rng::seed_from_u64(0);
            cx.forward.rng.set_stream(place as u64);
            module.training_step(&four().batch(0, place), cx).unwrap()
        });
        let grads = out.loss.backward().unwrap();
        for (name, var) in module.params.parameters() {
            let grad = grads.get(&var).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
            let sum = sums.entry(name).or_insert_with(|| vec![0.0; grad.len()]);
            sum.iter_mut().zip(&grad).for_each(|(s, g)| *s += f64::from(*g) / 4.0);
        }
    }
    let norm = sums.values().flatten().map(|g| g * g).sum::<f64>().sqrt();
    let log = read_json_lines(&dir.path().join("metrics.jsonl")).unwrap();
    let told = log.iter().find(|e| e.name == "train/grad_norm").unwrap().value;
    assert!((told - norm).abs() < 1e-6 * norm, "{told} {norm}");
    let bytes = log.iter().find(|e| e.name == "train/together_bytes").unwrap().value;
    assert_eq!(bytes, 4.0 * sums.values().map(Vec::len).sum::<usize>() as f64);
}

#[test]
fn a_run_goes_on_with_another_number_of_ranks() {
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let expected = train(None, 4, whole.path());
    // Stopped by rank 1 alone, which only knows that it shall stop.
    let run = |size: usize, until: Option<u64>| {
        on_ranks(size, |rank| {
            let module = Normed::new();
            let leads = rank.rank() == 0;
            let mut trainer =
                trainer(&module, settings(4, Some(parts.path()))).with_collective(Rc::new(rank));
            if let Some(step) = until {
                trainer = trainer.with_callback(stop_at(step));
            }
            let start = match newest_checkpoint(parts.path()).unwrap() {
                Some(_) => load(&mut trainer, parts.path(), &module),
                None => Progress::default(),
            };
            let at = trainer.fit(&module, &mut evaluated(), start).unwrap();
            (leads, at.step, module.bits())
        })
    };
    for (size, until) in [(2, Some(7)), (4, Some(15))] {
        for (_, step, _) in run(size, until) {
            assert_eq!(Some(step), until);
        }
    }
    for (_, step, bits) in run(1, None) {
        assert_eq!((step, &bits), (24, &expected));
    }
}

#[test]
fn one_rank_that_is_asked_to_stop_stops_all_and_one_that_fails_is_named() {
    let stop = Arc::new(std::sync::atomic::AtomicBool::new(true));
    let steps = on_ranks(3, |rank| {
        let module = Line::new();
        let settings = TrainerConfig { accumulate: 3, ..config(None) };
        let mut trainer = trainer(&module, settings);
        if rank.rank() == 2 {
            trainer = trainer.with_stop(Arc::clone(&stop));
        }
        fit(trainer.with_collective(Rc::new(rank)), &module, numbers()).unwrap().step
    });
    assert_eq!(steps, [1, 1, 1]);
    let dir = tempfile::tempdir().unwrap();
    let errors = on_ranks(2, |rank| {
        let module = Line::new();
        let mut settings = TrainerConfig { accumulate: 2, ..config(Some(dir.path())) };
        settings.checkpoint.every_steps = 1;
        let trainer = trainer(&module, settings).with_collective(Rc::new(rank));
        // The batch at place 5 is of rank 1.
        let data = Numbers { poison: Some((0, 5)), ..numbers() };
        causes(&fit(trainer, &module, data).unwrap_err())
    });
    assert!(errors[0].contains("rank 1 is gone"), "{errors:?}");
    assert!(errors[1].contains("step 2"), "{errors:?}");
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    assert!(newest.ends_with("step-000000002"), "{}", newest.display());
}

#[test]
fn batches_that_cannot_be_shared_evenly_are_refused() {
    let errors = on_ranks(2, |rank| {
        let module = Line::new();
        let settings = TrainerConfig { accumulate: 3, ..config(None) };
        let trainer = trainer(&module, settings).with_collective(Rc::new(rank));
        let before = module.values();
        let error = fit(trainer, &module, numbers()).unwrap_err();
        assert_eq!(before, module.values());
        error.to_string()
    });
    assert!(
        errors[0].contains("accumulate = 3") && errors[0].contains("multiple of 2"),
        "{errors:?}"
    );
}

#[test]
fn a_loader_makes_only_the_batches_of_its_part_and_the_same() {
    let dataset = dataset(rooms(14, 300, 4), &language_pretraining(0.05), 7);
    for workers in [0, 2] {
        let settings = LoaderSettings { workers, prefetch: 3, ..LoaderSettings::default() };
        let mut loader =
            SceneLoader::new(Arc::clone(&dataset) as _, InputFeatures::default(), settings)
                .unwrap();
        let all: Vec<_> = loader.epoch(3, 0).map(|batch| batch.unwrap().feat).collect();
        assert_eq!(all.len(), 7);
        for skip in [0, 3] {
            let part = BatchPart { group: 3, first: 1, count: 2 };
            let mine: Vec<_> = loader.epoch_part(3, skip, part).map(|b| b.unwrap().feat).collect();
            let places = (skip..7).filter(|place| [1, 2, 4, 5].contains(place));
            let expected: Vec<_> = places.map(|place| all[place].clone()).collect();
            assert_eq!(mine, expected, "{workers} workers, from {skip}");
        }
    }
}
