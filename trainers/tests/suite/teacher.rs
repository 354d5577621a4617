//! Self-distillation in small: a teacher that follows its student, with schedules of its momentum,
//! its temperature and the weight decay. Interrupted anywhere, it ends with the same bits.

use crate::support::{Rows, config, everything, fit, load, numbers, resume, stop_at, trainer_by};
use candle_core::{Device, Result, Tensor};
use scenesplat_models::ParamStore;
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::{
    AfterStep, CosineSchedule, DataModule, OneCycle, Progress, StepContext, StepOutput, TrainError,
    Trainer, TrainerConfig, TrainingModule, WithWeightDecay, ema_update,
};
use std::path::Path;
use std::sync::Mutex;

const PROTOTYPES: usize = 3;

/// `softmax(x·w)` of the student shall be that of the teacher on the same rows, shifted.
struct Pair {
    student: ParamStore,
    teacher: ParamStore,
    weights: [Tensor; 2],
    /// A statistic of the teacher that is no parameter of the student's.
    centre: Tensor,
    /// Momentum after each step, for the test to compare.
    momenta: Mutex<Vec<f64>>,
}

impl Pair {
    fn new() -> Self {
        let init = candle_nn::Init::Uniform { lo: -1.0, up: 1.0 };
        let build = |store: &ParamStore| {
            store.builder().get_with_hints((4, PROTOTYPES), "head.weight", init).unwrap()
        };
        let (student, teacher) = (ParamStore::trainable(1), ParamStore::trainable(2));
        let weights = [build(&student), build(&teacher)];
        let zero = candle_nn::Init::Const(0.0);
        let centre =
            teacher.builder().get_with_hints(PROTOTYPES, "centre.running_mean", zero).unwrap();
        Self { student, teacher, weights, centre, momenta: Mutex::default() }
    }
}

impl TrainingModule for Pair {
    type Batch = Rows;

    fn params(&self) -> &ParamStore {
        &self.student
    }

    fn training_step(&self, batch: &Rows, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let x = Tensor::from_vec(batch.concat(), (batch.len(), 4), &Device::Cpu)?;
        let temperature = CosineSchedule::teacher_temperature().value(cx.step, cx.total_steps);
        let [student, teacher] = &self.weights;
        let logits = x.matmul(&teacher.detach())?.broadcast_sub(&self.centre.detach())?;
        let target = candle_nn::ops::softmax(&(logits.clone() / temperature)?, 1)?.detach();
        // The teacher's own statistics develop in the step, as those of a batch norm do.
        let moved = ((self.centre.detach() * 0.9)? + (logits.mean(0)? * 0.1)?)?;
        self.teacher.buffers()["centre.running_mean"].set(&moved)?;
        let log = candle_nn::ops::log_softmax(&(x.matmul(student)? / 0.1)?, 1)?;
        let loss = (target * log)?.sum(1)?.mean_all()?.neg()?;
        let rows = batch.len();
        Ok(StepOutput { loss, rows, counted_rows: rows, terms: Vec::new(), features: None })
    }

    fn after_step(&self, cx: &AfterStep<'_>) -> std::result::Result<(), TrainError> {
        let momentum = CosineSchedule::teacher_momentum().value(cx.step, cx.total_steps);
        self.momenta.lock().unwrap().push(momentum);
        ema_update(&self.teacher.parameters(), cx.trained, momentum)
    }

    fn stores(&self) -> Vec<(&'static str, &ParamStore)> {
        vec![("teacher", &self.teacher)]
    }
}

fn trainer(module: &Pair, dir: Option<&Path>, decay: CosineSchedule) -> Trainer {
    let schedule = WithWeightDecay { rate: OneCycle::default(), decay };
    trainer_by(module, TrainerConfig { ema: Some(0.9), ..config(dir) }, 0.05, 0.001, schedule)
}

fn plain(module: &Pair, dir: Option<&Path>) -> Trainer {
    trainer(module, dir, CosineSchedule::weight_decay())
}

#[test]
fn the_teacher_follows_after_each_step_by_its_schedule() {
    let module = Pair::new();
    let at = fit(plain(&module, None), &module, numbers()).unwrap();
    let momenta = module.momenta.lock().unwrap();
    assert_eq!(momenta.len() as u64, at.total_steps);
    for (n, got) in momenta.iter().enumerate() {
        // 1 + ½ (0.9 − 1)(1 + cos(π n/T)), by hand.
        let part = n as f64 / at.total_steps as f64;
        let want = 1.0 - 0.05 * (1.0 + (std::f64::consts::PI * part).cos());
        assert!((got - want).abs() < 1e-12, "{got} {want}");
    }
    assert_ne!(everything(&module), everything(&Pair::new()));
}

#[test]
fn interrupted_anywhere_it_ends_with_the_same_bits() {
    let whole = Pair::new();
    fit(plain(&whole, None), &whole, numbers()).unwrap();
    for stops in [vec![1], vec![7], vec![27], vec![2, 5, 11], vec![13, 14, 15]] {
        let dir = tempfile::tempdir().unwrap();
        let mut start = Progress::default();
        for &stop in &stops {
            // Each time another process: nothing but the files is left.
            let module = Pair::new();
            let mut part = plain(&module, Some(dir.path())).with_callback(stop_at(stop));
            if start.step > 0 {
                start = load(&mut part, dir.path(), &module);
            }
            start = part.fit(&module, &mut DataModule::new(numbers()), start).unwrap();
            assert_eq!(start.step, stop);
        }
        let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
        assert!(newest.join("teacher.safetensors").is_file());
        let module = Pair::new();
        resume(plain(&module, Some(dir.path())), dir.path(), &module, numbers());
        assert_eq!(everything(&whole), everything(&module), "stopped at {stops:?}");
    }
}

#[test]
fn a_checkpoint_without_its_teacher_or_with_other_schedules_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let module = Pair::new();
    let first = plain(&module, Some(dir.path())).with_callback(stop_at(3));
    fit(first, &module, numbers()).unwrap();
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    let mut other = trainer(&module, Some(dir.path()), CosineSchedule::new(0.04, 0.2));
    let error = other.load_checkpoint(&newest, &module).unwrap_err().to_string();
    assert!(error.contains("schedule.weight_decay.to was 0.4 and is 0.2"), "{error}");
    std::fs::remove_file(newest.join("teacher.safetensors")).unwrap();
    let error = plain(&module, None).load_checkpoint(&newest, &module).unwrap_err().to_string();
    assert!(error.contains("teacher.safetensors is missing"), "{error}");
}
