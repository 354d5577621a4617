//! A third task is one `impl`: a network learns the rows of another, which follows it or not.

use crate::support::{dataset, fit, loader, logged, rooms, state, trainer_by};
use candle_core::Result;
use scenesplat_datasets::TrainBatch;
use scenesplat_datasets::transforms::validation;
use scenesplat_losses::{L2Loss, Objective};
use scenesplat_models::{Backbone, Forward, ModelConfig, ParamStore};
use scenesplat_trainers::callbacks::JsonLines;
use scenesplat_trainers::tasks::{Learner, RowTargets, TaskModule, TrainingTask, point_cloud};
use scenesplat_trainers::{
    AfterStep, OneCycle, StepContext, StepOutput, TrainError, TrainerConfig, TrainingModule,
};

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

/// Parameters by name.
type Values = Vec<(String, Vec<f32>)>;

/// Trains a student of seed 1 by a teacher of seed 2: the losses, and both networks' parameters.
fn run(dir: &std::path::Path, follows: bool) -> (Vec<f64>, [Values; 2]) {
    let [student, teacher] = [1, 2].map(ParamStore::trainable);
    let network = ModelConfig::tiny().build(student.builder()).unwrap();
    let model = Box::new(ModelConfig::tiny().build(teacher.builder()).unwrap());
    let task = Distillation { teacher: model, params: teacher, follows };
    let objective = Objective::new().with(1.0, L2Loss::default());
    let module = TaskModule::new(student, network, objective, task);
    let log = dir.join("metrics.jsonl");
    let config = TrainerConfig { epochs: 12, log_every: 1, ..Default::default() };
    let trainer = trainer_by(&module, config, 0.005, 0.0, OneCycle::default())
        .with_callback(JsonLines::new(&log));
    let data = dataset(rooms(1, 600, 3), &validation(0.3), 1);
    fit(trainer, &module, loader(data, 1, 1)).unwrap();
    let parameters = |store: &ParamStore| {
        let names = store.parameters();
        state(store).into_iter().filter(|(name, _)| names.contains_key(name)).collect()
    };
    let stores = [module.params(), module.stores()[0].1];
    let losses = logged(&log, "train/loss").into_iter().map(|(_, loss)| loss).collect();
    (losses, stores.map(parameters))
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
