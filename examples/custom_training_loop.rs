//! A training loop of one's own: a small language network on 40 synthetic rooms, scored on 10 rooms
//! it has never seen. `cargo run --release --example custom_training_loop`

use scenesplat::datasets;
use scenesplat::datasets::transforms::{TransformConfig, language_pretraining, validation};
use scenesplat::datasets::{BatchLoader, InputFeatures, LoaderSettings, SceneLoader};
use scenesplat::losses::{CosineLoss, LossInput, Objective, TextClassification, TextColumns};
use scenesplat::models::{Forward, ParamStore};
use scenesplat::prelude::*;
use scenesplat::trainers::evaluators::ZeroShotEvaluator;
use scenesplat::trainers::tasks::{TargetSource, point_cloud};
use scenesplat::trainers::{
    AdamW, AdamWConfig, OneCycle, Optimizer, Schedule, clip_grad_norm, group_by_keyword,
};
use std::sync::Arc;

fn main() -> anyhow::Result<()> {
    let texts = scenesplat::rooms::Vocabulary::new(64)?.class_table();
    let rooms = |count, seed, steps: Vec<TransformConfig>| {
        let source = datasets::SyntheticRooms::new(count, Default::default(), seed)?;
        let steps = datasets::build_transforms(&steps)?;
        datasets::SceneDataset::new(Arc::new(source), steps, 0, 1).map(Arc::new)
    };
    let (input, grid) = (InputFeatures::default(), 0.08);
    let settings = LoaderSettings { batch_size: 1, mix_probability: 0.0, ..Default::default() };
    let training = rooms(40, 1, language_pretraining(grid))?;
    let mut loader = SceneLoader::new(training, input.clone(), settings)?;
    let unseen = rooms(10, 1000, validation(grid))?;
    let judge = ZeroShotEvaluator::new("unseen", unseen, input, texts.clone(), vec![0, 1, 2]);
    let store = ParamStore::trainable(0);
    let network = ModelConfig::tiny().build(store.builder())?;
    let score = || judge.confusion(&network).map(|c| c.tester_report().foreground_mean_iou);
    let params = store.parameters();
    let groups = group_by_keyword(&params, 0.003, 0.02, &[]);
    let mut optimizer = AdamW::new(groups, AdamWConfig::default())?;
    let table = TextColumns::new(&texts.values, texts.dim)?;
    let classify = TextClassification { temperature: 0.05, ..TextClassification::new(table) };
    let objective = Objective::new().with(0.2, CosineLoss::default()).with(1.0, classify);
    let targets = TargetSource::class_text(&texts)?;

    let (epochs, steps) = (6_u64, loader.batches_per_epoch() as u64);
    for epoch in 0..epochs {
        println!("f-mIoU on unseen rooms: {:.3}", score()?.unwrap_or(0.0));
        for (i, batch) in (0..).zip(loader.epoch(epoch, 0)) {
            let (batch, step) = (batch?, epoch * steps + i);
            let mut rng = datasets::sample_rng(0, epoch, i);
            let pred = &network.forward(&point_cloud(&batch)?, &mut Forward::train(&mut rng))?;
            let (target, valid) = targets.of(&batch)?;
            let (target, valid, label) = (Some(&target), Some(&*valid), batch.segment.as_deref());
            let input = LossInput { pred, target, label, valid, progress: 0.0, seed: step };
            let loss = objective.forward(&input)?.total;
            let mut grads = loss.backward()?;
            clip_grad_norm(&params, &mut grads, 1.0)?;
            optimizer.step(&grads, &OneCycle::default().hyperparameters(step, epochs * steps))?;
            println!("step {step}: loss {:.3}", loss.to_scalar::<f32>()?);
        }
    }
    println!("f-mIoU on unseen rooms: {:.3}", score()?.unwrap_or(0.0));
    Ok(())
}
