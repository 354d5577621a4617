//! A walk with a camera through a room: where somebody can stand, and where they look.

use crate::dice::{between, chance, whole};
use crate::place::{Footprint, Layout, Placed, Pose, STRAIGHT};
use crate::shape::Block;
use crate::vector::{V3, Z, cross, sub, unit_or};
use scenesplat_kernels::random::{SampleRng, cos_sin};

/// Half the width of somebody with a camera, meters.
const HALF: f64 = 0.18;

/// Places tried for each stop.
const TRIES: u32 = 60;

/// A camera: unit axes, right-handed with `right × down = forward`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Camera {
    pub(crate) eye: V3,
    pub(crate) right: V3,
    pub(crate) down: V3,
    pub(crate) forward: V3,
}

impl Camera {
    /// The same, in the frame that `base` is in.
    pub(crate) fn moved(&self, base: &Pose) -> Self {
        Self {
            eye: base.point(self.eye),
            right: base.vector(self.right),
            down: base.vector(self.down),
            forward: base.vector(self.forward),
        }
    }

    fn looking(eye: V3, to: V3) -> Self {
        let forward = unit_or(sub(to, eye), [1.0, 0.0, 0.0]);
        let right = unit_or(cross(forward, Z), [0.0, -1.0, 0.0]);
        Self { eye, right, down: cross(forward, right), forward }
    }
}

/// Two to seven stops on the free floor, at one height that varies a little; some looks around from each, half
/// of them at an object. Nothing where nobody can stand.
pub(crate) fn walk(layout: &Layout, rng: &mut SampleRng) -> Vec<Camera> {
    let height = (layout.height * between(rng, 0.45, 0.72)).min(1.85);
    let [low, high] = [between(rng, -0.7, -0.3), between(rng, -0.1, 0.5)];
    let stops = whole(rng, 2, 7);
    let mut cameras = Vec::new();
    for _ in 0..stops {
        let Some([x, y]) = free_place(layout, rng) else { continue };
        for _ in 0..whole(rng, 3, 7) {
            let eye = [x, y, height + between(rng, -0.15, 0.15)];
            let aim = if chance(rng, 0.5) { object(layout, rng) } else { None };
            let to = aim.unwrap_or_else(|| {
                let [c, s] = cos_sin(rng);
                [x + c, y + s, eye[2] + between(rng, low, high)]
            });
            cameras.push(Camera::looking(eye, to));
        }
    }
    cameras
}

/// One to four stops on the free floor, from each of which a camera in the hand pans over one or two things and what is
/// around them, mostly downwards. Nothing where nobody can stand.
pub(crate) fn look_around(layout: &Layout, rng: &mut SampleRng) -> Vec<Camera> {
    let mut cameras = Vec::new();
    let height = between(rng, 1.0, 1.7).min(layout.height - 0.3);
    for _ in 0..whole(rng, 1, 4) {
        let Some([x, y]) = free_place(layout, rng) else { continue };
        for _ in 0..whole(rng, 1, 2) {
            let middle = layout.size.map(|side| side * between(rng, 0.2, 0.8));
            let aim = object(layout, rng).unwrap_or([middle[0], middle[1], 0.7]);
            for _ in 0..whole(rng, 3, 8) {
                let eye = std::array::from_fn(|i| [x, y, height][i] + between(rng, -0.2, 0.2));
                let spread = |rng: &mut SampleRng| between(rng, -0.9, 0.9);
                let to = [aim[0] + spread(rng), aim[1] + spread(rng), aim[2] + 0.6 * spread(rng)];
                cameras.push(Camera::looking(eye, to));
            }
        }
    }
    cameras
}

fn free_place(layout: &Layout, rng: &mut SampleRng) -> Option<[f64; 2]> {
    for _ in 0..TRIES {
        let [x, y] = layout.size.map(|side| between(rng, 0.2, (side - 0.2).max(0.21)));
        let block = Block { low: [-HALF, -HALF, 0.1], high: [HALF, HALF, 1.7] };
        let footprint = Footprint::of(&block, &Pose { origin: [x, y, 0.0], turn: STRAIGHT });
        if layout.can_stand(&footprint) {
            return Some([x, y]);
        }
    }
    None
}

/// The middle of something that stands or hangs in the room.
fn object(layout: &Layout, rng: &mut SampleRng) -> Option<V3> {
    let some: Vec<&Placed> = layout.objects.iter().filter(|o| !o.footprints.is_empty()).collect();
    if some.is_empty() {
        return None;
    }
    let object = some[whole(rng, 0, some.len() as u32 - 1) as usize];
    Some(object.pose.point(object.model.bounds().middle()))
}
