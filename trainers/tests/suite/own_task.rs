//! A third task is one `impl`: a network learns the rows of another, which follows it or not.

use candle_core::{Result, Var};
use scenesplat_datasets::transforms::validation;
use scenesplat_datasets::{
    InputFeatures, LoaderSettings, SceneDataset, SceneLoader, SyntheticRooms, TrainBatch,
    build_transforms,
};
use scenesplat_losses::{L2Loss, Objective};
use scenesplat_models::{Backbone, Forward, ModelConfig, ParamStore};
use scenesplat_rooms::SyntheticRoomSettings;
use scenesplat_trainers::callbacks::{JsonLines, read_json_lines};
use scenesplat_trainers::tasks::{Learner, RowTargets, TaskModule, TrainingTask, point_cloud};
use scenesplat_trainers::{
    AdamW, AdamWConfig, AfterStep, OneCycle, Progress, StepContext, StepOutput, TrainError,
    Trainer, TrainerConfig, TrainingModule, group_by_keyword,
};
use std::sync::Arc;

struct Distillation {
    teacher: Box<dyn Backbone>,
    params: ParamStore,
    follows: bool,
}

impl TrainingTask for Distillation {
    fn step(
        &self,
        learner: &Learner,
        batch: &TrainBatch,
        cx: &mut StepContext<'_>,
    ) -> Result<StepOutput> {
        let teach = &mut Forward::eval(cx.forward.rng);
        let target = self.teacher.forward(&point_cloud(batch)?, teach)?.detach();
        let pred = learner.forward(batch, cx)?;
        learner.output(&pred, RowTargets { target: Some(&target), ..RowTargets::default() }, cx)
    }

    fn after_step(&self, _: &Learner, cx: &AfterStep<'_>) -> std::result::Result<(), TrainError> {
        for (name, var) in self.params.parameters().iter().filter(|_| self.follows) {
            let student = cx.trained[name].as_tensor();
            var.set(student).map_err(|source| TrainError::Forward { source })?;
        }
        Ok(())
    }

    fn stores(&self) -> Vec<(&'static str, &ParamStore)> {
        vec![("teacher", &self.params)]
    }
}

/// Trains a student of seed 1 by a teacher of seed 2: the losses, and both networks' parameters.
fn run(dir: &std::path::Path, follows: bool) -> (Vec<f64>, [Vec<f32>; 2]) {
    let settings = SyntheticRoomSettings { num_gaussians: Some(600), ..Default::default() };
    let steps = build_transforms(&validation(0.3)).unwrap();
    let source = Arc::new(SyntheticRooms::new(1, settings, 3).unwrap());
    let data = Arc::new(SceneDataset::new(source, steps, 1, 1).unwrap());
    let loading = LoaderSettings { batch_size: 1, mix_probability: 0.0, ..Default::default() };
    let mut loader = SceneLoader::new(data, InputFeatures::default(), loading).unwrap();

    let [student, teacher] = [1, 2].map(ParamStore::trainable);
    let network = ModelConfig::tiny().build(student.builder()).unwrap();
    let model = Box::new(ModelConfig::tiny().build(teacher.builder()).unwrap());
    let all = |vars: &std::collections::BTreeMap<String, Var>| -> Vec<f32> {
        vars.values().flat_map(|v| v.flatten_all().unwrap().to_vec1().unwrap()).collect()
    };
    let vars = [student.parameters(), teacher.parameters()];
    let groups = group_by_keyword(&vars[0], 0.005, 0.0, &[]);
    let task = Distillation { teacher: model, params: teacher, follows };
    let objective = Objective::new().with(1.0, L2Loss::default());
    let module = TaskModule::new(student, network, objective, task);
    assert_eq!(module.stores().len(), 1);
    let log = dir.join("metrics.jsonl");
    let config = TrainerConfig { epochs: 12, log_every: 1, ..Default::default() };
    let optimizer = Box::new(AdamW::new(groups, AdamWConfig::default()).unwrap());
    Trainer::new(config, optimizer, Box::new(OneCycle::default()))
        .unwrap()
        .with_callback(JsonLines::new(&log))
        .fit(&module, &mut loader, &mut [], Progress::default())
        .unwrap();
    let log = read_json_lines(&log).unwrap();
    let losses = log.iter().filter(|v| v.name == "train/loss").map(|v| v.value).collect();
    (losses, [all(&vars[0]), all(&vars[1])])
}

#[test]
fn a_student_learns_from_its_teacher() {
    let dir = tempfile::tempdir().unwrap();
    let (losses, [student, teacher]) = run(dir.path(), false);
    assert!(losses[11] < 0.8 * losses[0], "{losses:?}");
    assert_ne!(student, teacher);
    let (_, [student, teacher]) = run(dir.path(), true);
    assert_eq!(student, teacher, "one that follows is moved after each step");
}
