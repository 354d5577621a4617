//! Pieces with panels across them, such as a row of cupboards, split between these panels.

use crate::cells::distinct;
use crate::upright_box::UprightBox;
use glam::DVec2;

/// No row of boxes is longer or higher, meters; strays far out lie in one cell and are one piece.
const FARTHEST: f64 = 1000.0;
/// Width of the bins along the piece, meters.
const BIN: f64 = 0.02;
/// A Gaussian faces along the piece within this cosine.
const FACING: f32 = 0.85;
/// Panels are at least so far apart, meters.
const APART: f64 = 0.38;
/// Parts are alike: the emptiest has at least this share of the surface of the fullest, for its length. The knees of a
/// desk and its drawers are not.
const ALIKE: f64 = 0.5;
/// Part of its cross-section that a panel must cover.
const COVER: f64 = 0.3;
/// Cells of the cross-section, meters.
const CELL: f64 = 0.08;

/// The parts of a piece between panels that cross it, at least two; `None` for anything else.
///
/// `facing`: cosine of a Gaussian's normal with a direction in plan; `None` where it is not flat.
pub(crate) fn split(
    rows: &[u32],
    coord: &[[f32; 3]],
    facing: impl Fn(u32, [f32; 2]) -> Option<f32>,
) -> Option<Vec<Vec<u32>>> {
    let around = UprightBox::around(coord, rows)?;
    let [long, deep, high] = around.size;
    if !(long <= FARTHEST && high <= FARTHEST) {
        return None;
    }
    if long < 2.0 * APART || deep < 0.25 || high < 0.3 || long < 1.3 * deep {
        return None;
    }
    let side = around.side();
    let along = |row: u32| {
        let [x, y, z] = coord[row as usize].map(f64::from);
        let [t, u] = around.in_plan(DVec2::new(x, y));
        [t + long / 2.0, u + deep / 2.0, z]
    };
    let bins = (long / BIN).ceil() as usize + 1;
    let mut across: Vec<Vec<[i32; 2]>> = vec![Vec::new(); bins];
    let plan = [side.x as f32, side.y as f32];
    for &row in rows.iter().filter(|row| facing(**row, plan).is_some_and(|f| f.abs() > FACING)) {
        let [t, u, z] = along(row);
        if t >= 0.0 && t <= long {
            across[(t / BIN) as usize].push([u, z].map(|v| (v / CELL).floor() as i32));
        }
    }
    // A panel is as thick as its noise: two bins together.
    let full = ((deep / CELL).ceil() * (high / CELL).ceil()).max(1.0);
    let cover: Vec<f64> = (0..bins)
        .map(|i| {
            let cells = across[i.saturating_sub(1)..=i].iter().flatten().copied();
            distinct(cells).len() as f64 / full
        })
        .collect();
    let cuts = cuts(&cover, long);
    if cuts.is_empty() {
        return None;
    }
    let mut parts: Vec<Vec<u32>> = vec![Vec::new(); cuts.len() + 1];
    for &row in rows {
        parts[cuts.partition_point(|cut| *cut < along(row)[0])].push(row);
    }
    let ends: Vec<f64> = std::iter::once(0.0).chain(cuts).chain([long]).collect();
    let fullness = parts.iter().zip(ends.windows(2)).map(|(part, ends)| {
        let cell = |&row: &u32| along(row).map(|v| (v / CELL).floor() as i32);
        distinct(part.iter().map(cell)).len() as f64 / (ends[1] - ends[0])
    });
    let (least, most) = fullness.fold((f64::INFINITY, 0.0), |(l, m), f| (f.min(l), f.max(m)));
    if least < ALIKE * most {
        return None;
    }
    parts.retain(|p| !p.is_empty());
    parts.sort_unstable_by_key(|p| p.first().copied());
    (parts.len() > 1).then_some(parts)
}

/// Where panels are along a piece of this length, the fullest first where two are too near each other.
fn cuts(cover: &[f64], long: f64) -> Vec<f64> {
    let mut order: Vec<usize> = (0..cover.len()).filter(|&i| cover[i] >= COVER).collect();
    order.sort_by(|&a, &b| cover[b].total_cmp(&cover[a]).then(a.cmp(&b)));
    let mut cuts: Vec<f64> = Vec::new();
    for at in order.into_iter().map(|i| i as f64 * BIN) {
        let inside = at > APART && at < long - APART;
        if inside && cuts.iter().all(|cut| (cut - at).abs() > APART) {
            cuts.push(at);
        }
    }
    cuts.sort_unstable_by(f64::total_cmp);
    cuts
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three hollow boxes in a row; their faces with normals.
    fn cupboards() -> (Vec<[f32; 3]>, Vec<[f32; 2]>) {
        let (mut coord, mut normal) = (Vec::new(), Vec::new());
        for unit in 0..3 {
            let start = unit as f32 * 0.61;
            for i in 0..20 {
                for k in 0..20 {
                    let (a, b) = (i as f32 * 0.03, k as f32 * 0.04);
                    for x in [0.0, 0.6] {
                        coord.push([start + x, a, b]);
                        normal.push([1.0, 0.0]);
                    }
                    coord.push([start + a, 0.6, b]);
                    normal.push([0.0, 1.0]);
                }
            }
        }
        (coord, normal)
    }

    #[test]
    fn cupboards_are_split_between_their_sides() {
        let (coord, normal) = cupboards();
        let rows: Vec<u32> = (0..coord.len() as u32).collect();
        let facing = |row: u32, d: [f32; 2]| {
            let n = normal[row as usize];
            Some(n[0] * d[0] + n[1] * d[1])
        };
        let parts = split(&rows, &coord, facing).unwrap();
        assert_eq!(parts.len(), 3);
        for (part, unit) in parts.iter().zip(0..) {
            let own = part.iter().filter(|r| **r / 1200 == unit).count();
            assert!(own > 780, "unit {unit}: {own} of {}", part.len());
        }
        assert_eq!(split(&rows, &coord, |_, _| None), None);
        let one: Vec<u32> = (0..1200).collect();
        assert_eq!(split(&one, &coord, facing), None);
    }

    /// Gaussians every 5 cm of drawers, 65 cm long, 60 cm deep and 80 cm high; of a panel at 71 cm; and of what is from
    /// 75 cm to 1.5 m at these heights (in 5 cm). How many are of drawers and panel.
    fn desk(right: &std::ops::RangeInclusive<u8>) -> (Vec<[f32; 3]>, [u32; 2]) {
        let mut coord = Vec::new();
        let mut add = |x: f32, heights: std::ops::RangeInclusive<u8>| {
            for y in 0..=12_u8 {
                let y = f32::from(y) * 0.05;
                coord.extend(heights.clone().map(|z| [x, y, f32::from(z) * 0.05]));
            }
        };
        (0..=13_u8).for_each(|x| add(f32::from(x) * 0.05, 0..=16));
        add(0.71, 0..=16);
        (15..=30_u8).for_each(|x| add(f32::from(x) * 0.05, right.clone()));
        // 14 and 1 slices of 13 by 17.
        (coord, [14 * 13 * 17, 13 * 17])
    }

    #[test]
    fn the_knees_of_a_desk_are_not_split_from_its_drawers() {
        let parts = |right: std::ops::RangeInclusive<u8>| {
            let (coord, [drawers, panel]) = desk(&right);
            let rows: Vec<u32> = (0..coord.len() as u32).collect();
            // The panel alone is flat, and faces along x.
            let facing =
                |row: u32, d: [f32; 2]| (drawers..drawers + panel).contains(&row).then_some(d[0]);
            let parts = split(&rows, &coord, facing);
            parts.map(|parts| parts.iter().map(Vec::len).collect::<Vec<_>>())
        };
        // In cells of 8 cm the drawers have 9 * 8 * 11 over 0.7 m, 1131 a meter. Panel and table top have 8 * 11 and
        // 10 * 8 over 0.75 m, 224 a meter: less than half of it.
        assert_eq!(parts(16..=16), None);
        // With drawers at both sides it is 1131 and 1210 a meter, and the panel parts them: 13 * 17 Gaussians of it and
        // 16 such slices at its right.
        assert_eq!(parts(0..=16), Some(vec![14 * 13 * 17, 17 * 13 * 17]));
    }

    #[test]
    fn a_panel_between_two_bins_is_one() {
        let parts = |[left, right]: [f32; 2]| {
            // Drawers at both sides without the panel between them, which has 5 of 12 depths at 11 of 16 heights.
            let (mut coord, [drawers, panel]) = desk(&(0..=16));
            coord.drain(drawers as usize..(drawers + panel) as usize);
            let first = coord.len() as u32;
            for y in 0..=4_u8 {
                let y = f32::from(y) * 0.05;
                let mut add = |x: f32, heights: &[u8]| {
                    coord.extend(heights.iter().map(|z| [x, y, f32::from(*z) * 0.05]));
                };
                add(left, &[0, 2, 4, 6, 8, 10]);
                add(right, &[7, 12, 14, 15, 16]);
            }
            let rows: Vec<u32> = (0..coord.len() as u32).collect();
            let facing = |row: u32, d: [f32; 2]| (row >= first).then_some(d[0]);
            split(&rows, &coord, facing).map_or(1, |parts| parts.len())
        };
        // Bins of 2 cm: in one, in two that are neighbors, and in two that are not.
        assert_eq!([parts([0.71, 0.71]), parts([0.71, 0.73]), parts([0.69, 0.73])], [2, 2, 1]);
    }

    #[test]
    fn panels_are_cut_where_they_cover_enough_and_lie_apart() {
        let of = |covers: &[(usize, f64)]| {
            let mut cover = vec![0.0; 101];
            covers.iter().for_each(|(i, c)| cover[*i] = *c);
            let found: Vec<i32> =
                cuts(&cover, 2.0).iter().map(|cut| (cut * 100.0).round() as i32).collect();
            found
        };
        // Centimeters. From 0.38 m of either end on; 0.3 of the cross-section.
        assert_eq!(of(&[(18, 0.9), (20, 0.5), (80, 0.3), (82, 0.9)]), [40, 160]);
        assert_eq!(of(&[(50, 0.29)]), Vec::<i32>::new());
        // The fullest of those within 0.38 m, of equal ones the first; then what is left.
        assert_eq!(of(&[(30, 0.5), (40, 0.8), (58, 0.7), (60, 0.6)]), [80, 120]);
        assert_eq!(of(&[(50, 0.5), (51, 0.5), (75, 0.4)]), [100, 150]);
        // Before the fullest as well as behind it.
        assert_eq!(of(&[(25, 0.5), (60, 0.9)]), [50, 120]);
    }

    #[test]
    fn what_is_too_small_or_too_short_is_no_row_of_boxes() {
        let (coord, normal) = cupboards();
        let parts = |scale: [f32; 3], facing: f32| {
            let coord: Vec<[f32; 3]> =
                coord.iter().map(|c| [0, 1, 2].map(|k| scale[k] * c[k])).collect();
            let rows: Vec<u32> = (0..coord.len() as u32).collect();
            let found = split(&rows, &coord, |row, d| {
                let n = normal[row as usize];
                Some(facing * (n[0] * d[0] + n[1] * d[1]))
            });
            found.map_or(1, |parts| parts.len())
        };
        // 1.82 m long, 0.6 m deep, 0.76 m high.
        assert_eq!(
            [parts([1.0, 0.45, 1.0], 1.0), parts([1.0, 0.4, 1.0], 1.0)],
            [3, 1],
            "0.27 and 0.24 m deep"
        );
        assert_eq!(
            [parts([1.0, 1.0, 0.42], 1.0), parts([1.0, 1.0, 0.38], 1.0)],
            [3, 1],
            "0.32 and 0.29 m high"
        );
        assert_eq!(
            [parts([1.0, 1.0, 1.0], 0.86), parts([1.0, 1.0, 1.0], -0.84)],
            [3, 1],
            "off the axis"
        );
        assert_eq!([parts([1.0; 3], -1.0), parts([1.0, 2.4, 1.0], 1.0)], [3, 1], "1.44 m deep");
        assert_eq!(parts([600.0, 1.0, 1.0], 1.0), 1, "farther than anything");
    }
}
