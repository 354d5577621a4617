//! Floor, ceiling and walls with their windows, doors, curtains and radiators.

use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::furniture::openings::{curtain, door, outside, radiator, tiles, window};
use crate::material::{ColorName, Material, Texture, wood};
use crate::model::Model;
use crate::place::{Footprint, Layout, Pose, STRAIGHT, Wall};
use crate::shape::{Block, Shape};
use crate::stock::{Opening, Place, Stock};
use crate::vector::{mix, times};
use scenesplat_kernels::random::SampleRng;

/// What decides the shell of a room.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan {
    /// Extent, meters.
    pub(crate) size: [f64; 2],
    pub(crate) height: f64,
    /// Extent of the corner that is missing.
    pub(crate) notch: Option<[f64; 2]>,
    pub(crate) is_wet: bool,
    /// Whether its floor is one of places other than homes.
    pub(crate) is_public: bool,
    pub(crate) has_ceiling: bool,
    /// Which sides have another room behind them, in a flat; none in a room by itself.
    pub(crate) inner: Option<[bool; 4]>,
    /// How far behind their faces the backs of outer walls are, meters.
    pub(crate) back: f64,
}

/// The back of a wall of a room by itself.
pub(crate) const USUAL_BACK: f64 = 0.12;

/// Sides of a plan: the walls at least y, largest x, largest y, least x.
pub(crate) const BOTTOM: usize = 0;
pub(crate) const TOP: usize = 2;

impl Plan {
    /// Which side a wall is on; the two walls of a missing corner are on those that they stand before.
    fn side(&self, wall: usize) -> usize {
        if self.notch.is_none() { wall } else { [0, 1, 2, 1, 2, 3][wall] }
    }

    /// Doors of a flat lead to its corridor, which is at the bottom.
    fn may_have_door(&self, wall: usize) -> bool {
        self.inner.is_none() || wall == BOTTOM
    }

    fn may_have_window(&self, wall: usize) -> bool {
        self.inner.is_none_or(|inner| !inner[self.side(wall)])
    }
}

/// An empty room with openings and what hangs in them.
pub(crate) fn build(plan: &Plan, stock: &mut Stock, rng: &mut SampleRng) -> Layout {
    let mut layout = empty(plan);
    if plan.inner.is_some() && chance(rng, 0.25) {
        add_passage(&mut layout, plan, rng);
    } else {
        put_door(&mut layout, |wall| plan.may_have_door(wall), stock, rng);
    }
    for _ in 0..whole(rng, 1, 3) {
        add_window(&mut layout, plan, stock, rng);
    }
    finish(&mut layout, plan, rng);
    layout
}

/// The corridor of a flat: holes where the rooms at its bottom and its top have their doors, a door at an end.
pub(crate) fn corridor(
    plan: &Plan,
    doors: [&[[f64; 4]]; 2],
    stock: &mut Stock,
    rng: &mut SampleRng,
) -> Layout {
    let mut layout = empty(plan);
    for (side, holes) in [BOTTOM, TOP].into_iter().zip(doors) {
        let wall = &mut layout.walls[side];
        wall.openings.extend(holes);
        for &[from, to, low, high] in holes {
            let pose = wall.pose((from + to) / 2.0, 0.0, 0.0);
            let half = (to - from) / 2.0;
            let block = Block { low: [-half, 0.0, low + 0.05], high: [half, 0.6, high] };
            layout.kept_free.push(Footprint::of(&block, &pose));
        }
    }
    let entrance = if chance(rng, 0.5) { BOTTOM + 1 } else { TOP + 1 };
    put_door(&mut layout, |wall| wall == entrance, stock, rng);
    finish(&mut layout, plan, rng);
    layout
}

fn empty(plan: &Plan) -> Layout {
    Layout {
        size: plan.size,
        height: plan.height,
        walls: walls(plan),
        objects: Vec::new(),
        notch: notch(plan),
        kept_free: Vec::new(),
    }
}

/// Walls around what opens in them, floor and ceiling.
fn finish(layout: &mut Layout, plan: &Plan, rng: &mut SampleRng) {
    let (name, paint) = wall_paint(plan.is_wet, rng);
    let skirting = (!plan.is_wet && chance(rng, 0.7)).then(|| between(rng, 0.05, 0.12));
    let skirting_paint = if chance(rng, 0.6) { Material::plain([236.0; 3]) } else { wood(rng).1 };
    for index in 0..layout.walls.len() {
        let wall = layout.walls[index].clone();
        let paint = if chance(rng, 0.12) { wall_paint(false, rng) } else { (name, paint) };
        let mut model = wall_model(&wall, plan.height, paint);
        if let Some(high) = skirting {
            skirt(&mut model, &wall, high, skirting_paint);
        }
        layout.put_flat(model, wall.pose(0.0, 0.0, 0.0));
    }
    level_faces(layout, plan, rng);
}

fn walls(plan: &Plan) -> Vec<Wall> {
    let [l, w] = plan.size;
    let corners = match plan.notch {
        None => vec![[0.0, 0.0], [l, 0.0], [l, w], [0.0, w]],
        Some([x, y]) => {
            vec![[0.0, 0.0], [l, 0.0], [l, w - y], [l - x, w - y], [l - x, w], [0.0, w]]
        }
    };
    (0..corners.len())
        .map(|i| {
            let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
            let (dx, dy): (f64, f64) = (b[0] - a[0], b[1] - a[1]);
            let length = dx.abs() + dy.abs();
            let is_inner = plan.inner.is_some_and(|inner| inner[plan.side(i)]);
            Wall {
                start: a,
                along: [dx / length, dy / length],
                length,
                openings: Vec::new(),
                back: (!is_inner).then_some(plan.back),
            }
        })
        .collect()
}

fn notch(plan: &Plan) -> Option<Footprint> {
    let ([l, w], [x, y]) = (plan.size, plan.notch?);
    let block = Block { low: [l - x, w - y, -1.0], high: [l, w, plan.height + 1.0] };
    Some(Footprint::of(&block, &Pose { origin: [0.0; 3], turn: STRAIGHT }))
}

/// A free stretch of a wall that may have it, `wide` meters and a margin; index of the wall and middle.
fn stretch(
    layout: &Layout,
    wide: f64,
    may: impl Fn(usize) -> bool,
    rng: &mut SampleRng,
) -> Option<(usize, f64)> {
    for _ in 0..20 {
        let index = whole(rng, 0, layout.walls.len() as u32 - 1) as usize;
        if !may(index) {
            continue;
        }
        let wall = &layout.walls[index];
        let reach = wide / 2.0 + 0.12;
        if wall.length < 2.0 * reach {
            continue;
        }
        let at = between(rng, reach, wall.length - reach);
        let free = |o: &[f64; 4]| at + reach < o[0] || at - reach > o[1];
        if wall.openings.iter().all(free) {
            return Some((index, at));
        }
    }
    None
}

/// A wide opening instead of a door.
fn add_passage(layout: &mut Layout, plan: &Plan, rng: &mut SampleRng) {
    let (wide, high) = (between(rng, 0.9, 2.4), between(rng, 2.0, (plan.height - 0.05).max(2.01)));
    let place = stretch(layout, wide, |wall| plan.may_have_door(wall), rng);
    let Some((index, at)) = place else { return };
    open_wall(layout, index, at, [wide, high]);
}

/// A hole in a wall to go through, before which nothing stands; the frame of what is in it.
fn open_wall(layout: &mut Layout, index: usize, at: f64, [wide, high]: [f64; 2]) -> Pose {
    let (wall, half) = (&mut layout.walls[index], wide / 2.0);
    wall.openings.push([at - half, at + half, 0.0, high]);
    let pose = wall.pose(at, 0.0, 0.0);
    let block = Block { low: [-half, 0.0, 0.05], high: [half, 0.75, high] };
    layout.kept_free.push(Footprint::of(&block, &pose));
    pose
}

fn put_door(
    layout: &mut Layout,
    may: impl Fn(usize) -> bool,
    stock: &mut Stock,
    rng: &mut SampleRng,
) {
    let size = [between(rng, 0.78, 1.02), between(rng, 1.98, 2.12_f64.min(layout.height - 0.05))];
    let found = stock.opening(ClassId::Door, layout.height - 0.05);
    let size = found.as_ref().map_or(size, |found| found.size);
    let Some((index, at)) = stretch(layout, size[0], may, rng) else { return };
    let model = match found {
        Some(found) => found.model,
        None => door(size, rng),
    };
    let pose = open_wall(layout, index, at, size);
    layout.put_flat(model, pose);
}

fn add_window(layout: &mut Layout, plan: &Plan, stock: &mut Stock, rng: &mut SampleRng) {
    let is_wet = plan.is_wet;
    let french = !is_wet && chance(rng, 0.2);
    let wide = if is_wet { between(rng, 0.5, 0.9) } else { between(rng, 0.8, 2.3) };
    let (sill, top) = if french {
        (0.05, between(rng, 2.0, layout.height - 0.1))
    } else {
        let sill = if is_wet { between(rng, 1.1, 1.5) } else { between(rng, 0.55, 1.05) };
        (sill, (sill + between(rng, 0.7, 1.6)).min(layout.height - 0.15))
    };
    let found = stock.opening(ClassId::Window, layout.height - 0.1);
    let (wide, sill, top) = match &found {
        Some(Opening { size: [wide, high], sill, .. }) => (*wide, *sill, sill + high),
        None => (wide, sill, top),
    };
    let french = french || sill < 0.3;
    let place = stretch(layout, wide, |wall| plan.may_have_window(wall), rng);
    let Some((index, at)) = place else { return };
    let recess = if chance(rng, 0.7) { between(rng, 0.03, 0.2) } else { 0.0 };
    let model = match found {
        Some(found) => glazed(found, rng),
        None => window([wide, top - sill], recess, rng),
    };
    let wall = &mut layout.walls[index];
    let wall_length = wall.length;
    wall.openings.push([at - wide / 2.0, at + wide / 2.0, sill, top]);
    let pose = wall.pose(at, 0.0, sill);
    let standing = wall.pose(at, 0.0, 0.0);
    layout.put_flat(model, pose);
    if !is_wet && chance(rng, 0.6) {
        let half =
            (wide / 2.0 + between(rng, 0.1, 0.35)).min(at - 0.03).min(wall_length - at - 0.03);
        let low = if french || chance(rng, 0.7) { 0.0 } else { sill - 0.2 };
        let rod = (top + between(rng, 0.06, 0.2)).min(layout.height - 0.06) - low;
        if half > wide / 2.0 - 0.05 {
            let cloth = stock.instead(curtain(half, rod, rng), Place::Floor);
            let off = between(rng, 0.08, 0.11);
            // Its own place, not a gap before the window, so it may be tried only once.
            let _ = layout.try_put(cloth, standing.then([0.0, off, low], STRAIGHT));
        }
    }
    if sill > 0.55 && chance(rng, 0.4) {
        let heater = radiator((wide * between(rng, 0.6, 0.95)).max(0.5), rng);
        let heater = stock.instead(heater, Place::Floor);
        let off = 0.04 - heater.bounds().low[1];
        let _ = layout.try_put(heater, standing.then([0.0, off, 0.0], STRAIGHT));
    }
    let half = wide / 2.0;
    let block = Block { low: [-half, 0.0, sill.max(0.05)], high: [half, 0.06, top] };
    layout.kept_free.push(Footprint::of(&block, &standing));
}

/// A window of a catalogue, and what is seen through its panes.
fn glazed(found: Opening, rng: &mut SampleRng) -> Model {
    let Opening { mut model, size: [wide, high], .. } = found;
    let view = outside(rng);
    let (w, h, rim) = (wide * 0.46, high * 0.92, high * 0.04);
    // Behind all of it.
    let y = model.piece.as_ref().map_or(0.0, |piece| piece.bounds().low[1] + 0.01);
    model.density = 0.7;
    model.face([w, y, rim], [-2.0 * w, 0.0, 0.0], [0.0, 0.0, h], view);
    model
}

fn wall_paint(is_wet: bool, rng: &mut SampleRng) -> (ColorName, Material) {
    if is_wet && chance(rng, 0.8) {
        return (ColorName::White, tiles(rng));
    }
    use ColorName::{Beige, Blue, Green, Grey, Pink, White, Yellow};
    let name =
        pick(rng, &[White, White, White, White, Beige, Beige, Grey, Yellow, Green, Blue, Pink]);
    // Paint of walls is pale.
    let base = mix(name.sample(rng), [238.0; 3], between(rng, 0.2, 0.7));
    let texture = match whole(rng, 0, 9) {
        0 => Texture::Stripes(between(rng, 0.05, 0.2)),
        1 => Texture::Boards(0.1, 9.0),
        2 => Texture::Plain,
        _ => Texture::Mottled(between(rng, 0.2, 0.9)),
    };
    let second = base.map(|c| c * between(rng, 0.88, 0.96));
    (name, Material::new(base, texture, rng).with_second(second))
}

/// The face of a wall around its holes; the back is hidden.
fn wall_model(wall: &Wall, height: f64, (name, paint): (ColorName, Material)) -> Model {
    let mut model = Model::new(ClassId::Wall, name, 0.8);
    let mut openings = wall.openings.clone();
    openings.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut rectangle = |[from, to]: [f64; 2], [low, high]: [f64; 2]| {
        if to - from < 1e-6 || high - low < 1e-6 {
            return;
        }
        // Looks into the room: left × up.
        let (u, v) = ([from - to, 0.0, 0.0], [0.0, 0.0, high - low]);
        model.face([to, 0.0, low], u, v, paint);
        if let Some(back) = wall.back {
            model.add_hidden(Shape::flat([from, -back, low], times(u, -1.0), v), paint);
        }
    };
    let mut end = 0.0;
    for &[from, to, low, high] in &openings {
        rectangle([end, from], [0.0, height]);
        rectangle([from, to], [0.0, low]);
        rectangle([from, to], [high, height]);
        end = to;
    }
    rectangle([end, wall.length], [0.0, height]);
    model
}

fn skirt(model: &mut Model, wall: &Wall, high: f64, material: Material) {
    let mut doors: Vec<[f64; 2]> =
        wall.openings.iter().filter(|o| o[2] < high).map(|o| [o[0], o[1]]).collect();
    doors.sort_by(|a, b| a[0].total_cmp(&b[0]));
    doors.push([wall.length, wall.length]);
    let mut end = 0.0;
    for [from, to] in doors {
        if from - end > 0.02 {
            let (u, v) = ([end - from, 0.0, 0.0], [0.0, 0.0, high]);
            model.face([from, 0.012, 0.0], u, v, material);
            let across = [from - end, 0.0, 0.0];
            model.face([end, 0.0, high], across, [0.0, 0.012, 0.0], material);
        }
        end = to;
    }
}

/// Floor and ceiling, of one or two rectangles.
fn level_faces(layout: &mut Layout, plan: &Plan, rng: &mut SampleRng) {
    let [l, w] = plan.size;
    let parts = match plan.notch {
        None => vec![([0.0, 0.0], [l, w])],
        Some([x, y]) => vec![([0.0, 0.0], [l, w - y]), ([0.0, w - y], [l - x, w])],
    };
    let (name, ground) = match plan.is_public && chance(rng, 0.7) {
        true => public_ground(rng),
        false => ground(plan.is_wet, rng),
    };
    let mut floor = Model::new(ClassId::Floor, name, 0.9);
    let white = ColorName::White.sample(rng);
    let white = Material::new(white, Texture::Mottled(0.6), rng);
    let mut ceiling = Model::new(ClassId::Ceiling, ColorName::White, 0.6);
    for &(low, high) in &parts {
        let (u, v) = ([high[0] - low[0], 0.0, 0.0], [0.0, high[1] - low[1], 0.0]);
        floor.face([low[0], low[1], 0.0], u, v, ground);
        ceiling.face([low[0], low[1], plan.height], v, u, white);
    }
    let origin = Pose { origin: [0.0; 3], turn: STRAIGHT };
    layout.put_flat(floor, origin);
    if plan.has_ceiling {
        layout.put_flat(ceiling, origin);
    }
}

fn ground(is_wet: bool, rng: &mut SampleRng) -> (ColorName, Material) {
    use ColorName::{Beige, Blue, Brown, Grey, Red, White};
    if is_wet || chance(rng, 0.2) {
        let name = pick(rng, &[White, Grey, Grey, Beige, Blue]);
        let base = name.sample(rng);
        let tiles = Material::new(base, Texture::Tiles(between(rng, 0.2, 0.6)), rng);
        return (name, tiles.with_second(base.map(|c| c * 0.7)));
    }
    if chance(rng, 0.3) {
        let name = pick(rng, &[Grey, Beige, Brown, Blue, Red]);
        let base = name.sample(rng);
        return (name, Material::new(base, Texture::Mottled(between(rng, 0.05, 0.3)), rng));
    }
    let name = pick(rng, &[Brown, Brown, Beige, Grey]);
    let base = name.sample(rng);
    let texture = Texture::Boards(between(rng, 0.08, 0.22), between(rng, 0.6, 1.8));
    (name, Material::new(base, texture, rng).with_second(base.map(|c| c * 0.8)))
}

/// Floors of places other than homes: carpets in narrow stripes, carpet tiles, stone.
fn public_ground(rng: &mut SampleRng) -> (ColorName, Material) {
    use ColorName::{Beige, Black, Blue, Brown, Green, Grey, White};
    let name = pick(rng, &[Grey, Grey, Grey, Black, Blue, Brown, Beige, Green, White]);
    let base = name.sample(rng);
    let other = pick(rng, &[Grey, Black, White, Blue]).sample(rng);
    let texture = match whole(rng, 0, 4) {
        0 | 1 => Texture::Stripes(between(rng, 0.008, 0.05)),
        2 => Texture::Checks(between(rng, 0.3, 0.6)),
        3 => Texture::Tiles(between(rng, 0.3, 0.6)),
        _ => Texture::Mottled(between(rng, 0.02, 0.2)),
    };
    let second = mix(base, other, between(rng, 0.1, 0.8));
    (name, Material::new(base, texture, rng).with_second(second))
}
