//! Statistics over the batches of all ranks: a step is that of one batch which holds all rows.

use crate::line::{Numbers, config};
use crate::ranks::on_ranks;
use candle_core::{DType, Device, Result, Tensor};
use scenesplat_datasets::{BatchLoader, DataError};
use scenesplat_models::layers::BatchNorm;
use scenesplat_models::{Mode, ParamStore};
use scenesplat_trainers::{
    AdamW, AdamWConfig, Collective, OneCycle, Progress, StepContext, StepOutput, ThreadRank,
    TrainError, Trainer, TrainerConfig, TrainingModule, group_by_keyword,
};
use std::rc::Rc;

type Rows = Vec<[f32; 4]>;
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

    fn values(&self) -> Named {
        let all = self.params.parameters().into_iter().chain(self.params.buffers());
        let flat = |t: &Tensor| {
            let t = t.to_dtype(DType::F32).and_then(|t| t.flatten_all()).unwrap();
            t.to_vec1::<f32>().unwrap()
        };
        all.map(|(name, var)| (name, flat(&var))).collect()
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

/// So many batches joined into one.
struct Joined(Numbers, usize);

impl BatchLoader<Rows> for Joined {
    fn batches_per_epoch(&self) -> usize {
        self.0.batches / self.1
    }
    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = std::result::Result<Rows, DataError>> + '_> {
        let parts: Vec<Rows> = self.0.epoch(epoch, 0).map(std::result::Result::unwrap).collect();
        let joined: Vec<Rows> = parts.chunks_exact(self.1).map(<[Rows]>::concat).collect();
        Box::new(joined.into_iter().skip(skip).map(Ok))
    }
}

fn numbers() -> Numbers {
    Numbers { batches: 8, rows: 6, poison: None }
}

fn loop_for(module: &Between, accumulate: u64, sync_batch_norm: bool) -> Trainer {
    let groups = group_by_keyword(&module.params.parameters(), 0.02, 0.01, &[]);
    let optimizer = AdamW::new(groups, AdamWConfig::default()).unwrap();
    let settings = TrainerConfig { accumulate, sync_batch_norm, ..config(None) };
    Trainer::new(settings, Box::new(optimizer), Box::new(OneCycle::default())).unwrap()
}

fn train(
    rank: Option<ThreadRank>,
    accumulate: u64,
    sync_batch_norm: bool,
    empty_above: f32,
    data: &mut dyn BatchLoader<Rows>,
) -> std::result::Result<Named, TrainError> {
    let module = Between::new(empty_above);
    let mut trainer = loop_for(&module, accumulate, sync_batch_norm);
    if let Some(rank) = rank {
        trainer = trainer.with_collective(Rc::new(rank));
    }
    trainer.fit(&module, data, &mut [], Progress::default())?;
    Ok(module.values())
}

#[test]
fn ranks_train_as_one_process_does_with_all_rows_in_one_batch() {
    for ranks in [2, 4] {
        let expected = train(None, 1, false, f32::MAX, &mut Joined(numbers(), ranks)).unwrap();
        let on_all = |sync: bool| {
            on_ranks(ranks, |rank| {
                train(Some(rank), ranks as u64, sync, f32::MAX, &mut numbers()).unwrap()
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
    let data = || Numbers { batches: 8, rows: 6, poison: None };
    let mut empty = [0; 2];
    for epoch in 0..4 {
        let firsts: Vec<f32> = data().epoch(epoch, 0).map(|batch| batch.unwrap()[0][0]).collect();
        for pair in firsts.chunks_exact(2) {
            let both: Vec<bool> = pair.iter().map(|first| *first > limit).collect();
            assert_ne!(both, [true, true]);
            empty[0] += usize::from(both[0]);
            empty[1] += usize::from(both[1]);
        }
    }
    assert!(empty.iter().all(|count| *count > 0), "{empty:?}");
    let all = on_ranks(2, |rank| train(Some(rank), 2, true, limit, &mut data()).unwrap());
    assert_eq!(all[0], all[1]);
    let updates = |values: &[(String, Vec<f32>)]| {
        let counts = values.iter().filter(|(name, _)| name.ends_with("num_batches_tracked"));
        counts.map(|(_, count)| count[0]).collect::<Vec<_>>()
    };
    assert_eq!(updates(&all[0]), [16.0, 16.0], "one a step");

    // In the first step one rank has no batch: what is remembered is of the other one's rows.
    let first: Vec<Rows> = data().epoch(0, 0).take(2).map(|batch| batch.unwrap()).collect();
    let with_rows: Vec<&Rows> = first.iter().filter(|rows| rows[0][0] <= limit).collect();
    assert_eq!(with_rows.len(), 1, "{first:?}");
    let module = Between::new(limit);
    let rows = Tensor::from_vec(with_rows[0].concat(), (6, 4), &Device::Cpu).unwrap();
    let seen = rows.matmul(&module.products[0]).unwrap().mean(0).unwrap();
    let expected = (seen * 0.01).unwrap().to_vec1::<f32>().unwrap();
    let one_step = || Numbers { batches: 2, rows: 6, poison: None };
    let means = on_ranks(2, |rank| {
        let module = Between::new(limit);
        let groups = group_by_keyword(&module.params.parameters(), 0.02, 0.01, &[]);
        let optimizer = AdamW::new(groups, AdamWConfig::default()).unwrap();
        let settings =
            TrainerConfig { accumulate: 2, sync_batch_norm: true, epochs: 1, ..config(None) };
        let schedule = Box::new(OneCycle::default());
        let trainer = Trainer::new(settings, Box::new(optimizer), schedule).unwrap();
        let mut trainer = trainer.with_collective(Rc::new(rank));
        trainer.fit(&module, &mut one_step(), &mut [], Progress::default()).unwrap();
        module.params.buffers()["first.running_mean"].to_vec1::<f32>().unwrap()
    });
    for mean in means {
        for (found, expected) in mean.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-7, "{found} {expected}");
        }
    }
}

#[test]
fn what_is_no_number_goes_through_the_statistics_and_ends_every_rank() {
    let errors = on_ranks(2, |rank| {
        let mut data = Numbers { poison: Some((0, 3)), ..numbers() };
        let module = Between::new(f32::MAX);
        let mut trainer = loop_for(&module, 2, true).with_collective(Rc::new(rank));
        let error = trainer.fit(&module, &mut data, &mut [], Progress::default()).unwrap_err();
        let causes = std::iter::successors(Some(&error as &dyn std::error::Error), |e| e.source());
        causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
    });
    for error in errors {
        assert!(error.contains("step 1,") && error.contains("loss is NaN"), "{error}");
    }
}

#[test]
fn processes_that_go_through_other_layers_are_told() {
    let errors = on_ranks(2, |rank| {
        let module = Between { skips: rank.rank() == 1, ..Between::new(f32::MAX) };
        let mut trainer = loop_for(&module, 2, true).with_collective(Rc::new(rank));
        let fitted = trainer.fit(&module, &mut numbers(), &mut [], Progress::default());
        let error = fitted.unwrap_err();
        let causes = std::iter::successors(Some(&error as &dyn std::error::Error), |e| e.source());
        causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
    });
    for error in errors {
        assert!(error.contains("the same layers"), "{error}");
    }
}

#[test]
fn what_cannot_be_synchronised_is_refused_with_the_mend() {
    let refused = |rank: Option<ThreadRank>, accumulate: u64| {
        train(rank, accumulate, true, f32::MAX, &mut numbers()).unwrap_err().to_string()
    };
    let alone = refused(None, 2);
    assert!(alone.contains("sync_batch_norm") && alone.contains("accumulate = 1"), "{alone}");
    for error in on_ranks(2, |rank| refused(Some(rank), 4)) {
        assert!(error.contains("there are 2") && error.contains("accumulate = 2"), "{error}");
    }
    // One batch a step in one process: there is nothing else to look at.
    let one = |sync: bool| train(None, 1, sync, f32::MAX, &mut numbers()).unwrap();
    assert_eq!(one(true), one(false));
}
