//! The data of a run.

use crate::{Evaluator, TrainingModule};
use scenesplat_datasets::BatchLoader;

/// Data of a run: batches to train on, and evaluators, which own what they score a module on.
///
/// ```
/// # use scenesplat_datasets::{InputFeatures, LoaderSettings, SceneDataset, SceneLoader};
/// # use scenesplat_datasets::{SyntheticRooms, build_transforms, transforms::semantic_segmentation};
/// # use scenesplat_trainers::{DataModule, evaluators::SegmentationEvaluator, tasks::TaskModule};
/// # use std::sync::Arc;
/// let rooms = Arc::new(SyntheticRooms::new(8, Default::default(), 1)?);
/// let steps = build_transforms(&semantic_segmentation(0.1))?;
/// let scenes = Arc::new(SceneDataset::new(rooms, steps, 0, 1)?);
/// let input = InputFeatures::default();
/// let loader = SceneLoader::new(scenes.clone(), input.clone(), LoaderSettings::default())?;
/// let seen = SegmentationEvaluator::new("seen", scenes, input, Vec::new());
/// let data = DataModule::<TaskModule>::new(loader).with_evaluator(seen);
/// assert_eq!(data.evaluators.len(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct DataModule<'a, M: TrainingModule> {
    /// Batches to train on.
    pub train: Box<dyn BatchLoader<M::Batch> + 'a>,
    /// What scores the module between epochs; their names differ.
    pub evaluators: Vec<Box<dyn Evaluator<M> + 'a>>,
}

impl<'a, M: TrainingModule> DataModule<'a, M> {
    /// Without evaluators.
    pub fn new(train: impl BatchLoader<M::Batch> + 'a) -> Self {
        Self { train: Box::new(train), evaluators: Vec::new() }
    }

    /// Adds an evaluator.
    #[must_use]
    pub fn with_evaluator(mut self, evaluator: impl Evaluator<M> + 'a) -> Self {
        self.evaluators.push(Box::new(evaluator));
        self
    }
}
