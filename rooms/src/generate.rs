//! A room from its settings: layout, surfaces, and the Gaussians scattered on them.

use crate::classes::ClassId;
use crate::error::RoomError;
use crate::material::ColorName;
use crate::model::Surface;
use crate::place::{Footprint, Placed};
use crate::recipe::{self, RoomKind};
use crate::scan::Scan;
use crate::shape;
use crate::splats::{self, Look, Owner, Rows, rounded_ln};
use rayon::prelude::*;
use scenesplat_kernels::random::{sample_rng, unit};
use scenesplat_scene::GaussianScene;
use serde::{Deserialize, Serialize};

/// Most Gaussians of a room.
pub const MAX_GAUSSIANS: usize = 20_000_000;

/// Gaussians lie at most this far outside the bounds of their object, metres.
pub const MAX_STRAY: f32 = splats::MAX_STRAY as f32 + 1e-4;

/// Streams of random numbers of a room; objects have those from `FIRST_OBJECT` on.
const LAYOUT: u64 = 0;
const LOOK: u64 = 1;
const FLOATERS: u64 = 2;
const FIRST_OBJECT: u64 = 3;
/// What a scan varies; rooms with so many objects there are not.
const SCAN: u64 = u64::MAX;

/// How the Gaussians of a room came about.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Capture {
    /// Furniture has more Gaussians than walls, small things most: density and size tell the class.
    #[default]
    Made,
    /// As scans differ from each other, and nothing of it tells the class: the density of each object,
    /// and of the room, from an eighth to twice what is asked for; sizes and opacities from faint to
    /// swollen; rough surfaces; more floaters and larger holes; what lies below the floor.
    Scan,
}

/// Which room.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SyntheticRoomSettings {
    /// Changes everything.
    pub seed: u64,
    /// Number of the room among those of a seed.
    pub room: u64,
    /// Gaussians per square metre of floor or wall, above 0; furniture gets up to twice, small
    /// things up to nine times as many (unless [`capture`](Self::capture) says otherwise). 500 fills most
    /// voxels of 4 cm, 2 500 those of 2 cm.
    pub gaussians_per_m2: f32,
    /// Exact number of Gaussians, whatever the density.
    pub num_gaussians: Option<usize>,
    /// Kind of the room; drawn if absent.
    pub kind: Option<RoomKind>,
    /// Share of rooms that look as converted points instead of captures, 0..=1.
    pub points_share: f32,
    /// How the Gaussians came about.
    pub capture: Capture,
}

impl Default for SyntheticRoomSettings {
    fn default() -> Self {
        Self {
            seed: 0,
            room: 0,
            gaussians_per_m2: 500.0,
            num_gaussians: None,
            kind: None,
            points_share: 0.3,
            capture: Capture::Made,
        }
    }
}

/// An object of a room.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticObject {
    /// What it is.
    pub class: ClassId,
    /// Its value in `instance`: its index in [`SyntheticRoom::objects`].
    pub instance: i32,
    /// What the colour of its main part is called, before light falls on it.
    pub color: ColorName,
    /// Corners of the box along the axes around its surfaces, metres; Gaussians stray from it by
    /// up to [`MAX_STRAY`].
    pub bounds: [[f32; 3]; 2],
}

/// A room and what is in it.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticRoom {
    /// The Gaussians, with normals, `segment` (row of [`CLASSES`](crate::CLASSES)) and `instance`; +z is up, the
    /// floor at z = 0, metres. Only floaters have the labels −1.
    pub scene: GaussianScene,
    /// Extent of the room, metres; the corner at the origin.
    pub size: [f32; 3],
    /// What kind it is.
    pub kind: RoomKind,
    /// Whether its Gaussians look as converted points.
    pub is_points: bool,
    /// All objects, parts of the building included; some may have no Gaussian.
    pub objects: Vec<SyntheticObject>,
}

/// Generates a room: 25 to 30 ms per 100 000 Gaussians on one core of an ordinary server; objects
/// are filled in parallel on the current rayon pool.
///
/// ```
/// use scenesplat_rooms::{SyntheticRoomSettings, generate};
///
/// let settings = SyntheticRoomSettings { num_gaussians: Some(2000), ..Default::default() };
/// let room = generate(&settings)?;
/// assert_eq!(room.scene.len(), 2000);
/// let names: Vec<_> = room.objects.iter().map(|o| (o.color.word(), o.class.about().name)).collect();
/// assert!(names.iter().any(|&(_, class)| class == "floor"), "{names:?}");
/// # Ok::<(), scenesplat_rooms::RoomError>(())
/// ```
///
/// # Errors
/// If a setting is out of range, or more than [`MAX_GAUSSIANS`] would be made.
pub fn generate(settings: &SyntheticRoomSettings) -> Result<SyntheticRoom, RoomError> {
    settings.check()?;
    let (seed, room) = (settings.seed, settings.room);
    let mut rng = sample_rng(seed, room, LAYOUT);
    let kind = RoomKind::random(&mut rng);
    let kind = settings.kind.unwrap_or(kind);
    let layout = recipe::furnish(kind, &mut rng);
    let size = [layout.size[0], layout.size[1], layout.height];
    let mut rng = sample_rng(seed, room, LOOK);
    let is_points = unit(&mut rng) < f64::from(settings.points_share);
    let mut look = Look::new(is_points, size, &mut rng);
    let mut density = f64::from(settings.gaussians_per_m2);
    let scan = match settings.capture {
        Capture::Made => None,
        Capture::Scan => {
            let mut rng = sample_rng(seed, room, SCAN);
            let scan = Scan::new(size, layout.objects.len(), &mut rng);
            scan.change(&mut look);
            density *= scan.density;
            Some((scan, rng))
        }
    };

    let is_seen = |surface: &Surface| is_points || !surface.hidden;
    let weight = |index: usize, s: &Surface| match &scan {
        _ if !is_seen(s) => 0.0,
        None => s.shape.area() * s.density,
        Some((scan, _)) => s.shape.area() * scan.objects[index].density,
    };
    let weights: Vec<f64> = (layout.objects.iter().enumerate())
        .flat_map(|(index, o)| o.model.surfaces.iter().map(move |s| (index, s)))
        .map(|(index, s)| weight(index, s))
        .collect();
    let total: f64 = weights.iter().sum();
    let n = settings.num_gaussians.unwrap_or((total * density) as usize);
    if n > MAX_GAUSSIANS {
        return Err(too_many("gaussians_per_m2", density.to_string()));
    }
    let num_floaters = (n as f64 * look.floaters) as usize;
    let num_below = scan.as_ref().map_or(0, |(scan, _)| (n as f64 * scan.below) as usize);
    let counts = shares(&weights, total, n - num_floaters - num_below);

    let sizes = |index: usize| scan.as_ref().map_or(0.0, |(scan, _)| scan.objects[index].ln_size);
    let mut rows = scatter_all(&layout.objects, &counts, &look, &sizes, [seed, room]);
    let spacing = rounded_ln((total / n.max(1) as f64).sqrt().clamp(1e-4, 0.2));
    let mut rng = sample_rng(seed, room, FLOATERS);
    for _ in 0..num_floaters {
        rows.push_floater(size, spacing, &mut rng);
    }
    if let Some((scan, mut rng)) = scan {
        for _ in 0..num_below {
            rows.push_below(size, scan.deep, spacing, &mut rng);
        }
    }
    Ok(SyntheticRoom {
        scene: rows.into_scene(),
        size: size.map(|v| v as f32),
        kind,
        is_points,
        objects: layout.objects.iter().enumerate().map(describe).collect(),
    })
}

/// Gaussians on all surfaces, `counts` of them, in the order of the objects.
fn scatter_all(
    objects: &[Placed],
    counts: &[usize],
    look: &Look,
    ln_size: &(dyn Fn(usize) -> f64 + Sync),
    [seed, room]: [u64; 2],
) -> Rows {
    let shadows: Vec<Footprint> = objects.iter().flat_map(casts_shadow).copied().collect();
    let mut counts_left = counts;
    let tasks: Vec<(&Placed, &[usize])> = (objects.iter())
        .map(|object| {
            let (own, rest) = counts_left.split_at(object.model.surfaces.len());
            counts_left = rest;
            (object, own)
        })
        .collect();
    let mut parts: Vec<Rows> = (tasks.par_iter().enumerate())
        .map(|(index, &(object, counts))| {
            // Numbers of its own for each object: threads cannot change who draws which.
            let mut rng = sample_rng(seed, room, FIRST_OBJECT + index as u64);
            let is_floor = object.model.class == ClassId::Floor && look.ambient < 1.0;
            let owner = Owner {
                pose: &object.pose,
                segment: object.model.class.index() as i32,
                instance: index as i32,
                shadows: if is_floor { &shadows } else { &[] },
                ln_size: ln_size(index),
            };
            let mut rows = Rows::with_capacity(counts.iter().sum());
            for (surface, &count) in object.model.surfaces.iter().zip(counts) {
                rows.scatter(surface, count, &owner, look, &mut rng);
            }
            rows
        })
        .collect();
    let mut rows = Rows::with_capacity(counts.iter().sum());
    for part in &mut parts {
        rows.append(part);
    }
    rows
}

impl SyntheticRoomSettings {
    /// The room of a seed with an exact number of Gaussians, however sparse that makes it.
    #[must_use]
    pub fn with_count(num_gaussians: usize, seed: u64) -> Self {
        Self { seed, num_gaussians: Some(num_gaussians), ..Self::default() }
    }

    fn check(&self) -> Result<(), RoomError> {
        let fail =
            |setting, value: String, expected| Err(RoomError::Setting { setting, value, expected });
        let density = self.gaussians_per_m2;
        if !(density.is_finite() && density > 0.0) {
            let expected = "a finite number above 0";
            return fail("gaussians_per_m2", density.to_string(), expected);
        }
        if !(0.0..=1.0).contains(&self.points_share) {
            return fail("points_share", self.points_share.to_string(), "a number in 0..=1");
        }
        match self.num_gaussians {
            Some(n) if n > MAX_GAUSSIANS => Err(too_many("num_gaussians", n.to_string())),
            _ => Ok(()),
        }
    }
}

fn too_many(setting: &'static str, value: String) -> RoomError {
    let expected = "a value that makes at most 20000000 Gaussians";
    RoomError::Setting { setting, value, expected }
}

/// Splits `n` by weight; the largest remainders get the rest.
fn shares(weights: &[f64], total: f64, n: usize) -> Vec<usize> {
    let exact: Vec<f64> = weights.iter().map(|w| w / total.max(1e-9) * n as f64).collect();
    let mut counts: Vec<usize> = exact.iter().map(|&e| e as usize).collect();
    let mut by_remainder: Vec<usize> = (0..weights.len()).filter(|&i| weights[i] > 0.0).collect();
    by_remainder.sort_by(|&a, &b| exact[b].fract().total_cmp(&exact[a].fract()).then(a.cmp(&b)));
    let rest = n - counts.iter().sum::<usize>().min(n);
    for &surface in by_remainder.iter().cycle().take(rest) {
        counts[surface] += 1;
    }
    counts
}

/// Boxes near the floor, but for what lies flat on it.
fn casts_shadow(object: &Placed) -> impl Iterator<Item = &Footprint> {
    object.footprints.iter().filter(|f| f.z()[0] < 0.3 && f.z()[1] > 0.1)
}

fn describe((index, object): (usize, &Placed)) -> SyntheticObject {
    let corners = object.model.surfaces.iter().flat_map(|s| {
        let [low, high] = s.shape.bounds();
        (0..8).map(move |corner| {
            object
                .pose
                .point(std::array::from_fn(|i| if corner >> i & 1 == 0 { low[i] } else { high[i] }))
        })
    });
    let bounds = corners.map(|c| [c, c]).reduce(shape::join).unwrap_or([[0.0; 3]; 2]);
    SyntheticObject {
        class: object.model.class,
        instance: index as i32,
        color: object.model.color,
        bounds: bounds.map(|corner| corner.map(|v| v as f32)),
    }
}
