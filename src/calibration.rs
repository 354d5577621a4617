//! What makes the answers of the network inside the program comparable with the world: at which temperature its cosines
//! are probabilities, and how much surface a thing of each class has at least.

use crate::network::NetworkError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const EMBEDDED: &str = include_str!("../assets/embedded/calibration.json");

/// Measured on rooms that the network was not trained on, by `examples/make_embedded_assets.rs`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// SHA-256 of the weights, hexadecimal.
    pub weights: String,
    /// What cosines with the texts of the classes are divided by before the softmax: the truth is likeliest then.
    pub temperature: f32,
    /// Expected calibration error at this temperature, on other rooms than it was fitted on, 0..=1.
    pub ece: f64,
    /// Of each class, how much surface (square metres) 19 in 20 of its things have more than, in rooms and flats.
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

    /// Least surface of a piece of each class, square metres; 0 for names that it does not know. `[names]`
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
