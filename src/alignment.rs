//! What is done to a scene before a network reads it: networks know rooms with +z up, in meters.
//!
//! A room that lies on its side loses most labels, and few files say how it lies. So up and unit are
//! estimated (as [`inspect`](crate::inspect::inspect) does), and a copy is turned and scaled for the network
//! alone. Up may be any direction, so the copy is level. Where the evidence is close, a network may decide
//! ([`judge`]); what stays open is a [`Remark`]. Outputs belong to rows, so they need no turning back. For
//! networks that know rooms along the axes ([`AlignmentSettings::square`]) walls are brought along the
//! axes, of the four ways to that in which what stands in the room leans most towards +y. Heights are measured from the [floors](Alignment::floors) of the copy.

pub mod judge;
mod remark;
mod report;

pub use remark::Remark;
pub use report::{AlignmentReport, Alternative};

use crate::inspect::{
    LengthUnit, ReadUnit, SizedUnit, UnitGuess, guess_unit, is_surely_no_metre, may_be_no_metre,
    usual_spacing,
};
use rayon::prelude::*;
use scenesplat_scene::edit::level;
use scenesplat_scene::frame::Matrix3;
use scenesplat_scene::similarity::{matrix_to_quat, quat_product};
use scenesplat_scene::vector::dot;
use scenesplat_scene::{
    Bounds, Floors, GaussianScene, Similarity, StatedUp, Up, UpGuess, Walls, guess_up,
    robust_bounds,
};
use serde::Serialize;
use std::borrow::Cow;

/// With fewer Gaussians neither up nor unit is judged.
const FEWEST_ROWS: usize = 100;

/// Rows by which tilt, yaw, floors and walls are judged.
const SAMPLE: usize = 200_000;

/// A tilt is a remark from so many degrees on; less changes no label.
const TILT: f64 = 1.0;

/// Where the user names an axis, a floor is made level up to so many degrees: more is no tilt but a slope.
const MOST_TILT: f64 = 20.0;

/// Level, the floor must hold so much more than before: a scene without one is not turned.
const SHARPER: f64 = 1.05;

/// Walls are brought along the axes from so many degrees on; less moves no Gaussian by a tenth of a voxel.
const LEAST_YAW: f64 = 0.1;

/// From so many degrees on it is a remark.
const YAW: f64 = 1.0;

/// Heights of closed rooms that are in meters without doubt.
const CLEAR_HEIGHTS: [f64; 2] = [2.2, 3.2];

/// Heights of rooms, meters; a closed room outside them is in another unit, and read as one of the
/// usual height.
const ROOM_HEIGHTS: [f64; 2] = [1.8, 4.3];
/// The lower one where walls end at one height all around: they were not cut off by the capture.
const LEAST_WHOLE_HEIGHT: f64 = 2.1;
const USUAL_HEIGHT: f64 = 2.6;

/// A unit by the height of walls is off by less than a tenth so often: rooms are 2.3 to 3.1 m high.
const BY_WALLS: f64 = 0.6;

/// What the user knows about a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AlignmentSettings {
    /// Which way is up; estimated if not given.
    pub up: Option<Up>,
    /// What the scene's file states about up, which decides where the scene leaves it open.
    pub stated_up: StatedUp,
    /// What one unit of the scene is, meters; estimated if not given. Finite, above 0.
    pub metres_per_unit: Option<f64>,
    /// Height of the floor along up, units of the scene (once level); looked for if not given. Finite.
    pub floor: Option<f64>,
    /// Whether walls are brought along the axes, for networks that know rooms so.
    pub square: bool,
    /// Leaves the scene as it is, whatever is known or seen.
    pub as_is: bool,
}

/// How a scene is changed for a network, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alignment {
    /// Which way is up in the scene.
    pub up: UpGuess,
    /// What one unit is, where it is not clearly a meter.
    pub unit: Option<UnitGuess>,
    /// The direction that is turned to +z; +z for none.
    pub turned_from: Up,
    /// Whether the network decided between directions.
    pub judged: bool,
    /// Factor that brings the scene to meters; 1 for none.
    pub scale: f64,
    /// What things of known size say about that factor, if the network looked for them.
    pub sized: Option<UnitBySize>,
    /// Degrees by which the floor was out of level, after the turn of the nearest axis; 0 if nothing
    /// was done about it.
    pub tilt: f64,
    /// Degrees by which the scene was turned about the vertical, after that, to the one square way in which its every
    /// pose is read, −180..=180; 0 if nothing was done about it.
    pub yaw: f64,
    /// Floors of the scene as the network reads it, meters.
    pub floors: Floors,
    /// All turns together, and all but that about the vertical.
    #[serde(skip)]
    rotation: Matrix3,
    #[serde(skip)]
    upright: Matrix3,
    /// What was subtracted from the positions of the scene when it was read.
    #[serde(skip)]
    origin: [f64; 3],
    /// Whether the unit was to be found, and the shape leaves it open.
    #[serde(skip)]
    is_size_open: bool,
    /// What a user must know, the most important first.
    pub remarks: Vec<Remark>,
}

/// The unit of a scene by things of known size in it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnitBySize {
    /// The probability that the factor is off by less than a tenth, 0..=1.
    pub confidence: f64,
    /// What speaks for it.
    pub evidence: String,
}

impl Alignment {
    /// Estimates the alignment of a scene. The same for any number of threads.
    pub fn of(scene: &GaussianScene, settings: &AlignmentSettings) -> Self {
        let up = settings.up.map_or_else(|| guess_up(scene, settings.stated_up), UpGuess::given);
        Self::with_up(scene, settings, up, false)
    }

    /// As [`of`](Self::of) for what is known or decided about up; `judged`: by the network.
    fn with_up(
        scene: &GaussianScene,
        settings: &AlignmentSettings,
        up: UpGuess,
        judged: bool,
    ) -> Self {
        let robust = robust_bounds(&scene.coord);
        let is_judged = scene.len() >= FEWEST_ROWS;
        let mut alignment = Self {
            up,
            unit: None,
            turned_from: Up::PLUS_Z,
            judged,
            scale: 1.0,
            sized: None,
            tilt: 0.0,
            yaw: 0.0,
            floors: Floors::given(0.0),
            rotation: Up::PLUS_Z.upright(),
            upright: Up::PLUS_Z.upright(),
            origin: scene.origin,
            is_size_open: false,
            remarks: Vec::new(),
        };
        if !settings.as_is {
            if settings.up.is_some() || is_judged {
                alignment.decide_up();
            }
            match settings.metres_per_unit {
                Some(metres) => alignment.set_scale(metres),
                None if is_judged && may_be_no_metre(&robust) => {
                    alignment.decide_unit(&robust, usual_spacing(&scene.coord));
                }
                None => {}
            }
        }
        let mut sample = alignment.sample(scene);
        alignment.floors = Floors::of_scene(&sample);
        if !settings.as_is && is_judged {
            alignment.decide_frame(&mut sample, settings);
        }
        if let Some(floor) = settings.floor {
            let height = floor - alignment.height_of_origin();
            alignment.floors = Floors::given(height * alignment.scale);
        }
        alignment.remarks.sort_by_key(|remark| !remark.is_warning());
        alignment
    }

    /// Heights of the floors along up in the coordinates of the scene's file, its units, ascending.
    pub fn floor_heights(&self) -> Vec<f64> {
        let origin = self.height_of_origin();
        self.floors.heights.iter().map(|height| height / self.scale + origin).collect()
    }

    fn height_of_origin(&self) -> f64 {
        dot(self.upright[2], self.origin)
    }

    /// The rows by which the rest is judged, turned and scaled as far as is known.
    fn sample(&self, scene: &GaussianScene) -> GaussianScene {
        let step = scene.len().div_ceil(SAMPLE).max(1);
        fn every<T: Copy>(values: &[T], step: usize) -> Vec<T> {
            values.iter().step_by(step).copied().collect()
        }
        let mut sample = GaussianScene {
            coord: every(&scene.coord, step),
            log_scale: every(&scene.log_scale, step),
            quat: every(&scene.quat, step),
            opacity_logit: every(&scene.opacity_logit, step),
            sh_dc: every(&scene.sh_dc, step),
            ..GaussianScene::default()
        };
        if !self.is_identity() {
            let (rotation, scale) = (self.rotation, self.scale);
            sample.transform(&Similarity { rotation, scale, translation: [0.0; 3] });
        }
        sample
    }

    /// Tilt, yaw and, where nothing else says it, the unit.
    fn decide_frame(&mut self, sample: &mut GaussianScene, settings: &AlignmentSettings) {
        // A scene that lies anyhow has no walls and no height.
        let is_upright = self.up.given || self.up.is_sure() || self.judged;
        // An axis that the user names is a rough answer; everything else is level by now.
        if settings.up.is_some_and(|up| up.axis_name().is_some()) {
            self.decide_tilt(sample);
        }
        self.upright = self.rotation;
        let is_sought = settings.metres_per_unit.is_none() && self.scale == 1.0;
        self.is_size_open = is_sought;
        let may_scale = is_sought && self.unit.is_none();
        if !is_upright || !(settings.square || may_scale) {
            return;
        }
        let walls = Walls::of(sample);
        let is_off = walls.yaw.abs() >= LEAST_YAW || walls.quarters != 0;
        if settings.square && walls.is_clear() && is_off {
            let turn = walls.yaw + 90.0 * f64::from(walls.quarters);
            self.yaw = turn - 360.0 * (turn / 360.0).round();
            self.turn(&walls.squaring(LEAST_YAW));
            if walls.yaw.abs() >= YAW {
                self.remarks.push(Remark::Squared { yaw: walls.yaw });
            }
        }
        if may_scale {
            self.decide_room(sample, &walls);
        }
    }

    fn decide_tilt(&mut self, sample: &mut GaussianScene) {
        let leveling = level(sample);
        if !leveling.has_floor() || !(TILT..=MOST_TILT).contains(&leveling.tilt) {
            return;
        }
        let mut turned = sample.clone();
        let rotation = leveling.rotation;
        turned.transform(&Similarity { rotation, ..Similarity::IDENTITY });
        let floors = Floors::of_scene(&turned);
        if floors.has_plane() && floors.score > SHARPER * self.floors.score {
            self.tilt = leveling.tilt;
            self.turn(&rotation);
            self.floors = floors;
            self.remarks.push(Remark::Leveled { tilt: leveling.tilt });
            *sample = turned;
        }
    }

    /// A room that is closed all around, and as high as none is.
    fn decide_room(&mut self, sample: &mut GaussianScene, walls: &Walls) {
        let extent = robust_bounds(&sample.coord).extent()[2];
        let least = if walls.closed_at_top < 4 { ROOM_HEIGHTS[0] } else { LEAST_WHOLE_HEIGHT };
        let is_room = |height: f64| (least..=ROOM_HEIGHTS[1]).contains(&height);
        let is_closed = walls.closed == 4 && walls.is_clear();
        let is_clear = is_closed && (CLEAR_HEIGHTS[0]..=CLEAR_HEIGHTS[1]).contains(&extent);
        self.is_size_open &= !is_clear;
        if walls.closed < 4 || !walls.is_clear() || extent <= 0.0 || is_room(extent) {
            return;
        }
        // Floors are looked for in meters, so first as if the extent were that of a room.
        let scaled = |by: f64, sample: &GaussianScene| {
            let mut scaled = sample.clone();
            scaled.transform(&Similarity { scale: by, ..Similarity::IDENTITY });
            scaled
        };
        let guess = USUAL_HEIGHT / extent;
        let floors = Floors::of_scene(&scaled(guess, sample));
        let height = walls.top - floors.heights[0] / guess;
        // Several storeys are higher than a room.
        if !floors.has_plane() || height <= 0.0 || is_room(height) || self.floors.heights.len() > 1
        {
            return;
        }
        let by = USUAL_HEIGHT / height;
        self.scale *= by;
        self.floors = Floors::of_scene(&scaled(by, sample));
        self.is_size_open = true;
        self.remarks.push(Remark::ScaledToRoom { by: self.scale, height });
    }

    /// Reads a copy that is so many times larger.
    fn scale_by(&mut self, scene: &GaussianScene, settings: &AlignmentSettings, by: f64) {
        self.scale *= by;
        self.floors = match settings.floor {
            Some(floor) => Floors::given((floor - self.height_of_origin()) * self.scale),
            None => Floors::of_scene(&self.sample(scene)),
        };
    }

    fn turn(&mut self, by: &Matrix3) {
        let old = self.rotation;
        self.rotation =
            [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| by[i][k] * old[k][j]).sum()));
    }

    fn decide_up(&mut self) {
        let UpGuess { direction, confidence, .. } = self.up;
        if !self.up.is_sure() && !self.judged {
            self.remarks.push(Remark::UpUnclear { likely: direction, confidence });
        }
        let axis = direction.nearest_axis();
        self.turned_from = direction;
        self.rotation = direction.upright();
        self.upright = self.rotation;
        self.tilt = direction.degrees_from(axis);
        if axis != Up::PLUS_Z {
            self.remarks.push(Remark::Turned { from: direction });
        } else if self.tilt >= TILT {
            self.remarks.push(Remark::Leveled { tilt: self.tilt });
        }
    }

    fn decide_unit(&mut self, robust: &Bounds, spacing: Option<f64>) {
        let Some(guess) = guess_unit(robust, spacing) else { return };
        if guess.unit == LengthUnit::Metre {
            return;
        }
        let (likely, confidence) = (guess.unit, guess.confidence);
        if is_surely_no_metre(&guess, robust) {
            self.set_scale(likely.metres());
        } else {
            self.remarks.push(Remark::UnitUnclear { likely, confidence });
        }
        self.unit = Some(guess);
    }

    fn set_scale(&mut self, metres: f64) {
        if metres != 1.0 {
            self.scale = metres;
            self.remarks.push(Remark::Scaled { by: metres });
        }
    }

    /// Whether the unit was to be found, and the shape of the scene leaves it open.
    pub fn is_size_open(&self) -> bool {
        self.is_size_open
    }

    /// In what unit a network reads the scene, for reports.
    pub fn read_unit(&self) -> ReadUnit {
        let metres = self.scale;
        let is_by_walls = |remark: &Remark| matches!(remark, Remark::ScaledToRoom { .. });
        if let Some(UnitBySize { confidence, evidence }) = self.sized.clone() {
            ReadUnit::Sized(SizedUnit { metres, confidence, evidence })
        } else if self.remarks.iter().any(is_by_walls) {
            let evidence = "by the height of walls that close the scene on four sides".to_owned();
            ReadUnit::Sized(SizedUnit { metres, confidence: BY_WALLS, evidence })
        } else if self.is_size_open {
            ReadUnit::Open
        } else {
            ReadUnit::Clear
        }
    }

    /// Whether up was to be found, and the scene leaves it open.
    pub fn is_open(&self) -> bool {
        self.remarks.iter().any(|remark| matches!(remark, Remark::UpUnclear { .. }))
    }

    /// All turns together: what brings +z up, the floor level and the walls along the axes, as far as
    /// something was done about them.
    pub fn rotation(&self) -> Matrix3 {
        self.rotation
    }

    /// As [`rotation`](Self::rotation), without the turn about the vertical.
    pub fn upright(&self) -> Matrix3 {
        self.upright
    }

    /// Whether the network reads the scene itself.
    pub fn is_identity(&self) -> bool {
        self.turned_from == Up::PLUS_Z && self.scale == 1.0 && self.tilt == 0.0 && self.yaw == 0.0
    }

    /// The scene as the network reads it: itself, bit for bit, if nothing is to be done, else a copy
    /// of what networks read (no labels, no higher harmonics).
    pub fn apply<'a>(&self, scene: &'a GaussianScene) -> Cow<'a, GaussianScene> {
        if self.is_identity() {
            return Cow::Borrowed(scene);
        }
        Cow::Owned(turned_and_scaled(scene, &self.rotation, self.scale))
    }
}

/// A turned and scaled copy of what networks read (no labels, no higher harmonics).
pub(crate) fn turned_and_scaled(
    scene: &GaussianScene,
    rotation: &Matrix3,
    scale: f64,
) -> GaussianScene {
    let turn = matrix_to_quat(rotation);
    let is_turned = *rotation != Up::PLUS_Z.upright();
    // Of an axis and without yaw a row of the rotation has one ±1 and two zeros: no rounding.
    let direction =
        |v: &[f32; 3]| rotation.map(|r| (0..3).map(|a| r[a] * f64::from(v[a])).sum::<f64>());
    let add = scale.ln();
    let scaled = |s: &[f32; 3]| s.map(|s| (f64::from(s) + add) as f32);
    let quat = |&q: &[f32; 4]| if is_turned { turned(turn, q) } else { q };
    let normals = scene.normal.as_ref();
    GaussianScene {
        coord: scene.coord.par_iter().map(|p| direction(p).map(|v| (scale * v) as f32)).collect(),
        log_scale: scene.log_scale.par_iter().map(scaled).collect(),
        quat: scene.quat.par_iter().map(quat).collect(),
        normal: normals.map(|n| n.par_iter().map(|n| direction(n).map(|v| v as f32)).collect()),
        opacity_logit: scene.opacity_logit.clone(),
        sh_dc: scene.sh_dc.clone(),
        ..GaussianScene::default()
    }
}

/// The quaternion of an orientation that is turned. Where `w` is 0 but for rounding, both signs fit
/// `w ≥ 0`; the largest component decides, as in generated rooms, so that a wall's Gaussians agree.
fn turned(turn: [f64; 4], quat: [f32; 4]) -> [f32; 4] {
    const ROUNDING: f32 = 1e-6;
    let q = quat_product(turn, quat);
    let largest = q.iter().copied().fold(0.0f32, |a, v| if v.abs() > a.abs() { v } else { a });
    if q[0].abs() < ROUNDING && largest < 0.0 { q.map(|v| -v) } else { q }
}

#[cfg(test)]
mod tests;
