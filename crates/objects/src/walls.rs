//! Pieces that follow lines in plan, such as the walls of a room, split into these lines.

use crate::cells::distinct;
use crate::upright_box::UprightBox;
use glam::DVec2;

/// Side of the cells of the plan, meters.
const CELL: f64 = 0.1;
/// A line takes what is no further from it, meters.
const REACH: f64 = 0.12;
/// Angles that lines are looked for at.
const ANGLES: usize = 180;
/// Shortest line, meters.
const SHORTEST: f64 = 0.6;
/// Share of the cells that a line must hold.
const LEAST_SHARE: f64 = 0.04;
/// Pieces smaller than this in plan, meters, are furniture.
const LEAST_SIDE: f64 = 1.2;
/// Most of its rectangle that a piece of lines covers; and one that stands, as walls do.
const FILL: f64 = 0.45;
const STANDING_FILL: f64 = 0.75;
/// Part of the cells that lines must explain.
const EXPLAINED: f64 = 0.8;
/// Most lines of one piece.
const MOST: usize = 24;

struct Line {
    /// Unit normal and distance from the origin.
    normal: DVec2,
    offset: f64,
    /// Extent along it.
    span: [f64; 2],
}

impl Line {
    fn distance(&self, p: DVec2) -> f64 {
        let off = (self.normal.dot(p) - self.offset).abs();
        let along = self.normal.perp_dot(p);
        let past = (self.span[0] - along).max(along - self.span[1]).max(0.0);
        off.hypot(past)
    }
}

/// The parts of a piece that lie along lines in plan, at least two; `None` for anything else.
///
/// `stands`: whether its surfaces are upright.
pub(crate) fn split(rows: &[u32], coord: &[[f32; 3]], stands: bool) -> Option<Vec<Vec<u32>>> {
    let around = UprightBox::around(coord, rows)?;
    if around.size[1] < LEAST_SIDE {
        return None;
    }
    let plan = |row: &u32| {
        let c = coord[*row as usize];
        DVec2::new(f64::from(c[0]), f64::from(c[1]))
    };
    let cells =
        distinct(rows.iter().map(|row| plan(row).to_array().map(|v| (v / CELL).floor() as i32)));
    let area = around.size[0] * around.size[1];
    let fill = if stands { STANDING_FILL } else { FILL };
    if cells.len() as f64 * CELL * CELL > fill * area {
        return None;
    }
    let middle = |cell: &[i32; 2]| DVec2::from(cell.map(|v| (f64::from(v) + 0.5) * CELL));
    let middles: Vec<DVec2> = cells.iter().map(middle).collect();
    let lines = lines(&middles)?;
    let nearest = |p: DVec2| {
        (0..lines.len())
            .fold(0, |n, i| if lines[i].distance(p) < lines[n].distance(p) { i } else { n })
    };
    let mut parts = vec![Vec::new(); lines.len()];
    rows.iter().for_each(|row| parts[nearest(plan(row))].push(*row));
    parts.retain(|p| !p.is_empty());
    parts.sort_unstable_by_key(|p| p.first().copied());
    (parts.len() > 1).then_some(parts)
}

/// Lines that explain most of the points, the strongest first.
fn lines(points: &[DVec2]) -> Option<Vec<Line>> {
    let mut left = points.to_vec();
    let mut found = Vec::new();
    while found.len() < MOST && !left.is_empty() {
        let Some((line, inside)) = strongest(&left) else { break };
        let share = inside.iter().filter(|i| **i).count() as f64 / points.len() as f64;
        if share < LEAST_SHARE || line.span[1] - line.span[0] < SHORTEST {
            break;
        }
        let mut flags = inside.iter();
        left.retain(|_| !flags.next().copied().unwrap_or_default());
        found.push(line);
    }
    let explained = 1.0 - left.len() as f64 / points.len() as f64;
    (found.len() > 1 && explained >= EXPLAINED).then_some(found)
}

/// The line with most points near it, and which they are.
fn strongest(points: &[DVec2]) -> Option<(Line, Vec<bool>)> {
    let mut best: Option<(usize, DVec2, f64)> = None;
    for step in 0..ANGLES {
        let normal = DVec2::from_angle(step as f64 * std::f64::consts::PI / ANGLES as f64);
        let mut offsets: Vec<f64> = points.iter().map(|p| normal.dot(*p)).collect();
        offsets.sort_unstable_by(f64::total_cmp);
        let mut start = 0;
        for end in 0..offsets.len() {
            while offsets[end] - offsets[start] > CELL * 1.5 {
                start += 1;
            }
            let count = end + 1 - start;
            if best.is_none_or(|(most, ..)| count > most) {
                best = Some((count, normal, offsets[start].midpoint(offsets[end])));
            }
        }
    }
    let (_, normal, offset) = best?;
    let is_near = |p: &DVec2| (normal.dot(*p) - offset).abs() <= REACH;
    let inside: Vec<bool> = points.iter().map(is_near).collect();
    let along = points.iter().filter(|p| is_near(p)).map(|p| normal.perp_dot(*p));
    let span = along.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)]);
    Some((Line { normal, offset, span }, inside))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walls of a rectangle, turned.
    fn room(turn: f64) -> Vec<[f32; 3]> {
        let (s, c) = turn.sin_cos();
        let mut out = Vec::new();
        for side in 0..4 {
            let (length, across) = if side % 2 == 0 { (5.0, 0.0) } else { (4.0, 0.0) };
            let corner = [[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]][side];
            let along = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]][side];
            for i in 0..50 {
                for k in 0..20 {
                    let t = length * (f64::from(i) + 0.5) / 50.0;
                    let p = [corner[0] + along[0] * t + across, corner[1] + along[1] * t];
                    let z = f64::from(k) * 0.12;
                    out.push([c * p[0] - s * p[1], s * p[0] + c * p[1], z].map(|v| v as f32));
                }
            }
        }
        out
    }

    #[test]
    fn four_walls_are_four() {
        for turn in [0.0, 0.4, 1.3] {
            let coord = room(turn);
            let rows: Vec<u32> = (0..coord.len() as u32).collect();
            let parts = split(&rows, &coord, true).unwrap();
            assert_eq!(parts.len(), 4, "{turn}");
            for (part, side) in parts.iter().zip(0..) {
                let own = part.iter().filter(|r| **r / 1000 == side).count();
                assert!(own > 900, "{turn}, wall {side}: {own} of {}", part.len());
            }
        }
    }

    #[test]
    fn what_fills_its_plan_stays_whole() {
        let coord: Vec<[f32; 3]> =
            (0..2500).map(|i| [(i % 50) as f32 * 0.06, (i / 50) as f32 * 0.06, 0.0]).collect();
        let rows: Vec<u32> = (0..2500).collect();
        assert_eq!(split(&rows, &coord, false), None, "a floor");
        let wall: Vec<u32> = (0..1000).collect();
        assert_eq!(split(&wall, &room(0.2), true), None, "one wall");
    }

    #[test]
    fn strays_beside_the_walls_change_nothing() {
        let with = |strays: usize| {
            let mut coord = room(0.0);
            // Apart from each other and from the walls, so that none is a line.
            let at =
                |i: usize| [0.6 + 0.37 * (i % 11) as f32, 0.5 + 0.41 * (i / 11 % 8) as f32, 0.0];
            coord.extend((0..strays).map(at));
            let rows: Vec<u32> = (0..coord.len() as u32).collect();
            split(&rows, &coord, true).map(|parts| parts.len())
        };
        assert_eq!((with(0), with(6)), (Some(4), Some(4)));
    }

    #[test]
    fn a_line_is_as_far_as_its_nearest_end() {
        // Along x at y = 2; its direction is counted against x.
        let line = Line { normal: DVec2::Y, offset: 2.0, span: [-1.0, 4.0] };
        let cases = [
            ([0.0, 2.5], 0.5),
            ([0.0, 1.0], 1.0),
            ([4.0, 6.0], 5.0),
            ([-7.0, 6.0], 5.0),
            ([1.0, 2.0], 0.0),
        ];
        for (p, want) in cases {
            assert!((line.distance(DVec2::from(p)) - want).abs() < 1e-12, "{p:?}");
        }
    }

    #[test]
    fn two_walls_at_a_corner_are_two_and_each_row_goes_to_its_own() {
        let corner = |long: f32, deep: f32| {
            let mut coord: Vec<[f32; 3]> =
                (0..120).map(|i| [long * (i as f32 + 0.5) / 120.0, 0.05, 0.5]).collect();
            coord.extend((0..100).map(|i| [0.05, 0.2 + deep * (i as f32 + 0.5) / 100.0, 1.0]));
            coord
        };
        let parts = |coord: &[[f32; 3]], stands| {
            let rows: Vec<u32> = (0..coord.len() as u32).collect();
            split(&rows, coord, stands)
        };
        let found = parts(&corner(3.0, 2.0), true).unwrap();
        assert_eq!(found.len(), 2);
        // But for what is at the corner.
        assert!(
            found[0].iter().filter(|r| **r < 120).count() > 112
                && found[1].iter().all(|r| *r >= 120 || *r < 8)
        );
        // Of a rectangle around it less than 1.2 m deep.
        assert_eq!(parts(&corner(3.0, 0.7), true), None);
        // Ten rows of 3 m every 0.22 m cover 3 of 5.8 square meters: too much but for what stands.
        let comb: Vec<[f32; 3]> = (0..600)
            .map(|i| [0.05 * (i % 60) as f32 + 0.02, 0.22 * (i / 60) as f32 + 0.05, 0.0])
            .collect();
        assert!(parts(&comb, true).is_some_and(|parts| parts.len() > 4));
        assert_eq!(parts(&comb, false), None);
    }

    #[test]
    fn the_strongest_line_is_that_of_most_points() {
        // Nine along y at x = 1 (one of them 0.1 beside), seven along x.
        let mut points: Vec<DVec2> = (0..9)
            .map(|i| DVec2::new(if i == 4 { 1.1 } else { 1.0 }, 0.2 * f64::from(i)))
            .collect();
        points.extend((0..7).map(|i| DVec2::new(2.0 + 0.3 * f64::from(i), 3.0)));
        let (line, inside) = strongest(&points).unwrap();
        assert_eq!(inside.iter().filter(|i| **i).count(), 9);
        assert!(inside[..9].iter().all(|i| *i) && (line.normal.x - 1.0).abs() < 1e-3);
        assert!(
            (line.offset - 1.05).abs() < 0.06 && (line.span[1] - line.span[0] - 1.6).abs() < 0.05,
            "{:?}",
            line.span
        );
        assert!(strongest(&[]).is_none());
        // Four lines of ten explain all; a single one is no corner; dust is none.
        let wall = |k: usize| {
            (0..10).map(move |i| {
                [
                    DVec2::new(0.1 * i as f64, k as f64),
                    DVec2::new(k as f64 + 3.0, 5.0 + 0.1 * i as f64),
                ][k % 2]
            })
        };
        let four: Vec<DVec2> = (0..4).flat_map(wall).collect();
        assert_eq!(lines(&four).map(|l| l.len()), Some(4));
        assert!(lines(&four[..10]).is_none());
        let dust: Vec<DVec2> =
            (0..101).map(|i: i32| DVec2::new(f64::from(i), f64::from(i * i % 101))).collect();
        assert!(lines(&dust).is_none());
    }
}
