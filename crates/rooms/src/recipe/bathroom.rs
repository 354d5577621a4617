//! Bathrooms.

use super::Room;
use crate::dice::between;
use crate::furniture::{bathroom, decoration, openings, seating, small, storage};
use crate::model::Build;
use crate::stock::Place;

impl Room<'_> {
    pub(super) fn bathroom(&mut self) {
        if self.likely(0.8) {
            self.at_wall(bathroom::bathtub);
        }
        self.at_wall(bathroom::toilet);
        if let Some(sink) = self.at_wall(bathroom::sink) {
            self.above(sink, decoration::mirror, 0.5);
            if self.likely(0.2) {
                self.at_wall(bathroom::sink);
            }
        }
        for (build, probability) in [
            (storage::cabinet as Build, 0.3),
            (small::trash_can, 0.6),
            (seating::stool, 0.35),
            (decoration::plant, 0.3),
            (small::carton, 0.2),
        ] {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
        if self.likely(0.5) {
            let heater = openings::radiator(between(self.rng, 0.5, 0.9), self.rng);
            let heater = self.stock.instead(heater, Place::Floor);
            self.layout.against_wall(heater, [0.0, 0.0], self.rng);
        }
        if self.likely(0.7) {
            let rug = decoration::rug(
                [between(self.rng, 0.3, 0.5), between(self.rng, 0.22, 0.35)],
                self.rng,
            );
            let rug = self.stock.instead(rug, Place::Floor);
            self.layout.on_floor(rug, self.rng);
        }
    }
}
