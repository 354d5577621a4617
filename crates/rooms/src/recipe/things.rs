//! Things of a catalogue that no recipe has a place for: clutter on furniture, on the floor and on walls.
//! Many have a name and no class.

use super::{Room, RoomKind};
use crate::catalogue::Entry;
use crate::classes::ClassId;
use crate::dice::{between, whole};
use crate::stock::Place;

/// Where libraries put what is in a kind of room.
fn categories(kind: RoomKind) -> &'static [&'static str] {
    match kind {
        RoomKind::Living => &["Living room", "Miscellaneous", "Lights", "Office"],
        RoomKind::Bedroom => &["Bedroom", "Living room", "Miscellaneous", "Lights"],
        RoomKind::Office => &["Office", "Living room", "Miscellaneous", "Lights"],
        RoomKind::Kitchen => &["Kitchen", "Miscellaneous"],
        RoomKind::Bathroom => &["Bathroom"],
        RoomKind::Pantry => &["Kitchen", "Office", "Miscellaneous", "Lights"],
        RoomKind::OpenOffice | RoomKind::Meeting | RoomKind::Classroom => {
            &["Office", "Miscellaneous", "Lights"]
        }
        RoomKind::Lobby => &["Living room", "Office", "Miscellaneous", "Lights"],
        RoomKind::Ward => &["Bedroom", "Bathroom", "Office", "Miscellaneous"],
        RoomKind::Mixed | RoomKind::Shop | RoomKind::Workshop => &[],
    }
}

/// Classes that recipes place on purpose: another bed is no clutter.
fn is_clutter(entry: &Entry) -> bool {
    match entry.meaning.class() {
        None => true,
        Some(class) => matches!(
            class,
            ClassId::Plant
                | ClassId::Lamp
                | ClassId::Book
                | ClassId::Box
                | ClassId::Mug
                | ClassId::Clock
                | ClassId::Picture
                | ClassId::TrashCan
                | ClassId::Stool
        ),
    }
}

impl Room<'_> {
    pub(super) fn things(&mut self, kind: RoomKind) {
        if self.stock.is_empty() {
            return;
        }
        let known = categories(kind);
        // Folders of models need not say categories.
        let belongs = |entry: &Entry| {
            let category = entry.category.as_str();
            known.is_empty() || category.is_empty() || known.contains(&category)
        };
        for parent in 0..self.layout.objects.len() {
            let supports = self.layout.objects[parent].model.supports.len() as u32;
            if supports == 0 {
                continue;
            }
            for _ in 0..whole(self.rng, 0, 3) {
                let support = whole(self.rng, 0, supports - 1) as usize;
                let fits = |entry: &Entry| {
                    let [w, d, h] = entry.size;
                    w.max(d) < 0.6 && h < 0.6 && is_clutter(entry) && belongs(entry)
                };
                let Some(model) = self.stock.thing(Place::Top, fits) else { continue };
                self.layout.on_top(parent, support, model, None, self.rng);
            }
        }
        for _ in 0..whole(self.rng, 0, 5) {
            let fits = |entry: &Entry| {
                let [w, d, h] = entry.size;
                let is_large = w.max(d) > 0.25 || h > 0.3;
                is_large && w.max(d) < 2.1 && h < 2.2 && is_clutter(entry) && belongs(entry)
            };
            let Some(model) = self.stock.thing(Place::Floor, fits) else { continue };
            if self.likely(0.6) {
                self.layout.against_wall(model, [0.0, 0.0], self.rng);
            } else {
                self.layout.on_floor(model, self.rng);
            }
        }
        for _ in 0..whole(self.rng, 0, 5) {
            let fits = |entry: &Entry| is_clutter(entry) && belongs(entry);
            let Some(model) = self.stock.thing(Place::Wall, fits) else { continue };
            let at = model.piece.as_ref().map_or(1.4, |piece| piece.elevation);
            // Nobody measures: a few centimeters more or less.
            let z = (at + between(self.rng, -0.05, 0.05)).max(0.05);
            self.layout.against_wall(model, [z, z], self.rng);
        }
    }
}
