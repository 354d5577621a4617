//! What is trained, and on what.

use super::recipe::{StabilityRecipe, WIDTH};
use crate::doctor::trial::Failure;
use scenesplat_datasets::{
    BatchLoader, DataError, Dataset, InputFeatures, SceneDataset, SyntheticRooms, TrainBatch,
    build_transforms, collate_samples,
};
use scenesplat_kernels::Precision;
use scenesplat_losses::{AggregatedContrastive, CosineLoss, Objective, TermSchedule};
use scenesplat_models::{Compute, ModelConfig, ParamStore, PointTransformerV3Config};
use scenesplat_rooms::{SyntheticRoomSettings, Vocabulary};
use scenesplat_trainers::tasks::{LanguagePretraining, TargetSource, TaskModule};
use std::sync::Arc;

/// Batches whose gradients an accumulated step averages.
pub(super) const ACCUMULATED: u64 = 4;
/// Rooms that take turns.
const ROOMS: usize = 16;

/// How large the scenes of a batch are beside each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Batches {
    Even,
    Uneven,
}

impl Batches {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Even => "even",
            Self::Uneven => "uneven",
        }
    }

    /// Gaussians of the two scenes of a batch.
    fn gaussians(self) -> [usize; 2] {
        match self {
            Self::Even => [500, 500],
            Self::Uneven => [960, 40],
        }
    }
}

/// How a step is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    Plain,
    Accumulated,
    Recomputed,
}

impl Form {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Accumulated => "accumulated",
            Self::Recomputed => "recomputed",
        }
    }

    pub(super) fn accumulate(self) -> u64 {
        if self == Self::Accumulated { ACCUMULATED } else { 1 }
    }
}

/// One training.
#[derive(Debug, Clone, Copy)]
pub(super) struct Setup {
    pub(super) recipe: StabilityRecipe,
    pub(super) precision: Precision,
    pub(super) batches: Batches,
    pub(super) form: Form,
    pub(super) seed: u64,
}

impl Setup {
    pub(super) fn name(&self) -> String {
        let Self { recipe, precision, batches, form, seed } = self;
        format!("{recipe}, {precision}, {} batches, {}, seed {seed}", batches.name(), form.name())
    }
}

/// A small network that learns the texts of its classes.
pub(super) fn module(precision: Precision, seed: u64) -> Result<TaskModule, Failure> {
    let config = PointTransformerV3Config {
        enc_channels: vec![8, 16, 16],
        enc_num_head: vec![1, 2, 2],
        enc_patch_size: vec![64; 3],
        dec_channels: vec![16, 16],
        dec_num_head: vec![2, 2],
        dec_patch_size: vec![64; 2],
        drop_path: 0.2,
        compute: Compute { precision, ..Compute::default() },
        ..PointTransformerV3Config::tiny()
    };
    let params = ParamStore::trainable(seed);
    let model = ModelConfig::new(config).with_projection(WIDTH).build(params.builder())?;
    // On from the first step: gradients of different steps are compared.
    let contrastive = AggregatedContrastive {
        min_points: 8,
        schedule: TermSchedule::Always,
        ..AggregatedContrastive::default()
    };
    let objective = Objective::new().with(1.0, CosineLoss::default()).with(0.02, contrastive);
    let targets = TargetSource::class_text(&Vocabulary::new(WIDTH)?.class_table())?;
    Ok(TaskModule::new(params, model, objective, LanguagePretraining { targets }))
}

/// Batches of two rooms, made as they are asked for; a function of seed, epoch and place.
pub(super) struct Rooms {
    scenes: [SceneDataset; 2],
    per_epoch: usize,
    /// Number of the batch, from 0, in which a value is not finite.
    poisoned: Option<usize>,
}

impl Rooms {
    pub(super) fn new(
        recipe: StabilityRecipe,
        batches: Batches,
        seed: u64,
        per_epoch: usize,
    ) -> Result<Self, Failure> {
        let scenes = |gaussians: usize| -> Result<SceneDataset, Failure> {
            let settings = SyntheticRoomSettings {
                num_gaussians: Some(gaussians),
                ..SyntheticRoomSettings::default()
            };
            let source = Arc::new(SyntheticRooms::new(ROOMS, settings, seed)?);
            let steps = build_transforms(&recipe.transforms())?;
            Ok(SceneDataset::new(source, steps, seed, 1)?)
        };
        let [a, b] = batches.gaussians();
        Ok(Self { scenes: [scenes(a)?, scenes(b)?], per_epoch, poisoned: None })
    }

    /// A batch contains a non-finite value.
    pub(super) fn poisoned_at(self, number: Option<usize>) -> Self {
        Self { poisoned: number, ..self }
    }

    /// The first scene of a batch.
    pub(super) fn name_of(&self, number: usize) -> Result<String, Failure> {
        let batch = self.batch(0, number)?;
        batch.ids.into_iter().next().ok_or_else(|| Failure("a batch without a scene".to_owned()))
    }

    fn batch(&self, epoch: u64, place: usize) -> Result<TrainBatch, DataError> {
        let number = epoch as usize * self.per_epoch + place;
        let [a, b] = &self.scenes;
        // Never a room beside itself.
        let of = |scenes: &SceneDataset, step: usize| {
            scenes.get(number as u64, (number * 2 + step) % ROOMS)
        };
        let samples = vec![of(a, 0)?, of(b, 1)?];
        let mut batch = collate_samples(samples, &InputFeatures::default())?;
        if self.poisoned == Some(number)
            && let Some(value) = batch.feat.get_mut(3)
        {
            *value = f32::NAN;
        }
        Ok(batch)
    }
}

impl BatchLoader<TrainBatch> for Rooms {
    fn batches_per_epoch(&self) -> usize {
        self.per_epoch
    }

    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<TrainBatch, DataError>> + '_> {
        Box::new((skip..self.per_epoch).map(move |place| self.batch(epoch, place)))
    }
}
