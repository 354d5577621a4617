//! A room from its settings: layout, surfaces, and the Gaussians scattered on them.

use crate::catalogue::{Catalogue, FurnitureSplit};
use crate::classes::ClassId;
use crate::depth;
use crate::error::RoomError;
use crate::flat::Flat;
use crate::jitter::jitter;
use crate::material::ColorName;
use crate::model::{OfPiece, Surface};
use crate::place::{Footprint, Placed};
use crate::recipe::{self, RoomKind};
use crate::scan::{self, Scan, ScannedObject};
use crate::seen::seen;
use crate::shape::Block;
use crate::splats::{self, Look, Owner, Row, rounded_ln};
use crate::stock::Stock;
use crate::vector::V3;
use crate::walk::Camera;
use rayon::prelude::*;
use scenesplat_kernels::random::{SampleRng, sample_rng, unit};
use scenesplat_scene::GaussianScene;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Most Gaussians of a room.
pub const MAX_GAUSSIANS: usize = 20_000_000;

/// Gaussians lie at most this far outside the bounds of their object, meters.
pub const MAX_STRAY: f32 = splats::MAX_STRAY as f32 + 1e-4;

/// Streams of random numbers of a room; objects have those from `FIRST_OBJECT` on.
const LAYOUT: u64 = 0;
const LOOK: u64 = 1;
const FLOATERS: u64 = 2;
const FIRST_OBJECT: u64 = 3;
/// What a scan varies, and which pieces of a catalogue there are; rooms with so many objects there are not.
const SCAN: u64 = u64::MAX;
const FURNITURE: u64 = u64::MAX - 1;
const WALK: u64 = u64::MAX - 2;
/// Whether it is a flat, and which.
const FLAT: u64 = u64::MAX - 3;
/// Whether its objects have densities of their own, and which.
const DENSITY: u64 = u64::MAX - 4;
/// Whether it is a place other than a home, and which.
const PUBLIC: u64 = u64::MAX - 5;

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
    /// As points of the models of a simulator: the density of each object, and of the room, its own, so that
    /// nothing of it tells the class; hardly any light; most things of one color.
    Model,
    /// As a depth camera that is held in the hand leaves it: points of what it looked at from a few places, as far as
    /// it reaches, each with errors of range, place and color; one density for all. Such a room has fewer Gaussians
    /// than asked for.
    Depth,
}

/// Which room.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SyntheticRoomSettings {
    /// Changes everything.
    pub seed: u64,
    /// Number of the room among those of a seed.
    pub room: u64,
    /// Gaussians per square meter of floor or wall, above 0; furniture gets up to twice, small
    /// things up to nine times as many (unless [`capture`](Self::capture) says otherwise). 500 fills most
    /// voxels of 4 cm, 2 500 those of 2 cm.
    pub gaussians_per_m2: f32,
    /// Exact number of Gaussians, whatever the density.
    pub num_gaussians: Option<usize>,
    /// Kind of the room; drawn if absent.
    pub kind: Option<RoomKind>,
    /// Share of rooms that look as converted points instead of captures, 0..=1; all of them if
    /// [`capture`](Self::capture) is [`Capture::Model`] or [`Capture::Depth`].
    pub points_share: f32,
    /// Share of the scenes that are flats instead of rooms, 0..=1: two to six rooms at a corridor, with the
    /// walls between them, doors or openings. Their number of Gaussians grows with their number of rooms.
    #[serde(skip_serializing_if = "is_none_of_them")]
    pub flat_share: f64,
    /// Share of the scenes that are places other than homes ([`RoomKind::PUBLIC`]), 0..=1; such a scene is no flat.
    /// No effect where [`kind`](Self::kind) says which.
    #[serde(skip_serializing_if = "is_none_of_them")]
    pub public_share: f64,
    /// How the Gaussians came about.
    pub capture: Capture,
    /// Share of the rooms as made whose objects each have a density of their own, whatever they are, 0..=1: what
    /// there is of a class tells no more how dense it is. Of [`Capture::Made`] alone, the others vary it anyway.
    #[serde(skip_serializing_if = "is_none_of_them")]
    pub density_variation: f64,
    /// Share of the rooms of which there is only what somebody saw who walked through with a camera, 0..=1: two
    /// to seven stops, some looks from each. Gaussians that hardly added to any picture are gone, and the
    /// others jittered so that the pictures stay what they were. Such a room has fewer Gaussians than asked for.
    #[serde(skip_serializing_if = "is_none_of_them")]
    pub seen_share: f64,
    /// A catalogue of real furniture: a `.sh3f` archive, a folder of them, or a folder of OBJ models; see
    /// [`Catalogue`]. Without it all furniture is built from parameters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub furniture: Option<PathBuf>,
    /// Share of the objects that are taken from the catalogue where it has one of the class, 0..=1.
    #[serde(skip_serializing_if = "is_usual_share")]
    pub furniture_share: f64,
    /// Share of the pieces of the catalogue that differ from their model, 0..=1: in width, depth and height by up
    /// to a fifth (doors and windows have their holes to fit), in hue, saturation and lightness.
    #[serde(skip_serializing_if = "is_none_of_them")]
    pub furniture_variation: f64,
    /// Which part of the catalogue: `all`, `train`, `held_out`, `without:LIBRARY`, `only:LIBRARY`.
    #[serde(skip_serializing_if = "is_all")]
    pub furniture_split: FurnitureSplit,
}

/// The share of catalogue furniture if none is given.
const USUAL_SHARE: f64 = 0.8;

// Settings without a catalogue are written as they were before there were any.
fn is_usual_share(share: &f64) -> bool {
    share.to_bits() == USUAL_SHARE.to_bits()
}

fn is_none_of_them(share: &f64) -> bool {
    *share == 0.0
}

fn is_all(split: &FurnitureSplit) -> bool {
    *split == FurnitureSplit::All
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
            flat_share: 0.0,
            public_share: 0.0,
            capture: Capture::Made,
            density_variation: 0.0,
            seen_share: 0.0,
            furniture: None,
            furniture_share: USUAL_SHARE,
            furniture_variation: 0.0,
            furniture_split: FurnitureSplit::All,
        }
    }
}

/// An object of a room.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticObject {
    /// What it is; none of a thing of a catalogue that is of no class: it has a name alone.
    pub class: Option<ClassId>,
    /// What it is called: as its class, or as in the catalogue that it is from.
    pub name: String,
    /// Its value in `instance`: its index in [`SyntheticRoom::objects`].
    pub instance: i32,
    /// What the color of its main part is called, before light falls on it.
    pub color: ColorName,
    /// Corners of the box along the axes around its surfaces, meters; Gaussians stray from it by
    /// up to [`MAX_STRAY`].
    pub bounds: [[f32; 3]; 2],
}

/// A room and what is in it.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticRoom {
    /// The Gaussians, with normals, `segment` (row of [`CLASSES`](crate::CLASSES)) and `instance`; +z is up, the
    /// floor at z = 0, meters. Only floaters have the labels −1, and things without a class the class −1.
    pub scene: GaussianScene,
    /// Extent of the room, meters; the corner at the origin.
    pub size: [f32; 3],
    /// What kind it is; of a flat, its first room.
    pub kind: RoomKind,
    /// How many rooms: 1, or those of a flat; a corridor is none.
    pub num_rooms: usize,
    /// Whether its Gaussians look as converted points.
    pub is_points: bool,
    /// Whether there is only what somebody saw who walked through it, see [`SyntheticRoomSettings::seen_share`].
    pub is_walked: bool,
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
/// let names: Vec<_> = room.objects.iter().map(|o| (o.color.word(), o.name.as_str())).collect();
/// assert!(names.iter().any(|&(_, name)| name == "floor"), "{names:?}");
/// # Ok::<(), scenesplat_rooms::RoomError>(())
/// ```
///
/// # Errors
/// If a setting is out of range, more than [`MAX_GAUSSIANS`] would be made, or the catalogue of furniture
/// cannot be read or has nothing in the part asked for.
pub fn generate(settings: &SyntheticRoomSettings) -> Result<SyntheticRoom, RoomError> {
    settings.check()?;
    let (seed, room) = (settings.seed, settings.room);
    let (kind, flat) = furnished(settings)?;
    let mut of_walk = sample_rng(seed, room, WALK);
    let is_depth = settings.capture == Capture::Depth;
    let is_walked = is_depth || unit(&mut of_walk) < settings.seen_share;
    let cameras = match (is_depth, is_walked) {
        (true, _) => flat.look_around(&mut of_walk),
        (false, true) => flat.walk(&mut of_walk),
        (false, false) => Vec::new(),
    };
    let num_rooms = flat.num_rooms;
    let (size, objects) = flat.into_objects();
    let mut rng = sample_rng(seed, room, LOOK);
    let is_points =
        unit(&mut rng) < f64::from(settings.points_share) || settings.capture.is_points();
    let mut look = Look::new(is_points, size, &mut rng);
    let mut density = f64::from(settings.gaussians_per_m2);
    let mut of_scan = sample_rng(seed, room, SCAN);
    let scan = scan_of(settings.capture, size, objects.len(), &mut of_scan);
    if let Some(scan) = &scan {
        scan.change(&mut look);
        density *= scan.density;
    }

    let mut rng = sample_rng(seed, room, DENSITY);
    let own: Option<Vec<f64>> = match &scan {
        Some(scan) => Some(scan.objects.iter().map(|object| object.density).collect()),
        None => (unit(&mut rng) < settings.density_variation)
            .then(|| scan::densities(objects.len(), &mut rng)),
    };
    let weights = weights(&objects, is_points, own.as_deref());
    let total: f64 = weights.iter().sum();
    let n = settings.num_gaussians.unwrap_or((total * density) as usize);
    if n > MAX_GAUSSIANS {
        return Err(too_many("gaussians_per_m2", density.to_string()));
    }
    let num_floaters = (n as f64 * look.floaters) as usize;
    let num_below = scan.as_ref().map_or(0, |scan| (n as f64 * scan.below) as usize);
    let counts = shares(&weights, total, n - num_floaters - num_below);

    let scanned = scan.as_ref().map(|scan| &scan.objects[..]);
    let mut rows = scatter_all(&objects, &counts, &look, scanned, [seed, room]);
    let spacing = rounded_ln((total / n.max(1) as f64).sqrt().clamp(1e-4, 0.2));
    let mut rng = sample_rng(seed, room, FLOATERS);
    rows.extend((0..num_floaters).map(|_| splats::floater(size, spacing, &mut rng)));
    if let Some(scan) = &scan {
        let below = |_| splats::below_floor(size, scan.deep, spacing, &mut of_scan);
        rows.extend((0..num_below).map(below));
    }
    let scene = splats::scene(&rows);
    Ok(SyntheticRoom {
        scene: match (is_depth && !cameras.is_empty(), is_walked) {
            (true, _) => depth::fused(&scene, &cameras, &mut of_walk),
            (false, true) => walked(scene, &cameras, &mut of_walk),
            (false, false) => scene,
        },
        is_walked,
        size: size.map(|v| v as f32),
        kind,
        num_rooms,
        is_points,
        objects: objects.iter().enumerate().map(describe).collect(),
    })
}

fn scan_of(capture: Capture, size: V3, objects: usize, rng: &mut SampleRng) -> Option<Scan> {
    match capture {
        Capture::Made => None,
        Capture::Scan => Some(Scan::new(size, objects, rng)),
        Capture::Model => Some(Scan::of_models(objects, rng)),
        Capture::Depth => Some(Scan::of_depth(objects, rng)),
    }
}

/// What somebody saw of a room, with the errors of a capture.
fn walked(mut scene: GaussianScene, cameras: &[Camera], rng: &mut SampleRng) -> GaussianScene {
    if !cameras.is_empty() {
        scene = scene.select_rows(&seen(&scene, cameras)).expect("rows are of the scene");
    }
    jitter(&mut scene, rng);
    scene
}

/// What kind of room it is, and what stands in it and in the others of its flat.
fn furnished(settings: &SyntheticRoomSettings) -> Result<(RoomKind, Flat), RoomError> {
    let (seed, room) = (settings.seed, settings.room);
    let mut rng = sample_rng(seed, room, LAYOUT);
    let home = RoomKind::random(&mut rng);
    let mut of_public = sample_rng(seed, room, PUBLIC);
    let public = (unit(&mut of_public) < settings.public_share)
        .then(|| RoomKind::random_public(&mut of_public));
    let kind = settings.kind.or(public).unwrap_or(home);
    let stock = &mut settings.stock()?;
    let mut of_flat = sample_rng(seed, room, FLAT);
    let is_flat = unit(&mut of_flat) < settings.flat_share && !kind.is_public();
    let flat = match is_flat {
        true => Flat::furnish(kind, stock, &mut of_flat),
        false => Flat::of_one_room(recipe::furnish(kind, stock, &mut rng)),
    };
    Ok((kind, flat))
}

/// Of each surface and piece, in the order of the objects, its area times its density; `own` has the density
/// of each object if that goes before the usual one.
fn weights(objects: &[Placed], is_points: bool, own: Option<&[f64]>) -> Vec<f64> {
    let mut weights = Vec::new();
    for (index, object) in objects.iter().enumerate() {
        let density = |usual: f64| own.map_or(usual, |own| own[index]);
        let of_surface = |s: &Surface| {
            if is_points || !s.hidden { s.shape.area() * density(s.density) } else { 0.0 }
        };
        weights.extend(object.model.surfaces.iter().map(of_surface));
        let of_piece = |of: &OfPiece| of.area(is_points) * density(of.density);
        weights.extend(object.model.piece.as_deref().map(of_piece));
    }
    weights
}

/// Gaussians on all surfaces, `counts` of them, in the order of the objects.
fn scatter_all(
    objects: &[Placed],
    counts: &[usize],
    look: &Look,
    scanned: Option<&[ScannedObject]>,
    [seed, room]: [u64; 2],
) -> Vec<Row> {
    let shadows: Vec<Footprint> = objects.iter().flat_map(casts_shadow).copied().collect();
    let mut counts_left = counts;
    let tasks: Vec<(&Placed, &[usize])> = (objects.iter())
        .map(|object| {
            let model = &object.model;
            let parts = model.surfaces.len() + usize::from(model.piece.is_some());
            let (own, rest) = counts_left.split_at(parts);
            counts_left = rest;
            (object, own)
        })
        .collect();
    let parts: Vec<Vec<Row>> = (tasks.par_iter().enumerate())
        .map(|(index, &(object, counts))| {
            // Numbers of its own for each object: threads cannot change who draws which.
            let mut rng = sample_rng(seed, room, FIRST_OBJECT + index as u64);
            let is_floor = object.model.is(ClassId::Floor) && look.ambient < 1.0;
            let owner = Owner {
                pose: &object.pose,
                segment: object.model.class.map_or(-1, |class| class.index() as i32),
                instance: index as i32,
                shadows: if is_floor { &shadows } else { &[] },
                ln_size: scanned.map_or(0.0, |scanned| scanned[index].ln_size),
                is_plain: scanned.is_some_and(|scanned| scanned[index].is_plain),
            };
            let mut rows = Vec::with_capacity(counts.iter().sum());
            for (surface, &count) in object.model.surfaces.iter().zip(counts) {
                owner.scatter(surface, count, look, &mut rng, &mut rows);
            }
            // The last count, if it has a piece.
            if let (Some(of), Some(&count)) = (&object.model.piece, counts.last()) {
                owner.scatter_piece(of, count, look, &mut rng, &mut rows);
            }
            rows
        })
        .collect();
    parts.concat()
}

impl Capture {
    /// Whether all its rooms are points.
    fn is_points(self) -> bool {
        matches!(self, Self::Model | Self::Depth)
    }
}

impl SyntheticRoomSettings {
    /// The room of a seed with an exact number of Gaussians, however sparse that makes it.
    #[must_use]
    pub fn with_count(num_gaussians: usize, seed: u64) -> Self {
        Self { seed, num_gaussians: Some(num_gaussians), ..Self::default() }
    }

    /// What the room may be furnished with.
    fn stock(&self) -> Result<Stock, RoomError> {
        let rng = sample_rng(self.seed, self.room, FURNITURE);
        let shares = [self.furniture_share, self.furniture_variation];
        Ok(Stock::new(self.catalogue()?, &self.furniture_split, shares, rng))
    }

    /// The catalogue that the settings name, if they do; opened once, whoever asks.
    ///
    /// # Errors
    /// If it cannot be read, or has nothing in the part asked for.
    pub fn catalogue(&self) -> Result<Option<Arc<Catalogue>>, RoomError> {
        let Some(path) = &self.furniture else { return Ok(None) };
        let catalogue = Catalogue::shared(path)?;
        catalogue.check(&self.furniture_split)?;
        Ok(Some(catalogue))
    }

    fn check(&self) -> Result<(), RoomError> {
        let fail =
            |setting, value: String, expected| Err(RoomError::Setting { setting, value, expected });
        let density = self.gaussians_per_m2;
        if !(density.is_finite() && density > 0.0) {
            let expected = "a finite number above 0";
            return fail("gaussians_per_m2", density.to_string(), expected);
        }
        let (own, varied) = (self.density_variation, self.furniture_variation);
        for (setting, share) in [
            ("flat_share", self.flat_share),
            ("public_share", self.public_share),
            ("seen_share", self.seen_share),
            ("furniture_share", self.furniture_share),
            ("density_variation", own),
            ("furniture_variation", varied),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return fail(setting, share.to_string(), "a number in 0..=1");
            }
        }
        if !(0.0..=1.0).contains(&self.points_share) {
            return fail("points_share", self.points_share.to_string(), "a number in 0..=1");
        }
        if own > 0.0 && self.capture != Capture::Made {
            let expected =
                "0 unless `capture` is \"made\": the others give each object its density anyway";
            return fail("density_variation", own.to_string(), expected);
        }
        if self.seen_share > 0.0 && self.capture == Capture::Depth {
            let expected = "0 if `capture` is \"depth\": such a room is what was seen anyway";
            return fail("seen_share", self.seen_share.to_string(), expected);
        }
        if self.furniture.is_none() && varied > 0.0 {
            let expected = "0 without `furniture`, the path of a catalogue";
            return fail("furniture_variation", varied.to_string(), expected);
        }
        if self.furniture.is_none() && self.furniture_split != FurnitureSplit::All {
            let expected = "none of it without `furniture`, the path of a catalogue";
            return fail("furniture_split", self.furniture_split.to_string(), expected);
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
    let model = &object.model;
    let boxes = model.surfaces.iter().map(|s| s.shape.bounds());
    let boxes = boxes.chain(model.piece.iter().map(|of| of.bounds()));
    let corners = boxes.flat_map(|Block { low, high }| {
        let pick = move |corner: i32, i| if corner >> i & 1 == 0 { low[i] } else { high[i] };
        (0..8).map(move |corner| object.pose.point(std::array::from_fn(|i| pick(corner, i))))
    });
    let bounds = corners.map(Block::at).reduce(Block::join).unwrap_or(Block::at([0.0; 3]));
    SyntheticObject {
        class: model.class,
        name: match (&model.piece, model.class) {
            (Some(of), _) => of.name.to_string(),
            (None, class) => class.map_or_else(String::new, |class| class.about().name.to_owned()),
        },
        instance: index as i32,
        color: model.color,
        bounds: [bounds.low, bounds.high].map(|corner| corner.map(|v| v as f32)),
    }
}
