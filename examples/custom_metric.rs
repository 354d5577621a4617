//! A metric of one's own in an evaluator of ours. `cargo run --release --example custom_metric`

use scenesplat::datasets::transforms::validation;
use scenesplat::datasets::{InputFeatures, SceneDataset, SyntheticRooms, build_transforms};
use scenesplat::losses::{CrossEntropy, Objective};
use scenesplat::metrics::{Measurement, Metric, MetricError};
use scenesplat::models::ParamStore;
use scenesplat::prelude::*;
use scenesplat::rooms::CLASSES;
use scenesplat::trainers::evaluators::SegmentationEvaluator;
use scenesplat::trainers::tasks::{SemanticSegmentation, TaskModule};
use scenesplat::trainers::{Evaluator, Progress};
use std::sync::Arc;

/// How many classes the network ever says, of those that are there.
#[derive(Clone, Default)]
struct Variety {
    said: Vec<i32>,
    there: Vec<i32>,
}

impl Metric for Variety {
    type Update<'a> = (&'a [i32], &'a [i32]);

    fn update(&mut self, (predicted, truth): Self::Update<'_>) -> Result<(), MetricError> {
        for (list, labels) in [(&mut self.said, predicted), (&mut self.there, truth)] {
            list.extend(labels.iter().filter(|label| **label >= 0));
            list.sort_unstable();
            list.dedup();
        }
        Ok(())
    }

    fn merge(&mut self, other: &Self) -> Result<(), MetricError> {
        self.update((&other.said, &other.there))
    }

    fn names(&self) -> Vec<String> {
        vec!["variety".to_owned()]
    }

    fn measure(&self) -> Vec<Measurement> {
        vec![Measurement::new("variety", self.said.len() as f64 / self.there.len() as f64)]
    }
}

fn main() -> anyhow::Result<()> {
    let source = Arc::new(SyntheticRooms::new(3, Default::default(), 1)?);
    let rooms = Arc::new(SceneDataset::new(source, build_transforms(&validation(0.1))?, 0, 1)?);
    let params = ParamStore::trainable(0);
    let network = ModelConfig::tiny().with_classes(CLASSES.len()).build(params.builder())?;
    let objective = Objective::new().with(1.0, CrossEntropy::default());
    let module = TaskModule::new(params, network, objective, SemanticSegmentation);
    let mut evaluator =
        SegmentationEvaluator::new("rooms", rooms, InputFeatures::default(), vec![])
            .with_metric(Variety::default());
    for measurement in evaluator.run(&module, Progress::default())? {
        println!("{}: {:.4}", measurement.name, measurement.value);
    }
    Ok(())
}
