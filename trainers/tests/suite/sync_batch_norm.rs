//! Statistics over the batches of all ranks: a step is that of one batch which holds all rows.

use crate::ranks::on_ranks;
use crate::support::{Batches, Numbers, Rows, causes, config, fit, state, trainer_by};
use candle_core::{Device, Result, Tensor};
use scenesplat_datasets::BatchLoader;
use scenesplat_models::layers::BatchNorm;
use scenesplat_models::{Mode, ParamStore};
use scenesplat_trainers::{
    Collective, OneCycle, StepContext, StepOutput, ThreadRank, TrainError, Trainer, TrainerConfig,
    TrainingModule,
};
use std::rc::Rc;

/// Parameters, then buffers, by name.
type Named = Vec<(String, Vec<f32>)>;

/// `y = norm(norm(x·first)·second)·last`: gradients go through a batch norm to parameters before it.
struct Between {
    params: ParamStore,
    products: [Tensor; 3],
    norms: [BatchNorm; 2],
    /// Batches that are empty begin with a number above this.
    empty_above: f32,
    /// Leaves the second batch norm out, as no process may do alone.
    skips: bool,
}

impl Between {
    fn new(empty_above: f32) -> Self {
        let params = ParamStore::trainable(3);
        let vb = params.builder();
        let init = candle_nn::Init::Uniform { lo: -1.0, up: 1.0 };
        let product =
            |name: &str, shape: (usize, usize)| vb.get_with_hints(shape, name, init).unwrap();
        let products = [product("a", (4, 5)), product("b", (5, 3)), product("c", (3, 1))];
        let norms = [("first", 5), ("second", 3)]
            .map(|(name, channels)| BatchNorm::new(channels, vb.pp(name)).unwrap());
        Self { params, products, norms, empty_above, skips: false }
    }
}

impl TrainingModule for Between {
    type Batch = Rows;
    fn params(&self) -> &ParamStore {
        &self.params
    }
    fn training_step(&self, batch: &Rows, _: &mut StepContext<'_>) -> Result<StepOutput> {
        let x = Tensor::from_vec(batch.concat(), (batch.len(), 4), &Device::Cpu)?;
        let [a, b, c] = &self.products;
        let y = self.norms[0].forward(&x.matmul(a)?, Mode::Train)?;
        let mut y = y.sqr()?.matmul(b)?;
        if !self.skips {
            y = self.norms[1].forward(&y, Mode::Train)?;
        }
        let y = y.matmul(c)?;
        let loss = (y - x.narrow(1, 0, 1)?)?.sqr()?.mean_all()?;
        let rows = batch.len();
        Ok(StepOutput { loss, rows, counted_rows: rows, terms: Vec::new(), features: None })
    }
    fn is_empty(&self, batch: &Rows) -> bool {
        batch[0][0] > self.empty_above
    }
}

fn numbers() -> Numbers {
    Numbers { batches: 8, rows: 6, poison: None }
}

fn trainer(module: &Between, accumulate: u64, sync_batch_norm: bool) -> Trainer {
    let settings = TrainerConfig { accumulate, sync_batch_norm, ..config(None) };
    trainer_by(module, settings, 0.02, 0.01, OneCycle::default())
}

fn train(
    rank: Option<ThreadRank>,
    accumulate: u64,
    sync_batch_norm: bool,
    empty_above: f32,
    data: impl BatchLoader<Rows>,
) -> std::result::Result<Named, TrainError> {
    let module = Between::new(empty_above);
    let mut trainer = trainer(&module, accumulate, sync_batch_norm);
    if let Some(rank) = rank {
        trainer = trainer.with_collective(Rc::new(rank));
    }
    fit(trainer, &module, data)?;
    Ok(state(&module.params))
}

#[test]
fn ranks_train_as_one_process_does_with_all_rows_in_one_batch() {
    for ranks in [2, 4] {
        // So many batches joined into one.
        let joined = Batches(8 / ranks, |epoch, place| -> Rows {
            (0..ranks).flat_map(|part| numbers().batch(epoch, place * ranks + part)).collect()
        });
        let expected = train(None, 1, false, f32::MAX, joined).unwrap();
        let on_all = |sync: bool| {
            on_ranks(ranks, |rank| {
                train(Some(rank), ranks as u64, sync, f32::MAX, numbers()).unwrap()
            })
        };
        let apart = |found: &[(String, Vec<f32>)], what: fn(&str) -> bool| {
            let pairs = found.iter().zip(&expected).filter(|((name, _), _)| what(name));
            pairs.fold(0.0_f32, |most, ((name, a), (other, b))| {
                assert_eq!(name, other);
                let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs() / (1.0 + b.abs()));
                apart.fold(most, f32::max)
            })
        };
        let all = on_all(true);
        for found in &all {
            assert_eq!(found, &all[0], "the ranks differ");
            // Remembered statistics and their count among them: one update a step.
            let apart = apart(found, |_| true);
            assert!(apart < 2e-5, "{ranks} ranks: {apart}");
        }
        assert_eq!(on_all(true), all, "two runs differ");
        let own = on_all(false);
        let apart = apart(&own[0], |name| ["a", "b", "c"].contains(&name));
        assert!(apart > 1e-3, "weights by the statistics of each batch are others: {apart}");
    }
}

#[test]
fn ranks_without_a_batch_hold_nobody_up_and_have_no_part_in_the_statistics() {
    // Some batches begin with a number above this, on either rank, and in no step on both.
    let limit = 1.0;
    let mut empty = [0; 2];
    for epoch in 0..4 {
        let firsts: Vec<f32> = (0..8).map(|place| numbers().batch(epoch, place)[0][0]).collect();
        for pair in firsts.chunks_exact(2) {
            let both: Vec<bool> = pair.iter().map(|first| *first > limit).collect();
            assert_ne!(both, [true, true]);
            empty[0] += usize::from(both[0]);
            empty[1] += usize::from(both[1]);
        }
    }
    assert!(empty.iter().all(|count| *count > 0), "{empty:?}");
    let all = on_ranks(2, |rank| train(Some(rank), 2, true, limit, numbers()).unwrap());
    assert_eq!(all[0], all[1]);
    let updates = |values: &[(String, Vec<f32>)]| {
        let counts = values.iter().filter(|(name, _)| name.ends_with("num_batches_tracked"));
        counts.map(|(_, count)| count[0]).collect::<Vec<_>>()
    };
    assert_eq!(updates(&all[0]), [16.0, 16.0], "one a step");

    // In the first step one rank has no batch: what is remembered is of the other one's rows.
    let first: Vec<Rows> = (0..2).map(|place| numbers().batch(0, place)).collect();
    let with_rows: Vec<&Rows> = first.iter().filter(|rows| rows[0][0] <= limit).collect();
    assert_eq!(with_rows.len(), 1, "{first:?}");
    let module = Between::new(limit);
    let rows = Tensor::from_vec(with_rows[0].concat(), (6, 4), &Device::Cpu).unwrap();
    let seen = rows.matmul(&module.products[0]).unwrap().mean(0).unwrap();
    let expected = (seen * 0.01).unwrap().to_vec1::<f32>().unwrap();
    let means = on_ranks(2, |rank| {
        let module = Between::new(limit);
        let settings =
            TrainerConfig { accumulate: 2, sync_batch_norm: true, epochs: 1, ..config(None) };
        let trainer = trainer_by(&module, settings, 0.02, 0.01, OneCycle::default());
        let one_step = Numbers { batches: 2, ..numbers() };
        fit(trainer.with_collective(Rc::new(rank)), &module, one_step).unwrap();
        module.params.buffers()["first.running_mean"].to_vec1::<f32>().unwrap()
    });
    for mean in means {
        for (found, expected) in mean.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-7, "{found} {expected}");
        }
    }
}

/// The error of each of two ranks.
fn errors(module: impl Fn(&ThreadRank) -> Between + Sync, data: Numbers) -> Vec<String> {
    on_ranks(2, |rank| {
        let module = module(&rank);
        let trainer = trainer(&module, 2, true).with_collective(Rc::new(rank));
        causes(&fit(trainer, &module, data).unwrap_err())
    })
}

#[test]
fn what_is_no_number_goes_through_the_statistics_and_ends_every_rank() {
    let data = Numbers { poison: Some((0, 3)), ..numbers() };
    for error in errors(|_| Between::new(f32::MAX), data) {
        assert!(error.contains("step 1,") && error.contains("loss is NaN"), "{error}");
    }
}

#[test]
fn processes_that_go_through_other_layers_get_an_error() {
    let module = |rank: &ThreadRank| Between { skips: rank.rank() == 1, ..Between::new(f32::MAX) };
    for error in errors(module, numbers()) {
        assert!(error.contains("the same layers"), "{error}");
    }
}

#[test]
fn what_cannot_be_synchronized_is_refused_with_help() {
    let refused = |rank: Option<ThreadRank>, accumulate: u64| {
        train(rank, accumulate, true, f32::MAX, numbers()).unwrap_err().to_string()
    };
    let alone = refused(None, 2);
    assert!(alone.contains("sync_batch_norm") && alone.contains("accumulate = 1"), "{alone}");
    for error in on_ranks(2, |rank| refused(Some(rank), 4)) {
        assert!(error.contains("there are 2") && error.contains("accumulate = 2"), "{error}");
    }
    // One batch a step in one process: there is nothing else to look at.
    let one = |sync: bool| train(None, 1, sync, f32::MAX, numbers()).unwrap();
    assert_eq!(one(true), one(false));
}
