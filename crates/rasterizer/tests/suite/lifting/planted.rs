//! Labels whose truth is known: a synthetic room, seen with the true objects as segments.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_rasterizer::lifting::{
    DepthEffect, DepthProbe, FinaliseSettings, LabelledPicture, LiftError, LiftSettings, Lifter,
    NO_SEGMENT, SegmentMap,
};
use scenesplat_rasterizer::{
    Gaussians, RasterSettings, Span, TILE, TileRect, TileVisitor, View, blend, project, tile_lists,
};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use scenesplat_scene::vector::cross;

/// Width of the objects' features.
pub const DIM: usize = 64;

/// How large the experiment is.
#[derive(Debug, Clone, Copy)]
pub struct Size {
    /// Gaussians in the room.
    pub gaussians: usize,
    /// Cameras.
    pub views: usize,
    /// Width and height of the pictures.
    pub picture: [u32; 2],
    /// Number of the room.
    pub room: u64,
}

/// A room, its objects' features, and pictures of it with the true objects.
pub struct Planted {
    pub gaussians: Gaussians,
    /// Object of each Gaussian; −1 for what belongs to none.
    pub object: Vec<i32>,
    pub views: Vec<View>,
    /// Ids are objects.
    pub maps: Vec<SegmentMap>,
    /// Unit features of the objects. `[objects, DIM]`
    pub features: Vec<f32>,
}

/// How well labels came back.
#[derive(Debug, Clone)]
pub struct Recovered {
    /// Part of the weight of all Gaussians whose nearest object is their own.
    pub mass: f64,
    /// Part of the Gaussians with coverage ½ or more whose nearest object is their own.
    pub gaussians: f64,
    /// Mean of 1 − cosine to the own object's feature, of the same Gaussians.
    pub error: f64,
    /// Number of these Gaussians.
    pub covered: usize,
    pub disagreement: Option<f64>,
}

impl Planted {
    pub fn new(size: Size) -> Self {
        let settings = SyntheticRoomSettings {
            room: size.room,
            num_gaussians: Some(size.gaussians),
            points_share: 0.0,
            ..SyntheticRoomSettings::default()
        };
        let room = generate(&settings).expect("a room");
        let object = room.scene.instance.clone().expect("objects");
        let gaussians = Gaussians::from_scene(&room.scene).expect("activated values");
        let objects = object.iter().max().map_or(0, |&o| o as usize + 1);
        let views = cameras(room.size, size.views, size.picture);
        let maps = views.iter().map(|view| object_map(&gaussians, &object, view)).collect();
        Self { gaussians, object, views, maps, features: object_features(objects) }
    }

    pub fn num_objects(&self) -> usize {
        self.features.len() / DIM
    }

    /// Lifts the maps onto the Gaussians, with a part of each picture's segments named wrongly.
    pub fn lifter(&self, wrong: f64, settings: LiftSettings) -> Result<Lifter<'_>, LiftError> {
        let mut lifter = Lifter::new(&self.gaussians, 1, DIM, settings)?;
        self.pictures(wrong, |_, picture| lifter.add(picture).map(|_| ()))?;
        Ok(lifter)
    }

    /// What depth agreement changes, by every `step`-th of these pictures.
    pub fn depth_effect(&self, wrong: f64, step: usize) -> Result<DepthEffect, LiftError> {
        let mut probe = DepthProbe::new(&self.gaussians, DIM, &LiftSettings::default())?;
        self.pictures(wrong, |number, picture| match number % step {
            0 => probe.add(picture),
            _ => Ok(()),
        })?;
        probe.effect()
    }

    /// Hands out the pictures with a part of the segments of each named after other objects.
    fn pictures(
        &self,
        wrong: f64,
        mut sink: impl FnMut(usize, &LabelledPicture<'_>) -> Result<(), LiftError>,
    ) -> Result<(), LiftError> {
        let mut rng = ChaCha8Rng::seed_from_u64(77);
        for (number, (view, map)) in self.views.iter().zip(&self.maps).enumerate() {
            let features = self.renamed(wrong, &mut rng);
            let levels = std::slice::from_ref(map);
            sink(number, &LabelledPicture { view, levels, features: &features, depth: None })?;
        }
        Ok(())
    }

    /// The objects' features, each with this probability replaced by another object's.
    fn renamed(&self, wrong: f64, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let (mut features, count) = (self.features.clone(), self.num_objects());
        for (own, row) in features.chunks_exact_mut(DIM).enumerate() {
            if rng.random_bool(wrong) {
                let other = (own + rng.random_range(1..count)) % count;
                row.copy_from_slice(&self.features[other * DIM..(other + 1) * DIM]);
            }
        }
        features
    }

    /// Makes features and compares them with the truth.
    pub fn recover(
        &self,
        lifter: &mut Lifter<'_>,
        settings: &FinaliseSettings,
    ) -> Result<Recovered, LiftError> {
        let lifted = lifter.collect(0, settings)?;
        let (mut mass, mut own_mass, mut covered, mut own, mut error) = (0.0, 0.0, 0, 0, 0.0);
        for (i, &truth) in self.object.iter().enumerate() {
            let feature = &lifted.features[i * DIM..(i + 1) * DIM];
            let cosine = |o: usize| dot(feature, &self.features[o * DIM..(o + 1) * DIM]);
            let Ok(truth_row) = usize::try_from(truth) else { continue };
            let nearest = |a: &usize, b: &usize| cosine(*a).total_cmp(&cosine(*b));
            let found = lifted.valid[i].then(|| (0..self.num_objects()).max_by(nearest)).flatten();
            let is_own = found == Some(truth_row);
            let weight = f64::from(lifted.coverage[i]);
            mass += weight;
            own_mass += if is_own { weight } else { 0.0 };
            if weight >= 0.5 {
                covered += 1;
                own += usize::from(is_own);
                error += 1.0 - f64::from(cosine(truth_row));
            }
        }
        let count = covered.max(1) as f64;
        Ok(Recovered {
            mass: own_mass / mass.max(1e-9),
            gaussians: own as f64 / count,
            error: error / count,
            covered,
            disagreement: lifter.disagreement(0)?.value(),
        })
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Directions around a common one, cosines about 0.5: features of different things are never
/// orthogonal in the networks that make them.
fn object_features(count: usize) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut out = Vec::with_capacity(count * DIM);
    for _ in 0..count {
        let row: Vec<f32> = (0..DIM).map(|_| rng.random_range(-1.0f32..1.0) + 0.577).collect();
        let norm = dot(&row, &row).sqrt();
        out.extend(row.iter().map(|v| v / norm));
    }
    out
}

/// A walk around the middle of a room (z up), looking across it, up and down in turn.
fn cameras(size: [f32; 3], count: usize, picture: [u32; 2]) -> Vec<View> {
    let view = |i: usize| {
        let turn = std::f32::consts::TAU * i as f32 / count as f32;
        let place = [
            size[0] * (0.5 + 0.32 * turn.cos()),
            size[1] * (0.5 + 0.32 * turn.sin()),
            (0.6 * size[2]).clamp(1.0, 1.7),
        ];
        // Across the room, to either side in turn; down, level and up.
        let yaw = turn + std::f32::consts::PI + [0.0, 0.5, -0.5, 1.2][i % 4];
        let pitch = [-0.5f32, -0.1, 0.35][i % 3];
        let forward = [yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin()];
        let right = [yaw.sin(), -yaw.cos(), 0.0];
        let down = cross(forward, right);
        let row = |axis: [f32; 3]| [axis[0], axis[1], axis[2], -dot(&axis, &place)];
        let [width, height] = picture;
        View {
            world_to_camera: [row(right), row(down), row(forward)],
            fx: 0.7 * width as f32,
            fy: 0.7 * width as f32,
            cx: width as f32 / 2.0,
            cy: height as f32 / 2.0,
            width,
            height,
        }
    };
    (0..count).map(view).collect()
}

/// Per pixel the object of the Gaussian with the largest weight.
fn object_map(gaussians: &Gaussians, object: &[i32], view: &View) -> SegmentMap {
    let id = |row: u32| match row {
        u32::MAX => NO_SEGMENT,
        row => u16::try_from(object[row as usize]).unwrap_or(NO_SEGMENT),
    };
    let ids = heaviest(gaussians, view).into_iter().map(id).collect();
    SegmentMap::new(view.width, view.height, ids).expect("one id per pixel")
}

/// Per pixel the Gaussian with the largest weight; `u32::MAX` where there is none.
fn heaviest(gaussians: &Gaussians, view: &View) -> Vec<u32> {
    let settings = RasterSettings::default();
    let projected = project(gaussians, view, &settings).expect("a view");
    let lists = tile_lists(&projected, view, &settings);
    let make = |rect: TileRect| Heaviest { rect, best: [(0.0, u32::MAX); TILE * TILE] };
    let mut rows = vec![u32::MAX; view.pixels()];
    for (rect, best) in blend(&projected, &lists, view, &settings, make) {
        for r in 0..rect.height as usize {
            for c in 0..rect.width as usize {
                let (_, row) = best[r * TILE + c];
                let at = (rect.y0 as usize + r) * view.width as usize + rect.x0 as usize + c;
                if row != u32::MAX {
                    rows[at] = projected.index[row as usize];
                }
            }
        }
    }
    rows
}

/// The Gaussian with the largest weight of each pixel.
struct Heaviest {
    rect: TileRect,
    best: [(f32, u32); TILE * TILE],
}

impl TileVisitor for Heaviest {
    type Output = (TileRect, [(f32, u32); TILE * TILE]);

    fn span(&mut self, _entry: u32, row: u32, span: Span<'_>) {
        for (best, &weight) in self.best[span.at..].iter_mut().zip(span.weights) {
            if weight > best.0 {
                *best = (weight, row);
            }
        }
    }

    fn finish(self, _: &[f32; TILE * TILE], _: &[u32; TILE * TILE]) -> Self::Output {
        (self.rect, self.best)
    }
}
