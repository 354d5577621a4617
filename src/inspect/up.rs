//! Which way is up.

use super::bounds::Bounds;
use super::statistics::quantile;
use crate::outputs::guess_up;
use crate::preview::UpAxis;
use scenesplat_scene::GaussianScene;
use serde::Serialize;

/// Rows that the guess looks at.
const SAMPLE: usize = 200_000;

/// Cells per side in which the coverage of a level surface is counted.
const CELLS: usize = 24;

/// Thickness of the slab in which a floor is looked for, in units of the longest side.
const SLAB: f64 = 0.04;

/// A Gaussian is flat when its shortest axis is so much shorter than the middle one, in ln.
const FLAT: f32 = 1.0;

/// A surface faces an axis when the cosine between them exceeds this: within 26°.
const FACING: f32 = 0.9;

/// What each kind of evidence is worth. Set on fourteen scenes whose up is known; only the order of
/// the directions comes from them.
const COVER_WEIGHT: f64 = 0.5;
const BELOW_WEIGHT: f64 = 0.8;
const LEVEL_WEIGHT: f64 = 0.5;
const FLOOR_WEIGHT: f64 = 0.5;
const TALL_WEIGHT: f64 = 0.3;
const HABIT_WEIGHT: f64 = 0.1;

/// One side this much longer than both others is taken for the height of something that stands.
const TALL: f64 = 1.6;

/// The direction that seems to be up.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UpGuess {
    /// The direction.
    pub axis: UpAxis,
    /// How sure, 0..=1: how far its score leads. Below 0.15 it is no more than a habit.
    pub confidence: f64,
    /// Whether the user said so; then the confidence is 1.
    pub given: bool,
    /// What speaks for it.
    pub evidence: String,
    /// All directions, the best first; empty if given.
    pub candidates: Vec<UpEvidence>,
}

/// What speaks for one direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UpEvidence {
    /// The direction.
    pub axis: UpAxis,
    /// Weighted sum of what follows, and of the shape.
    pub score: f64,
    /// Share of the ground plan that the lowest slab covers: a floor.
    pub floor_cover: f64,
    /// Share of the rows in the lower half.
    pub below: f64,
    /// Share of the surface of flat Gaussians that is level.
    pub level: f64,
    /// Share of the surface of flat Gaussians that is level and in the lowest slab.
    pub floor: f64,
}

const AXES: [UpAxis; 6] =
    [UpAxis::PlusX, UpAxis::MinusX, UpAxis::PlusY, UpAxis::MinusY, UpAxis::PlusZ, UpAxis::MinusZ];

impl UpAxis {
    /// Its name: `+z`.
    pub fn name(self) -> &'static str {
        match self {
            Self::PlusX => "+x",
            Self::MinusX => "-x",
            Self::PlusY => "+y",
            Self::MinusY => "-y",
            Self::PlusZ => "+z",
            Self::MinusZ => "-z",
        }
    }

    /// Number of the axis, and whether it points along it.
    fn axis(self) -> (usize, bool) {
        match self {
            Self::PlusX => (0, true),
            Self::MinusX => (0, false),
            Self::PlusY => (1, true),
            Self::MinusY => (1, false),
            Self::PlusZ => (2, true),
            Self::MinusZ => (2, false),
        }
    }
}

/// A row that the guess looks at.
struct Look {
    /// Position in the robust box, 0..=1 along each axis.
    place: [f64; 3],
    /// The axis that it faces, if it is flat and faces any.
    facing: Option<usize>,
    /// Visible surface, m²; 0 if it is not flat.
    surface: f32,
}

/// Guesses from a floor, from most of it lying low, from level surfaces and from the shape.
pub(super) fn guess(scene: &GaussianScene, robust: &Bounds) -> UpGuess {
    let looks = look(scene, robust);
    let habit = guess_up(scene);
    let mut candidates = AXES.map(|up| weigh(&looks, robust, up, habit));
    // Stable: of equals the first axis of the list wins, whatever the threads.
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    let [best, second, ..] = candidates;
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let evidence = format!(
        "the lowest {} cover {} of the ground plan, {} of the rows lie in the lower half, {} of the \
         surface is level; next best is {}",
        percent(SLAB),
        percent(best.floor_cover),
        percent(best.below),
        percent(best.level),
        second.axis.name()
    );
    UpGuess {
        axis: best.axis,
        confidence: (best.score - second.score).clamp(0.0, 1.0),
        given: false,
        evidence,
        candidates: candidates.to_vec(),
    }
}

/// The direction that the user names.
pub(super) fn given(up: UpAxis) -> UpGuess {
    UpGuess {
        axis: up,
        confidence: 1.0,
        given: true,
        evidence: "as given".to_owned(),
        candidates: Vec::new(),
    }
}

fn look(scene: &GaussianScene, robust: &Bounds) -> Vec<Look> {
    let extent = robust.extent();
    let step = scene.len().div_ceil(SAMPLE).max(1);
    let mut looks: Vec<Look> = (0..scene.len())
        .step_by(step)
        .filter(|&row| robust.distance(scene.coord[row]) == 0.0)
        .map(|row| {
            let place = [0, 1, 2].map(|a| {
                let above = f64::from(scene.coord[row][a]) - robust.low[a];
                if extent[a] > 0.0 { above / extent[a] } else { 0.0 }
            });
            let (facing, surface) = facing(scene, row).unwrap_or((None, 0.0));
            Look { place, facing, surface }
        })
        .collect();
    // A few huge discs, a backdrop say, must not outweigh the scene.
    let mut surfaces: Vec<f32> = looks.iter().map(|l| l.surface).filter(|s| *s > 0.0).collect();
    let most = quantile(&mut surfaces, 0.99).unwrap_or(0.0);
    looks.iter_mut().for_each(|l| l.surface = l.surface.min(most));
    looks
}

/// The axis that a flat Gaussian faces, and its visible surface; `None` if it is not flat.
fn facing(scene: &GaussianScene, row: usize) -> Option<(Option<usize>, f32)> {
    let mut order = [0, 1, 2];
    let scale = scene.log_scale[row];
    order.sort_by(|&a, &b| scale[a].total_cmp(&scale[b]));
    let [shortest, middle, longest] = order;
    if scale[middle] - scale[shortest] < FLAT || scale[middle] == f32::NEG_INFINITY {
        return None;
    }
    let [w, x, y, z] = scene.quat[row];
    // Columns of the rotation matrix are the principal axes.
    let axis = match shortest {
        0 => [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        1 => [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        _ => [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    };
    let surface = (scale[middle] + scale[longest]).exp() * scene.opacity(row);
    let faced = (0..3).find(|&a| axis[a].abs() > FACING);
    surface.is_finite().then_some((faced, surface))
}

fn weigh(looks: &[Look], robust: &Bounds, up: UpAxis, habit: UpAxis) -> UpEvidence {
    let (axis, is_positive) = up.axis();
    let extent = robust.extent();
    let [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
    // A slab as thick as the scene is flat says nothing.
    let slab = (SLAB * robust.largest_extent() / extent[axis].max(f64::MIN_POSITIVE)).min(0.25);
    let cell = |share: f64| ((share * CELLS as f64) as usize).min(CELLS - 1);
    let (mut any, mut low) = ([false; CELLS * CELLS], [false; CELLS * CELLS]);
    let (mut below, mut level, mut floor, mut surface) = (0usize, 0.0, 0.0, 0.0);
    for l in looks {
        let height = if is_positive { l.place[axis] } else { 1.0 - l.place[axis] };
        let at = cell(l.place[u]) * CELLS + cell(l.place[v]);
        let is_low = height <= slab;
        any[at] = true;
        low[at] |= is_low;
        below += usize::from(height < 0.5);
        let own = f64::from(l.surface);
        surface += own;
        if l.facing == Some(axis) {
            level += own;
            floor += if is_low { own } else { 0.0 };
        }
    }
    let count = |cells: &[bool]| cells.iter().filter(|&&c| c).count() as f64;
    let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    let is_flat = extent[axis] <= 0.0;
    let mut out = UpEvidence {
        axis: up,
        score: 0.0,
        floor_cover: if is_flat { 0.0 } else { share(count(&low), count(&any)) },
        below: if is_flat { 0.5 } else { share(below as f64, looks.len() as f64) },
        level: share(level, surface),
        floor: share(floor, surface),
    };
    let is_tall = extent[axis] > TALL * extent[u].max(extent[v]);
    out.score = COVER_WEIGHT * out.floor_cover
        + BELOW_WEIGHT * (out.below - 0.5)
        + LEVEL_WEIGHT * out.level
        + FLOOR_WEIGHT * out.floor
        // A corridor is long too, but closed at its ends.
        + if is_tall { TALL_WEIGHT * (1.0 - out.floor_cover) } else { 0.0 }
        + if up == habit { HABIT_WEIGHT } else { 0.0 };
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect::bounds::robust_bounds;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    #[test]
    fn rooms_are_upright_however_they_are_turned() {
        let room = generate(&SyntheticRoomSettings::with_count(6_000, 3)).unwrap().scene;
        let guess_of = |scene: &GaussianScene| guess(scene, &robust_bounds(&scene.coord));
        assert_eq!(guess_of(&room).axis, UpAxis::PlusZ);
        // Half a turn about x: quaternion (0, 1, 0, 0) from the left.
        let mut turned = room.clone();
        turned.coord.iter_mut().for_each(|c| *c = [c[0], -c[1], -c[2]]);
        turned.quat.iter_mut().for_each(|q| *q = [-q[1], q[0], -q[3], q[2]]);
        assert_eq!(guess_of(&turned).axis, UpAxis::MinusZ);
        // A quarter turn about x takes z to -y.
        let h = std::f32::consts::FRAC_1_SQRT_2;
        let mut turned = room;
        turned.coord.iter_mut().for_each(|c| *c = [c[0], -c[2], c[1]]);
        turned.quat.iter_mut().for_each(|[w, x, y, z]| {
            (*w, *x, *y, *z) = (h * (*w - *x), h * (*x + *w), h * (*y - *z), h * (*z + *y));
        });
        assert_eq!(guess_of(&turned).axis, UpAxis::MinusY);
    }

    #[test]
    fn a_corridor_does_not_stand_on_its_end() {
        let mut corridor = generate(&SyntheticRoomSettings::with_count(6_000, 4)).unwrap().scene;
        corridor.coord.iter_mut().for_each(|c| c[0] *= 4.0);
        corridor.log_scale.iter_mut().for_each(|s| s[0] += 0.7);
        let robust = robust_bounds(&corridor.coord);
        assert!(robust.extent()[0] > 3.0 * robust.extent()[2], "{:?}", robust.extent());
        assert_eq!(guess(&corridor, &robust).axis, UpAxis::PlusZ);
    }

    #[test]
    fn points_and_planes_have_an_up_too() {
        let flat = |coord: Vec<[f32; 3]>| GaussianScene {
            log_scale: vec![[-3.0, -3.0, f32::NEG_INFINITY]; coord.len()],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; coord.len()],
            opacity_logit: vec![f32::INFINITY; coord.len()],
            sh_dc: vec![[0.0; 3]; coord.len()],
            coord,
            ..GaussianScene::default()
        };
        for coord in [
            vec![[1.0, 2.0, 3.0]],
            (0..400u16).map(|i| [f32::from(i % 20), f32::from(i / 20), 0.0]).collect(),
            vec![[1e30, -1e30, 0.0], [f32::MAX, f32::MIN, 1.0]],
        ] {
            let scene = flat(coord);
            let guess = guess(&scene, &robust_bounds(&scene.coord));
            assert!(guess.candidates.iter().all(|c| c.score.is_finite()), "{guess:?}");
        }
    }
}
