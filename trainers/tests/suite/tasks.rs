//! Tasks and evaluators: what losses are told, which rows count, the mode of evaluation, and a task
//! and a metric of one's own.

use crate::support::{
    PerVoxel, dataset, fit, in_step, loader, rooms as synthetic, state, texts, trainer_by,
};
use candle_core::{Result, Tensor};
use scenesplat_datasets::transforms::validation;
use scenesplat_datasets::{
    DataError, Dataset, InputChannel, InputFeatures, Sample, TrainBatch, collate_samples,
};
use scenesplat_losses::{CosineLoss, CrossEntropy, Loss, LossInput, Objective};
use scenesplat_metrics::{Measurement, Metric, MetricError};
use scenesplat_models::{Backbone, Forward, Mode, ModelConfig, ParamStore, PointCloud};
use scenesplat_rooms::CLASSES;
use scenesplat_scene::{LabelledPoints, LanguageFeatures, TextTable};
use scenesplat_trainers::evaluators::{SegmentationEvaluator, ZeroShotEvaluator};
use scenesplat_trainers::tasks::{
    LanguagePretraining, SemanticSegmentation, TargetSource, TaskModule, TrainingTask, point_cloud,
};
use scenesplat_trainers::{
    Evaluator, HasBackbone, OneCycle, Progress, StepContext, StepOutput, TrainerConfig,
    TrainingModule,
};
use std::sync::{Arc, Mutex};

/// What a loss was told: labels, mask, targets, progress.
type Told = (Option<Vec<i32>>, Option<Vec<bool>>, Option<Vec<Vec<f32>>>, f64);

/// Writes down what it is told; its value is a constant times the sum of the predictions.
#[derive(Clone)]
struct Spy(&'static str, f64, Arc<Mutex<Vec<Told>>>);
impl Spy {
    fn new(name: &'static str, factor: f64) -> Self {
        Self(name, factor, Arc::default())
    }
}
impl Loss for Spy {
    fn name(&self) -> &str {
        self.0
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        let target = input.target.map(|t| t.to_vec2().unwrap());
        let told = (input.label.map(<[_]>::to_vec), input.valid.map(<[_]>::to_vec), target);
        self.2.lock().unwrap().push((told.0, told.1, told.2, input.progress));
        Ok(Some((input.pred.sum_all()? * self.1)?))
    }
}

fn rooms(count: usize) -> Arc<dyn Dataset> {
    dataset(synthetic(count, 600, 3), &validation(0.3), 1)
}

/// A batch whose first rows have no label.
fn batch() -> TrainBatch {
    let sample = rooms(1).get(0, 0).unwrap();
    let mut batch = collate_samples(vec![sample], &InputFeatures::default()).unwrap();
    batch.segment.as_mut().unwrap()[..7].fill(-1);
    batch
}

fn step(module: &TaskModule, batch: &TrainBatch) -> StepOutput {
    in_step(|cx| {
        cx.progress = 0.25;
        module.training_step(batch, cx).unwrap()
    })
}

const WIDTH: usize = 6;

/// A linear layer on each voxel and one loss.
fn linear(
    width: usize,
    loss: impl Loss + 'static,
    task: impl TrainingTask + 'static,
) -> TaskModule {
    let params = ParamStore::trainable(1);
    let model = PerVoxel::new(&params, width);
    TaskModule::new(params, model, Objective::new().with(1.0, loss), task)
}

#[test]
fn losses_get_the_rows_that_count_and_their_weights() {
    let params = ParamStore::trainable(1);
    let model = PerVoxel::new(&params, WIDTH);
    let (a, b) = (Spy::new("a", 1.0), Spy::new("b", -0.5));
    let objective = Objective::new().with(0.25, a.clone()).with(2.0, b);
    let targets = TargetSource::class_text(&texts(WIDTH)).unwrap();
    let module = TaskModule::new(params, model, objective, LanguagePretraining { targets });
    let batch = batch();
    let out = step(&module, &batch);
    let labels = batch.segment.as_ref().unwrap();
    let counted = labels.iter().filter(|l| **l >= 0).count();
    assert_eq!((out.rows, out.counted_rows), (labels.len(), counted));
    assert!(labels.len() - counted >= 7);
    // 0.25 · s + 2 · (−0.5 · s), by hand.
    let sum = out.terms[0].1;
    assert!((out.terms[1].1 + 0.5 * sum).abs() < 1e-4 * sum.abs(), "{:?}", out.terms);
    let total = f64::from(out.loss.to_scalar::<f32>().unwrap());
    assert!((total - (0.25 - 1.0) * sum).abs() < 1e-4 * sum.abs(), "{total} {sum}");
    let told = a.2.lock().unwrap();
    let (label, valid, target, progress) = &told[0];
    assert_eq!(label.as_ref().unwrap(), labels);
    assert_eq!(*progress, 0.25);
    let table = texts(WIDTH);
    for (row, &label) in labels.iter().enumerate() {
        assert_eq!(valid.as_ref().unwrap()[row], label >= 0);
        if let Ok(class) = usize::try_from(label) {
            let (got, want) = (&target.as_ref().unwrap()[row], table.row(class).unwrap());
            assert!(got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-6), "row {row}");
        }
    }
}

#[test]
fn rows_without_label_or_feature_do_not_count() {
    let module = linear(CLASSES.len(), CrossEntropy::default(), SemanticSegmentation);
    let mut batch = batch();
    let before = step(&module, &batch);
    let labels = batch.segment.as_mut().unwrap();
    let counted = labels.iter().filter(|l| **l >= 0).count();
    assert_eq!(before.counted_rows, counted);
    labels.fill(-1);
    let none = step(&module, &batch);
    assert_eq!((none.rows, none.counted_rows, none.terms.len()), (batch.len(), 0, 0));
    // Features: those that the mask says are there.
    let task = LanguagePretraining { targets: TargetSource::Features };
    let module = linear(WIDTH, CosineLoss::default(), task);
    let one = half::f16::from_f32(1.0);
    let rows = batch.len();
    let feat = LanguageFeatures { values: vec![one; rows * WIDTH], dim: WIDTH };
    batch.lang_feat = Some(feat);
    batch.valid_feat = Some((0..rows).map(|row| row % 3 == 0).collect());
    assert_eq!(step(&module, &batch).counted_rows, rows.div_ceil(3));
}

/// A task of one's own around any backbone.
struct Own {
    params: ParamStore,
    model: Box<dyn Backbone>,
}
impl HasBackbone for Own {
    fn backbone(&self) -> &dyn Backbone {
        self.model.as_ref()
    }
}
impl TrainingModule for Own {
    type Batch = TrainBatch;
    fn params(&self) -> &ParamStore {
        &self.params
    }
    fn training_step(&self, batch: &TrainBatch, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let loss = self.model.forward(&point_cloud(batch)?, &mut cx.forward)?.sqr()?.mean_all()?;
        let rows = batch.len();
        Ok(StepOutput { loss, rows, counted_rows: rows, terms: Vec::new(), features: None })
    }
}

/// Rows and those that are right.
#[derive(Debug, Clone, Default)]
struct Right([usize; 2]);
impl Metric for Right {
    type Update<'a> = (&'a [i32], &'a [i32]);
    fn update(
        &mut self,
        (predicted, truth): Self::Update<'_>,
    ) -> std::result::Result<(), MetricError> {
        let known = predicted.iter().zip(truth).filter(|(_, t)| **t >= 0);
        let [all, right] = &mut self.0;
        known.for_each(|(p, t)| {
            *all += 1;
            *right += usize::from(p == t);
        });
        Ok(())
    }
    fn merge(&mut self, other: &Self) -> std::result::Result<(), MetricError> {
        (0..2).for_each(|i| self.0[i] += other.0[i]);
        Ok(())
    }
    fn names(&self) -> Vec<String> {
        vec!["right".to_owned()]
    }
    fn measure(&self) -> Vec<Measurement> {
        vec![Measurement::new("right", self.0[1] as f64 / self.0[0] as f64)]
    }
}

#[test]
fn a_task_and_a_metric_of_ones_own_are_evaluated_in_evaluation_mode() {
    let params = ParamStore::trainable(1);
    let model = PerVoxel::new(&params, CLASSES.len());
    let modes = model.2.clone();
    let module = Own { params, model: Box::new(model) };
    let input = InputFeatures::default();
    let mut segmentation = SegmentationEvaluator::new("own", rooms(2), input.clone(), Vec::new())
        .with_metric(Right::default());
    let names = Evaluator::<Own>::measurements(&segmentation);
    assert!(names.contains(&"right".to_owned()) && names.contains(&"allAcc".to_owned()));
    let first = segmentation.run(&module, Progress::default()).unwrap();
    let value = |name: &str| first.iter().find(|m| m.name == name).unwrap().value;
    assert!((value("right") - value("allAcc")).abs() < 1e-12);
    // Another run begins anew.
    assert_eq!(first, segmentation.run(&module, Progress::default()).unwrap());
    assert_eq!(*modes.lock().unwrap(), [Mode::Eval; 4]);
    let params = ParamStore::trainable(1);
    let model = PerVoxel::new(&params, WIDTH);
    let module = Own { params, model: Box::new(model) };
    let mut zero_shot = ZeroShotEvaluator::new("own", rooms(1), input, texts(WIDTH), Vec::new())
        .with_metric(Right::default());
    let found = zero_shot.run(&module, Progress::default()).unwrap();
    assert!(found.iter().any(|m| m.name == "right"));
}

/// A scene of Gaussians on a line, of the classes given, and one point before them, of class 1.
struct OnALine(Vec<usize>);
impl Dataset for OnALine {
    fn len(&self) -> usize {
        1
    }
    fn id(&self, _: usize) -> &str {
        "line"
    }
    fn get(&self, _: u64, _: usize) -> std::result::Result<Sample, DataError> {
        let n = self.0.len();
        let color = |class: &usize| std::array::from_fn(|c| if c == *class { 255.0 } else { 0.0 });
        Ok(Sample {
            id: "line".to_owned(),
            coord: (0..n).map(|i| [i as f32, 0.0, 0.0]).collect(),
            color: self.0.iter().map(color).collect(),
            opacity: vec![1.0; n],
            scale: vec![[0.1; 3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            grid_coord: (0..n as i32).map(|i| [i, 0, 0]).collect(),
            grid_size: 1.0,
            labelled_points: Some(LabelledPoints {
                coord: vec![[-1.0, 0.0, 0.0]],
                segment: Some(vec![1]),
                instance: None,
            }),
            ..Sample::default()
        })
    }
}

/// Gives its input.
struct Echo;
impl Backbone for Echo {
    fn forward(&self, points: &PointCloud, _: &mut Forward<'_>) -> Result<Tensor> {
        Ok(points.feat.clone())
    }
    fn out_channels(&self) -> usize {
        3
    }
}

#[test]
fn as_many_neighbours_vote_as_it_says() {
    // Nearest first. Votes of one: 0; of two: a tie, which the smaller class wins; of three: 1; of four: a
    // tie again.
    let data: Arc<dyn Dataset> = Arc::new(OnALine(vec![0, 1, 1, 0]));
    let channels = vec![InputChannel::Color];
    let input = InputFeatures { channels, scale_clip: None, ..InputFeatures::default() };
    let module = Own { params: ParamStore::trainable(1), model: Box::new(Echo) };
    let axes = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let names = ["a", "b", "c"].map(str::to_owned).to_vec();
    let texts = TextTable::from_rows(names, axes.to_vec(), 3).unwrap();
    for (k, right) in [(1, 0.0), (2, 0.0), (3, 1.0), (4, 0.0), (9, 0.0)] {
        let accuracy = |evaluator: &mut dyn Evaluator<Own>| {
            let found = evaluator.run(&module, Progress::default()).unwrap();
            found.iter().find(|m| m.name == "allAcc").unwrap().value
        };
        let by_text =
            ZeroShotEvaluator::new("t", data.clone(), input.clone(), texts.clone(), Vec::new());
        assert_eq!(accuracy(&mut by_text.with_vote(k)), right, "texts, {k} voters");
        let by_logit = SegmentationEvaluator::new("s", data.clone(), input.clone(), Vec::new());
        assert_eq!(accuracy(&mut by_logit.with_vote(k)), right, "logits, {k} voters");
    }
}

#[test]
fn evaluation_moves_no_statistic_and_freezing_holds_them() {
    let classes = CLASSES.len();
    let module = || {
        let params = ParamStore::trainable(1);
        let network = ModelConfig::tiny().with_classes(classes).build(params.builder()).unwrap();
        let objective = Objective::new().with(1.0, CrossEntropy::default());
        TaskModule::new(params, network, objective, SemanticSegmentation)
    };
    let buffers = |module: &TaskModule| -> Vec<(String, Vec<f32>)> {
        let names = module.params().buffers();
        let all = state(module.params()).into_iter();
        all.filter(|(name, _)| names.contains_key(name)).collect()
    };
    let evaluated = module();
    let before = buffers(&evaluated);
    SegmentationEvaluator::new("a", rooms(1), InputFeatures::default(), Vec::new())
        .run(&evaluated, Progress::default())
        .unwrap();
    assert_eq!(before, buffers(&evaluated));
    let train = |freeze: &[&str]| {
        let module = module();
        let freeze = freeze.iter().map(|part| (*part).to_owned()).collect();
        let config = TrainerConfig { freeze, ..TrainerConfig::default() };
        let trainer = trainer_by(&module, config, 0.003, 0.05, OneCycle::default());
        fit(trainer, &module, loader(rooms(2), 1, 0)).unwrap();
        buffers(&module)
    };
    let moved = |after: &[(String, Vec<f32>)]| -> Vec<String> {
        let pairs = before.iter().zip(after).filter(|(b, a)| b != a);
        pairs.map(|((name, _), _)| name.clone()).collect()
    };
    let all = moved(&train(&[]));
    assert_eq!(all.len(), before.len(), "each batch norm's statistics move");
    let some = moved(&train(&["embedding"]));
    assert!(!some.is_empty() && some.len() < all.len());
    assert!(some.iter().all(|name| !name.contains("embedding")), "{some:?}");
}
