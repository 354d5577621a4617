//! Batches in a fixed order, made ahead by worker threads.

mod assembly;
mod batches;

pub use batches::SceneBatches;

use crate::error::require;
use crate::rng::{Purpose, permutation, purpose_rng};
use crate::{DataError, Dataset, InputFeatures, LeftOut, TrainBatch};
use assembly::Assembly;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

/// Gives the batches of one epoch after the other.
///
/// A trainer knows no more of its data than this. Batches depend on the loader's settings and
/// `epoch` alone, so a run that was interrupted continues with `skip`.
pub trait BatchLoader<B> {
    /// Number of batches of every epoch.
    fn batches_per_epoch(&self) -> usize;

    /// Iterates over `epoch` without its first `skip` batches. It ends with the first error.
    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<B, DataError>> + '_>;

    /// As [`epoch`](Self::epoch), only the batches that `part` holds. As it stands the others are made and dropped; a
    /// loader that can does not make them.
    fn epoch_part<'s>(
        &'s mut self,
        epoch: u64,
        skip: usize,
        part: BatchPart,
    ) -> Box<dyn Iterator<Item = Result<B, DataError>> + 's>
    where
        B: 's,
    {
        let batches = self.epoch(epoch, skip).enumerate();
        Box::new(batches.filter_map(move |(at, batch)| {
            (part.holds(skip + at) || batch.is_err()).then_some(batch)
        }))
    }

    /// What was left out or repaired in the scenes read so far, and what they lack.
    fn left_out(&self) -> LeftOut {
        LeftOut::default()
    }
}

/// Of each group of batches, those from one place on: what one of several processes trains on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BatchPart {
    /// Batches of a group, at least 1.
    pub group: usize,
    /// The first that is held.
    pub first: usize,
    /// How many are held.
    pub count: usize,
}

impl BatchPart {
    /// Whether it holds the batch at that place of an epoch.
    pub fn holds(self, place: usize) -> bool {
        (self.first..self.first + self.count).contains(&(place % self.group))
    }
}

/// What to do about a scene that cannot be read or changed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BrokenScenes {
    /// The epoch ends with an error that names the scene.
    #[default]
    Stop,
    /// It is left out and noted, see [`SceneLoader::skipped`]; its batch is smaller, and empty
    /// if no scene is left ([`TrainBatch::is_empty`]), so that the number of batches stays. A panic is a
    /// bug and no property of a scene: it always stops.
    Skip,
}

scenesplat_kernels::settings! {
    /// How scenes become batches. The default is the original's training, for one process.
    pub struct LoaderSettings {
        /// Scenes of a batch, before some are mixed.
        pub batch_size: usize = 2,
        /// Whether scenes come in another order each epoch.
        pub shuffle: bool = true,
        /// Seed of the order and of the mixing.
        pub seed: u64 = 0,
        /// Threads that make batches; 0 = in the caller's thread, when they are asked for.
        pub workers: usize = 2,
        /// Batches that are made or wait at a time, beside the one in use; at least one a worker is
        /// needed to keep all busy. Without workers none are.
        pub prefetch: usize = 4,
        /// Whether scenes that do not fill the last batch are left out.
        pub drop_last: bool = true,
        /// Probability that the scenes of a batch are merged in pairs, see
        /// [`mix_pairs`](crate::mix_pairs).
        pub mix_probability: f64 = 0.8,
        /// Mixes as the original does, cells twice included.
        pub mix_exact: bool = false,
        /// What to do about scenes that cannot be used.
        pub broken_scenes: BrokenScenes = BrokenScenes::Stop,
    }
}

impl LoaderSettings {
    /// One whole scene after the other, as evaluation needs them.
    pub fn evaluation() -> Self {
        Self {
            batch_size: 1,
            shuffle: false,
            drop_last: false,
            mix_probability: 0.0,
            ..Self::default()
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// Names the first that is out of range.
    pub fn check(&self) -> Result<(), DataError> {
        require(self.batch_size > 0, "batch_size", 0, "a number of 1 or more")?;
        // More threads than this are a typing error.
        require(self.workers <= 1024, "workers", self.workers, "at most 1024")?;
        let ok = self.workers == 0 || self.prefetch > 0;
        require(ok, "prefetch", 0, "at least 1 when there are workers")?;
        let ok = (0.0..=1.0).contains(&self.mix_probability);
        require(ok, "mix_probability", self.mix_probability, "a number in 0..=1")
    }
}

/// A scene that was left out, see [`BrokenScenes::Skip`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SkippedScene {
    /// How often it was left out of a batch.
    pub times: usize,
    /// Why, the first time, with all causes.
    pub reason: String,
}

/// Scenes left out so far, by name.
type Skipped = Arc<Mutex<BTreeMap<String, SkippedScene>>>;

/// Batches of the scenes of one dataset.
///
/// Whole batches are made by worker threads and handed over in order; the same settings give the
/// same batches for any number of workers. The workers live as long as an epoch's iterator: when it
/// is dropped, they stop after the scene they are at, and have ended when the drop returns.
///
/// ```
/// use scenesplat_datasets::transforms::{build_transforms, language_pretraining};
/// use scenesplat_datasets::{
///     BatchLoader, InputFeatures, LoaderSettings, SceneDataset, SceneLoader, SyntheticRooms,
/// };
/// use scenesplat_rooms::SyntheticRoomSettings;
/// use std::sync::Arc;
///
/// // One's own scenes: `SceneFolders::new("my/scenes".as_ref(), &[], Default::default())?`
/// let room = SyntheticRoomSettings { num_gaussians: Some(2000), ..Default::default() };
/// let source = Arc::new(SyntheticRooms::new(4, room, 1)?);
/// let transforms = build_transforms(&language_pretraining(0.05))?;
/// let dataset = Arc::new(SceneDataset::new(source, transforms, 7, 1)?);
/// let settings = LoaderSettings { batch_size: 2, workers: 1, ..LoaderSettings::default() };
/// let mut loader = SceneLoader::new(dataset, InputFeatures::default(), settings)?;
/// for batch in loader.epoch(0, 0) {
///     let batch = batch?;
///     assert_eq!(batch.feat.len(), batch.len() * batch.channels);
/// }
/// # Ok::<(), scenesplat_datasets::DataError>(())
/// ```
#[derive(Clone)]
pub struct SceneLoader {
    assembly: Arc<Assembly>,
    skipped: Skipped,
}

impl SceneLoader {
    /// Batches of `dataset`, as the network of these input features reads them.
    ///
    /// # Errors
    /// If a setting is out of range, or there is not one batch.
    pub fn new(
        dataset: Arc<dyn Dataset>,
        features: InputFeatures,
        settings: LoaderSettings,
    ) -> Result<Self, DataError> {
        settings.check()?;
        require(!dataset.is_empty(), "dataset", "0 scenes", "at least one scene")?;
        let ok = !settings.drop_last || dataset.len() >= settings.batch_size;
        let scenes = format!("{} (of {} scenes)", settings.batch_size, dataset.len());
        let expected = "no more than the scenes of an epoch; or drop_last = false";
        require(ok, "batch_size", scenes, expected)?;
        let assembly = Arc::new(Assembly { dataset, features, settings });
        Ok(Self { assembly, skipped: Skipped::default() })
    }

    /// The settings.
    pub fn settings(&self) -> &LoaderSettings {
        &self.assembly.settings
    }

    /// The scenes that were left out of batches handed over so far, by name.
    pub fn skipped(&self) -> BTreeMap<String, SkippedScene> {
        self.skipped.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// As [`BatchLoader::epoch`], without borrowing the loader.
    pub fn batches(&self, epoch: u64, skip: usize) -> SceneBatches {
        self.some_batches(epoch, skip, |_| true)
    }

    fn some_batches(
        &self,
        epoch: u64,
        skip: usize,
        wanted: impl Fn(usize) -> bool,
    ) -> SceneBatches {
        let plan = self.plan(epoch).into_iter().enumerate();
        // What a batch holds depends on its place in the epoch, whoever asks for it.
        let plan = plan.skip(skip).filter(|(place, _)| wanted(*place)).collect();
        SceneBatches::start(&self.assembly, &self.skipped, epoch, plan)
    }

    /// Names of the scenes in the first batches of an epoch.
    pub fn scenes(&self, epoch: u64, batches: usize) -> BTreeSet<String> {
        let samples = self.plan(epoch).into_iter().take(batches).flatten();
        samples.map(|sample| self.assembly.dataset.id(sample).to_owned()).collect()
    }

    /// The scenes of each batch of an epoch.
    fn plan(&self, epoch: u64) -> Vec<Vec<usize>> {
        let scenes = self.assembly.dataset.len();
        let settings = self.settings();
        let order = if settings.shuffle {
            permutation(&mut purpose_rng(Purpose::Order, settings.seed, epoch, 0), scenes)
        } else {
            (0..scenes).collect()
        };
        let count = self.batches_per_epoch();
        order.chunks(settings.batch_size).take(count).map(<[usize]>::to_vec).collect()
    }

    /// Number of batches of every epoch.
    pub fn batches_per_epoch(&self) -> usize {
        let (scenes, size) = (self.assembly.dataset.len(), self.settings().batch_size);
        if self.settings().drop_last { scenes / size } else { scenes.div_ceil(size) }
    }
}

impl BatchLoader<TrainBatch> for SceneLoader {
    fn batches_per_epoch(&self) -> usize {
        self.batches_per_epoch()
    }

    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<TrainBatch, DataError>> + '_> {
        Box::new(self.batches(epoch, skip))
    }

    fn epoch_part<'s>(
        &'s mut self,
        epoch: u64,
        skip: usize,
        part: BatchPart,
    ) -> Box<dyn Iterator<Item = Result<TrainBatch, DataError>> + 's>
    where
        TrainBatch: 's,
    {
        Box::new(self.some_batches(epoch, skip, |place| part.holds(place)))
    }

    fn left_out(&self) -> LeftOut {
        let mut left_out = self.assembly.dataset.left_out();
        left_out.skipped = self.skipped();
        // A scene that cannot be read at all was tried nonetheless.
        let (skipped, seen) = (left_out.skipped.len(), left_out.scenes);
        left_out.scenes = seen.max(skipped);
        left_out
    }
}
