//! Pieces of a catalogue in place of parametric models.

use crate::catalogue::{Catalogue, Entry, FurnitureSplit, Meaning};
use crate::classes::ClassId;
use crate::dice::{chance, pick};
use crate::material::ColorName;
use crate::model::{Model, OfPiece, Support};
use crate::shape::Block;
use crate::variation::{Variation, varied};
use crate::vector::V3;
use scenesplat_kernels::random::SampleRng;
use std::sync::Arc;

/// Where something will be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Place {
    /// On the floor, free or at a wall; pieces that hang low on a wall, such as washbasins, too.
    Floor,
    /// On other things.
    Top,
    /// On a wall; its underside is where it is put.
    Wall,
    /// Under the ceiling, which is where it is put.
    Ceiling,
}

/// A door or a window of a catalogue.
#[derive(Debug)]
pub(crate) struct Opening {
    pub(crate) model: Model,
    /// Width and height of the hole in the wall, and how high it begins.
    pub(crate) size: [f64; 2],
    pub(crate) sill: f64,
}

/// What a room may be furnished with, beside what is built for it.
#[derive(Debug)]
pub(crate) struct Stock(Option<Shelf>);

#[derive(Debug)]
struct Shelf {
    catalogue: Arc<Catalogue>,
    /// Indices of its models.
    models: Vec<usize>,
    share: f64,
    /// Share of the pieces that differ from their models.
    varied: f64,
    /// Of its own: without a catalogue, rooms are what they were.
    rng: SampleRng,
}

/// What is higher than this above the floor hangs on a wall, meters.
const HANGS: f64 = 0.2;

/// What reaches this high and hangs belongs to the ceiling, meters.
const UNDER_CEILING: f64 = 2.3;

/// Pieces tried before the parametric model stays.
const TRIES: u32 = 4;

/// Gaussians per area of things that have a name alone, as of other small and large things.
const SMALL_DENSITY: f64 = 3.0;
const LARGE_DENSITY: f64 = 1.7;

impl Stock {
    /// Without a catalogue: everything is built.
    #[cfg(test)]
    pub(crate) fn none() -> Self {
        Self(None)
    }

    pub(crate) fn new(
        catalogue: Option<Arc<Catalogue>>,
        split: &FurnitureSplit,
        [share, varied]: [f64; 2],
        rng: SampleRng,
    ) -> Self {
        Self(catalogue.map(|catalogue| {
            let models = catalogue.indices(split).collect();
            Shelf { catalogue, models, share, varied, rng }
        }))
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_none()
    }

    /// A piece of the same class for the same place, if chance will have it and there is one; else the
    /// model itself.
    pub(crate) fn instead(&mut self, model: Model, place: Place) -> Model {
        let (Some(shelf), Some(class)) = (&mut self.0, model.class) else { return model };
        if !chance(&mut shelf.rng, shelf.share) {
            return model;
        }
        let bounds = model.bounds();
        let fits = |entry: &Entry| {
            entry.meaning == Meaning::Class(class)
                && !entry.is_opening
                && is_for(entry, place)
                && (!is_varied(class) || is_alike(entry, &bounds))
        };
        let area: f64 = model.surfaces.iter().map(|s| s.shape.area()).sum();
        let weighted: f64 = model.surfaces.iter().map(|s| s.shape.area() * s.density).sum();
        let density = if area > 0.0 { weighted / area } else { model.density };
        shelf.draw(fits, place, density).unwrap_or(model)
    }

    /// A door or a window that ends below a height.
    pub(crate) fn opening(&mut self, class: ClassId, below: f64) -> Option<Opening> {
        let shelf = self.0.as_mut()?;
        if !chance(&mut shelf.rng, shelf.share) {
            return None;
        }
        let fits = |entry: &Entry| {
            entry.meaning == Meaning::Class(class)
                && entry.is_opening
                && entry.elevation + entry.size[2] < below
        };
        let (index, mut model) = shelf.draw_one(fits, Place::Wall, 1.3)?;
        let entry = &shelf.catalogue.entries()[index];
        let depth = entry.size[1];
        // The face of the wall is at y = 0; a library that says nothing has the wall as thick as the piece.
        let [thick, off] = entry.wall;
        let back = off.unwrap_or(0.0) + thick.unwrap_or(depth);
        let piece = model.piece.as_mut()?;
        piece.at[1] = depth / 2.0 - back;
        Some(Opening { model, size: [entry.size[0], entry.size[2]], sill: entry.elevation })
    }

    /// Something for a place, of those that `fits` says, with or without a class.
    pub(crate) fn thing(&mut self, place: Place, fits: impl Fn(&Entry) -> bool) -> Option<Model> {
        let shelf = self.0.as_mut()?;
        let density = if place == Place::Floor { LARGE_DENSITY } else { SMALL_DENSITY };
        let fits = |entry: &Entry| !entry.is_opening && is_for(entry, place) && fits(entry);
        shelf.draw(fits, place, density)
    }
}

impl Shelf {
    fn draw(&mut self, fits: impl Fn(&Entry) -> bool, place: Place, density: f64) -> Option<Model> {
        self.draw_one(fits, place, density).map(|(_, model)| model)
    }

    fn draw_one(
        &mut self,
        fits: impl Fn(&Entry) -> bool,
        place: Place,
        density: f64,
    ) -> Option<(usize, Model)> {
        let entries = self.catalogue.entries();
        let some: Vec<usize> = self.models.iter().copied().filter(|&i| fits(&entries[i])).collect();
        if some.is_empty() {
            return None;
        }
        for _ in 0..TRIES {
            let index = pick(&mut self.rng, &some);
            // What cannot be read is left out; `Catalogue::examine` names it.
            if let Ok(piece) = self.catalogue.piece(index) {
                let entry = &entries[index];
                let is_varied = self.varied > 0.0 && chance(&mut self.rng, self.varied);
                let variation = is_varied.then(|| Variation::draw(entry.is_opening, &mut self.rng));
                let at = match place {
                    Place::Floor => [0.0, 0.0, entry.elevation],
                    Place::Top | Place::Wall => [0.0; 3],
                    Place::Ceiling => [0.0, 0.0, -varied(piece.bounds, variation.as_ref()).high[2]],
                };
                return Some((index, model(entry, piece, variation, at, density)));
            }
        }
        None
    }
}

fn model(
    entry: &Entry,
    piece: Arc<crate::catalogue::Piece>,
    variation: Option<Variation>,
    at: V3,
    density: f64,
) -> Model {
    let by = variation.as_ref();
    let color = by.map_or(piece.mean_color, |by| by.color(piece.mean_color));
    let mut model = Model::new(ClassId::Box, ColorName::nearest(color), density);
    model.class = entry.meaning.class();
    model.solids = piece.solids.iter().map(|&block| varied(block, by).moved(at)).collect();
    if model.is(ClassId::Rug) {
        // Furniture stands on it.
        let Block { low, high } = varied(piece.bounds, by);
        model.solids = vec![Block { low, high: [high[0], high[1], high[2].max(0.006)] }];
    }
    let top = piece.support.map(|top| match by {
        None => top,
        Some(by) => {
            let [low, high] = [top.low, top.high].map(|[x, y]| by.place([x, y, top.z]));
            Support { low: [low[0], low[1]], high: [high[0], high[1]], z: low[2], ..top }
        }
    });
    model.supports = supports(model.class, &top, at[2]);
    let name = entry.name.as_str().into();
    let elevation = entry.elevation;
    model.piece = Some(Box::new(OfPiece { piece, name, at, density, elevation, variation }));
    model
}

/// Where things stand on it; on a bed first where the pillows are, at its back.
fn supports(class: Option<ClassId>, found: &Option<Support>, lift: f64) -> Vec<Support> {
    let Some(found) = *found else { return Vec::new() };
    let found = Support { z: found.z + lift, ..found };
    if class == Some(ClassId::Bed) && found.high[1] - found.low[1] > 1.0 {
        let head = Support { high: [found.high[0], found.low[1] + 0.6], ..found };
        return vec![head, found];
    }
    vec![found]
}

/// Whether a piece of a catalogue belongs to a place.
fn is_for(entry: &Entry, place: Place) -> bool {
    // These hang low, where the recipes have models that stand.
    use ClassId::{Bathtub, Curtain, Radiator, Sink, Toilet};
    let stands =
        matches!(entry.meaning, Meaning::Class(Sink | Radiator | Bathtub | Toilet | Curtain));
    let top = entry.elevation + entry.size[2];
    let hangs = entry.elevation >= HANGS && !stands;
    let is_light = matches!(entry.meaning, Meaning::Class(ClassId::Lamp) | Meaning::Other);
    let is_under_ceiling = hangs && is_light && top > UNDER_CEILING;
    match place {
        Place::Floor | Place::Top => !hangs,
        Place::Wall => entry.is_opening || (hangs && !is_under_ceiling),
        Place::Ceiling => is_under_ceiling,
    }
}

/// Whether things of a class differ so much that one is not the other's place: a lamp on a desk, on the
/// floor, under the ceiling.
fn is_varied(class: ClassId) -> bool {
    use ClassId::{Box, Clock, KitchenCabinet, Lamp, Plant, Rug, Stove};
    matches!(class, Lamp | Plant | Box | Clock | Stove | KitchenCabinet | Rug)
}

/// Whether a piece is about as large as a model.
fn is_alike(entry: &Entry, model: &Block) -> bool {
    let [w, d, h] = model.size();
    let long = |w: f64, d: f64| (w * w + d * d).sqrt();
    let ratio = |a: f64, b: f64| a.max(0.01) / b.max(0.01);
    let [tall, wide] =
        [ratio(entry.size[2], h), ratio(long(entry.size[0], entry.size[1]), long(w, d))];
    // Rugs are thin, whatever they are.
    (h < 0.05 || (0.45..2.1).contains(&tall)) && (0.4..2.5).contains(&wide)
}
