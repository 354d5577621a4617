//! Samples by number.

use crate::error::require;
use crate::teacher::Lesson;
use crate::{
    DataError, DataSource, LeftOut, RepairedScene, Sample, SceneTeacher, TeacherView, Transform,
    sample_rng,
};
use scenesplat_scene::RepairReport;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A fixed number of samples, each of which can be made at any time.
///
/// Which scenes there are is the business of a [`DataSource`]; transforms, epochs and seeds are
/// that of a dataset.
pub trait Dataset: Send + Sync {
    /// Number of samples in one epoch.
    fn len(&self) -> usize;

    /// Whether there is none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Makes sample `index` of `epoch`; the same arguments give the same sample, bit for bit.
    ///
    /// # Errors
    /// If there is no such sample or it cannot be made; the error names the scene.
    fn get(&self, epoch: u64, index: usize) -> Result<Sample, DataError>;

    /// Name of the scene that sample `index` is made of; empty if there is no such sample.
    fn id(&self, index: usize) -> &str;

    /// What was left out or repaired in the scenes read so far, and what they lack.
    fn left_out(&self) -> LeftOut {
        LeftOut::default()
    }
}

/// The scenes of a source, each changed by the same transforms.
pub struct SceneDataset {
    source: Arc<dyn DataSource>,
    transforms: Vec<Arc<dyn Transform>>,
    seed: u64,
    repeat: usize,
    lesson: Option<Lesson>,
    repairs: Mutex<BTreeMap<String, RepairReport>>,
    /// Rows of each scene read so far, whether it has labels, and whether it has features.
    seen: Mutex<BTreeMap<String, (usize, bool, bool)>>,
}

impl SceneDataset {
    /// Samples of `source`, each scene `repeat` times an epoch (the original's `loop`), with other
    /// random numbers each time.
    ///
    /// # Errors
    /// If `repeat` is 0, or the number of samples overflows.
    pub fn new(
        source: Arc<dyn DataSource>,
        transforms: Vec<Arc<dyn Transform>>,
        seed: u64,
        repeat: usize,
    ) -> Result<Self, DataError> {
        let ok = repeat > 0 && source.scene_ids().len().checked_mul(repeat).is_some();
        require(ok, "repeat", repeat, "a number of 1 or more")?;
        Ok(Self {
            source,
            transforms,
            seed,
            repeat,
            lesson: None,
            repairs: Mutex::default(),
            seen: Mutex::default(),
        })
    }

    /// Lets a teacher say what each row shall be: its rows replace the language features of the
    /// scenes, see [`teacher`](crate::teacher). With [`TeacherView::Augmented`] it looks before the last
    /// `steps_after` transforms, see [`steps_after_look`](crate::teacher::steps_after_look).
    #[must_use]
    pub fn with_teacher(mut self, teacher: Arc<dyn SceneTeacher>, steps_after: usize) -> Self {
        let steps_after = match teacher.view() {
            TeacherView::Augmented => steps_after.min(self.transforms.len()),
            TeacherView::Scene => self.transforms.len(),
        };
        self.lesson = Some(Lesson { teacher, steps_after });
        self
    }

    /// The scenes in which something had to be repaired or left out so far, by name, with what.
    pub fn repairs(&self) -> BTreeMap<String, RepairReport> {
        held(&self.repairs).clone()
    }

    fn make(&self, epoch: u64, index: usize, id: &str) -> Result<Sample, DataError> {
        let loaded = self.source.load(id)?;
        let points = loaded.scene.labelled_points.as_ref().and_then(|p| p.segment.as_deref());
        let labels = [loaded.scene.segment.as_deref(), points];
        let labels = labels.into_iter().flatten().flatten().any(|label| *label >= 0);
        let about = (loaded.report.source_rows, labels, loaded.scene.lang_feat.is_some());
        held(&self.seen).entry(id.to_owned()).or_insert(about);
        if loaded.report.dropped_rows > 0 || loaded.report.worth_telling().next().is_some() {
            held(&self.repairs).entry(id.to_owned()).or_insert(loaded.report);
        }
        loaded.scene.check_rows()?;
        let mut sample = Sample::from_scene(id, loaded.scene);
        let mut rng = sample_rng(self.seed, epoch, index as u64);
        let looks_at = self.lesson.as_ref().map(|l| self.transforms.len() - l.steps_after);
        let mut shown = None;
        for (i, transform) in self.transforms.iter().enumerate() {
            if looks_at == Some(i) {
                shown = self.lesson.as_ref().map(|lesson| lesson.look(&mut sample));
            }
            transform.apply(&mut sample, &mut rng)?;
        }
        sample.check()?;
        if let (Some(lesson), Some(shown)) = (&self.lesson, shown) {
            lesson.give(shown, &mut sample)?;
            sample.check()?;
        }
        Ok(sample)
    }
}

/// What a lock holds, whatever happened to those who held it.
fn held<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Dataset for SceneDataset {
    fn len(&self) -> usize {
        self.source.scene_ids().len() * self.repeat
    }

    fn get(&self, epoch: u64, index: usize) -> Result<Sample, DataError> {
        if index >= self.len() {
            return Err(DataError::RowOutOfRange { row: index, rows: self.len() });
        }
        let id = self.id(index);
        self.make(epoch, index, id).map_err(|error| error.in_scene(id))
    }

    fn id(&self, index: usize) -> &str {
        let ids = self.source.scene_ids();
        if index < self.len() { &ids[index % ids.len()] } else { "" }
    }

    fn left_out(&self) -> LeftOut {
        let seen = held(&self.seen);
        let repairs = held(&self.repairs);
        let lacking = |lacks: fn(&(usize, bool, bool)) -> bool| {
            seen.iter().filter(|(_, about)| lacks(about)).map(|(id, _)| id.clone()).collect()
        };
        LeftOut {
            scenes: seen.len(),
            rows: seen.values().map(|(rows, ..)| rows).sum(),
            skipped: BTreeMap::new(),
            repaired: repairs.iter().map(|(id, r)| (id.clone(), RepairedScene::from(r))).collect(),
            without_labels: lacking(|(_, labels, _)| !labels),
            without_features: lacking(|(.., features)| !features),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SampleRng, SyntheticRooms};
    use rand_chacha::rand_core::RngCore;
    use scenesplat_rooms::SyntheticRoomSettings;

    #[derive(Debug)]
    struct Shake;

    impl Transform for Shake {
        fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
            sample.coord.iter_mut().flatten().for_each(|c| *c += rng.next_u32() as f32 * 1e-12);
            Ok(())
        }
    }

    #[derive(Debug)]
    struct Breaks;

    impl Transform for Breaks {
        fn apply(&self, sample: &mut Sample, _: &mut SampleRng) -> Result<(), DataError> {
            sample.quat.pop();
            Ok(())
        }
    }

    fn dataset(transforms: Vec<Arc<dyn Transform>>, repeat: usize) -> SceneDataset {
        let source =
            Arc::new(SyntheticRooms::new(2, SyntheticRoomSettings::with_count(200, 0), 1).unwrap());
        SceneDataset::new(source, transforms, 5, repeat).unwrap()
    }

    #[test]
    fn seed_epoch_and_index_decide_the_sample() {
        let data = dataset(vec![Arc::new(Shake)], 2);
        assert_eq!(data.len(), 4);
        assert_eq!([data.id(0), data.id(3), data.id(4)], ["room-000000", "room-000001", ""]);
        let sample = data.get(1, 2).unwrap();
        assert_eq!(sample.id, "room-000000");
        assert_eq!(sample, data.get(1, 2).unwrap());
        assert_ne!(sample.coord, data.get(1, 0).unwrap().coord, "a repeat draws anew");
        assert_ne!(sample.coord, data.get(2, 2).unwrap().coord);
        let same = dataset(vec![Arc::new(Shake)], 2);
        assert_eq!(sample, same.get(1, 2).unwrap());
    }

    #[test]
    fn errors_name_the_scene() {
        let data = dataset(vec![Arc::new(Breaks)], 1);
        let error = data.get(0, 1).unwrap_err();
        assert!(matches!(&error, DataError::Sample { id, .. } if id == "room-000001"), "{error}");
        assert!(matches!(data.get(0, 2), Err(DataError::RowOutOfRange { row: 2, rows: 2 })));
        let source =
            Arc::new(SyntheticRooms::new(2, SyntheticRoomSettings::with_count(200, 0), 1).unwrap());
        assert!(SceneDataset::new(source, vec![], 0, 0).is_err());
    }
}
