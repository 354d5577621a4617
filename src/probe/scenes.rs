//! Scenes that a probe learns from and is scored on.

use super::ProbeError;
use scenesplat_datasets::transforms::{build_transforms, validation};
use scenesplat_datasets::{DataError, DataSource, Dataset, SceneDataset, SourceScene};
use std::sync::Arc;

/// Scenes in their order: the last ones are scored, the others are learned from.
pub struct ProbeScenes {
    source: Arc<dyn DataSource>,
    grid_size: f64,
    test: usize,
}

/// Scenes as a network reads them.
type Scenes = Arc<dyn Dataset>;

/// Some scenes of another source.
struct Part {
    source: Arc<dyn DataSource>,
    ids: Vec<String>,
}

impl DataSource for Part {
    fn scene_ids(&self) -> &[String] {
        &self.ids
    }
    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        self.source.load(id)
    }
}

impl ProbeScenes {
    /// `test`: how many of the last scenes are scored; a quarter, at least one, if not given.
    /// `grid_size`: the network's voxels, meters.
    ///
    /// # Errors
    /// If there are not two scenes, or none would be left to learn from.
    pub fn new(
        source: Arc<dyn DataSource>,
        grid_size: f64,
        test: Option<usize>,
    ) -> Result<Self, ProbeError> {
        let scenes = source.scene_ids().len();
        if scenes < 2 {
            return Err(ProbeError::TooFewScenes { scenes });
        }
        let test = test.unwrap_or((scenes / 4).max(1));
        if test == 0 || test >= scenes {
            let (setting, value) = ("test", test.to_string());
            let expected = "at least one scene, and fewer than there are";
            return Err(ProbeError::Setting { setting, value, expected });
        }
        Ok(Self { source, grid_size, test })
    }

    /// Those that are learned from, and those that are scored.
    pub(super) fn split(&self) -> Result<(Scenes, Scenes), ProbeError> {
        let ids = self.source.scene_ids();
        let (train, test) = ids.split_at(ids.len() - self.test);
        let dataset = |ids: &[String]| -> Result<Scenes, ProbeError> {
            let part = Part { source: Arc::clone(&self.source), ids: ids.to_vec() };
            let steps = build_transforms(&validation(self.grid_size))?;
            Ok(Arc::new(SceneDataset::new(Arc::new(part), steps, 0, 1)?))
        };
        Ok((dataset(train)?, dataset(test)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_datasets::SyntheticRooms;

    #[test]
    fn a_quarter_of_the_scenes_is_scored() {
        let of = |count: usize, test: Option<usize>| {
            let source =
                SyntheticRooms::new(count, scenesplat_rooms::SyntheticRoomSettings::default(), 1);
            ProbeScenes::new(Arc::new(source.unwrap()), 0.1, test).map(|scenes| scenes.test)
        };
        assert_eq!([2, 3, 4, 8, 11].map(|count| of(count, None).unwrap()), [1, 1, 1, 2, 2]);
        assert_eq!(of(8, Some(5)).unwrap(), 5);
        assert!(matches!(of(1, None), Err(ProbeError::TooFewScenes { scenes: 1 })));
        assert!(of(8, Some(0)).is_err() && of(8, Some(8)).is_err());
        let source = Arc::new(SyntheticRooms::new(8, Default::default(), 1).unwrap());
        let (train, test) = ProbeScenes::new(source, 0.1, Some(3)).unwrap().split().unwrap();
        assert_eq!((train.len(), test.len()), (5, 3));
    }

    #[test]
    fn the_last_scenes_are_scored_and_the_others_learned_from() {
        let source = Arc::new(SyntheticRooms::new(4, Default::default(), 1).unwrap());
        let (train, test) = ProbeScenes::new(source, 0.1, Some(1)).unwrap().split().unwrap();
        let names = |scenes: &Scenes| -> Vec<String> {
            (0..scenes.len()).map(|index| scenes.id(index).to_owned()).collect()
        };
        // Rooms are numbered from 0 on.
        assert_eq!(names(&train), ["room-000000", "room-000001", "room-000002"]);
        assert_eq!(names(&test), ["room-000003"]);
    }
}
