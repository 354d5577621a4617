//! Synthetic rooms as a source of scenes.

use crate::effects::{EffectRanges, simulate_in_room};
use crate::error::{bad_setting, require};
use crate::{DataError, DataSource, SourceScene};
use half::f16;
use rand_chacha::rand_core::RngCore;
use scenesplat_kernels::random::sample_rng;
use scenesplat_rooms::vocabulary::{NO_TARGET, Vocabulary};
use scenesplat_rooms::{CLASSES, SyntheticObject, SyntheticRoom, SyntheticRoomSettings, generate};
use scenesplat_scene::{LanguageFeatures, RepairReport, TextTable};
use std::collections::HashMap;
use std::sync::Arc;

/// Most rooms of a source.
pub const MAX_ROOMS: usize = 1_000_000;
/// The epoch that no training has: random numbers of the damage of rooms.
const EFFECTS: u64 = u64::MAX;

/// Where the language features of objects come from.
#[derive(Debug)]
enum ObjectTargets {
    /// Class, groups and color of each.
    Vocabulary(Arc<Vocabulary>),
    /// The vectors of what they are called.
    Texts {
        dim: usize,
        /// By the name in small letters.
        rows: HashMap<String, Vec<f16>>,
    },
}

/// Any number of rooms `room-000000`, `room-000001`, …; nothing is kept, `load` generates.
#[derive(Debug, Clone)]
pub struct SyntheticRooms {
    ids: Vec<String>,
    settings: SyntheticRoomSettings,
    targets: Option<Arc<ObjectTargets>>,
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
        require(count <= MAX_ROOMS, "count", count, "at most 1000000 rooms")?;
        let ids = (0..count).map(|i| format!("room-{i:06}")).collect();
        settings.seed = seed;
        // Now rather than at the first room.
        settings.catalogue()?;
        Ok(Self { ids, settings, targets: None, effects: EffectRanges::default() })
    }

    /// Gives every Gaussian of an object its feature in the vocabulary: class, groups and color.
    #[must_use]
    pub fn with_vocabulary(mut self, vocabulary: Arc<Vocabulary>) -> Self {
        self.targets = Some(Arc::new(ObjectTargets::Vocabulary(vocabulary)));
        self
    }

    /// Gives every Gaussian of an object the text vector of what the object is called: of its name, whatever the
    /// case, or where the table does not have it, of its class. Things that have neither get none.
    ///
    /// # Errors
    /// If the table lacks one of the classes, or has a name twice with different vectors.
    pub fn with_texts(mut self, table: &TextTable) -> Result<Self, DataError> {
        let mut rows: HashMap<String, Vec<f16>> = HashMap::new();
        for (name, row) in table.names.iter().zip(table.values.chunks_exact(table.dim)) {
            let row: Vec<f16> = row.iter().map(|&v| f16::from_f32(v)).collect();
            let key = name.trim().to_lowercase();
            if rows.get(&key).is_some_and(|other| *other != row) {
                let value = format!("two vectors for {name:?}");
                return Err(bad_setting("texts", value, "one vector for each name"));
            }
            rows.insert(key, row);
        }
        let lacking: Vec<&str> =
            CLASSES.iter().map(|c| c.name).filter(|&name| !rows.contains_key(name)).collect();
        let value = format!("no vector for {}", lacking.join(", "));
        let expected = "a row for the name of each of the 41 classes";
        require(lacking.is_empty(), "texts", value, expected)?;
        self.targets = Some(Arc::new(ObjectTargets::Texts { dim: table.dim, rows }));
        Ok(self)
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
        match self.targets.as_deref() {
            Some(ObjectTargets::Vocabulary(vocabulary)) => add_features(&mut room, vocabulary),
            Some(ObjectTargets::Texts { dim, rows }) => add_texts(&mut room, rows, *dim),
            None => {}
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

/// Writes the text of each Gaussian's object into the scene; floaters and things without a text have none.
fn add_texts(room: &mut SyntheticRoom, rows: &HashMap<String, Vec<f16>>, dim: usize) {
    let text_of = |object: &SyntheticObject| {
        let own = rows.get(&object.name.trim().to_lowercase());
        own.or_else(|| rows.get(object.class?.about().name)).map(Vec::as_slice)
    };
    let texts: Vec<Option<&[f16]>> = room.objects.iter().map(text_of).collect();
    let instance = room.scene.instance.as_deref().unwrap_or(&[]);
    let mut values = vec![f16::ZERO; instance.len() * dim];
    let mut is_valid = vec![false; instance.len()];
    for (row, &instance) in instance.iter().enumerate() {
        let object = usize::try_from(instance).ok().and_then(|i| texts.get(i));
        if let Some(Some(text)) = object {
            values[row * dim..(row + 1) * dim].copy_from_slice(text);
            is_valid[row] = true;
        }
    }
    room.scene.valid_feat_mask = Some(is_valid);
    room.scene.lang_feat = Some(LanguageFeatures { values, dim });
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

    /// The k-th class has the k-th unit vector; `more` are further rows.
    fn texts(more: &[(&str, usize)]) -> TextTable {
        let dim = 64;
        let all = CLASSES.iter().enumerate().map(|(k, class)| (class.name, k));
        let (mut names, mut values) = (Vec::new(), Vec::new());
        for (name, k) in all.chain(more.iter().copied()) {
            names.push(name.to_owned());
            values.extend((0..dim).map(|i| f32::from(u8::from(i == k))));
        }
        TextTable { names, dim, values }
    }

    #[test]
    fn texts_are_those_of_the_objects_that_gaussians_are_of() {
        let settings =
            SyntheticRoomSettings { num_gaussians: Some(4000), ..SyntheticRoomSettings::default() };
        let rooms = SyntheticRooms::new(4, settings, 5).unwrap();
        let with = rooms.clone().with_texts(&texts(&[])).unwrap();
        let mut floaters = 0;
        for id in with.scene_ids() {
            let scene = with.load(id).unwrap().scene;
            let (features, valid) = (scene.lang_feat.unwrap(), scene.valid_feat_mask.unwrap());
            for (row, &class) in scene.segment.unwrap().iter().enumerate() {
                let vector = &features.values[row * 64..(row + 1) * 64];
                let largest = vector.iter().position(|v| v.to_f32() == 1.0);
                assert_eq!(largest, usize::try_from(class).ok(), "{id}, row {row}");
                assert_eq!(valid[row], class >= 0, "{id}, row {row}");
                floaters += usize::from(class < 0);
            }
        }
        assert!(floaters > 0, "without floaters the test says nothing of them");

        let mut short = texts(&[]);
        short.names[3] = "nothing".to_owned();
        let error = rooms.clone().with_texts(&short).unwrap_err().to_string();
        assert!(error.contains(CLASSES[3].name), "{error}");
        let error = rooms.with_texts(&texts(&[("Wall", 50)])).unwrap_err().to_string();
        assert!(error.contains("two vectors for \"Wall\""), "{error}");
    }

    #[test]
    fn the_name_of_an_object_goes_before_its_class() {
        let settings =
            SyntheticRoomSettings { num_gaussians: Some(4000), ..SyntheticRoomSettings::default() };
        let rooms = SyntheticRooms::new(1, settings, 5).unwrap();
        let mut room = rooms.room(0).unwrap();
        let floor = room.objects.iter().position(|o| o.name == "floor").unwrap();
        let wall = room.objects.iter().position(|o| o.name == "wall").unwrap();
        room.objects[floor].name = "Old Planks".to_owned();
        room.objects[wall].class = None;
        room.objects[wall].name = "no such text".to_owned();
        let with = rooms.with_texts(&texts(&[("old planks", 60)])).unwrap();
        let Some(ObjectTargets::Texts { dim, rows }) = with.targets.as_deref() else { panic!() };
        add_texts(&mut room, rows, *dim);
        let features = room.scene.lang_feat.unwrap();
        let valid = room.scene.valid_feat_mask.unwrap();
        for (row, &instance) in room.scene.instance.unwrap().iter().enumerate() {
            if instance == floor as i32 {
                assert_eq!(features.values[row * 64 + 60].to_f32(), 1.0);
            }
            assert_eq!(valid[row], instance >= 0 && instance != wall as i32, "row {row}");
        }
    }

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
