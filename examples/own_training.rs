//! A training with own data, an own loss and an own callback: `cargo run --release --example own_training`

use scenesplat::datasets::transforms::semantic_segmentation;
use scenesplat::datasets::{DataError, DataSource, SceneDataset, SceneLoader, SourceScene};
use scenesplat::prelude::*;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::trainers::tasks::{SemanticSegmentation, TaskModule};
use scenesplat::trainers::{AdamW, OneCycle, group_by_keyword};
use scenesplat::{losses::CrossEntropy, scene::RepairReport};

/// Own data: rooms in which a Gaussian is low (class 0) or high (1). A folder of files would be read here.
struct Heights(Vec<String>);
impl DataSource for Heights {
    fn scene_ids(&self) -> &[String] {
        &self.0
    }
    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        let number = self.0.iter().position(|known| known == id).unwrap_or_default();
        let mut scene = generate(&SyntheticRoomSettings::with_count(2000, number as u64))?.scene;
        scene.segment = Some(scene.coord.iter().map(|at| i32::from(at[2] > 1.0)).collect());
        Ok(SourceScene { scene, report: RepairReport::default() })
    }
}
/// Own loss: large logits cost, so that the network stays unsure. A term beside the cross entropy.
struct LogitSize;
impl Loss for LogitSize {
    fn name(&self) -> &str {
        "logit_size"
    }
    fn forward(&self, input: &LossInput<'_>) -> candle_core::Result<Option<candle_core::Tensor>> {
        Ok(Some(input.pred.sqr()?.mean_all()?)) // `None` where a term is off: the log then says so.
    }
}
/// Own callback: prints the loss, and stops when it is small.
struct StopBelow(f64);
impl Callback for StopBelow {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let Event::Step { measurements } = event else { return Ok(Flow::Continue) };
        println!("step {}: loss {:.3}", at.step, measurements[0].value);
        Ok(if measurements[0].value < self.0 { Flow::Stop } else { Flow::Continue })
    }
}
fn main() -> anyhow::Result<()> {
    let rooms = Heights((0..6).map(|i| format!("room-{i}")).collect());
    let steps = datasets::build_transforms(&semantic_segmentation(0.05))?;
    let scenes = SceneDataset::new(std::sync::Arc::new(rooms), steps, 0, 1)?;
    let loader =
        SceneLoader::new(std::sync::Arc::new(scenes), Default::default(), Default::default())?;
    let params = ParamStore::trainable(0);
    let network = ModelConfig::tiny().with_classes(2).build(params.builder())?;
    let groups = group_by_keyword(&params.parameters(), 0.003, 0.02, &[]);
    let optimizer = Box::new(AdamW::new(groups, Default::default())?);
    let objective = Objective::new().with(1.0, CrossEntropy::default()).with(0.01, LogitSize);
    let module = TaskModule::new(params, network, objective, SemanticSegmentation);
    let config = TrainerConfig { epochs: 20, log_every: 1, ..Default::default() };
    let trainer = Trainer::new(config, optimizer, Box::new(OneCycle::default()))?;
    let mut trainer = trainer.with_callback(StopBelow(0.3));
    println!("{:?}", trainer.fit(&module, &mut DataModule::new(loader), Progress::default())?);
    Ok(())
}
