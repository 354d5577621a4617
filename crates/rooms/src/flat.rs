//! A flat: rooms on both sides of a corridor, or a room by itself.

use crate::dice::{between, chance, whole};
use crate::place::{BACKWARDS, Footprint, Layout, Placed, Pose, STRAIGHT};
use crate::recipe::{self, InFlat, RoomKind};
use crate::stock::Stock;
use crate::vector::V3;
use crate::walk::{Camera, look_around, walk};
use scenesplat_kernels::random::SampleRng;

/// Fewest and most rooms of a flat; the corridor is none of them.
const ROOMS: [u32; 2] = [2, 6];

/// Rooms with their places.
#[derive(Debug)]
pub(crate) struct Flat {
    parts: Vec<(Layout, Pose)>,
    /// Extent, meters; the least corner at the origin.
    size: V3,
    /// How many rooms, without the corridor.
    pub(crate) num_rooms: usize,
}

/// Rooms in a row on one side of the corridor.
struct Row {
    rooms: Vec<Layout>,
    /// Where each begins along the corridor, meters.
    starts: Vec<f64>,
    length: f64,
    depth: f64,
}

impl Flat {
    pub(crate) fn of_one_room(layout: Layout) -> Self {
        let size = [layout.size[0], layout.size[1], layout.height];
        Self {
            parts: vec![(layout, Pose { origin: [0.0; 3], turn: STRAIGHT })],
            size,
            num_rooms: 1,
        }
    }

    /// Two to six rooms, the first of this kind; as thick as the walls between them are, so far apart are the
    /// faces of neighbors.
    pub(crate) fn furnish(first: RoomKind, stock: &mut Stock, rng: &mut SampleRng) -> Self {
        let num_rooms = whole(rng, ROOMS[0], ROOMS[1]) as usize;
        let is_one_sided = num_rooms < 4 && chance(rng, 0.3);
        let above = if is_one_sided { num_rooms } else { num_rooms.div_ceil(2) };
        let thick = between(rng, 0.08, 0.3);
        let wide = between(rng, 0.95, 2.2);
        let flat = InFlat {
            height: between(rng, 2.25, 3.2),
            has_ceiling: chance(rng, 0.6),
            back: between(rng, 0.08, 0.35),
            inner: [false; 4],
        };
        let kinds: Vec<RoomKind> =
            (0..num_rooms).map(|i| if i == 0 { first } else { RoomKind::random(rng) }).collect();
        let up = Row::furnish(&kinds[..above], &flat, thick, stock, rng);
        let down = Row::furnish(&kinds[above..], &flat, thick, stock, rng);

        let length = up.length.max(down.length);
        // Holes of the corridor where the rooms have theirs; its walls run the other way round.
        let above_doors: Vec<[f64; 4]> =
            up.doors().map(|(at, [a, b, z, h])| [length - at - b, length - at - a, z, h]).collect();
        let mirrored = |(index, [a, b, z, h]): (usize, [f64; 4])| {
            let end = down.starts[index] + down.rooms[index].size[0];
            [end - b, end - a, z, h]
        };
        let below_doors: Vec<[f64; 4]> = down.doors_by_room().map(mirrored).collect();
        let ends = InFlat { inner: [!down.rooms.is_empty(), false, true, false], ..flat };
        let corridor = recipe::furnish_corridor(
            [length, wide],
            &ends,
            [&below_doors, &above_doors],
            stock,
            rng,
        );

        // The least corner at the origin.
        let floor = if down.rooms.is_empty() { 0.0 } else { down.depth + thick };
        let top = floor + wide + thick;
        let mut parts = vec![(corridor, Pose { origin: [0.0, floor, 0.0], turn: STRAIGHT })];
        for (room, at) in up.rooms.into_iter().zip(up.starts) {
            parts.push((room, Pose { origin: [at, top, 0.0], turn: STRAIGHT }));
        }
        for (room, at) in down.rooms.into_iter().zip(down.starts) {
            let origin = [at + room.size[0], floor - thick, 0.0];
            parts.push((room, Pose { origin, turn: BACKWARDS }));
        }
        Self { parts, size: [length, top + up.depth, flat.height], num_rooms }
    }

    /// Somebody walks through one room after the other.
    pub(crate) fn walk(&self, rng: &mut SampleRng) -> Vec<Camera> {
        let mut cameras = Vec::new();
        for (layout, base) in &self.parts {
            cameras.extend(walk(layout, rng).iter().map(|camera| camera.moved(base)));
        }
        cameras
    }

    /// Somebody looks at some things of one room with a depth camera.
    pub(crate) fn look_around(&self, rng: &mut SampleRng) -> Vec<Camera> {
        let (layout, base) = &self.parts[whole(rng, 0, self.parts.len() as u32 - 1) as usize];
        look_around(layout, rng).iter().map(|camera| camera.moved(base)).collect()
    }

    /// Its extent, and all objects where they are in it.
    pub(crate) fn into_objects(self) -> (V3, Vec<Placed>) {
        let mut all = Vec::new();
        for (layout, base) in self.parts {
            all.extend(layout.objects.into_iter().map(|object| {
                let pose = base.then(object.pose.origin, object.pose.turn);
                // Parts of the building have none, and get none.
                let blocks = match object.footprints.is_empty() {
                    true => Vec::new(),
                    false => object.model.occupied(),
                };
                let footprints = blocks.iter().map(|b| Footprint::of(b, &pose)).collect();
                Placed { pose, footprints, ..object }
            }));
        }
        (self.size, all)
    }
}

impl Row {
    fn furnish(
        kinds: &[RoomKind],
        flat: &InFlat,
        thick: f64,
        stock: &mut Stock,
        rng: &mut SampleRng,
    ) -> Self {
        let mut row = Self { rooms: Vec::new(), starts: Vec::new(), length: 0.0, depth: 0.0 };
        for (index, &kind) in kinds.iter().enumerate() {
            // The corridor is at the bottom of each, neighbors beside it.
            let inner = [true, index + 1 < kinds.len(), false, index > 0];
            let flat = InFlat { inner, ..*flat };
            let room = recipe::furnish_in(kind, Some(&flat), stock, rng);
            if index > 0 {
                row.length += thick;
            }
            row.starts.push(row.length);
            row.length += room.size[0];
            row.depth = row.depth.max(room.size[1]);
            row.rooms.push(room);
        }
        row
    }

    /// Holes to the corridor, each with the index of its room, in the frame of that.
    fn doors_by_room(&self) -> impl Iterator<Item = (usize, [f64; 4])> {
        let rooms = self.rooms.iter().enumerate();
        rooms
            .flat_map(|(index, room)| room.walls[0].openings.iter().map(move |&hole| (index, hole)))
    }

    /// The same, each with where its room begins.
    fn doors(&self) -> impl Iterator<Item = (f64, [f64; 4])> {
        self.doors_by_room().map(|(index, hole)| (self.starts[index], hole))
    }
}
