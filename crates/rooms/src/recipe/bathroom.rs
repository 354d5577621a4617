//! Bathrooms.

use super::Room;
use crate::dice::between;
use crate::furniture::{bathroom, decoration, openings, seating, small, storage};

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
        self.some_at_wall(&[
            (storage::cabinet, 0.3),
            (small::trash_can, 0.6),
            (seating::stool, 0.35),
            (decoration::plant, 0.3),
            (small::carton, 0.2),
        ]);
        if self.likely(0.5) {
            self.at_wall(|rng| openings::radiator(between(rng, 0.5, 0.9), rng));
        }
        if self.likely(0.7) {
            self.on_floor(|rng| {
                decoration::rug([between(rng, 0.3, 0.5), between(rng, 0.22, 0.35)], rng)
            });
        }
    }
}
