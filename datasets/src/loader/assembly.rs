//! Making one batch.

use super::{BrokenScenes, LoaderSettings};
use crate::mix3d::mix_pairs;
use crate::rng::{Purpose, happens, purpose_rng};
use crate::{DataError, Dataset, InputFeatures, Sample, TrainBatch, collate_samples};
use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// What every batch is made by; shared by the workers.
pub(super) struct Assembly {
    pub dataset: Arc<dyn Dataset>,
    pub features: InputFeatures,
    pub settings: LoaderSettings,
}

/// A batch, and the scenes that could not be part of it with the reasons.
pub(super) struct Assembled {
    pub batch: TrainBatch,
    pub skipped: Vec<(String, String)>,
}

impl Assembly {
    /// Makes batch `number` of `epoch` of the given scenes; `None` if `stopped` says so meanwhile.
    pub(super) fn assemble(
        &self,
        epoch: u64,
        number: usize,
        scenes: &[usize],
        stopped: impl Fn() -> bool,
    ) -> Option<Result<Assembled, DataError>> {
        let mut samples = Vec::with_capacity(scenes.len());
        let mut skipped = Vec::new();
        for &scene in scenes {
            if stopped() {
                return None;
            }
            match self.guarded(&[scene], || self.dataset.get(epoch, scene)) {
                Ok(sample) => samples.push(sample),
                // A panic is a bug, not a property of the scene.
                Err(error @ DataError::Panicked { .. }) => return Some(Err(error)),
                Err(error) if self.settings.broken_scenes == BrokenScenes::Skip => {
                    skipped.push((self.dataset.id(scene).to_owned(), reason(&error)));
                }
                Err(error) => return Some(Err(error)),
            }
        }
        let joined = self.guarded(scenes, || self.join(epoch, number, samples));
        Some(joined.map(|batch| Assembled { batch, skipped }))
    }

    /// What is made of some scenes; a panic is an error that names them.
    fn guarded<T>(
        &self,
        scenes: &[usize],
        make: impl FnOnce() -> Result<T, DataError>,
    ) -> Result<T, DataError> {
        catch_unwind(AssertUnwindSafe(make)).unwrap_or_else(|panic| {
            let ids: Vec<&str> = scenes.iter().map(|&scene| self.dataset.id(scene)).collect();
            Err(DataError::Panicked { id: ids.join(", "), message: message(panic.as_ref()) })
        })
    }

    fn join(
        &self,
        epoch: u64,
        number: usize,
        mut samples: Vec<Sample>,
    ) -> Result<TrainBatch, DataError> {
        let mut rng = purpose_rng(Purpose::Mixing, self.settings.seed, epoch, number as u64);
        if happens(&mut rng, self.settings.mix_probability) {
            samples = mix_pairs(samples, self.settings.mix_exact, &mut rng)?;
        }
        collate_samples(samples, &self.features)
    }
}

/// The text that a panic came with.
fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "without a message".to_owned())
}

/// An error with all its causes.
fn reason(error: &DataError) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}
