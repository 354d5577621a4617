//! Which way is up: the one answer for pictures, networks and reports.
//!
//! Few files say it, so the scene is asked. Directions that much surface faces may be up, and those at
//! right angles to two of them; each is weighed, and its opposite, by what a floor leaves behind: a slab
//! that covers the ground plan, most rows low, flat Gaussians that lie level. What a shiny floor reflects is left out.
//! The best is sharpened by a plane through its fullest level surface. All of it happens in the frame of the direction,
//! so that a scene may lie in any pose. Where the best hardly leads, what the file or its format says decides.

mod cameras;
mod direction;
mod evidence;
mod peaks;
mod plane;
mod reflection;
mod squareness;
mod surface;
mod walls;

pub use cameras::up_of_cameras;
pub use direction::Up;
pub(crate) use direction::shortest_to_z;
pub use evidence::UpEvidence;
pub use squareness::squareness;
pub use walls::Walls;

use crate::GaussianScene;
use crate::frame::{Matrix3, product};
use glam::DVec3;
use peaks::peaks;
use serde::Serialize;
use surface::Surface;

/// Within so many degrees a direction is that of an axis: over a room they are half a voxel of the network, and rugs
/// tilt a floor by half of them. By a plane these, or so many standard errors of its tilt; without one those.
const EXACT: f64 = 0.3;
const ERRORS: f64 = 3.0;
const ROUGH: f64 = 1.0;

/// A camera is seldom pitched by more degrees when a capture begins, so that up is within them of what
/// its format calls up.
const PITCH: f64 = 50.0;

/// Directions less than so many degrees apart are one candidate.
const APART: f64 = 20.0;

/// What is at right angles to two peaks is a candidate if these are so, within so many degrees.
const SQUARE: f64 = 10.0;

/// What the file states is no direction to which so much less of the surface is level than to the best.
const LEAST_LEVEL: f64 = 0.2;

/// What it is worth that a direction is near what the format of the file calls up, and next to what the file itself says.
const STATED_WEIGHT: f64 = 0.1;
const COMMENT_WEIGHT: f64 = 0.4;

/// The direction that seems to be up.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UpGuess {
    /// The direction.
    #[serde(rename = "axis")]
    pub direction: Up,
    /// How sure, 0..=1: how far its score leads. Below [`UpGuess::SURE`] it is no more than what the
    /// file states.
    pub confidence: f64,
    /// Whether the user said so; then the confidence is 1.
    pub given: bool,
    /// Whether what the file states agrees with the best direction, so that less confidence is enough.
    pub agrees: bool,
    /// What speaks for it.
    pub evidence: String,
    /// All directions that were weighed, the best first; empty if given.
    pub candidates: Vec<UpEvidence>,
}

/// What a file, or the convention of its format, says about up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StatedUp {
    /// The direction.
    #[serde(rename = "axis")]
    pub direction: Up,
    /// Who says so, for messages: `glTF`.
    pub source: &'static str,
}

/// Which way is up in a scene; where the scene itself leaves it open, what its file states decides.
///
/// The same for any number of threads. Without rows or extent the confidence is 0.
pub fn guess_up(scene: &GaussianScene, stated: StatedUp) -> UpGuess {
    let mut surface = Surface::of(scene);
    let peaks = peaks(&surface);
    let directions = directions(&surface, &peaks, stated.direction);
    reflection::leave_out(&mut surface, directions.iter().map(|up| frame(*up, &peaks)));
    let mut candidates: Vec<UpEvidence> = directions
        .into_iter()
        .flat_map(|up| evidence::weigh_both(&surface, up, &frame(up, &peaks)))
        .collect();
    let is_near = |up: Up| up.degrees_from(stated.direction) <= PITCH;
    for candidate in &mut candidates {
        candidate.score += match candidate.direction.degrees_from(stated.direction) {
            off if off <= APART && stated.source == StatedUp::COMMENT => COMMENT_WEIGHT,
            off if off <= PITCH => STATED_WEIGHT,
            _ => 0.0,
        };
    }
    // Stable: of equals the first wins, whatever the threads.
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    let best = candidates[0];
    let second = candidates[1];
    let confidence = (best.score - second.score).clamp(0.0, 1.0);
    let agrees = is_near(best.direction);
    let evidence = text(&best, second.direction);
    let direction = best.direction;
    let mut guess = UpGuess { direction, confidence, given: false, agrees, evidence, candidates };
    if confidence < UpGuess::SURE {
        // What is level next to it, or else itself.
        let is_it = |c: &&UpEvidence| c.direction.degrees_from(stated.direction) <= APART;
        let may_be = |c: &&UpEvidence| is_it(c) && c.level >= LEAST_LEVEL * best.level;
        let stated_one = guess.candidates.iter().find(may_be);
        guess.direction = stated_one.map_or(direction, |c| c.direction);
        let who = if stated_one.is_some() { stated.source } else { "the best of them" };
        guess.evidence += &format!("; that is close, so {who} decides");
    }
    guess
}

impl StatedUp {
    /// The source of what a file itself says, unlike the convention of its format.
    pub const COMMENT: &'static str = "the file's comment";

    /// Of scenes in memory, about which no file says anything: as networks know rooms.
    pub const UPRIGHT: Self = Self { direction: Up::PLUS_Z, source: "the convention of networks" };
}

impl Default for StatedUp {
    fn default() -> Self {
        Self::UPRIGHT
    }
}

impl UpGuess {
    /// From this confidence on the scene decides by itself. The least that ten rooms of the demo have is 0.33.
    pub const SURE: f64 = 0.25;

    /// From this confidence on it is sure where what the file states agrees.
    pub const SURE_IF_STATED: f64 = 0.15;

    /// Whether the scene itself says so, or with the file, or the user.
    pub fn is_sure(&self) -> bool {
        let least = if self.agrees { Self::SURE_IF_STATED } else { Self::SURE };
        self.confidence >= least
    }

    /// The direction that the user names.
    pub fn given(direction: Up) -> Self {
        Self {
            direction,
            confidence: 1.0,
            given: true,
            agrees: true,
            evidence: "as given".to_owned(),
            candidates: Vec::new(),
        }
    }
}

fn text(best: &UpEvidence, second: Up) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    format!(
        "the lowest slab covers {} of the ground plan, {} of the rows lie in the lower half, {} of the \
         surface is level, {} of what is slanted is plumb; next best is {second}",
        percent(best.floor_cover),
        percent(best.below),
        percent(best.level),
        percent(best.plumb),
    )
}

/// Directions of which one, or its opposite, may be up.
fn directions(surface: &Surface, peaks: &[DVec3], stated: Up) -> Vec<Up> {
    // With the degrees within which it may be an axis.
    let mut found: Vec<(DVec3, f64)> = Vec::new();
    let is_new = |found: &[(DVec3, f64)], direction: DVec3| {
        let apart = APART.to_radians().cos();
        found.iter().all(|f| f.0.dot(direction).abs() <= apart)
    };
    for &peak in peaks {
        found.push(match plane::fullest_plane(surface, peak) {
            Some(plane) => (plane.normal, EXACT.max(ERRORS * plane.error)),
            None => (peak, ROUGH),
        });
    }
    // The floor may be hidden under furniture, or not captured.
    for (i, a) in peaks.iter().enumerate() {
        for b in &peaks[..i] {
            let across = a.cross(*b);
            if across.length() >= SQUARE.to_radians().cos() && is_new(&found, across.normalize()) {
                found.push((across.normalize(), ROUGH));
            }
        }
    }
    // What has no surface to speak for it.
    let has_frame = found.len() >= 3;
    let axes = [stated, Up::PLUS_X, Up::PLUS_Y, Up::PLUS_Z];
    for axis in axes.into_iter().take(if has_frame { 1 } else { 4 }) {
        let axis = DVec3::from(axis.vector());
        if is_new(&found, axis) {
            found.push((axis, EXACT));
        }
    }
    let up = |(v, within): (DVec3, f64)| Up::new(v.to_array()).map(|up| exact(up, within));
    found.into_iter().filter_map(up).collect()
}

/// The axis, if the direction is within so many degrees of one.
fn exact(up: Up, within: f64) -> Up {
    let axis = up.nearest_axis();
    if axis.degrees_from(up) <= within { axis } else { up }
}

/// A frame whose third axis is a direction: that of the walls if there are any, else that of its turn
/// upright.
fn frame(up: Up, peaks: &[DVec3]) -> Matrix3 {
    let upright = up.upright();
    let z = DVec3::from(up.vector());
    let most_level = SQUARE.to_radians().sin();
    let wall = peaks.iter().find(|p| p.dot(z).abs() <= most_level);
    let Some(wall) = wall else { return upright };
    let x = (*wall - z * wall.dot(z)).normalize();
    // Next to the turn upright, so that axes keep their order.
    let [first, second, _] = upright.map(DVec3::from);
    let angle = f64::atan2(x.dot(second), x.dot(first));
    let quarter = std::f64::consts::FRAC_PI_2;
    let (s, c) = (angle - quarter * (angle / quarter).round()).sin_cos();
    product(&[[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], &upright)
}

#[cfg(test)]
mod tests;
