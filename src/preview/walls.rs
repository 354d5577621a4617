//! Walls around the ground plan of a scene, however the room is turned and whether or not it has a ceiling.

use super::discs::Disc;

/// Directions from the middle that are told apart.
const SECTORS: usize = 48;
/// Levels of the height.
const LEVELS: usize = 8;
/// Levels that a wall reaches through, and that what stands inside a room stays below.
const TALL: usize = 5;
/// Cells per side of the ground plan.
const CELLS: usize = 16;
/// The band of a sector, in its outermost distances, that walls stand in.
const BAND: f64 = 0.85;
/// What is nearer to the middle, in the same unit, is inside.
const INSIDE: f64 = 0.6;
/// Most discs that are looked at.
const SAMPLE: usize = 200_000;
/// Part of the discs that a level would have if all had as many, from which on it counts as filled: less is noise.
const FILLED: usize = 20;
/// Part of the sectors towards the camera that has to be walls.
const NEAR_SHARE: f64 = 0.5;
/// Part of the ground plan inside that is open to the sky.
const OPEN_SHARE: f64 = 0.5;

/// Where walls stand, and whether one could look over them.
pub(super) struct SurroundingWalls {
    /// Whether a wall stands at the end of each sector; the first begins at the first level axis.
    sectors: [bool; SECTORS],
    /// Most of what is inside them is lower than they are.
    is_open_above: bool,
}

impl SurroundingWalls {
    /// Of discs in the upright frame, those outside of the box left out.
    pub(super) fn of(discs: &[Disc], low: [f64; 3], high: [f64; 3]) -> Self {
        let size = [0, 1, 2].map(|a| (high[a] - low[a]).max(f64::MIN_POSITIVE));
        // Place in the box from 0 to 1, sector, distance from the middle.
        let place = |disc: &Disc| {
            let p = [0, 1, 2].map(|a| (f64::from(disc.centre[a]) - low[a]) / size[a]);
            let [x, y] = [0, 1].map(|a| (p[a] - 0.5) * size[a]);
            let turn = y.atan2(x).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
            let sector = ((turn * SECTORS as f64) as usize).min(SECTORS - 1);
            p.iter().all(|v| (0.0..1.0).contains(v)).then_some((p, sector, x.hypot(y)))
        };
        let step = discs.len() / SAMPLE + 1;
        let places: Vec<_> = discs.iter().step_by(step).filter_map(place).collect();
        let mut distances = vec![Vec::new(); SECTORS];
        places.iter().for_each(|&(_, sector, r)| distances[sector].push(r));
        let ends: Vec<f64> = distances.iter_mut().map(|all| outermost(all)).collect();

        let mut band = [[0_usize; LEVELS]; SECTORS];
        let mut inside = vec![[0_usize; LEVELS]; CELLS * CELLS];
        for &(p, sector, r) in &places {
            let level = (p[2] * LEVELS as f64) as usize;
            if r >= BAND * ends[sector] {
                band[sector][level] += 1;
            } else if r < INSIDE * ends[sector] {
                let [i, j] = [0, 1].map(|a| (p[a] * CELLS as f64) as usize);
                inside[i * CELLS + j][level] += 1;
            }
        }
        let least = |columns: usize| (places.len() / (columns * LEVELS * FILLED)).max(1);
        let filled = |levels: &[usize; LEVELS], least: usize| levels.map(|count| count >= least);
        let sectors = band
            .map(|levels| filled(&levels, least(SECTORS)).iter().filter(|f| **f).count() >= TALL);
        let tops: Vec<usize> = (inside.iter())
            .filter_map(|levels| filled(levels, least(CELLS * CELLS)).iter().rposition(|f| *f))
            .collect();
        let below = tops.iter().filter(|top| **top < TALL).count() as f64;
        let is_open_above = !tops.is_empty() && below >= OPEN_SHARE * tops.len() as f64;
        Self { sectors, is_open_above }
    }

    pub(super) fn is_open_above(&self) -> bool {
        self.is_open_above
    }

    /// Whether walls stand before a camera that looks to this azimuth, degrees, at the middle.
    pub(super) fn hide_from(&self, azimuth: f64) -> bool {
        let is_near = |sector: &usize| {
            let from = 360.0 * (*sector as f64 + 0.5) / SECTORS as f64;
            (from - azimuth).to_radians().cos() < -0.5
        };
        let near: Vec<usize> = (0..SECTORS).filter(is_near).collect();
        let walls = near.iter().filter(|&&sector| self.sectors[sector]).count() as f64;
        walls >= NEAR_SHARE * near.len() as f64
    }
}

/// The distance that 5 % of a sector are beyond.
fn outermost(distances: &mut [f64]) -> f64 {
    if distances.is_empty() {
        return f64::INFINITY;
    }
    let at = (0.95 * (distances.len() - 1) as f64) as usize;
    *distances.select_nth_unstable_by(at, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor of 6 × 4 m with walls of 2.5 m on the chosen sides, turned about the vertical axis.
    fn room(sides: [bool; 4], degrees: f64, furniture: f32) -> Vec<Disc> {
        let mut points = Vec::new();
        for i in 0..60 {
            for j in 0..40 {
                let (x, y) = (0.1 * f64::from(i) - 3.0, 0.1 * f64::from(j) - 2.0);
                points.push([x, y, 0.0]);
                if x.abs() < 1.0 && y.abs() < 1.0 {
                    points.push([x, y, f64::from(furniture)]);
                }
            }
            for k in 0..25 {
                let (along, z) = (f64::from(i) / 60.0 - 0.5, 0.1 * f64::from(k));
                let walls = [
                    [-3.0, 4.0 * along, z],
                    [3.0, 4.0 * along, z],
                    [6.0 * along, -2.0, z],
                    [6.0 * along, 2.0, z],
                ];
                points.extend(walls.into_iter().zip(sides).filter(|w| w.1).map(|w| w.0));
            }
        }
        let (s, c) = degrees.to_radians().sin_cos();
        let turned = |[x, y, z]: [f64; 3]| [c * x - s * y, s * x + c * y, z].map(|v| v as f32);
        let disc = |p| Disc { centre: turned(p), radius: 0.05, color: [0; 3] };
        points.into_iter().map(disc).collect()
    }

    fn walls_of(discs: &[Disc]) -> SurroundingWalls {
        let end = |sign: f32, a: usize| {
            let most = discs.iter().map(|d| sign * d.centre[a]).fold(f32::NEG_INFINITY, f32::max);
            f64::from(sign * most) + 0.01 * f64::from(sign)
        };
        SurroundingWalls::of(discs, [0, 1, 2].map(|a| end(-1.0, a)), [0, 1, 2].map(|a| end(1.0, a)))
    }

    #[test]
    fn walls_are_seen_however_the_room_is_turned() {
        for degrees in [0.0, 17.0, 45.0, 77.0] {
            let walls = walls_of(&room([true; 4], degrees, 0.8));
            assert!(walls.is_open_above(), "{degrees}");
            for azimuth in 0..24 {
                assert!(walls.hide_from(15.0 * f64::from(azimuth)), "{degrees}: {azimuth}");
            }
            let none = walls_of(&room([false; 4], degrees, 2.4));
            assert!(!none.hide_from(0.0), "{degrees}");
        }
    }

    #[test]
    fn only_a_wall_before_the_camera_hides_the_room() {
        let walls = walls_of(&room([true, false, true, false], 0.0, 0.8));
        assert!(walls.hide_from(60.0), "walls at low x and y, seen from there");
        assert!(!walls.hide_from(240.0), "seen from the open side");
    }

    #[test]
    fn a_closed_block_is_not_open_above() {
        let mut closed = room([true; 4], 0.0, 0.8);
        let roof = |d: &Disc| Disc { centre: [d.centre[0], d.centre[1], 2.4], ..*d };
        let roofs: Vec<Disc> = closed.iter().filter(|d| d.centre[2] == 0.0).map(roof).collect();
        closed.extend(roofs);
        assert!(!walls_of(&closed).is_open_above());
    }

    #[test]
    fn nothing_and_one_point() {
        for discs in [vec![], vec![Disc { centre: [1.0; 3], radius: 0.1, color: [0; 3] }]] {
            let walls = SurroundingWalls::of(&discs, [1.0; 3], [1.0; 3]);
            assert!(!walls.hide_from(0.0) && !walls.is_open_above());
        }
    }
}
