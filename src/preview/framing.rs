//! Where the cameras stand and what they show.

use super::discs::{Disc, Lens};
use super::walls::SurroundingWalls;
use scenesplat_scene::Up;
use scenesplat_scene::quantile::quantile;

/// Turns a scene so that +z is up.
#[derive(Clone, Copy)]
pub(super) struct Upright {
    rows: [[f32; 3]; 3],
}

impl Upright {
    pub(super) fn new(up: Up) -> Self {
        let rows = up.upright().map(|row| row.map(|v| v as f32));
        Self { rows }
    }

    /// As [`Self::turn`], of a position in f64.
    pub(super) fn turn_exact(&self, p: [f64; 3]) -> [f64; 3] {
        self.rows.map(|r| (0..3).map(|a| f64::from(r[a]) * p[a]).sum())
    }

    /// The name of an upright direction in the scene's own axes: `-y`.
    pub(super) fn axis_name(&self, direction: [f64; 3]) -> &'static str {
        let names = [["+x", "-x"], ["+y", "-y"], ["+z", "-z"]];
        let along =
            |a: usize| -> f64 { (0..3).map(|i| f64::from(self.rows[i][a]) * direction[i]).sum() };
        (0..3).find(|&a| along(a).abs() > 0.5).map_or("", |a| names[a][usize::from(along(a) < 0.0)])
    }

    /// The direction or position in the scene's own axes.
    pub(super) fn turn_back(&self, p: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|a| (0..3).map(|i| f64::from(self.rows[i][a]) * p[i]).sum())
    }

    pub(super) fn turn(&self, p: [f32; 3]) -> [f32; 3] {
        // A sum of one coordinate and two zeros would turn -0 into 0 only: no rounding.
        self.rows.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2])
    }
}

/// The box that is shown, and how.
pub(super) struct Framing {
    /// Bounds of what is drawn, fitted into the views.
    low: [f64; 3],
    high: [f64; 3],
    /// Discs outside are not drawn.
    draw_low: [f64; 3],
    draw_high: [f64; 3],
    /// The same limits before walls and ceiling were cut away.
    uncut_low: [f64; 3],
    uncut_high: [f64; 3],
    /// Of a room that may be cut open.
    room: Option<Room>,
    /// Some of the centers that are drawn, for aiming the camera.
    sample: Vec<[f64; 3]>,
    /// Space around centers, meters.
    border: f64,
}

/// What encloses a room.
struct Room {
    has_ceiling: bool,
    walls: SurroundingWalls,
}

/// Where the perspective view of a preview looks to, level, from the side of low x and y.
const AZIMUTH: f64 = 60.0;

/// What is lower, meters, is no room without a ceiling.
pub(super) const LOWEST_ROOM: f64 = 1.8;

/// Part of the radius, before the middle, that the near walls of a room are cut away up to.
pub(super) const CUT_SHARE: f64 = 0.3;

/// Most centers that aim the camera.
const SAMPLE: usize = 5000;

/// Share of the discs, at each end of an axis, that may be outliers.
const OUTSIDE: f64 = 0.02;

/// What is drawn reaches this far beyond the robust bounds, in units of their longest side.
const REACH: f64 = 0.12;

/// Share of the drawn discs, at each end of an axis, that the views need not show whole.
const FRINGE: f64 = 0.001;

/// Cells per side in which the coverage of a wall or ceiling is counted.
const CELLS: usize = 24;

/// A layer of it is a part of a wall when so many are; and the thickest wall, in heights of the room.
const FACE_COVER: f64 = 0.4;
const THICKEST: f64 = 0.25;

/// A side of the box counts as a wall when so many of its cells are covered.
const WALL_COVER: f64 = 0.6;

impl Framing {
    pub(super) fn of(discs: &[Disc], open_rooms: bool) -> Self {
        let mut radii: Vec<f32> = discs.iter().map(|d| d.radius).collect();
        let border = 2.0 * at(&mut radii, 0.5).clamp(1e-4, 1e4);
        let (low, high) = bounds(&discs.iter(), OUTSIDE, border);
        let largest = (0..3).map(|a| high[a] - low[a]).fold(0.0, f64::max);
        let mut framing = Self {
            low,
            high,
            draw_low: low.map(|v| v - REACH * largest),
            draw_high: high.map(|v| v + REACH * largest),
            uncut_low: low.map(|v| v - REACH * largest),
            uncut_high: high.map(|v| v + REACH * largest),
            room: None,
            sample: Vec::new(),
            border,
        };
        if open_rooms {
            framing.cut_open(discs);
        }
        let shown: Vec<&Disc> = discs.iter().filter(|d| framing.shows(d.centre)).collect();
        (framing.low, framing.high) = bounds(&shown.iter().copied(), FRINGE, border);
        let within =
            |p: &[f64; 3]| (0..3).all(|a| (framing.low[a]..=framing.high[a]).contains(&p[a]));
        framing.sample = shown
            .iter()
            .step_by(shown.len() / SAMPLE + 1)
            .map(|d| d.centre.map(f64::from))
            .filter(within)
            .collect();
        framing
    }

    /// Bounds of what is drawn.
    pub(super) fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        (self.low, self.high)
    }

    /// Whether the perspective view leaves something out to look into a room.
    pub(super) fn is_cut_open(&self) -> bool {
        self.cut_sides() != ([None; 3], [None; 3]) || self.is_cut_open_for(&[AZIMUTH])
    }

    /// The same for cameras that look to these azimuths, degrees: a closed room is cut open for any, one without a ceiling
    /// if its walls stand before most of them.
    pub(super) fn is_cut_open_for(&self, azimuths: &[f64]) -> bool {
        let Some(Room { has_ceiling, walls }) = &self.room else { return false };
        let hidden = azimuths.iter().filter(|azimuth| walls.hide_from(**azimuth)).count();
        *has_ceiling || 2 * hidden > azimuths.len()
    }

    /// Limits of what is drawn at the low and high side of each axis, where a wall or ceiling is cut
    /// away there.
    pub(super) fn cut_sides(&self) -> ([Option<f64>; 3], [Option<f64>; 3]) {
        let cut = |draw: f64, limit: f64| (draw != limit).then_some(draw);
        (
            [0, 1, 2].map(|a| cut(self.draw_low[a], self.uncut_low[a])),
            [0, 1, 2].map(|a| cut(self.draw_high[a], self.uncut_high[a])),
        )
    }

    /// Where the wall at the high side of the first axis begins, if there is one.
    pub(super) fn right_wall(&self, discs: &[Disc]) -> Option<f64> {
        self.room.as_ref()?;
        self.covers(discs, 0, true).then(|| self.high[0] - self.thickness(discs, 0, true))
    }

    pub(super) fn shows(&self, p: [f32; 3]) -> bool {
        (0..3).all(|a| (self.draw_low[a]..=self.draw_high[a]).contains(&f64::from(p[a])))
    }

    /// Moves the limits of what is drawn inside the ceiling and the walls toward the camera, if this is a room: with a floor
    /// and a ceiling, or with walls around a middle that is open above.
    fn cut_open(&mut self, discs: &[Disc]) {
        if !self.covers(discs, 2, false) {
            return;
        }
        let walls = SurroundingWalls::of(discs, self.low, self.high);
        let has_ceiling = self.covers(discs, 2, true);
        let is_high = self.high[2] - self.low[2] > LOWEST_ROOM;
        let is_open = is_high && walls.is_open_above();
        if !has_ceiling && !is_open {
            return;
        }
        let extent = [0, 1, 2].map(|a| self.high[a] - self.low[a]);
        for axis in [0, 1] {
            if self.covers(discs, axis, false) {
                self.draw_low[axis] = self.low[axis] + self.thickness(discs, axis, false);
            }
        }
        self.room = Some(Room { has_ceiling, walls });
        if has_ceiling {
            self.draw_high[2] = self.high[2] - 0.12 * extent[2];
        }
    }

    /// Whether one side of the box is mostly covered by discs near it: of the cells of its
    /// rectangle that anything in the scene projects to, for level sides; of all, for upright ones.
    fn covers(&self, discs: &[Disc], axis: usize, at_high: bool) -> bool {
        let depth = 0.06 * (self.high[axis] - self.low[axis]);
        self.cover(discs, axis, at_high, [f64::NEG_INFINITY, depth]) >= WALL_COVER
    }

    /// How deep a wall at one side of the box is: its inner face may be as closed as the outer one.
    fn thickness(&self, discs: &[Disc], axis: usize, at_high: bool) -> f64 {
        let height = self.high[2] - self.low[2];
        let (mut depth, step) = (0.08 * height, 0.04 * height);
        while depth < THICKEST * height
            && self.cover(discs, axis, at_high, [depth, depth + step]) >= FACE_COVER
        {
            depth += step;
        }
        depth
    }

    /// How much of one side of the box is covered by discs in a layer of these depths, 0..=1.
    fn cover(&self, discs: &[Disc], axis: usize, at_high: bool, layer: [f64; 2]) -> f64 {
        let [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
        let cell = |p: f32, a: usize| {
            let share = (f64::from(p) - self.low[a]) / (self.high[a] - self.low[a]);
            (0.0..1.0).contains(&share).then_some((share * CELLS as f64) as usize)
        };
        let mut any = [false; CELLS * CELLS];
        let mut side = [false; CELLS * CELLS];
        for disc in discs {
            let [Some(i), Some(j)] = [u, v].map(|a| cell(disc.centre[a], a)) else { continue };
            any[i * CELLS + j] = true;
            let p = f64::from(disc.centre[axis]);
            let depth = if at_high { self.high[axis] - p } else { p - self.low[axis] };
            side[i * CELLS + j] |= (layer[0]..layer[1]).contains(&depth);
        }
        let count = |cells: &[bool]| cells.iter().filter(|&&c| c).count() as f64;
        let whole = if axis == 2 { count(&any) } else { (CELLS * CELLS) as f64 };
        if whole >= 0.2 * (CELLS * CELLS) as f64 { count(&side) / whole } else { 0.0 }
    }

    /// A camera that looks down at the box from the side of low x and y.
    pub(super) fn perspective(&self) -> Lens {
        // Rooms are shown more steeply than objects.
        let elevation = if self.is_cut_open() { 50.0_f64 } else { 35.0 }.to_radians();
        let azimuth = AZIMUTH.to_radians();
        let forward =
            [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), -elevation.sin()];
        let right = [azimuth.sin(), -azimuth.cos(), 0.0];
        let up =
            [elevation.sin() * azimuth.cos(), elevation.sin() * azimuth.sin(), elevation.cos()];
        let half_view = 20.0_f64.to_radians().tan();
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let mut target = [0, 1, 2].map(|a| (self.low[a] + self.high[a]) / 2.0);
        let mut distance = 0.0;
        // Each round stands back until everything is inside the view, then aims at the middle of
        // what is seen.
        for _ in 0..6 {
            let seen: Vec<[f64; 3]> = self
                .sample
                .iter()
                .map(|p| {
                    let offset = [0, 1, 2].map(|a| p[a] - target[a]);
                    [dot(offset, right), dot(offset, up), dot(offset, forward)]
                })
                .collect();
            distance = seen.iter().fold(3.0 * self.border, |distance: f64, [x, y, z]| {
                let aside = x.abs().max(y.abs()) + self.border;
                distance.max(aside / (0.97 * half_view) - z)
            });
            for (side, direction) in [(0, right), (1, up)] {
                let angles = seen.iter().map(|p| p[side] / (distance + p[2]));
                let (low, high) = angles
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
                if low <= high {
                    let shift = (low + high) / 2.0 * distance;
                    target = std::array::from_fn(|a| target[a] + shift * direction[a]);
                }
            }
        }
        Lens {
            axes: [right, up.map(|v| -v), forward],
            eye: [0, 1, 2].map(|a| target[a] - distance * forward[a]),
            scale: 1.0 / half_view,
            is_perspective: true,
            size: self.size(),
            near: self.near(distance),
        }
    }

    /// Depth from which on the perspective view shows something: behind near walls that are no sides of the box, such as
    /// those of a room that is turned.
    fn near(&self, distance: f64) -> f64 {
        let (low, _) = self.cut_sides();
        let is_cut = low[0].is_some() && low[1].is_some();
        let walls = self.room.as_ref().filter(|_| !is_cut);
        let radius = (0..3).map(|a| (self.high[a] - self.low[a]).powi(2)).sum::<f64>().sqrt() / 2.0;
        match walls {
            Some(room) if room.walls.hide_from(AZIMUTH) => distance - CUT_SHARE * radius,
            _ => 0.0,
        }
    }

    /// A view straight down; x to the right, y up.
    pub(super) fn top(&self) -> Lens {
        let half = (0..2).map(|a| (self.high[a] - self.low[a]) / 2.0).fold(0.0, f64::max);
        let middle = [0, 1].map(|a| (self.low[a] + self.high[a]) / 2.0);
        Lens {
            axes: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
            eye: [middle[0], middle[1], self.draw_high[2] + self.size()],
            scale: 0.97 / half,
            is_perspective: false,
            size: self.size(),
            near: 0.0,
        }
    }

    fn size(&self) -> f64 {
        (0..3).map(|a| self.high[a] - self.low[a]).fold(0.0, f64::max)
    }
}

/// Bounds of the centers without a share at each end, plus a border: never an empty box.
fn bounds<'a>(
    discs: &(impl Iterator<Item = &'a Disc> + Clone),
    share: f64,
    border: f64,
) -> ([f64; 3], [f64; 3]) {
    let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
    let mut values = Vec::new();
    for axis in 0..3 {
        values.clear();
        values.extend(discs.clone().map(|d| d.centre[axis]));
        low[axis] = at(&mut values, share) - border;
        high[axis] = at(&mut values, 1.0 - share) + border;
    }
    (low, high)
}

/// A quantile, 0 without values.
fn at(values: &mut [f32], share: f64) -> f64 {
    quantile(values, share).map_or(0.0, f64::from)
}
