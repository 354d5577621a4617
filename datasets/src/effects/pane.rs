//! Where a scene can have a pane of glass: on its largest upright plane.

use super::strength::{GLASS_ALPHA, GLASS_SHARE};
use super::{Effect, rng};
use crate::rng::between;
use scenesplat_scene::Up;
use scenesplat_scene::bounds::robust_bounds;
use scenesplat_scene::vector::{cross, dot};

/// Points that the search reads.
const SAMPLE: usize = 20_000;
/// Directions that a plane may face, over half a turn.
const DIRECTIONS: usize = 180;
/// Thickness of a plane, in diagonals of the scene.
const THICKNESS: f64 = 0.01;
/// Least share of the points on a plane, and least extent of it, in diagonals.
const LEAST_SHARE: f64 = 0.03;
const LEAST_EXTENT: f64 = 0.1;
/// Share of a plane's points beyond each of its ends.
const FRINGE: f64 = 0.02;
/// What is left of light that all of a pane takes in: glass is greenish.
pub(super) const TINT: [f64; 3] = [0.92, 1.0, 0.96];

/// Gaussians stray so far from the window that they belong to, meters.
const LEAST_THICKNESS: f64 = 0.01;

/// An upright plane of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wall {
    /// Of length 1, level, toward the middle of the scene.
    pub normal: [f64; 3],
    /// `normal · p` of its points, units of the scene.
    pub offset: f64,
    /// Level direction in the plane, of length 1.
    pub across: [f64; 3],
    /// Up, of length 1.
    pub up: [f64; 3],
    /// Its ends along `across`, `across · p`.
    pub width: [f64; 2],
    /// Its ends along `up`, `up · p`.
    pub height: [f64; 2],
    /// How far its points lie from it, units of the scene.
    pub thickness: f64,
}

/// A pane: a rectangle in an upright plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pane {
    /// Of length 1, toward the middle of the scene.
    pub normal: [f64; 3],
    /// Level direction in the plane, of length 1.
    pub across: [f64; 3],
    /// Up, of length 1.
    pub up: [f64; 3],
    /// Its middle.
    pub centre: [f64; 3],
    /// Half of its width and height, units of the scene.
    pub half: [f64; 2],
    /// Part of the light that it takes in, 0 to 1.
    pub alpha: f64,
    /// Red, green and blue of what it lets through, 0 to 1.
    pub tint: [f64; 3],
    /// Distance within which Gaussians lie in it, units of the scene.
    pub thickness: f64,
}

/// The most common place along a direction, and how many points are there.
fn fullest(places: &[f64], step: f64) -> (usize, f64) {
    let low = places.iter().copied().fold(f64::INFINITY, f64::min);
    let bin = |place: f64| ((place - low) / step) as usize;
    let last = places.iter().map(|&place| bin(place)).max().unwrap_or(0);
    let mut counts = vec![0; last + 2];
    places.iter().for_each(|&place| counts[bin(place)] += 1);
    // A plane may lie on the border of two.
    let (mut best, mut at) = (0, 0);
    for i in 0..=last {
        if counts[i] + counts[i + 1] > best {
            (best, at) = (counts[i] + counts[i + 1], i);
        }
    }
    (best, low + step * (at + 1) as f64)
}

/// The share `FRINGE` and `1 − FRINGE` of values.
fn ends(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    [at(FRINGE), at(1.0 - FRINGE)]
}

/// The normal and offset of the line of the plan that holds the most points, within a thickness of it.
fn fullest_line(level: &[[f64; 2]], thickness: f64) -> Option<([f64; 2], f64)> {
    let mut best = (0, [1.0, 0.0], 0.0);
    for k in 0..DIRECTIONS {
        let angle = std::f64::consts::PI * k as f64 / DIRECTIONS as f64;
        let facing = [angle.cos(), angle.sin()];
        let places: Vec<f64> = level.iter().map(|p| facing[0] * p[0] + facing[1] * p[1]).collect();
        let (count, offset) = fullest(&places, thickness);
        if count > best.0 {
            best = (count, facing, offset);
        }
    }
    let (_, mut facing, mut offset) = best;
    // Twice the line of least squares through what is near.
    for _ in 0..2 {
        let is_near =
            |p: &&[f64; 2]| (facing[0] * p[0] + facing[1] * p[1] - offset).abs() <= thickness;
        let near: Vec<[f64; 2]> = level.iter().filter(is_near).copied().collect();
        let n = near.len() as f64;
        if near.is_empty() {
            return None;
        }
        let mean = [0, 1].map(|i| near.iter().map(|p| p[i]).sum::<f64>() / n);
        let moment = |i: usize, j: usize| {
            near.iter().map(|p| (p[i] - mean[i]) * (p[j] - mean[j])).sum::<f64>()
        };
        // The direction of least variance of a 2 × 2 covariance.
        let angle = 0.5 * (2.0 * moment(0, 1)).atan2(moment(0, 0) - moment(1, 1));
        facing = [-angle.sin(), angle.cos()];
        offset = facing[0] * mean[0] + facing[1] * mean[1];
    }
    Some((facing, offset))
}

/// The upright plane with the most Gaussians; `None` if every plane has less than 3 % of the
/// Gaussians, or is less than a tenth of the scene's diagonal wide or high. Gaussians that are nowhere
/// do not count.
pub fn largest_wall(coord: &[[f32; 3]], up: Up) -> Option<Wall> {
    let there = coord.iter().filter(|p| p.iter().all(|v| v.is_finite()));
    let there: Vec<[f64; 3]> = there.map(|p| p.map(f64::from)).collect();
    let bounds = robust_bounds(coord);
    let diagonal = bounds.diagonal();
    if !(diagonal.is_finite() && diagonal > 0.0) {
        return None;
    }
    // What lies far outside must not stretch the histograms.
    let room = bounds.grown(0.1 * diagonal);
    let inside = |p: &[f64; 3]| room.distance(p.map(|v| v as f32)) == 0.0;
    let step = there.len().div_ceil(SAMPLE).max(1);
    let points: Vec<[f64; 3]> = there.iter().step_by(step).copied().filter(inside).collect();
    let [first, second, up] = up.upright();
    let thickness = THICKNESS * diagonal;
    let level: Vec<[f64; 2]> = points.iter().map(|&p| [dot(p, first), dot(p, second)]).collect();
    let (facing, mut offset) = fullest_line(&level, thickness)?;
    let mut normal: [f64; 3] =
        std::array::from_fn(|i| facing[0] * first[i] + facing[1] * second[i]);
    let middle: [f64; 3] = std::array::from_fn(|i| 0.5 * (bounds.low[i] + bounds.high[i]));
    if dot(normal, middle) < offset {
        (normal, offset) = (normal.map(|v| -v), -offset);
    }
    let on: Vec<[f64; 3]> =
        points.iter().copied().filter(|&p| (dot(normal, p) - offset).abs() <= thickness).collect();
    if on.len() < 8 || (on.len() as f64) < LEAST_SHARE * points.len() as f64 {
        return None;
    }
    let across = cross(up, normal);
    let along = |direction: [f64; 3]| ends(on.iter().map(|&p| dot(direction, p)).collect());
    let (width, height) = (along(across), along(up));
    let least = LEAST_EXTENT * diagonal;
    let large = [width, height].iter().all(|[low, high]| high - low >= least);
    large.then_some(Wall { normal, offset, across, up, width, height, thickness })
}

impl Pane {
    /// A pane on a wall: at severity *s* 12 % · *s* of its area, anywhere on it, taking in 6 % · *s* of
    /// the light. It stands before the wall's own Gaussians, its thickness away.
    pub fn on(wall: &Wall, severity: f64, seed: u64) -> Self {
        let mut rng = rng(seed, Effect::Glass, 0);
        let side = (GLASS_SHARE * severity).sqrt();
        let mut place = |[low, high]: [f64; 2]| {
            let half = 0.5 * (high - low);
            let reach = half * (1.0 - side);
            (0.5 * (low + high) + between(&mut rng, [-reach, reach]), half * side)
        };
        let ((x, half_width), (y, half_height)) = (place(wall.width), place(wall.height));
        let offset = wall.offset + wall.thickness;
        let centre =
            std::array::from_fn(|i| offset * wall.normal[i] + x * wall.across[i] + y * wall.up[i]);
        Self {
            normal: wall.normal,
            across: wall.across,
            up: wall.up,
            centre,
            half: [half_width, half_height],
            alpha: GLASS_ALPHA * severity,
            tint: TINT,
            thickness: wall.thickness,
        }
    }

    /// The pane of a window: its box, and the size of the room that it is in, whose corner is the origin and
    /// whose up is +z. It takes in 6 % · *s* of the light.
    pub fn in_box([low, high]: [[f32; 3]; 2], room: [f32; 3], severity: f64) -> Self {
        let [low, high] = [low, high].map(|p| p.map(f64::from));
        let centre: [f64; 3] = std::array::from_fn(|i| 0.5 * (low[i] + high[i]));
        let size = |i: usize| high[i] - low[i];
        // Windows stand in walls along x or y.
        let thin = usize::from(size(1) < size(0));
        let towards = (0.5 * f64::from(room[thin]) - centre[thin]).signum();
        let (mut normal, mut across) = ([0.0; 3], [0.0; 3]);
        normal[thin] = towards;
        across[1 - thin] = 1.0;
        // Before all of what the window is made of.
        let half_depth = 0.5 * size(thin);
        let mut front = centre;
        front[thin] += towards * half_depth;
        Self {
            normal,
            across,
            up: [0.0, 0.0, 1.0],
            centre: front,
            half: [0.5 * size(1 - thin), 0.5 * size(2)],
            alpha: GLASS_ALPHA * severity,
            tint: TINT,
            // Twice this far behind its front a Gaussian still belongs to it.
            thickness: half_depth + LEAST_THICKNESS,
        }
    }

    /// How far a point is before the pane's plane, units of the scene; below 0 behind it.
    pub fn before(&self, point: [f64; 3]) -> f64 {
        dot(self.normal, std::array::from_fn(|i| point[i] - self.centre[i]))
    }

    /// Whether the point of the plane next to a point is in the pane.
    pub fn covers(&self, point: [f64; 3]) -> bool {
        let from: [f64; 3] = std::array::from_fn(|i| point[i] - self.centre[i]);
        dot(from, self.across).abs() <= self.half[0] && dot(from, self.up).abs() <= self.half[1]
    }

    /// The mirror image of a point.
    pub fn mirrored(&self, point: [f64; 3]) -> [f64; 3] {
        let twice = 2.0 * self.before(point);
        std::array::from_fn(|i| point[i] - twice * self.normal[i])
    }

    /// The mirror image of a direction.
    pub fn mirrored_direction(&self, direction: [f64; 3]) -> [f64; 3] {
        let twice = 2.0 * dot(self.normal, direction);
        std::array::from_fn(|i| direction[i] - twice * self.normal[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::{sample_rng, unit};

    /// A room of 4 × 3 × 2.5 m about the origin, turned about z, one long wall denser.
    pub(crate) fn room(turn: f64) -> Vec<[f32; 3]> {
        let mut rng = sample_rng(5, 0, 0);
        let (sin, cos) = turn.sin_cos();
        let mut points = Vec::new();
        let mut add = |x: f64, y: f64, z: f64| {
            points.push([(cos * x - sin * y) as f32, (sin * x + cos * y) as f32, z as f32]);
        };
        for i in 0..6000 {
            let [u, v] = [unit(&mut rng), unit(&mut rng)];
            let noise = 0.01 * (unit(&mut rng) - 0.5);
            match i % 6 {
                0 | 1 => add(4.0 * u - 2.0, -1.5 + noise, 2.5 * v),
                2 => add(4.0 * u - 2.0, 1.5 + noise, 2.5 * v),
                3 => add(-2.0 + noise, 3.0 * u - 1.5, 2.5 * v),
                _ => add(4.0 * u - 2.0, 3.0 * v - 1.5, noise),
            }
        }
        points
    }

    #[test]
    fn the_largest_wall_of_a_turned_room_is_found() {
        for turn in [0.0, 0.3, 1.2, -2.5] {
            let wall = largest_wall(&room(turn), Up::PLUS_Z).unwrap();
            // The wall y = −1.5 faces +y, turned with the room.
            let want = [-f64::sin(turn), f64::cos(turn), 0.0];
            assert!(dot(wall.normal, want) > 0.9999, "{turn}: {wall:?}");
            assert!((wall.offset + 1.5).abs() < 0.01, "{turn}: {wall:?}");
            let [width, height] = [wall.width, wall.height].map(|[low, high]| high - low);
            assert!((width - 4.0).abs() < 0.25 && (height - 2.5).abs() < 0.2, "{wall:?}");
        }
    }

    #[test]
    fn where_there_is_no_wall_there_is_none() {
        let mut rng = sample_rng(6, 0, 0);
        let mut ball = Vec::new();
        for _ in 0..4000 {
            let d = scenesplat_kernels::random::direction(&mut rng);
            let r = unit(&mut rng).cbrt();
            ball.push(d.map(|v| (r * v) as f32));
        }
        // A slab of a ball through its middle, a hundredth of its diagonal to each side, holds little.
        let found = largest_wall(&ball, Up::PLUS_Z);
        assert!(found.is_none_or(|wall| wall.offset.abs() < 0.5), "{found:?}");
        let floor: Vec<[f32; 3]> =
            (0..2500).map(|i| [(i % 50) as f32, (i / 50) as f32, 0.0]).collect();
        assert_eq!(largest_wall(&floor, Up::PLUS_Z), None);
        assert!(largest_wall(&floor, Up::PLUS_X).is_some(), "it is a wall if x is up");
        assert_eq!(largest_wall(&[], Up::PLUS_Z), None);
        assert_eq!(largest_wall(&[[f32::NAN; 3]; 9], Up::PLUS_Z), None);
        assert_eq!(largest_wall(&[[1.0; 3]; 900], Up::PLUS_Z), None);
    }

    #[test]
    fn panes_are_of_the_stated_size_and_on_the_wall() {
        let wall = largest_wall(&room(0.7), Up::PLUS_Z).unwrap();
        for (severity, seed) in [(0.1, 0), (1.0, 1), (5.0, 2)] {
            let pane = Pane::on(&wall, severity, seed);
            let area = 4.0 * pane.half[0] * pane.half[1];
            let [width, height] = [wall.width, wall.height].map(|[low, high]| high - low);
            assert!((area / (width * height) - GLASS_SHARE * severity).abs() < 1e-9);
            assert!((pane.alpha - GLASS_ALPHA * severity).abs() < 1e-12);
            let x = dot(pane.centre, wall.across);
            assert!(x - pane.half[0] >= wall.width[0] - 1e-9, "{pane:?}");
            assert!(x + pane.half[0] <= wall.width[1] + 1e-9);
            let mirrored = pane.mirrored([0.1, 0.2, 0.3]);
            assert!((pane.before(mirrored) + pane.before([0.1, 0.2, 0.3])).abs() < 1e-12);
        }
    }
}
