//! Fragments of one object joined over the gaps that a capture leaves.

use crate::cells::Joined;
use crate::upright_box::UprightBox;

/// A fragment has at most this share of what it is joined to.
const SMALL: f64 = 0.35;
/// Fragments join over so many gaps in plan.
const REACH: f64 = 2.5;
/// Parts above each other join over this height, meters: a seat and its legs, a shade and its foot.
const STACK: f64 = 0.35;
/// Part of the smaller plan that must lie over the larger one.
const OVER: f64 = 0.6;
/// Halves of one thing hang in one plane, as high, and at most so far apart, meters.
const PAIR: f64 = 2.2;
/// What hangs in a plane is at most so thick and at least so high, meters.
const THIN: f64 = 0.3;
const HIGH: f64 = 0.8;

/// Joins the pieces of one class that are fragments of one object. Those that come out larger than
/// both by far are left apart.
///
/// `min_count`: Gaussians of an object at least; smaller pieces join one, and not each other.
/// `pairs`: whether thin hanging pieces at one height in one plane are one object (curtains).
pub(crate) fn join(
    pieces: Vec<Vec<u32>>,
    coord: &[[f32; 3]],
    gap: f64,
    min_count: usize,
    pairs: bool,
) -> Vec<Vec<u32>> {
    let Some(boxes) = boxes(&pieces, coord) else { return pieces };
    // The largest first: fragments go to the largest thing near.
    let mut order: Vec<usize> = (0..pieces.len()).collect();
    order.sort_by_key(|&i| (usize::MAX - pieces[i].len(), i));
    // What is no object by itself takes nothing in: specks are many, and all pairs of them too many.
    let large = order.partition_point(|&i| pieces[i].len() >= min_count);
    let mut joined = Joined::new(pieces.len());
    for (place, &small) in order.iter().enumerate() {
        let (own, count) = (&boxes[small], pieces[small].len() as f64);
        let distance = |&big: &usize| {
            let other = &boxes[big];
            let (plan, height) = (own.plan_gap(other), own.height_gap(other));
            let is_small = count <= SMALL * pieces[big].len() as f64;
            let fits = (is_small && plan.hypot(height) <= REACH * gap)
                || (height <= STACK && is_over(own, other))
                || (pairs && is_pair(own, other));
            fits.then(|| plan.hypot(height))
        };
        let near =
            order[..place.min(large)].iter().filter_map(|big| distance(big).map(|d| (d, *big)));
        // Of equally near ones the first, which is larger.
        let nearest = near.reduce(|best, next| if next.0 < best.0 { next } else { best });
        if let Some((_, big)) = nearest {
            joined.join(small as u32, big as u32);
        }
    }
    gathered(pieces, &mut joined)
}

/// The box around each piece; `None` if one is empty.
fn boxes(pieces: &[Vec<u32>], coord: &[[f32; 3]]) -> Option<Vec<UprightBox>> {
    pieces.iter().map(|rows| UprightBox::around(coord, rows)).collect()
}

fn gathered(pieces: Vec<Vec<u32>>, joined: &mut Joined) -> Vec<Vec<u32>> {
    let mut place: Vec<Option<usize>> = vec![None; pieces.len()];
    let mut out: Vec<Vec<u32>> = Vec::new();
    for (i, rows) in (0u32..).zip(pieces) {
        match &mut place[joined.root(i) as usize] {
            Some(at) => out[*at].extend(rows),
            none => {
                *none = Some(out.len());
                out.push(rows);
            }
        }
    }
    out.iter_mut().for_each(|rows| rows.sort_unstable());
    out
}

/// Two sides of one wall are so near, meters, and so long and high at least.
const WALL: f64 = 0.2;
const WALL_LONG: f64 = 1.0;

/// Joins the two sides of walls: thin upright pieces, parallel, one before the other.
pub(crate) fn join_sides(pieces: Vec<Vec<u32>>, coord: &[[f32; 3]]) -> Vec<Vec<u32>> {
    let Some(boxes) = boxes(&pieces, coord) else { return pieces };
    let mut joined = Joined::new(pieces.len());
    let walls: Vec<usize> = (0..boxes.len()).filter(|&i| is_wall(&boxes[i])).collect();
    for (at, &i) in walls.iter().enumerate() {
        for &j in &walls[at + 1..] {
            if are_sides(&boxes[i], &boxes[j]) {
                joined.join(i as u32, j as u32);
            }
        }
    }
    gathered(pieces, &mut joined)
}

fn is_wall(b: &UprightBox) -> bool {
    b.size[1] <= THIN && b.size[0] >= WALL_LONG && b.size[2] >= HIGH
}

fn are_sides(a: &UprightBox, b: &UprightBox) -> bool {
    if a.plan_gap(b) > WALL {
        return false;
    }
    if (b.yaw - a.yaw).cos().abs() < 0.995 {
        return false;
    }
    let [along, across] = a.in_plan(b.plan_center()).map(f64::abs);
    let common = (a.size[0] + b.size[0]) / 2.0 - along;
    across <= WALL + (a.size[1] + b.size[1]) / 2.0
        && common >= 0.7 * a.size[0].min(b.size[0])
        && a.height_gap(b) == 0.0
}

/// Whether most of one plan lies over or under the other.
fn is_over(a: &UprightBox, b: &UprightBox) -> bool {
    let (small, large) =
        if a.size[0] * a.size[1] <= b.size[0] * b.size[1] { (a, b) } else { (b, a) };
    let (s, c) = small.yaw.sin_cos();
    let mut inside = 0;
    for i in 0..7 {
        for j in 0..7 {
            let u = (f64::from(i) / 6.0 - 0.5) * small.size[0];
            let v = (f64::from(j) / 6.0 - 0.5) * small.size[1];
            let p = [small.center[0] + c * u - s * v, small.center[1] + s * u + c * v];
            inside += u32::from(large.plan_distance(p) == 0.0);
        }
    }
    f64::from(inside) >= OVER * 49.0
}

/// Whether two thin things hang in one plane at one height, near each other.
fn is_pair(a: &UprightBox, b: &UprightBox) -> bool {
    let thin = |b: &UprightBox| b.size[1] <= THIN && b.size[2] >= HIGH;
    if !thin(a) || !thin(b) || a.plan_gap(b) > PAIR {
        return false;
    }
    let ([al, ah], [bl, bh]) = (a.heights(), b.heights());
    if (al - bl).abs() > 0.25 || (ah - bh).abs() > 0.25 {
        return false;
    }
    let d = b.plan_center() - a.plan_center();
    // Both lie along the line between them: narrow ones may be wider than long in plan.
    let off = |x: &UprightBox| (x.side().dot(d) / d.x.hypot(d.y).max(1e-9)).abs();
    let along = |x: &UprightBox| off(x) > 0.98 || x.size[0] < 0.35;
    along(a) && along(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(
        out: &mut Vec<[f32; 3]>,
        low: [f32; 3],
        size: [f32; 3],
        count: [usize; 3],
    ) -> Vec<u32> {
        let start = out.len() as u32;
        let at = |i: usize, n: usize, s: f32| s * i as f32 / (n.max(2) - 1) as f32;
        for i in 0..count[0] {
            for j in 0..count[1] {
                for k in 0..count[2] {
                    let step = [
                        at(i, count[0], size[0]),
                        at(j, count[1], size[1]),
                        at(k, count[2], size[2]),
                    ];
                    out.push([0, 1, 2].map(|a| low[a] + step[a]));
                }
            }
        }
        (start..out.len() as u32).collect()
    }

    #[test]
    fn a_shade_over_its_foot_is_one_lamp_and_two_lamps_are_two() {
        let mut coord = Vec::new();
        let foot = block(&mut coord, [0.0; 3], [0.2, 0.2, 0.02], [6, 6, 2]);
        let shade = block(&mut coord, [-0.05, -0.05, 0.3], [0.3, 0.3, 0.2], [8, 8, 4]);
        let other = block(&mut coord, [1.0, 0.0, 0.0], [0.2, 0.2, 0.5], [6, 6, 6]);
        let found = join(vec![foot, shade, other], &coord, 0.1, 1, false);
        assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [72 + 256, 216]);
    }

    #[test]
    fn two_halves_of_a_curtain_are_one_and_two_pictures_two() {
        let mut coord = Vec::new();
        let left = block(&mut coord, [0.0; 3], [0.5, 0.08, 2.0], [10, 2, 20]);
        let right = block(&mut coord, [1.7, 0.0, 0.0], [0.5, 0.08, 2.0], [10, 2, 20]);
        let pieces = vec![left, right];
        assert_eq!(join(pieces.clone(), &coord, 0.1, 1, true).len(), 1);
        assert_eq!(join(pieces, &coord, 0.1, 1, false).len(), 2);
    }

    #[test]
    fn a_small_fragment_goes_to_the_nearest_large_piece() {
        let mut coord = Vec::new();
        let one = block(&mut coord, [0.0; 3], [1.0; 3], [6, 6, 6]);
        let two = block(&mut coord, [2.0, 0.0, 0.0], [1.0; 3], [6, 6, 6]);
        let bit = block(&mut coord, [1.85, 0.5, 0.5], [0.05; 3], [2, 2, 2]);
        let found = join(vec![one, two, bit], &coord, 0.1, 1, false);
        assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [216, 224]);
    }

    #[test]
    fn a_curtain_and_a_wardrobe_are_no_pair() {
        let at = |x: f64, depth: f64| UprightBox {
            center: [x, 0.0, 1.0],
            size: [0.5, depth, 2.0],
            yaw: 0.0,
        };
        let (left, right) = (at(0.0, 0.08), at(1.0, 0.08));
        assert!(is_pair(&left, &right));
        for thick in [is_pair(&left, &at(1.0, 0.45)), is_pair(&at(0.0, 0.45), &right)] {
            assert!(!thick);
        }
    }

    #[test]
    fn sides_of_a_wall_are_parallel_whichever_way_their_yaw_is_counted() {
        let side =
            |x: f64, yaw: f64| UprightBox { center: [x, 0.0, 1.25], size: [3.0, 0.05, 2.5], yaw };
        // Both lie along y, 12 cm apart; 1.57 and -1.57 are half a turn apart, less 0.1 degrees.
        let one = side(0.0, 1.57);
        assert!(are_sides(&one, &side(0.12, 1.57)));
        assert!(are_sides(&one, &side(0.12, -1.57)));
        assert!(are_sides(&side(0.0, -1.57), &side(0.12, 1.57)));
        assert!(!are_sides(&one, &side(0.12, 0.0)), "one across the other");
        assert!(!are_sides(&one, &side(0.5, -1.57)), "too far apart");
    }

    #[test]
    fn a_fragment_joins_by_its_share_and_its_distance() {
        // Lines of 100 and of a few Gaussians, one above another in plan; how many pieces are left.
        let left = |few: usize, beside: f32, over: f32, min_count: usize| {
            let mut coord = Vec::new();
            let long = block(&mut coord, [0.0; 3], [1.0, 0.0, 0.0], [100, 1, 1]);
            let short = block(&mut coord, [0.2, beside, over], [0.1, 0.0, 0.0], [few, 1, 1]);
            join(vec![short, long], &coord, 0.1, min_count, false).len()
        };
        // 35 of 100 at most, 2.5 gaps of 0.1 m.
        assert_eq!([left(35, 0.2, 0.0, 1), left(36, 0.2, 0.0, 1)], [1, 2]);
        assert_eq!([left(9, 0.24, 0.0, 1), left(9, 0.26, 0.0, 1)], [1, 2]);
        assert_eq!([left(9, 0.15, 0.19, 1), left(9, 0.15, 0.21, 1)], [1, 2]);
        // What is no object takes nothing in.
        assert_eq!([left(9, 0.2, 0.0, 100), left(9, 0.2, 0.0, 101)], [1, 2]);
        // Plates of 64 above each other join over 0.35 m.
        let stacked = |over: f32| {
            let mut coord = Vec::new();
            let plates =
                [0.0, over].map(|z| block(&mut coord, [0.0, 0.0, z], [0.5, 0.4, 0.0], [8, 8, 1]));
            join(plates.to_vec(), &coord, 0.01, 1, false).len()
        };
        assert_eq!([stacked(0.34), stacked(0.36)], [1, 2]);
        // The nearest takes it, of equally near ones the larger; rows rise in a piece, pieces keep their order.
        let owner = |y: f32| {
            let mut coord = Vec::new();
            let bit = block(&mut coord, [0.0, y, 0.0], [0.1, 0.0, 0.0], [4, 1, 1]);
            let lines = [(0.0, 50), (0.25, 60)]
                .map(|(y, n)| block(&mut coord, [0.0, y, 0.0], [1.0, 0.0, 0.0], [n, 1, 1]));
            let found = join(vec![lines[0].clone(), bit, lines[1].clone()], &coord, 0.1, 1, false);
            assert!(found.iter().all(|rows| rows.is_sorted()));
            [found[0].len(), found[1].len()]
        };
        assert_eq!([owner(0.1), owner(0.15), owner(0.125)], [[54, 60], [50, 64], [50, 64]]);
    }

    #[test]
    fn boxes_are_over_each_other_pairs_and_sides_up_to_their_limits() {
        let at = |center: [f64; 3], size: [f64; 3], yaw: f64| UprightBox { center, size, yaw };
        // Of 7 columns of a plan of 1 m five lie over what begins at −0.25, four at −0.1: 0.6 of 49 are 29.4.
        let small = at([0.0; 3], [1.0, 1.0, 1.0], 0.0);
        let large = |edge: f64| at([edge + 2.0, 0.3, 5.0], [4.0, 3.0, 1.0], 0.0);
        for (edge, over) in [(-0.25, true), (-0.1, false)] {
            assert_eq!(
                (is_over(&small, &large(edge)), is_over(&large(edge), &small)),
                (over, over)
            );
        }
        // Turned a quarter, a long one is over what lies along y.
        let shelf = at([0.0; 3], [2.0, 0.1, 0.1], std::f64::consts::FRAC_PI_2);
        assert!(is_over(&shelf, &at([0.0; 3], [3.0, 0.4, 0.1], std::f64::consts::FRAC_PI_2)));
        assert!(!is_over(&shelf, &at([0.0; 3], [3.0, 0.4, 0.1], 0.0)));
        let left = at([0.0, 0.0, 1.0], [0.5, 0.08, 2.0], 0.0);
        let pair =
            |center: [f64; 3], size: [f64; 3], yaw: f64| is_pair(&left, &at(center, size, yaw));
        let cases = [
            (pair([2.69, 0.0, 1.0], [0.5, 0.08, 2.0], 0.0), true, "2.19 m between them"),
            (pair([2.71, 0.0, 1.0], [0.5, 0.08, 2.0], 0.0), false, "2.21 m"),
            (pair([1.0, 0.0, 1.1], [0.5, 0.3, 2.28], 0.0), true, "0.04 m lower and 0.24 m higher"),
            (pair([1.0, 0.0, 1.14], [0.5, 0.08, 2.26], 0.0), false, "0.27 m higher"),
            (pair([1.0, 0.0, 0.86], [0.5, 0.08, 2.26], 0.0), false, "0.27 m lower"),
            (pair([1.0, 0.0, 1.0], [0.5, 0.31, 2.0], 0.0), false, "too thick"),
            (pair([1.0, 0.15, 1.0], [0.5, 0.08, 2.0], 0.0), true, "0.989 along the line between"),
            (pair([1.0, 0.25, 1.0], [0.5, 0.08, 2.0], 0.0), false, "0.970"),
            (pair([1.0, 0.0, 1.0], [0.36, 0.08, 2.0], 1.0), false, "turned"),
            (pair([1.0, 0.0, 1.0], [0.34, 0.08, 2.0], 1.0), true, "turned, but narrow"),
        ];
        for (found, want, text) in cases {
            assert_eq!(found, want, "{text}");
        }
        let low = |high: f64| at([0.0, 0.0, high / 2.0], [0.5, 0.08, high], 0.0);
        let beside = |high: f64| at([1.0, 0.0, high / 2.0], [0.5, 0.08, high], 0.0);
        assert_eq!([0.81, 0.79].map(|high| is_pair(&low(high), &beside(high))), [true, false]);
        let wall = |size: [f64; 3]| is_wall(&at([0.0; 3], size, 0.0));
        let sizes = [[1.01, 0.29, 0.81], [0.99, 0.2, 2.0], [2.0, 0.31, 2.0], [2.0, 0.2, 0.79]];
        assert_eq!(sizes.map(wall), [true, false, false, false]);
        // Of two walls along x, 5 cm thick: what is 19 cm between them, not 21; 0.7 of the shorter in common.
        let one = at([0.0, 0.0, 1.0], [3.0, 0.05, 2.0], 0.0);
        let side =
            |center: [f64; 3], size: [f64; 3], yaw: f64| are_sides(&one, &at(center, size, yaw));
        let found = [
            side([0.0, 0.24, 1.0], [3.0, 0.05, 2.0], 0.0),
            side([0.0, 0.26, 1.0], [3.0, 0.05, 2.0], 0.0),
            side([1.79, 0.1, 1.0], [2.0, 0.05, 2.0], 0.0),
            side([1.0, 0.1, 1.0], [2.0, 0.05, 2.0], 0.0),
            side([1.2, 0.1, 1.0], [2.0, 0.05, 2.0], 0.0),
            side([0.0, 0.1, 3.1], [3.0, 0.05, 2.0], 0.0),
            side([0.0, 0.1, 1.0], [3.0, 0.05, 2.0], 0.09),
            side([0.0, 0.1, 1.0], [3.0, 0.05, 2.0], 0.11),
        ];
        assert_eq!(found, [true, false, false, true, false, false, true, false]);
    }

    #[test]
    fn sides_of_a_wall_become_one_piece() {
        let mut coord = Vec::new();
        let wall = |coord: &mut Vec<[f32; 3]>, y: f32, high: f32| {
            block(coord, [0.0, y, 0.0], [2.0, 0.02, high], [20, 2, 10])
        };
        let pieces = vec![
            wall(&mut coord, 0.0, 2.0),
            wall(&mut coord, 3.0, 2.0),
            wall(&mut coord, 0.15, 2.0),
            wall(&mut coord, 3.1, 0.5),
        ];
        let found = join_sides(pieces, &coord);
        assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [800, 400, 400]);
        assert!(found[0].contains(&0) && found[0].contains(&800));
        let empty = vec![vec![0], Vec::new()];
        assert_eq!(
            (join(empty.clone(), &coord, 0.1, 1, false), join_sides(empty.clone(), &coord)),
            (empty.clone(), empty)
        );
    }
}
