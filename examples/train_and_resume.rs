//! `Trainer::fit`, a callback of one's own, and a run that is stopped and goes on with the bits of one
//! that was not. `cargo run --release --example train_and_resume`

use scenesplat::datasets::transforms::semantic_segmentation;
use scenesplat::datasets::{InputFeatures, LoaderSettings, SceneDataset, SceneLoader};
use scenesplat::losses::{CrossEntropy, Objective};
use scenesplat::models::ParamStore;
use scenesplat::prelude::*;
use scenesplat::trainers::checkpoint::newest_checkpoint;
use scenesplat::trainers::tasks::{SemanticSegmentation, TaskModule};
use scenesplat::trainers::{
    AdamW, AdamWConfig, Callback, DataModule, Event, Flow, OneCycle, Progress, TrainError, Trainer,
    TrainerConfig, group_by_keyword,
};
use scenesplat::{datasets, rooms};
use std::sync::Arc;

/// Prints the loss, and asks to stop after a step.
struct StopAfter(u64);

impl Callback for StopAfter {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let Event::Step { measurements } = event else { return Ok(Flow::Continue) };
        println!("step {}: loss {:.3}", at.step, measurements[0].value);
        Ok(if at.step == self.0 { Flow::Stop } else { Flow::Continue })
    }
}

fn main() -> anyhow::Result<()> {
    let checkpoints = std::env::temp_dir().join(format!("train_and_resume-{}", std::process::id()));
    let part = |stop: u64| -> anyhow::Result<Progress> {
        let source = Arc::new(datasets::SyntheticRooms::new(8, Default::default(), 1)?);
        let steps = datasets::build_transforms(&semantic_segmentation(0.1))?;
        let scenes = Arc::new(SceneDataset::new(source, steps, 0, 1)?);
        let settings = LoaderSettings::default();
        let loader = SceneLoader::new(scenes, InputFeatures::default(), settings)?;
        let params = ParamStore::trainable(0);
        let network = ModelConfig::tiny().with_classes(rooms::CLASSES.len());
        let network = network.build(params.builder())?;
        let objective = Objective::new().with(1.0, CrossEntropy::default());
        let groups = group_by_keyword(&params.parameters(), 0.003, 0.02, &[]);
        let optimizer = Box::new(AdamW::new(groups, AdamWConfig::default())?);
        let module = TaskModule::new(params, network, objective, SemanticSegmentation);
        let mut config = TrainerConfig { epochs: 3, log_every: 1, ..Default::default() };
        config.checkpoint.dir = Some(checkpoints.clone());
        let mut trainer = Trainer::new(config, optimizer, Box::new(OneCycle::default()))?
            .with_callback(StopAfter(stop));
        let start = match newest_checkpoint(&checkpoints)? {
            Some(checkpoint) => trainer.load_checkpoint(&checkpoint, &module)?,
            None => Progress::default(),
        };
        Ok(trainer.fit(&module, &mut DataModule::new(loader), start)?)
    };
    println!("stopped at step {}", part(5)?.step);
    println!("done at step {}", part(u64::MAX)?.step);
    std::fs::remove_dir_all(&checkpoints)?;
    Ok(())
}
