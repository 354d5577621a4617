//! Synthetic rooms as a source of scenes.

use crate::effects::{EffectRanges, simulate_in_room};
use crate::error::bad_setting;
use crate::{DataError, DataSource, SourceScene};
use half::f16;
use rand_chacha::rand_core::RngCore;
use scenesplat_kernels::random::sample_rng;
use scenesplat_rooms::vocabulary::{NO_TARGET, Vocabulary};
use scenesplat_rooms::{SyntheticRoom, SyntheticRoomSettings, generate};
use scenesplat_scene::{LanguageFeatures, RepairReport};
use std::sync::Arc;

/// Most rooms of a source.
pub const MAX_ROOMS: usize = 1_000_000;
/// The epoch that no training has: random numbers of the damage of rooms.
const EFFECTS: u64 = u64::MAX;

/// Any number of rooms `room-000000`, `room-000001`, …; nothing is kept, `load` generates.
#[derive(Debug, Clone)]
pub struct SyntheticRooms {
    ids: Vec<String>,
    settings: SyntheticRoomSettings,
    vocabulary: Option<Arc<Vocabulary>>,
    effects: EffectRanges,
}

impl SyntheticRooms {
    /// The first `count` rooms of a seed. Of the settings, `seed` is replaced and `room` is where
    /// the numbering starts; room `i` depends on the seed and `i` only, not on `count`.
    ///
    /// # Errors
    /// If there are more than [`MAX_ROOMS`] rooms, whose names alone would fill the memory, or the catalogue
    /// of furniture cannot be read.
    pub fn new(
        count: usize,
        mut settings: SyntheticRoomSettings,
        seed: u64,
    ) -> Result<Self, DataError> {
        if count > MAX_ROOMS {
            return Err(bad_setting("count", count, "at most 1000000 rooms"));
        }
        let ids = (0..count).map(|i| format!("room-{i:06}")).collect();
        settings.seed = seed;
        // Now rather than at the first room.
        settings.catalogue()?;
        Ok(Self { ids, settings, vocabulary: None, effects: EffectRanges::default() })
    }

    /// Gives every Gaussian of an object its feature in the vocabulary: class, groups and colour.
    #[must_use]
    pub fn with_vocabulary(mut self, vocabulary: Arc<Vocabulary>) -> Self {
        self.vocabulary = Some(vocabulary);
        self
    }

    /// Damages each room as a bad capture of it would have, by those of the effects that the room calls for
    /// ([`simulate_in_room`]); severities are drawn for each room by its seed and number.
    #[must_use]
    pub fn with_effects(mut self, effects: EffectRanges) -> Self {
        self.effects = effects;
        self
    }

    /// A room with what is in it, undamaged.
    ///
    /// # Errors
    /// As [`generate`], and if there is no room of this number.
    pub fn room(&self, index: usize) -> Result<SyntheticRoom, DataError> {
        if index >= self.ids.len() {
            let id = format!("room-{index:06}");
            return Err(DataError::UnknownScene { id, known: self.ids.len() });
        }
        let room = self.settings.room.wrapping_add(index as u64);
        Ok(generate(&SyntheticRoomSettings { room, ..self.settings.clone() })?)
    }
}

impl DataSource for SyntheticRooms {
    fn scene_ids(&self) -> &[String] {
        &self.ids
    }

    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        // Ids are in order, so the place is found without a search through all of them.
        let index = self.ids.binary_search_by(|known| {
            // Longer numbers follow shorter ones.
            known.len().cmp(&id.len()).then_with(|| known.as_str().cmp(id))
        });
        let unknown = || DataError::UnknownScene { id: id.to_owned(), known: self.ids.len() };
        let index = index.map_err(|_| unknown())?;
        let mut room = self.room(index)?;
        if let Some(vocabulary) = &self.vocabulary {
            add_features(&mut room, vocabulary);
        }
        let scene = if self.effects.is_empty() {
            room.scene
        } else {
            let mut rng = sample_rng(self.settings.seed, EFFECTS, index as u64);
            let effects = self.effects.draw(&mut rng);
            simulate_in_room(&room, &effects, rng.next_u64())?.simulated.scene
        };
        let report = RepairReport { source_rows: scene.len(), ..RepairReport::default() };
        Ok(SourceScene { scene, report })
    }
}

/// Writes each Gaussian's target into the scene; floaters have none.
fn add_features(room: &mut SyntheticRoom, vocabulary: &Vocabulary) {
    let targets = vocabulary.targets(room);
    let dim = targets.dim;
    let table: Vec<f16> = targets.table.iter().map(|&v| f16::from_f32(v)).collect();
    let mut values = vec![f16::ZERO; targets.index.len() * dim];
    for (out, &row) in values.chunks_exact_mut(dim).zip(&targets.index) {
        if row != NO_TARGET {
            let start = row as usize * dim;
            out.copy_from_slice(&table[start..start + dim]);
        }
    }
    room.scene.valid_feat_mask = Some(targets.index.iter().map(|&row| row != NO_TARGET).collect());
    room.scene.lang_feat = Some(LanguageFeatures { values, dim });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_are_found_by_name_and_do_not_depend_on_their_number() {
        let settings =
            SyntheticRoomSettings { num_gaussians: Some(300), ..SyntheticRoomSettings::default() };
        let few: Box<dyn DataSource> =
            Box::new(SyntheticRooms::new(3, settings.clone(), 5).unwrap());
        let many = SyntheticRooms::new(12, settings, 5).unwrap();
        assert_eq!(few.scene_ids()[1], "room-000001");
        let load = |id| few.load(id).unwrap();
        assert_eq!(load("room-000002"), many.load("room-000002").unwrap());
        assert_eq!(load("room-000002").scene, many.room(2).unwrap().scene);
        assert_ne!(load("room-000001").scene.coord, load("room-000002").scene.coord);
        for id in ["room-000003", "room-2", ""] {
            let error = few.load(id).unwrap_err();
            assert!(matches!(error, DataError::UnknownScene { known: 3, .. }), "{error}");
        }
        assert!(many.room(12).is_err());
    }

    #[test]
    fn rooms_are_damaged_each_by_itself() {
        let settings =
            SyntheticRoomSettings { num_gaussians: Some(900), ..SyntheticRoomSettings::default() };
        let plain = SyntheticRooms::new(4, settings, 5).unwrap();
        let source = |text: &str| plain.clone().with_effects(text.parse().unwrap());
        let load = |source: &SyntheticRooms, room| source.load(room).unwrap().scene;
        let (hurt, again) = (source("holes=1..4"), source("holes=1..4"));
        let mut missing = std::collections::BTreeSet::new();
        for room in ["room-000000", "room-000001", "room-000002", "room-000003"] {
            let scene = load(&hurt, room);
            assert_eq!(scene, load(&again, room));
            missing.insert(900 - scene.len());
        }
        // 3 % for each severity, which is another one in each room.
        assert!(missing.len() > 2 && missing.iter().all(|n| (27..=108).contains(n)), "{missing:?}");
        assert_eq!(load(&source("none"), "room-000001"), load(&plain, "room-000001"));
        let floaters = load(
            &source("floaters=5").with_vocabulary(Arc::new(Vocabulary::new(64).unwrap())),
            "room-000002",
        );
        let mask = floaters.valid_feat_mask.unwrap();
        assert!(mask.len() > 900 && mask[900..].iter().all(|valid| !valid));
    }
}
