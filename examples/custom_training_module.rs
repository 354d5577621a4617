//! A `TrainingModule` of one's own: a network that guesses the colors of a room from the shapes in it, a pretext task that no
//! setting offers. The trainer does the rest: optimizer, schedule, checks of gradients, checkpoints.
//! `cargo run --release --example custom_training_module`

use candle_core::Result;
use scenesplat::datasets::transforms::semantic_segmentation;
use scenesplat::datasets::{
    InputFeatures, LoaderSettings, SceneDataset, SceneLoader, SyntheticRooms, TrainBatch,
    build_transforms,
};
use scenesplat::models::ParamStore;
use scenesplat::prelude::*;
use scenesplat::trainers::tasks::point_cloud;
use scenesplat::trainers::{
    AdamW, AdamWConfig, Callback, DataModule, Event, Flow, OneCycle, Progress, StepContext,
    StepOutput, TrainError, Trainer, TrainerConfig, TrainingModule, group_by_keyword,
};
use std::sync::Arc;

/// Reads opacity, rotation and size, and gives the three numbers of a color.
struct Colors {
    params: ParamStore,
    network: Box<dyn Backbone>,
}

impl TrainingModule for Colors {
    type Batch = TrainBatch;

    fn params(&self) -> &ParamStore {
        &self.params
    }

    fn training_step(&self, batch: &TrainBatch, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let mut points = point_cloud(batch)?;
        // The first three channels are the color, which the network is to guess and must not see.
        let color = points.feat.narrow(1, 0, 3)?;
        points.feat = points.feat.narrow(1, 3, 8)?.contiguous()?;
        let guess = self.network.forward(&points, &mut cx.forward)?;
        let loss = (&guess - color)?.abs()?.mean_all()?;
        let terms = vec![("l1".to_owned(), f64::from(loss.to_scalar::<f32>()?))];
        let (rows, features) = (batch.len(), Some(guess.detach()));
        Ok(StepOutput { loss, rows, counted_rows: rows, terms, features })
    }
}

/// Prints what each step measured.
struct Print;

impl Callback for Print {
    fn on_event(
        &mut self,
        event: &Event<'_>,
        at: Progress,
    ) -> std::result::Result<Flow, TrainError> {
        if let Event::Step { measurements } = event {
            println!("step {}: {} {:.3}", at.step, measurements[0].name, measurements[0].value);
        }
        Ok(Flow::Continue)
    }
}

fn main() -> anyhow::Result<()> {
    let rooms = Arc::new(SyntheticRooms::new(16, Default::default(), 1)?);
    let steps = build_transforms(&semantic_segmentation(0.1))?;
    let scenes = Arc::new(SceneDataset::new(rooms, steps, 0, 1)?);
    let loader = SceneLoader::new(scenes, InputFeatures::default(), LoaderSettings::default())?;

    let params = ParamStore::trainable(0);
    let backbone = PointTransformerV3Config { in_channels: 8, ..PointTransformerV3Config::tiny() };
    let network = ModelConfig::new(backbone).with_classes(3).build(params.builder())?;
    let groups = group_by_keyword(&params.parameters(), 0.003, 0.02, &[]);
    let module = Colors { params, network };

    let settings = TrainerConfig { epochs: 5, log_every: 1, ..Default::default() };
    let optimizer = Box::new(AdamW::new(groups, AdamWConfig::default())?);
    let mut trainer =
        Trainer::new(settings, optimizer, Box::new(OneCycle::default()))?.with_callback(Print);
    let end = trainer.fit(&module, &mut DataModule::new(loader), Progress::default())?;
    println!("done at step {}", end.step);
    Ok(())
}
