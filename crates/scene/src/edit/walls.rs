//! What the walls of a room say: how it is turned about the vertical, and how high it is.

use super::level::{Flat, flats};
use crate::bounds::{Bounds, robust_bounds};
use crate::frame::Matrix3;
use crate::quantile::quantile;
use crate::{GaussianScene, Similarity};
use serde::Serialize;

/// A surface is plumb when its normal leans by at most this sine: 17 degrees.
const PLUMB: f64 = 0.3;

/// Degrees about the direction so far within which walls are averaged anew.
const CONES: [f64; 4] = [20.0, 10.0, 6.0, 4.0];

/// Rows that lie this near to a side of the box are its wall, in units of its longest side.
const NEAR: f64 = 0.06;

/// Stretches into which a side is cut, and the share of them that has to be covered.
const STRETCHES: usize = 24;
const COVERED: f64 = 0.6;

/// Part of the height of the walls that is their top.
const TOP: f64 = 0.15;

/// Fewest plumb rows that say anything.
const LEAST_ROWS: usize = 200;

/// Walls of a scene whose +z is up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Walls {
    /// Degrees by which the walls are turned from the axes, counter-clockwise seen from above,
    /// −45..=45.
    pub yaw: f64,
    /// Share of the plumb surface that is perpendicular or parallel to that within 10 degrees; of
    /// random directions 0.22 are.
    pub share: f64,
    /// Plumb Gaussians.
    pub rows: usize,
    /// How many of the four sides of the scene, seen along its walls, are closed by walls.
    pub closed: usize,
    /// How many of them are closed in the highest seventh of the walls, too: four where walls end at one
    /// height all around. Below a ceiling they do; where a capture stops short of it they seldom do.
    pub closed_at_top: usize,
    /// Height that 98 of 100 plumb Gaussians lie below, units of the scene.
    pub top: f64,
}

impl Walls {
    /// Looks at a scene. The same for any number of threads.
    pub fn of(scene: &GaussianScene) -> Self {
        let bounds = robust_bounds(&scene.coord);
        let mut plumb = flats(scene, &bounds);
        plumb.retain(|f| f.normal[2].abs() <= PLUMB);
        // No single Gaussian makes a wall.
        let most = plumb.iter().map(|f| f.surface).sum::<f64>() / 100.0;
        plumb.iter_mut().for_each(|f| f.surface = f.surface.min(most));
        let mut yaw = mean_yaw(&plumb, 0.0, 45.0).unwrap_or(0.0);
        for cone in CONES {
            yaw = mean_yaw(&plumb, yaw, cone).unwrap_or(yaw);
        }
        let total: f64 = plumb.iter().map(|f| f.surface).sum();
        let along = plumb.iter().filter(|f| off(f, yaw).abs() <= 10.0).map(|f| f.surface);
        let share = along.sum::<f64>() / total.max(f64::MIN_POSITIVE);
        let mut heights: Vec<f32> = plumb.iter().map(|f| f.coord[2] as f32).collect();
        let top = quantile(&mut heights, 0.98).map_or(bounds.high[2], f64::from);
        let closed = closed_sides(&plumb, yaw, &bounds, f64::NEG_INFINITY);
        let from = top - TOP * (top - bounds.low[2]);
        let closed_at_top = closed_sides(&plumb, yaw, &bounds, from);
        Self { yaw, share, rows: plumb.len(), closed, closed_at_top, top }
    }

    /// Whether the walls have a direction at all.
    pub fn is_clear(&self) -> bool {
        self.rows >= LEAST_ROWS && self.share >= 0.5
    }

    /// The turn about the vertical that brings the walls along the axes.
    pub fn squaring(&self) -> Matrix3 {
        let (s, c) = self.yaw.to_radians().sin_cos();
        let mut turn = Similarity::IDENTITY.rotation;
        turn[0] = [c, s, 0.0];
        turn[1] = [-s, c, 0.0];
        turn
    }
}

/// Degrees between a plumb Gaussian's normal and the nearest of four directions, −45..=45.
fn off(flat: &Flat, yaw: f64) -> f64 {
    let angle = flat.normal[1].atan2(flat.normal[0]).to_degrees() - yaw;
    angle - 90.0 * (angle / 90.0).round()
}

/// Mean direction of the walls within `cone` degrees about `yaw`: of four times the angle, as a
/// quarter turn makes no difference.
fn mean_yaw(plumb: &[Flat], yaw: f64, cone: f64) -> Option<f64> {
    let mut sum = [0.0; 2];
    for f in plumb {
        let angle = off(f, yaw);
        if angle.abs() <= cone {
            let (s, c) = (4.0 * angle).to_radians().sin_cos();
            sum = [sum[0] + c * f.surface, sum[1] + s * f.surface];
        }
    }
    (sum != [0.0; 2]).then(|| {
        let found = yaw + sum[1].atan2(sum[0]).to_degrees() / 4.0;
        found - 90.0 * (found / 90.0).round()
    })
}

/// Sides that are closed by plumb Gaussians from the height `from` on.
fn closed_sides(plumb: &[Flat], yaw: f64, bounds: &Bounds, from: f64) -> usize {
    let (s, c) = yaw.to_radians().sin_cos();
    let at = |f: &Flat| [c * f.coord[0] + s * f.coord[1], c * f.coord[1] - s * f.coord[0]];
    let places: Vec<[f64; 2]> = plumb.iter().map(at).collect();
    if places.len() < LEAST_ROWS {
        return 0;
    }
    let span = |a: usize| {
        let mut values: Vec<f32> = places.iter().map(|p| p[a] as f32).collect();
        [0.01, 0.99].map(|share| f64::from(quantile(&mut values, share).unwrap_or(0.0)))
    };
    let spans = [span(0), span(1)];
    let near = NEAR * bounds.largest_extent();
    let mut closed = 0;
    for (a, across) in [(0, 1), (1, 0)] {
        for side in spans[a] {
            let [low, high] = spans[across];
            let length = (high - low).max(f64::MIN_POSITIVE);
            let mut covered = [false; STRETCHES];
            let is_near =
                |(p, f): &(&[f64; 2], &Flat)| (p[a] - side).abs() <= near && f.coord[2] >= from;
            for (p, _) in places.iter().zip(plumb).filter(is_near) {
                let share = (p[across] - low) / length;
                if (0.0..1.0).contains(&share) {
                    covered[(share * STRETCHES as f64) as usize] = true;
                }
            }
            let count = covered.iter().filter(|&&c| c).count();
            closed += usize::from(count as f64 >= COVERED * STRETCHES as f64);
        }
    }
    closed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::EulerAngles;

    /// Walls of a room of 4 × 3 × 2.5 m, with a round pillar in it.
    fn room() -> GaussianScene {
        let mut scene = GaussianScene::default();
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let mut push = |coord: [f32; 3], quat: [f32; 4]| {
            scene.coord.push(coord);
            scene.quat.push(quat);
        };
        for i in 0..50u16 {
            let z = 0.05 * f32::from(i);
            for j in 0..60u16 {
                let t = f32::from(j) / 60.0;
                push([4.0 * t, 0.0, z], [half, half, 0.0, 0.0]);
                push([4.0 * t, 3.0, z], [half, half, 0.0, 0.0]);
                push([0.0, 3.0 * t, z], [half, 0.0, half, 0.0]);
                push([4.0, 3.0 * t, z], [half, 0.0, half, 0.0]);
                let (s, c) = (std::f32::consts::PI * t).sin_cos();
                push([2.0 + 0.3 * c, 1.5 + 0.3 * s, z], [half, half * s, half * c, 0.0]);
            }
        }
        let n = scene.coord.len();
        scene.log_scale = vec![[-3.5, -3.5, -6.0]; n];
        scene.opacity_logit = vec![3.0; n];
        scene.sh_dc = vec![[0.0; 3]; n];
        scene
    }

    #[test]
    fn the_turn_of_a_room_is_found_and_undone() {
        let still = Walls::of(&room());
        assert!(still.yaw.abs() < 0.3 && still.is_clear() && still.closed == 4, "{still:?}");
        assert!((still.top - 2.4).abs() < 0.06, "{still:?}");
        for yaw in [10.0, 37.0, -30.0, 44.0] {
            let mut scene = room();
            let rotation = EulerAngles([0.0, 0.0, yaw]).matrix();
            scene.transform(&Similarity { rotation, scale: 1.0, translation: [5.0, 1.0, 2.0] });
            let found = Walls::of(&scene);
            assert!((found.yaw - yaw).abs() < 0.3 && found.is_clear(), "{yaw}: {found:?}");
            assert_eq!(found.closed, 4, "{yaw}: {found:?}");
            let rotation = found.squaring();
            scene.transform(&Similarity { rotation, ..Similarity::IDENTITY });
            assert!(Walls::of(&scene).yaw.abs() < 0.3, "{yaw}");
        }
    }

    #[test]
    fn walls_that_end_here_and_there_are_not_closed_at_the_top() {
        let whole = Walls::of(&room());
        assert_eq!((whole.closed, whole.closed_at_top), (4, 4), "{whole:?}");
        // Beyond the middle of the room nothing above 1.6 m was captured.
        let scene = room();
        let is_seen = |p: &[f32; 3]| p[0] < 2.0 || p[2] < 1.6;
        let rows: Vec<usize> = (0..scene.len()).filter(|&row| is_seen(&scene.coord[row])).collect();
        let torn = Walls::of(&scene.select_rows(&rows).unwrap());
        assert_eq!((torn.closed, torn.closed_at_top), (4, 1), "{torn:?}");
    }

    #[test]
    fn what_is_round_has_no_direction() {
        let mut scene = room();
        let is_pillar: Vec<u32> = (0..scene.len() as u32).filter(|row| row % 5 == 4).collect();
        scene =
            scene.select_rows(&is_pillar.iter().map(|&r| r as usize).collect::<Vec<_>>()).unwrap();
        let found = Walls::of(&scene);
        assert!(!found.is_clear(), "{found:?}");
        assert_eq!(Walls::of(&GaussianScene::default()).closed, 0);
    }
}
