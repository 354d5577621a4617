//! What makes the answers of a network comparable with the world: at which temperature its cosines
//! are probabilities, and how much surface a thing of each class has at least.

use crate::network::{NetworkError, Weights};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// Its name in the folder of a network.
const FILE: &str = "calibration.json";

const EMBEDDED: &str = include_str!("../assets/embedded/calibration.json");

/// Measured on rooms that the network was not trained on, by `crates/lab/examples/lab/embedded_assets.rs`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// SHA-256 of the weights, hexadecimal.
    pub weights: String,
    /// What cosines with the texts of the classes are divided by before the softmax: the truth is likeliest then.
    pub temperature: f32,
    /// Expected calibration error at this temperature, on other rooms than it was fitted on, 0..=1.
    pub ece: f64,
    /// Of each class, how much surface (square meters) 19 in 20 of its things have more than, in rooms and flats.
    pub surface: BTreeMap<String, f64>,
}

/// What part of that surface a piece must have: of a thing that a scan saw from one side there is half.
const LEAST_PART: f64 = 0.3;

impl Calibration {
    /// That of the network inside the program.
    ///
    /// # Errors
    /// If the program was built with a broken file.
    pub fn embedded() -> Result<Self, NetworkError> {
        serde_json::from_str(EMBEDDED)
            .map_err(NetworkError::config("assets/embedded/calibration.json"))
    }

    /// That of these weights: the network inside the program has one, and a folder in which a `calibration.json` lies
    /// beside `model.safetensors`.
    ///
    /// # Errors
    /// If the file cannot be read, or is of other weights.
    pub fn of(weights: &Weights) -> Result<Option<Self>, NetworkError> {
        let folder = match weights {
            Weights::Embedded => return Self::embedded().map(Some),
            Weights::File(folder) if folder.join(FILE).is_file() => folder,
            _ => return Ok(None),
        };
        let path = folder.join(FILE);
        let text = std::fs::read_to_string(&path).map_err(NetworkError::config(&path))?;
        let found: Self = serde_json::from_str(&text).map_err(NetworkError::config(&path))?;
        let values = folder.join("model.safetensors");
        let values = std::fs::read(&values).map_err(NetworkError::config(&values))?;
        let hash: String = Sha256::digest(values).iter().map(|b| format!("{b:02x}")).collect();
        if found.weights != hash {
            let problem = format!(
                "it is of the weights {}, beside it are {hash}; remove it, or make it again",
                found.weights
            );
            return Err(NetworkError::config(&path)(problem));
        }
        Ok(Some(found))
    }

    /// Least surface of a piece of each class, square meters; 0 for names that it does not know. `[names]`
    pub fn least_area(&self, names: &[String]) -> Vec<f64> {
        names
            .iter()
            .map(|name| LEAST_PART * self.surface.get(name).copied().unwrap_or(0.0))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embedded;
    use scenesplat_objects::surfaces::{SurfaceSettings, surfaces};
    use scenesplat_rooms::{CLASSES, SyntheticRoomSettings, generate};

    #[test]
    fn it_is_of_the_network_inside_the_program() {
        let own = Calibration::embedded().unwrap();
        assert_eq!(own.weights, embedded::sha256());
        assert!((0.02..0.2).contains(&own.temperature) && own.ece < 0.05, "{own:?}");
        let names: Vec<String> = CLASSES.iter().map(|class| class.name.to_owned()).collect();
        assert!(own.surface.keys().all(|name| names.contains(name)));
        let least = own.least_area(&names);
        assert!(least.iter().all(|area| *area > 0.0 && *area < 10.0), "{least:?}");
        assert_eq!(own.least_area(&["throne".to_owned()]), [0.0]);
    }

    #[test]
    fn it_lies_beside_weights_and_is_of_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let weights = Weights::File(folder.path().to_owned());
        assert_eq!(Calibration::of(&weights).unwrap(), None);
        assert_eq!(Calibration::of(&Weights::Seeded(3)).unwrap(), None);
        let own = Calibration::embedded().unwrap();
        assert_eq!(Calibration::of(&Weights::Embedded).unwrap(), Some(own));
        let assets = scenesplat_test_support::repository().join("assets/embedded");
        for name in [FILE, "model.safetensors"] {
            std::fs::copy(assets.join(name), folder.path().join(name)).unwrap();
        }
        assert_eq!(Calibration::of(&weights).unwrap(), Some(Calibration::embedded().unwrap()));
        std::fs::write(folder.path().join("model.safetensors"), "others").unwrap();
        let error = Calibration::of(&weights).unwrap_err();
        let source = std::error::Error::source(&error).map(ToString::to_string);
        let said = format!("{error} {}", source.unwrap_or_default());
        assert!(said.contains(FILE) && said.contains("make it again"), "{said}");
    }

    /// Things of rooms are as large as it says, or the table is of other classes.
    #[test]
    fn hardly_a_thing_has_less_surface() {
        let own = Calibration::embedded().unwrap();
        let names: Vec<String> = CLASSES.iter().map(|class| class.name.to_owned()).collect();
        let (mut all, mut below, mut far_above) = (0, 0, 0);
        for room in 0..12 {
            let settings = SyntheticRoomSettings { seed: 9, room, ..Default::default() };
            let room = generate(&settings).unwrap();
            let color = vec![[0.5; 3]; room.scene.len()];
            let found = surfaces(&room.scene.coord, &color, &SurfaceSettings::default()).unwrap();
            let instance = room.scene.instance.as_ref().unwrap();
            let areas = found.areas(instance, room.objects.len()).unwrap();
            for (object, area) in room.objects.iter().zip(areas) {
                let Some(class) = object.class else { continue };
                let usual = own.surface[&names[class.index()]];
                all += 1;
                below += usize::from(area < LEAST_PART * usual);
                far_above += usize::from(area > 20.0 * usual);
            }
        }
        assert!(all > 200, "{all}");
        assert!(below * 50 < all && far_above * 10 < all, "{below} and {far_above} of {all}");
    }
}
