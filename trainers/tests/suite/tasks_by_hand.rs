//! What tasks hand to their losses, who counts, and what their errors and evaluators say, by hand.

use crate::support::in_step;
use candle_core::{Result, Tensor};
use half::f16;
use scenesplat_datasets::{
    DataError, Dataset, FullScene, InputChannel, InputFeatures, LeftOut, Sample, TrainBatch,
};
use scenesplat_losses::{Loss, LossInput, Objective};
use scenesplat_metrics::Measurement;
use scenesplat_models::{Backbone, Forward, ParamStore, PointCloud};
use scenesplat_scene::{LabelledPoints, LanguageFeatures, TextTable};
use scenesplat_trainers::evaluators::{SegmentationEvaluator, VOTE_K, ZeroShotEvaluator};
use scenesplat_trainers::tasks::{
    LanguagePretraining, Learner, RowTargets, SemanticSegmentation, TargetSource, TaskModule,
    TrainingTask, bad_values, point_cloud,
};
use scenesplat_trainers::{Evaluator, Progress, StepContext, StepOutput, TrainingModule};
use std::sync::Arc;

/// Three rows of two scenes, two channels.
fn batch() -> TrainBatch {
    TrainBatch {
        ids: vec!["a".to_owned(), "b".to_owned()],
        coord: vec![[0.0; 3]; 3],
        grid_coord: vec![[0, 1, 2], [3, 4, 5], [6, 7, 8]],
        feat: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        channels: 2,
        offsets: vec![0, 1, 3],
        ..TrainBatch::default()
    }
}

#[test]
fn batches_become_points_and_their_bad_values_are_named() {
    let mut batch = batch();
    let points = point_cloud(&batch).unwrap();
    assert_eq!(points.feat.to_vec2::<f32>().unwrap(), [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]);
    assert_eq!(points.grid_coord.len(), 3);
    assert!(point_cloud(&TrainBatch { feat: vec![0.0; 5], ..batch.clone() }).is_err());
    let mut values = vec![f16::ONE; 9];
    (values[2], values[7]) = (f16::INFINITY, f16::NAN);
    batch.lang_feat = Some(LanguageFeatures { values, dim: 3 });
    (batch.feat[1], batch.feat[4], batch.feat[5]) = (f32::NEG_INFINITY, f32::NAN, f32::NAN);
    // The first of each array and scene, by the row of the scene: row 2 of the batch is row 1 of b.
    let named = [
        "a: feat 1 of row 0 is -inf",
        "a: lang_feat 2 of row 0 is inf",
        "b: feat 0 of row 1 is NaN",
        "b: lang_feat 1 of row 1 is NaN",
    ];
    assert_eq!(bad_values(&batch), named);
}

#[test]
fn targets_are_the_features_or_the_texts_of_the_classes() {
    let table =
        TextTable::from_rows(vec!["x".into(), "y".into()], vec![3.0, 4.0, 0.0, -2.0], 2).unwrap();
    let source = TargetSource::class_text(&table).unwrap();
    let labelled = |labels: Vec<i32>| TrainBatch { segment: Some(labels), ..batch() };
    let (rows, valid) = source.of(&labelled(vec![1, -1, 0])).unwrap();
    let rows = rows.to_vec2::<f32>().unwrap();
    assert_eq!((rows[0].as_slice(), rows[2].as_slice()), (&[0.0, -1.0][..], &[0.6, 0.8][..]));
    assert_eq!(valid, [true, false, true]);
    let told =
        |batch: &TrainBatch, source: &TargetSource| source.of(batch).unwrap_err().to_string();
    assert!(told(&labelled(vec![0, 2, 0]), &source).contains("segment of row 1: class 2 of 2"));
    assert!(told(&batch(), &source).contains("none of the scenes a, b has labels"));
    let error = told(&batch(), &TargetSource::Features);
    assert!(error.contains("lang_feat: none of the scenes a, b"), "{error}");
    // Features as they are, whatever their length; without a mask all are there.
    let values: Vec<f16> = [1.0, 2.0, 0.0, 0.0, -0.5, 3.0].map(f16::from_f32).to_vec();
    let mut with = TrainBatch { lang_feat: Some(LanguageFeatures { values, dim: 2 }), ..batch() };
    let (rows, valid) = TargetSource::Features.of(&with).unwrap();
    assert_eq!(rows.to_vec2::<f32>().unwrap(), [[1.0, 2.0], [0.0, 0.0], [-0.5, 3.0]]);
    assert_eq!(valid, [true; 3]);
    with.valid_feat = Some(vec![false, true, false]);
    assert_eq!(TargetSource::Features.of(&with).unwrap().1, [false, true, false]);
    let long = TextTable { values: vec![3.0, 4.0, 0.0, 1.0], ..table };
    assert!(TargetSource::class_text(&long).is_err());
}

/// The mean of all predictions, under this name; on only where asked.
#[derive(Clone)]
struct Mean(bool);
impl Loss for Mean {
    fn name(&self) -> &str {
        "mean"
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        assert_eq!((input.progress, input.seed), (0.5, 9));
        Ok(if self.0 { Some(input.pred.mean_all()?) } else { None })
    }
}

/// Hands on what it holds.
struct Hands {
    target: bool,
    valid: Option<Vec<bool>>,
    label: Option<Vec<i32>>,
}
impl TrainingTask for Hands {
    fn step(
        &self,
        learner: &Learner,
        batch: &TrainBatch,
        cx: &mut StepContext<'_>,
    ) -> Result<StepOutput> {
        let pred = learner.forward(batch, cx)?;
        let target = self.target.then(|| pred.detach());
        let targets = RowTargets {
            target: target.as_ref(),
            valid: self.valid.as_deref(),
            label: self.label.as_deref(),
        };
        learner.output(&pred, targets, cx)
    }
}

/// Gives its input.
struct Echo(usize);
impl Backbone for Echo {
    fn forward(&self, points: &PointCloud, _: &mut Forward<'_>) -> Result<Tensor> {
        Ok(points.feat.clone())
    }
    fn out_channels(&self) -> usize {
        self.0
    }
}

#[test]
fn rows_count_by_their_targets_or_else_by_their_labels() {
    let run = |on, target, valid: Option<&[bool]>, label: Option<&[i32]>| {
        let task =
            Hands { target, valid: valid.map(<[_]>::to_vec), label: label.map(<[_]>::to_vec) };
        let objective = Objective::new().with(2.0, Mean(on));
        let module = TaskModule::new(ParamStore::trainable(1), Echo(2), objective, task);
        let out = in_step(|cx| {
            cx.progress = 0.5;
            module.training_step(&batch(), cx).unwrap()
        });
        assert_eq!(out.rows, 3);
        assert_eq!(out.features.unwrap().to_vec2::<f32>().unwrap()[2], [5.0, 6.0]);
        if on {
            // Twice the mean of 1 to 6.
            assert_eq!(
                (out.loss.to_scalar::<f32>().unwrap(), &out.terms[0]),
                (7.0, &("mean".into(), 3.5))
            );
        }
        out.counted_rows
    };
    let (some, none) = (Some(&[true, false, true][..]), Some(&[false; 3][..]));
    let labels = Some(&[-1, 0, -1][..]);
    assert_eq!(run(true, true, None, labels), 3);
    assert_eq!(run(true, true, some, labels), 2);
    assert_eq!(run(true, true, none, labels), 1);
    assert_eq!(run(true, true, none, None), 0);
    assert_eq!(run(true, false, some, labels), 1);
    assert_eq!(run(false, true, some, labels), 0, "no term is on");

    let objective = || Objective::new().with(1.0, Mean(true));
    let tell = |module: TaskModule| {
        in_step(|cx| module.training_step(&batch(), cx).err().unwrap().to_string())
    };
    let params = ParamStore::trainable(1);
    let error = tell(TaskModule::new(params.clone(), Echo(2), objective(), SemanticSegmentation));
    assert!(error.contains("segment: none of the scenes a, b has labels"), "{error}");
    let task = LanguagePretraining { targets: TargetSource::Features };
    let module = TaskModule::new(params, Echo(2), objective(), task);
    assert_eq!(
        (module.scenes(&batch()), module.is_empty(&batch())),
        (vec!["a".into(), "b".into()], false)
    );
    assert!(module.is_empty(&TrainBatch::default()) && module.suspects(&batch()).is_empty());
    assert!(tell(module).contains("lang_feat"));
}

/// Samples as they are given.
#[derive(Clone)]
struct Given(Vec<Sample>);
impl Dataset for Given {
    fn len(&self) -> usize {
        self.0.len()
    }
    fn get(&self, epoch: u64, index: usize) -> std::result::Result<Sample, DataError> {
        assert_eq!(epoch, 0, "each evaluation sees the same rows");
        Ok(self.0[index].clone())
    }
    fn id(&self, index: usize) -> &str {
        &self.0[index].id
    }
    fn left_out(&self) -> LeftOut {
        LeftOut::default()
    }
}

/// Voxels of these colors on a line, of these classes.
fn sample(id: &str, colors: &[[f32; 3]], labels: Option<Vec<i32>>) -> Sample {
    let n = colors.len();
    Sample {
        id: id.to_owned(),
        coord: (0..n).map(|i| [i as f32, 0.0, 0.0]).collect(),
        color: colors.to_vec(),
        opacity: vec![1.0; n],
        scale: vec![[0.1; 3]; n],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
        grid_coord: (0..n as i32).map(|i| [i, 0, 0]).collect(),
        grid_size: 1.0,
        segment: labels,
        ..Sample::default()
    }
}

const A: [f32; 3] = [255.0, 0.0, 0.0];
const B: [f32; 3] = [0.0, 255.0, 0.0];
const C: [f32; 3] = [0.0, 0.0, 255.0];

fn input() -> InputFeatures {
    InputFeatures {
        channels: vec![InputChannel::Color],
        scale_clip: None,
        ..InputFeatures::default()
    }
}

fn module() -> TaskModule {
    TaskModule::new(ParamStore::trainable(1), Echo(3), Objective::new(), SemanticSegmentation)
}

fn measured(
    evaluator: &mut dyn Evaluator<TaskModule>,
) -> std::result::Result<Vec<Measurement>, String> {
    evaluator.run(&module(), Progress::default()).map_err(|e| e.to_string())
}

#[track_caller]
fn has(found: &[Measurement], want: &[(&str, f64)]) {
    for (name, want) in want {
        let got = found
            .iter()
            .find(|m| m.name == *name)
            .unwrap_or_else(|| panic!("{name}: {found:?}"))
            .value;
        assert!((got - want).abs() < 1e-6, "{name}: {got}, by hand {want}");
    }
}

#[test]
fn logits_score_every_gaussian_and_leave_classes_out_of_some_averages() {
    assert_eq!(VOTE_K, 25);
    // Of the first of equal logits: [255, 255, 0] is an A. No rows: passed over.
    let both = sample("one", &[A, B, [255.0, 255.0, 0.0], C, B], Some(vec![0, 1, 1, 2, -1]));
    let data =
        Given(vec![both, sample("empty", &[], None), sample("two", &[B, C], Some(vec![0, 2]))]);
    let with =
        |excluded| SegmentationEvaluator::new("s", Arc::new(data.clone()), input(), excluded);
    let found = measured(&mut with(vec![0])).unwrap();
    // Found 0 1 0 2 · 1 2 for 0 1 1 2 · 0 2. Hits 1, 1, 2; IoU 1/3, 1/3, 1; accuracies 1/2, 1/2, 1.
    has(
        &found,
        &[
            ("allAcc", 4.0 / 6.0),
            ("mIoU", (1.0 / 3.0 + 1.0 / 3.0 + 1.0) / 3.0),
            ("mAcc", 2.0 / 3.0),
            ("f-mIoU", 2.0 / 3.0),
            ("f-mAcc", 0.75),
            ("oracle/mIoU", 1.0),
        ],
    );
    assert_eq!(Evaluator::<TaskModule>::name(&with(vec![])), "s");
    has(&measured(&mut with(vec![])).unwrap(), &[("f-mIoU", 5.0 / 9.0)]);
    let bare = Given(vec![sample("bare", &[A], None)]);
    let error = measured(&mut SegmentationEvaluator::new("s", Arc::new(bare), input(), vec![]))
        .unwrap_err();
    assert!(error.contains("bare has no labels"), "{error}");
    let nothing = Given(vec![sample("empty", &[], None), sample("e", &[], None)]);
    let error = measured(&mut SegmentationEvaluator::new("s", Arc::new(nothing), input(), vec![]))
        .unwrap_err();
    assert!(error.contains("evaluation s: none of its 2 scenes"), "{error}");
    // Points, where there are some, are scored by 25 voters: here by all, of which most are A.
    let mut pointed = sample("p", &[A, A, B], Some(vec![1, 1, 1]));
    let points =
        LabelledPoints { coord: vec![[2.0, 0.0, 0.0]], segment: Some(vec![0]), instance: None };
    pointed.labelled_points = Some(points);
    let found = measured(&mut SegmentationEvaluator::new(
        "s",
        Arc::new(Given(vec![pointed])),
        input(),
        vec![],
    ))
    .unwrap();
    has(&found, &[("allAcc", 1.0)]);
}

#[test]
fn texts_score_every_gaussian_by_the_vote_of_those_with_a_feature() {
    // The third text is the first again: its rows come out as the first class.
    let names = ["a", "b", "a again"].map(str::to_owned).to_vec();
    let axes = vec![1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 3.0, 0.0, 0.0];
    let texts = TextTable::from_rows(names, axes, 3).unwrap();
    let zero_shot =
        |data: Given| ZeroShotEvaluator::new("z", Arc::new(data), input(), texts.clone(), vec![1]);
    // The input of a color is c / 127.5 − 1: [255, 0, 0] is (1, −1, −1).
    let data = Given(vec![sample("one", &[A, A, B], Some(vec![2, 2, 1]))]);
    let found = measured(&mut zero_shot(data.clone()).with_vote(1)).unwrap();
    // 0 0 1 for 2 2 1, of which no labels of texts could do more: IoU 0, 1, 0, and without b 0.
    has(
        &found,
        &[
            ("allAcc", 1.0 / 3.0),
            ("mIoU", 1.0 / 3.0),
            ("f-mIoU", 0.0),
            ("oracle/allAcc", 1.0 / 3.0),
        ],
    );
    // By 25 voters all are of the class of most; of those with a feature alone, of the last's.
    has(&measured(&mut zero_shot(data.clone())).unwrap(), &[("allAcc", 0.0)]);
    let mut masked = data.clone();
    masked.0[0].valid_feat = Some(vec![false, false, true]);
    has(&measured(&mut zero_shot(masked.clone())).unwrap(), &[("allAcc", 1.0 / 3.0)]);
    masked.0[0].valid_feat = Some(vec![false; 3]);
    has(&measured(&mut zero_shot(masked)).unwrap(), &[("allAcc", 0.0)]);
    // The whole scene is scored, not its sample.
    let mut whole = data;
    whole.0[0].full = Some(FullScene {
        coord: vec![[0.0; 3], [0.1, 0.0, 0.0], [2.0, 0.0, 0.0], [2.1, 0.0, 0.0]],
        voxel: vec![0, 1, 2, 2],
        segment: Some(vec![0, 1, 1, 1]),
        ..FullScene::default()
    });
    let evaluator = zero_shot(whole).with_vote(1);
    has(&measured(&mut zero_shot(evaluator_data()).with_vote(1)).unwrap(), &[("allAcc", 0.5)]);
    let confusion = evaluator.confusion(&Echo(3)).unwrap();
    assert_eq!(confusion.counts(), [1, 0, 0, 1, 2, 0, 0, 0, 0]);
}

/// A sample whose own labels say otherwise than the scene's.
fn evaluator_data() -> Given {
    let mut one = sample("one", &[A, B], Some(vec![1, 0]));
    one.full = Some(FullScene {
        coord: vec![[0.0; 3], [1.0, 0.0, 0.0]],
        voxel: vec![1, 0],
        segment: Some(vec![1, 1]),
        ..FullScene::default()
    });
    Given(vec![one])
}
