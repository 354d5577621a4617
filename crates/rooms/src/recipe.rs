//! What kinds of rooms there are and what stands in them.

mod bathroom;
mod bedroom;
mod extras;
mod kitchen;
mod living;
mod office;
mod pantry;
mod public;
mod things;

use crate::dice::{between, chance, weighted, whole};
use crate::furniture;
use crate::model::{Build, Model};
use crate::place::{Layout, STRAIGHT};
use crate::shell::{Plan, USUAL_BACK, build};
use crate::stock::{Place, Stock};
use scenesplat_kernels::random::SampleRng;
use serde::{Deserialize, Serialize};

/// What a room is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RoomKind {
    /// Sofa, television, dining table.
    Living,
    /// Bed, nightstands, wardrobe.
    Bedroom,
    /// Desks with computers.
    Office,
    /// Run of cabinets with sink and stove.
    Kitchen,
    /// Toilet, washbasin, bathtub.
    Bathroom,
    /// A flat of one room: two of the others together, sometimes with a bathtub or a sink.
    Mixed,
    /// The kitchen of a workplace: cabinets over a corner, a large table, papers and boxes.
    Pantry,
    /// Many desks in blocks.
    OpenOffice,
    /// A long table with chairs and a screen.
    Meeting,
    /// Shelves in rows, tables of goods, a counter.
    Shop,
    /// Beds with curtains between them.
    Ward,
    /// Desks in rows.
    Classroom,
    /// Benches, shelves, boxes.
    Workshop,
    /// Seats along the walls, a desk to be received at.
    Lobby,
}

impl RoomKind {
    /// Rooms of homes.
    pub const HOMES: [Self; 6] =
        [Self::Living, Self::Bedroom, Self::Office, Self::Kitchen, Self::Bathroom, Self::Mixed];

    /// Places other than homes.
    pub const PUBLIC: [Self; 8] = [
        Self::Pantry,
        Self::OpenOffice,
        Self::Meeting,
        Self::Shop,
        Self::Ward,
        Self::Classroom,
        Self::Workshop,
        Self::Lobby,
    ];

    /// Chosen so that each class is in a tenth of the rooms of homes or more.
    const WEIGHTS: [f64; 6] = [0.17, 0.17, 0.15, 0.16, 0.17, 0.18];

    /// Of [`PUBLIC`](Self::PUBLIC).
    const PUBLIC_WEIGHTS: [f64; 8] = [0.25, 0.14, 0.14, 0.12, 0.1, 0.08, 0.08, 0.09];

    /// A room of a home.
    pub(crate) fn random(rng: &mut SampleRng) -> Self {
        Self::HOMES[weighted(rng, &Self::WEIGHTS)]
    }

    /// A place that is no home.
    pub(crate) fn random_public(rng: &mut SampleRng) -> Self {
        Self::PUBLIC[weighted(rng, &Self::PUBLIC_WEIGHTS)]
    }

    /// Whether it is a place other than a home.
    pub fn is_public(self) -> bool {
        Self::PUBLIC.contains(&self)
    }

    /// Smallest and largest side of the plan, meters.
    fn sides(self) -> [f64; 2] {
        match self {
            Self::Living => [3.4, 6.0],
            Self::Bedroom => [3.0, 5.0],
            Self::Office => [2.9, 5.4],
            Self::Kitchen => [2.7, 5.0],
            Self::Bathroom => [2.1, 3.5],
            Self::Mixed => [4.2, 6.8],
            Self::Pantry => [3.2, 6.0],
            Self::Meeting => [3.4, 6.5],
            Self::OpenOffice | Self::Shop | Self::Classroom => [4.8, 7.6],
            Self::Ward | Self::Workshop | Self::Lobby => [4.2, 7.0],
        }
    }
}

/// What the rooms of a flat have in common, and which sides of this one have others behind them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct InFlat {
    pub(crate) height: f64,
    pub(crate) has_ceiling: bool,
    pub(crate) back: f64,
    pub(crate) inner: [bool; 4],
}

/// Builds and furnishes a room.
pub(crate) fn furnish(kind: RoomKind, stock: &mut Stock, rng: &mut SampleRng) -> Layout {
    furnish_in(kind, None, stock, rng)
}

/// A corridor, and what stands in one: doors as [`corridor`](crate::shell::corridor) has them.
pub(crate) fn furnish_corridor(
    size: [f64; 2],
    flat: &InFlat,
    doors: [&[[f64; 4]]; 2],
    stock: &mut Stock,
    rng: &mut SampleRng,
) -> Layout {
    let InFlat { height, has_ceiling, back, inner } = *flat;
    let plan = Plan {
        size,
        height,
        notch: None,
        is_wet: false,
        is_public: false,
        has_ceiling,
        inner: Some(inner),
        back,
    };
    let mut layout = crate::shell::corridor(&plan, doors, stock, rng);
    let mut room = Room { layout: &mut layout, stock, rng };
    room.some_at_wall(&[(furniture::storage::cabinet, 0.3), (furniture::storage::wardrobe, 0.3)]);
    room.extras(RoomKind::Living);
    layout
}

/// A room by itself, or one of a flat.
pub(crate) fn furnish_in(
    kind: RoomKind,
    flat: Option<&InFlat>,
    stock: &mut Stock,
    rng: &mut SampleRng,
) -> Layout {
    let [short, long] = kind.sides();
    let size = [between(rng, short, long), between(rng, short, long)];
    let is_l = kind != RoomKind::Bathroom && size[0].min(size[1]) > 3.3 && chance(rng, 0.3);
    let notch = is_l.then(|| size.map(|s| s * between(rng, 0.25, 0.45)));
    let mut plan = Plan {
        size,
        height: between(rng, 2.25, 3.2),
        notch,
        is_wet: kind == RoomKind::Bathroom,
        is_public: kind.is_public(),
        has_ceiling: chance(rng, 0.7),
        inner: None,
        back: USUAL_BACK,
    };
    if let Some(&InFlat { height, has_ceiling, back, inner }) = flat {
        plan = Plan { height, has_ceiling, back, inner: Some(inner), ..plan };
    }
    let mut layout = build(&plan, stock, rng);
    let mut room = Room { layout: &mut layout, stock, rng };
    match kind {
        RoomKind::Living => room.living(),
        RoomKind::Bedroom => room.bedroom(),
        RoomKind::Office => room.office(),
        RoomKind::Kitchen => room.kitchen(),
        RoomKind::Bathroom => room.bathroom(),
        RoomKind::Mixed => room.mixed(),
        RoomKind::Pantry => room.pantry(),
        RoomKind::OpenOffice => room.open_office(),
        RoomKind::Meeting => room.meeting(),
        RoomKind::Shop => room.shop(),
        RoomKind::Ward => room.ward(),
        RoomKind::Classroom => room.classroom(),
        RoomKind::Workshop => room.workshop(),
        RoomKind::Lobby => room.lobby(),
    }
    room.extras(kind);
    room.clutter();
    room.things(kind);
    layout
}

struct Room<'a> {
    layout: &'a mut Layout,
    stock: &'a mut Stock,
    rng: &'a mut SampleRng,
}

impl Room<'_> {
    fn likely(&mut self, probability: f64) -> bool {
        chance(self.rng, probability)
    }

    /// Builds a model, or takes a piece of a catalogue instead.
    fn make(&mut self, build: impl FnOnce(&mut SampleRng) -> Model, place: Place) -> Model {
        let model = build(self.rng);
        self.stock.instead(model, place)
    }

    fn at_wall(&mut self, build: impl FnOnce(&mut SampleRng) -> Model) -> Option<usize> {
        let model = self.make(build, Place::Floor);
        self.layout.against_wall(model, [0.0, 0.0], self.rng)
    }

    /// Of these, each with its probability.
    fn some_at_wall(&mut self, some: &[(Build, f64)]) {
        for &(build, probability) in some {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
    }

    /// On a wall, its middle between these heights.
    fn hang(&mut self, build: Build, z: [f64; 2]) -> Option<usize> {
        let model = self.make(build, Place::Wall);
        self.layout.against_wall(model, z, self.rng)
    }

    fn on_floor(&mut self, build: impl FnOnce(&mut SampleRng) -> Model) -> Option<usize> {
        let model = self.make(build, Place::Floor);
        self.layout.on_floor(model, self.rng)
    }

    /// Something on the wall above an object that stands at it.
    fn above(&mut self, parent: usize, build: Build, gap: f64) -> Option<usize> {
        let model = self.make(build, Place::Wall);
        let block = model.extent();
        let object = &self.layout.objects[parent];
        let bounds = object.model.bounds();
        let z = bounds.high[2] + gap.max(0.05 - block.low[2]);
        let pose = object.pose.then([0.0, bounds.low[1] - block.low[1] + 0.003, z], STRAIGHT);
        self.layout.try_put(model, pose).ok()
    }

    fn mixed(&mut self) {
        let first = whole(self.rng, 0, 3);
        let second = (first + whole(self.rng, 1, 3)) % 4;
        for kind in [first, second] {
            match kind {
                0 => self.living(),
                1 => self.bedroom(),
                2 => self.workplace(),
                _ => self.kitchen(),
            }
        }
        self.some_at_wall(&[
            (furniture::bathroom::sink, 0.15),
            (furniture::bathroom::bathtub, 0.12),
            (furniture::bathroom::toilet, 0.1),
            (furniture::kitchen::refrigerator, 0.25),
        ]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn nothing_stands_in_anything_else() {
        let mut num_objects = 0;
        for index in 0..120 {
            let mut rng = sample_rng(11, index, 0);
            let kind = RoomKind::random(&mut rng);
            let layout = furnish(kind, &mut Stock::none(), &mut rng);
            num_objects += layout.objects.len();
            for (i, a) in layout.objects.iter().enumerate() {
                for b in &layout.objects[..i] {
                    let overlap =
                        a.footprints.iter().any(|f| b.footprints.iter().any(|g| f.overlaps(g)));
                    let (a, b) = (a.model.class, b.model.class);
                    assert!(!overlap, "{kind:?} {index}: {a:?} in {b:?}");
                }
                let is_flat = a.footprints.is_empty();
                let class = a.model.class.expect("without a catalogue all have one");
                assert_eq!(is_flat, class.about().groups == [crate::Group::Structure]);
            }
        }
        assert!(num_objects > 120 * 18, "{num_objects}");
    }
}
