//! Distillation by hand: the loss from the teacher's rows, the weights of its terms, who counts, and the
//! numbers of an evaluation of two networks.

use crate::support::{PerVoxel, in_step};
use candle_core::{Device, Result, Tensor};
use half::f16;
use scenesplat_datasets::{
    DataError, Dataset, FullScene, InputFeatures, Sample, TeacherRows, TrainBatch,
};
use scenesplat_losses::{CosineLoss, L2Loss, Objective, Reduction, SmoothL1Loss};
use scenesplat_metrics::Measurement;
use scenesplat_models::{Backbone, Forward, ParamStore, PointCloud};
use scenesplat_scene::{LanguageFeatures, TextTable};
use scenesplat_trainers::evaluators::{DistillationEvaluator, ZeroShotEvaluator};
use scenesplat_trainers::tasks::{Distillation, TaskModule};
use scenesplat_trainers::{Evaluator, Progress, StepOutput, TrainingModule};
use std::sync::Arc;

fn features(rows: &[[f32; 2]]) -> LanguageFeatures {
    LanguageFeatures { values: rows.iter().flatten().map(|v| f16::from_f32(*v)).collect(), dim: 2 }
}

/// Five rows; the teacher's are of any length, one is zero, one is masked out.
fn batch() -> TrainBatch {
    TrainBatch {
        ids: vec!["a".to_owned()],
        coord: (0..5).map(|i| [i as f32, 0.0, 0.0]).collect(),
        grid_coord: (0..5).map(|i| [i, 0, 0]).collect(),
        feat: (0..55).map(|i| (i as f32 * 0.37).sin()).collect(),
        channels: 11,
        offsets: vec![0, 5],
        lang_feat: Some(features(&[[3.0, 4.0], [0.0, -2.0], [0.0, 0.0], [1.0, 1.0], [-0.5, 0.0]])),
        valid_feat: Some(vec![true, true, true, false, true]),
        ..TrainBatch::default()
    }
}

/// Those rows at unit length, and whether they count; by hand.
const TAUGHT: [Option<[f64; 2]>; 5] =
    [Some([0.6, 0.8]), Some([0.0, -1.0]), None, None, Some([-1.0, 0.0])];

fn step(module: &TaskModule, batch: &TrainBatch) -> Result<StepOutput> {
    in_step(|cx| module.training_step(batch, cx))
}

fn student(weights: [f64; 3]) -> TaskModule {
    let params = ParamStore::trainable(1);
    let model = PerVoxel::new(&params, 2);
    let smooth = SmoothL1Loss { beta: 0.3, reduction: Reduction::Mean };
    let objective = Objective::new()
        .with(weights[0], CosineLoss::default())
        .with(weights[1], L2Loss::default())
        .with(weights[2], smooth);
    TaskModule::new(params, model, objective, Distillation)
}

/// Cosine, L2 and smooth L1 of the student's rows with the teacher's, in f64.
fn by_hand(module: &TaskModule, batch: &TrainBatch) -> [f64; 3] {
    let params = module.params().parameters();
    let weight: Vec<Vec<f32>> = params["weight"].to_vec2().unwrap();
    let bias: Vec<f32> = params["bias"].to_vec1().unwrap();
    let mut sums = [0.0; 3];
    for (row, t) in TAUGHT.iter().enumerate() {
        let Some(t) = t else { continue };
        let p: [f64; 2] = std::array::from_fn(|c| {
            let x = &batch.feat[row * 11..][..11];
            let dot = |(w, x): (&f32, &f32)| f64::from(*w) * f64::from(*x);
            f64::from(bias[c]) + weight[c].iter().zip(x).map(dot).sum::<f64>()
        });
        let norm = (p[0] * p[0] + p[1] * p[1]).sqrt();
        sums[0] += 1.0 - (p[0] * t[0] + p[1] * t[1]) / norm;
        for c in 0..2 {
            let d = (p[c] - t[c]).abs();
            sums[1] += d * d;
            sums[2] += if d < 0.3 { d * d / 0.6 } else { d - 0.15 };
        }
    }
    sums.map(|sum| sum / 3.0)
}

#[test]
fn the_loss_is_that_of_the_teachers_rows_at_unit_length() {
    let batch = batch();
    for weights in [[1.0, 1.0, 1.0], [1.0, 0.5, 0.25], [0.3, 2.0, 0.0]] {
        let module = student(weights);
        let out = step(&module, &batch).unwrap();
        let terms = by_hand(&module, &batch);
        let want: f64 = weights.iter().zip(terms).map(|(w, t)| w * t).sum();
        let got = f64::from(out.loss.to_scalar::<f32>().unwrap());
        assert!((got - want).abs() < 1e-5, "{weights:?}: {got}, by hand {want}");
        for ((name, got), want) in out.terms.iter().zip(terms) {
            assert!((got - want).abs() < 1e-5, "{name}: {got}, by hand {want}");
        }
        assert_eq!(
            (out.rows, out.counted_rows),
            (5, 3),
            "a zero row and a masked one do not count"
        );
        let grads = out.loss.backward().unwrap();
        assert!(grads.get(&module.params().parameters()["weight"]).is_some());
    }
}

#[test]
fn what_a_teacher_cannot_say_is_an_error() {
    let told = |batch: &TrainBatch| step(&student([1.0; 3]), batch).err().unwrap().to_string();
    let none = TrainBatch { lang_feat: None, ..batch() };
    assert!(told(&none).contains("without rows of a teacher"), "{}", told(&none));
    let values = vec![f16::ONE; 15];
    let wide = TrainBatch { lang_feat: Some(LanguageFeatures { values, dim: 3 }), ..batch() };
    assert!(told(&wide).contains("3 wide") && told(&wide).contains("model.projection"));
    for bad in [f16::NAN, f16::INFINITY] {
        let mut broken = batch();
        broken.lang_feat.as_mut().unwrap().values[3] = bad;
        assert!(told(&broken).contains("target[1, "), "{}", told(&broken));
        // Where the row does not count, nobody asks.
        broken.valid_feat.as_mut().unwrap()[1] = false;
        assert_eq!(step(&student([1.0; 3]), &broken).unwrap().counted_rows, 2);
    }
    let mut nothing = batch();
    nothing.valid_feat = Some(vec![false; 5]);
    let out = step(&student([1.0; 3]), &nothing).unwrap();
    assert_eq!((out.counted_rows, out.terms.len()), (0, 0));
}

/// One scene of three voxels and five Gaussians, as if a teacher with four voxels had looked.
struct OneScene(Sample);

impl Dataset for OneScene {
    fn len(&self) -> usize {
        1
    }
    fn get(&self, _: u64, _: usize) -> std::result::Result<Sample, DataError> {
        Ok(self.0.clone())
    }
    fn id(&self, _: usize) -> &str {
        "scene"
    }
}

/// Answers with given rows, whatever it is asked.
struct Says(Vec<[f32; 2]>);

impl Backbone for Says {
    fn forward(&self, points: &PointCloud, _: &mut Forward<'_>) -> Result<Tensor> {
        assert_eq!(points.grid_coord.len(), self.0.len());
        Tensor::from_slice(self.0.as_flattened(), (self.0.len(), 2), &Device::Cpu)
    }
    fn out_channels(&self) -> usize {
        2
    }
}

fn scene(teacher: Option<TeacherRows>) -> Sample {
    let at = |x: &[f32]| x.iter().map(|&x| [x, 0.0, 0.0]).collect::<Vec<_>>();
    let full = FullScene {
        coord: at(&[0.1, 0.4, 1.2, 1.8, 2.5]),
        voxel: vec![0, 0, 1, 1, 2],
        segment: Some(vec![0, 0, 0, 1, 1]),
        teacher,
        ..FullScene::default()
    };
    Sample {
        id: "scene".to_owned(),
        coord: at(&[0.1, 1.2, 2.5]),
        color: vec![[100.0; 3]; 3],
        opacity: vec![0.5; 3],
        scale: vec![[0.1; 3]; 3],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 3],
        grid_coord: vec![[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        grid_size: 1.0,
        full: Some(full),
        ..Sample::default()
    }
}

fn measured(teacher: Option<TeacherRows>) -> std::result::Result<Vec<Measurement>, String> {
    let names = ["a", "b"].map(str::to_owned).to_vec();
    let texts = TextTable::from_rows(names, vec![1.0, 0.0, 0.0, 1.0], 2).unwrap();
    let data = Arc::new(OneScene(scene(teacher)));
    let own = ZeroShotEvaluator::new("unseen", data, InputFeatures::default(), texts, Vec::new());
    let mut evaluator = DistillationEvaluator::new(own.with_vote(1));
    let params = ParamStore::trainable(1);
    // Classes 0, 0, 1; lengths do not matter.
    let model = Says(vec![[2.0, 0.0], [0.6, 0.1], [0.0, 1.0]]);
    let module = TaskModule::new(params, model, Objective::new(), Distillation);
    let found = evaluator.run(&module, Progress::default()).map_err(|e| e.to_string())?;
    let listed = Evaluator::<TaskModule>::measurements(&evaluator);
    assert!(found.iter().all(|m| listed.contains(&m.name)), "{found:?}");
    Ok(found)
}

#[test]
fn student_teacher_truth_and_agreement_are_measured() {
    // The teacher has a voxel for each Gaussian but the last, for which it has nothing.
    let rows = features(&[[1.0, 0.0], [0.0, 3.0], [1.0, 0.0], [0.0, 1.0]]);
    let row_of = vec![0, 1, 2, 3, TeacherRows::NONE];
    let found = measured(Some(TeacherRows { rows, row_of })).unwrap();
    let value = |name: &str| found.iter().find(|m| m.name == name).unwrap().value;
    let close = |name: &str, want: f64| {
        assert!((value(name) - want).abs() < 1e-6, "{name}: {}, by hand {want}", value(name));
    };
    // Student: 0 0 0 0 1 against 0 0 0 1 1. IoU of 0: 3/4, of 1: 1/2.
    close("allAcc", 0.8);
    close("mIoU", 0.625);
    // Teacher: 0 1 0 1 and nothing. IoU of 0: 2/3, of 1: 1/3.
    close("teacher/allAcc", 0.6);
    close("teacher/mIoU", 0.5);
    close("teacher/f-mIoU", 0.5);
    close("oracle/mIoU", 1.0);
    // Cosines over four Gaussians: 1, 0, then of [0.6, 0.1] with both axes.
    let norm = (0.37f64).sqrt();
    close("agreement/cosine", (1.0 + 0.0 + 0.6 / norm + 0.1 / norm) / 4.0);
    close("agreement/top1", 0.5);
}

#[test]
fn scenes_without_a_teachers_rows_are_refused_by_name() {
    let error = measured(None).unwrap_err();
    assert!(error.contains("scene scene comes without rows of a teacher"), "{error}");
    let rows = LanguageFeatures { values: vec![f16::ONE; 3], dim: 3 };
    let error = measured(Some(TeacherRows { rows, row_of: vec![0; 5] })).unwrap_err();
    assert!(error.contains("expected 2, got 3"), "{error}");
}
